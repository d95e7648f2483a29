"""Power and temperature hand in hand, however the samples are cut."""

from __future__ import annotations

from array import array
from hashlib import sha256
from math import exp
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.channels import CHANNELS
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.estimator.coupling import Coupling
from bstm_daemon.estimator.estimator import PUBLISH_US, ROWS, STEP_US
from bstm_daemon.model.heat.friction_law import FrictionLaw
from bstm_daemon.model.heat.memory import SampleState
from bstm_daemon.model.heat.sample_pass import DONE
from bstm_daemon.model.heat.sample_plan import plan_samples
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.config.sections import Config

FADE = FrictionLaw.of(
    temperature_k=lambda t: 1.0 - 0.3 / (1.0 + exp((500.0 - t) / 45.0))
)
LINE_US = 3_000_000
ROLES = ("vehicle_speed", "primary_pressure")


class Brakes:
    """A coupling with its state and batch, fed in pieces."""

    def __init__(
        self, config: Config, law: FrictionLaw | None, room: int = ROWS
    ) -> None:
        names = [corner.name for corner in config.corner]
        laws = {} if law is None else dict.fromkeys(names, law)
        present = {ROLE_INDEX[role]: 500_000 for role in ROLES}
        plan = plan_samples(config, present, STEP_US, laws=laws)
        kernel = load_kernel()
        programs = [compile_corner(config, c) for c in config.corner]
        batch = Batch(programs, 300.0, None, kernel, len(names))
        self.batches = [(batch, names)]
        self.state = SampleState.new()
        self.coupling = Coupling(
            plan, kernel, room, (PUBLISH_US, LINE_US), coupled=bool(laws)
        )
        self.rows, self.outputs = array("d"), array("d")
        self.width = len(names) * len(CHANNELS)

    def feed(self, samples: Sequence[tuple[int, str, float]]) -> Brakes:
        times = array("q", [s[0] for s in samples])
        roles = array("i", [ROLE_INDEX[s[1]] for s in samples])
        values = array("d", [s[2] for s in samples])
        index = 0
        while index < len(times):
            index, steps, code, outputs = self.coupling.fill(
                self.state, self.batches, times, roles, values, index
            )
            self.rows.extend(self.coupling.rows[: steps * self.width])
            self.outputs.extend(outputs[0])
        assert code == DONE
        return self

    def bits(self) -> list[str]:
        """Return digests of all that was written and remembered."""
        parts = (
            *(self.rows, self.outputs, self.state.numbers),
            self.batches[0][0].state,
        )
        return [sha256(part.tobytes()).hexdigest() for part in parts]

    def power(self) -> list[float]:
        return list(self.rows[CHANNELS.index("brake_power_w") :: self.width])


def stop(seconds: float = 12.0) -> list[tuple[int, str, float]]:
    """Return samples at 35 m/s and 30 bar: hot at once."""
    return [
        (at, role, value)
        for at in range(33_000, round(seconds * 1e6), 10_000)
        for role, value in zip(ROLES, (35.0, 30e5), strict=True)
    ]


@pytest.fixture
def car(make_car: Any, make_corner: Callable[..., Any]) -> Config:
    """Return a car with two brakes."""
    config: Config = make_car(make_corner("FL"), make_corner("FR"))
    return config


def test_the_interface_is_the_mean_of_disc_and_face(car: Config) -> None:
    """As the friction law takes it after a restart, each corner its own."""
    brakes, laws = Brakes(car, FADE), {}
    (batch, _) = brakes.batches[0]
    for corner in range(2):
        first = corner * batch.width
        for node, kelvin in (("disc", 700.0), ("pad_front", 500.0)):
            place = first + batch.names.index(node)
            batch.state[place] = kelvin + 10.0 * corner
    taken: Any = SimpleNamespace(heat_interface=laws.__setitem__)

    brakes.coupling.heat_interfaces(taken, brakes.batches)

    assert laws == {0: 600.0, 1: 610.0}


def test_pieces_change_no_bit(car: Config) -> None:
    """A sample at a time as live, all at once as in replay, little room."""
    whole = Brakes(car, FADE).feed(stop())
    live = Brakes(car, FADE)
    for sample in stop():
        live.feed([sample])

    assert live.bits() == whole.bits()
    assert Brakes(car, FADE, 7).feed(stop()).bits() == whole.bits()


def test_power_falls_as_the_brake_gets_hot(car: Config) -> None:
    faded = Brakes(car, FADE).feed(stop())
    power = faded.power()
    batch = faded.batches[0][0]
    nodes = batch.programs[0].state_names
    between_k = 0.5 * sum(
        batch.state[nodes.index(name)] for name in ("disc", "pad_front")
    )
    cold = Brakes(car, None).feed(stop()).power()[0]

    assert power[0] == pytest.approx(cold, rel=0.01)
    assert between_k > 500.0
    told_k = faded.state.interface_k(0)
    assert told_k == pytest.approx(between_k, abs=5.0)
    factor = 1.0 - 0.3 / (1.0 + exp((told_k - 500.0) / -45.0))
    assert power[-1] == pytest.approx(factor * power[5], rel=0.02)


def test_uncoupled_it_is_the_pass_and_the_march(car: Config) -> None:
    plain = Brakes(car, None).feed(stop())

    assert plain.state.interface_k(0) == 0.0
    assert plain.bits() == Brakes(car, None, 7).feed(stop()).bits()

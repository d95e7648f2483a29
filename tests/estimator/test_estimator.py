"""The estimator: one path for one row and for a million."""

from __future__ import annotations

from array import array
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.channels import CHANNELS, FLAGS, VEHICLE_CHANNELS
from bstm_daemon.errors import ConfigError, UsageError
from bstm_daemon.estimate import Validity
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.native.loader import VARIABLE, Kernel
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.estimator.blocks import Block

SECOND = 1_000_000
Samples = list[tuple[int, int, float]]
SPEED, PRESSURE = ROLE_INDEX["vehicle_speed"], ROLE_INDEX["primary_pressure"]
PRESENT = {SPEED: 500_000, PRESSURE: 500_000}


def samples_of(
    seconds: float,
    start_us: int = 0,
    speed: float = 15.0,
    pressure: float = 1e6,
    every_us: int = 20_000,
) -> Samples:
    """Return held speed and pressure."""
    return [
        (at, role, value)
        for at in range(start_us, start_us + round(seconds * 1e6), every_us)
        for role, value in ((SPEED, speed), (PRESSURE, pressure))
    ]


def feed(
    estimator: Estimator, samples: Sequence[tuple[int, int, float]]
) -> Any:
    """Advance by *samples* in one call."""
    return estimator.advance(
        array("q", [s[0] for s in samples]),
        array("i", [s[1] for s in samples]),
        array("d", [s[2] for s in samples]),
    )


def joined(blocks: list[Block]) -> tuple[Any, ...]:
    """Return all that the blocks publish, as one."""
    times, rows, vehicle = array("q"), array("d"), array("d")
    flags = array("q")
    outputs: dict[int, array[float]] = {}
    validity: dict[str, array[int]] = {}
    for block in blocks:
        times.extend(block.times_us)
        rows.extend(block.rows)
        vehicle.extend(block.vehicle)
        flags.extend(block.flags)
        for group, output in enumerate(block.outputs):
            outputs.setdefault(group, array("d")).extend(output)
        for corner, valid in block.validity.items():
            validity.setdefault(corner, array("b")).extend(valid)
            own = validity.setdefault(f"{corner} reasons", array("B"))
            own.extend(block.reasons[corner])
        validity.setdefault("", array("b")).extend(block.disagrees)
    return (
        *(times.tolist(), rows.tobytes(), vehicle.tobytes(), flags.tolist()),
        {group: output.tobytes() for group, output in outputs.items()},
        {corner: valid.tolist() for corner, valid in validity.items()},
    )


@pytest.fixture
def form(monkeypatch: pytest.MonkeyPatch, kernel: Kernel | None) -> str:
    """Let the estimator take one form of the kernel, then the other."""
    name = "reference" if kernel is None else "compiled"
    monkeypatch.setenv(VARIABLE, name)
    return name


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch, compiled: Kernel) -> Kernel:
    """Let the estimator take the compiled form: hours of data time."""
    monkeypatch.setenv(VARIABLE, "compiled")
    return compiled


@pytest.fixture(scope="module")
def car(make_car: Any, make_corner: Any) -> Any:
    """Return four corners of three kinds: two alike, an effect, a drum."""
    drum = make_corner("RL", type="drum", disc=None, pad=None)
    return make_car(
        *(make_corner("FL"), make_corner("FR"), drum, make_corner("RR")),
        effect=[{"name": "caliper_fluid_split", "corner": "FR"}],
    )


def test_forms_agree(
    monkeypatch: pytest.MonkeyPatch, compiled: Kernel, car: Any
) -> None:
    """Pass and march, bit for bit, in pure Python and compiled."""
    assert compiled is not None
    found = []
    for name in ("reference", "compiled"):
        monkeypatch.setenv(VARIABLE, name)
        estimator = Estimator(car, PRESENT)
        assert estimator.compiled is (name == "compiled")
        found.append(joined(feed(estimator, samples_of(10.0))))
    assert found[0] == found[1]


@settings(max_examples=10, deadline=None)
@given(cuts=st.lists(st.integers(0, 400), max_size=8))
def test_chunks_never_change_a_number(car: Any, cuts: list[int]) -> None:
    """Cut anywhere: braking, silence, a late stamp, a clock set back."""
    samples = [
        *samples_of(3.0),
        (2_500_000, SPEED, 14.0),
        (5_000_000, TICK, 0.0),
        *samples_of(2.0, -60 * SECOND),
    ]
    whole = joined(feed(Estimator(car, PRESENT), samples))
    places = sorted({0, len(samples), *(min(c, len(samples)) for c in cuts)})
    pieces = Estimator(car, PRESENT)
    blocks: list[Block] = []
    for first, last in pairwise(places):
        blocks += feed(pieces, samples[first:last])
    assert joined(blocks) == whole


def test_one_row_at_a_time(form: str, car: Any) -> None:
    """As live: the same numbers as the whole column."""
    del form
    samples = samples_of(2.0)
    whole = joined(feed(Estimator(car, PRESENT), samples))
    rows = Estimator(car, PRESENT)
    blocks: list[Block] = []
    for sample in samples:
        blocks += feed(rows, [sample])
    assert joined(blocks) == whole


def test_more_steps_than_one_march_holds(fast: Kernel, car: Any) -> None:
    """Ten minutes of silence in one tick are 12000 steps, all published."""
    assert fast is not None
    estimator = Estimator(car, PRESENT)
    found = joined(feed(estimator, [(0, SPEED, 0.0), (600 * SECOND, TICK, 0)]))
    assert found[0] == list(range(100_000, 600 * SECOND + 1, 100_000))


@pytest.mark.slow
@pytest.mark.usefixtures("all_verified")
def test_history_is_known_from_its_moment_on(fast: Kernel, car: Any) -> None:
    """Validity does not depend on how the stream is cut either."""
    assert fast is not None
    stream: Samples = [
        sample
        for at in range(0, 7200 * SECOND, 400_000)
        for sample in ((at, SPEED, 10.0), (at, PRESSURE, 0.0))
    ]
    whole = joined(feed(Estimator(car, PRESENT), stream))
    pieces = Estimator(car, PRESENT)
    blocks: list[Block] = []
    for first in range(0, len(stream), 1000):
        blocks += feed(pieces, stream[first : first + 1000])
    assert joined(blocks)[5] == whole[5]
    validity = whole[5]["FL"]
    assert validity[0] == Validity.DEGRADED
    assert validity[-1] == Validity.VALID


@pytest.mark.parametrize(
    "start_us", [0, 30_000, 50_000, -70_001, 7 * 3600 * SECOND]
)
def test_publication_grid(car: Any, start_us: int) -> None:
    """Whole multiples of 100 ms, none missing."""
    found = joined(feed(Estimator(car, PRESENT), samples_of(3.0, start_us)))
    times = found[0]
    assert {at % 100_000 for at in times} == {0}
    assert times == list(range(times[0], times[-1] + 1, 100_000))
    assert times[0] - start_us <= 100_000
    assert start_us + 3 * SECOND - times[-1] <= 120_000


def test_groups_give_the_numbers_of_a_corner_alone(
    form: str, car: Any, make_car: Any, make_corner: Any
) -> None:
    """FL and RR share a structure, FR has one of its own; none disturbs."""
    del form
    together = Estimator(car, PRESENT)
    feed(together, samples_of(4.0))
    assert {g.corners for g in together.groups} == {("FL", "RR"), ("FR",)}
    for name in ("FL", "FR", "RR"):
        alone = Estimator(
            make_car(make_corner(name), effect=car.effect), PRESENT
        )
        feed(alone, samples_of(4.0))
        assert together.state(name) == alone.state(name)
    assert "caliper" in together.state("FR")
    assert "caliper" not in together.state("FL")


def test_drum_gets_power_but_no_state(car: Any) -> None:
    """Its energy is in the rows; a temperature is not."""
    estimator = Estimator(car, PRESENT)
    (block,) = feed(estimator, samples_of(2.0))
    width = len(CHANNELS)
    power = block.rows[2 * width + CHANNELS.index("brake_power_w")]
    per_pa = 2.83e-3 * 2.0 * 0.13
    assert power == pytest.approx(per_pa * 1e6 * 15.0 / 0.3418)
    with pytest.raises(KeyError):
        estimator.state("RL")
    assert set(block.validity) == {"FL", "FR", "RR"}


def test_blocks_have_the_sizes_they_say(car: Any) -> None:
    """Rows, vehicle, outputs, flags and validity per publication."""
    estimator = Estimator(car, PRESENT)
    (block,) = feed(estimator, [*samples_of(2.0), (2 * SECOND, TICK, 0.0)])
    n = len(block.times_us)
    assert len(block.rows) == n * 4 * len(CHANNELS)
    assert len(block.vehicle) == n * len(VEHICLE_CHANNELS)
    assert len(block.flags) == n
    for group, output in zip(estimator.groups, block.outputs, strict=True):
        assert len(output) == n * len(group.corners) * group.size
        last = output[-group.size :][: len(group.state_names)]
        state = estimator.state(group.corners[-1])
        assert dict(zip(group.state_names, last, strict=True)) == state


def test_temperatures_hold_the_energy(form: str, make_car: Any) -> None:
    """What the pass counts as friction energy is what the nodes took."""
    del form
    car = make_car(
        vehicle={"ambient_c": 20.0},
        cooling={"speed_ms": [0.0, 50.0], "s_per_s": [0.0, 0.0]},
        thermal={
            "pad_dynamic_convection_ws_m3k": 0.0,
            "fluid_static_convection_w_k": 0.0,
            "fluid_dynamic_convection_ws_mk": 0.0,
        },
    )
    estimator = Estimator(car, PRESENT)
    samples = [*samples_of(20.0), (20 * SECOND, TICK, 0.0)]
    block = feed(estimator, samples)[-1]
    energy = block.rows[-len(CHANNELS) + CHANNELS.index("brake_energy_ff_j")]
    program = estimator.programs["FL"]
    stored = 0.0
    state = estimator.state("FL")
    for node in program.network.nodes:
        if node.boundary_input is None:
            table = node.capacity_table
            rise = (
                state[node.name] - 293.15
                if table is None
                else table.integral(state[node.name]) - table.integral(293.15)
            )
            stored += node.capacity_j_k * rise
    assert stored == pytest.approx(energy, rel=1e-9)
    assert energy > 1e5


@pytest.mark.usefixtures("all_verified")
def test_validity(car: Any) -> None:
    """Degraded while the start is unknown or a mandatory input is missing."""
    unknown = Estimator(car, PRESENT)
    (block,) = feed(unknown, samples_of(1.0))
    assert set(block.validity["FL"]) == {Validity.DEGRADED}
    known = Estimator(car, PRESENT, history_known=True)
    assert known.history_known
    blocks = feed(known, [*samples_of(1.0), (3 * SECOND, TICK, 0.0)])
    _, _, _, flags, _, validity = joined(blocks)
    for flag, valid in zip(flags, validity["FL"], strict=True):
        missing = flag & (FLAGS["speed_missing"] | FLAGS["pressure_missing"])
        assert valid == (Validity.DEGRADED if missing else Validity.VALID)
    assert {Validity.VALID, Validity.DEGRADED} == set(validity["FL"])


@pytest.mark.parametrize("start_k", [100.0, 5000.0])
def test_impossibles_are_invalid(car: Any, start_k: float) -> None:
    """Outside any brake's range no estimate counts."""
    (block,) = feed(
        Estimator(car, PRESENT, history_known=True, initial_k=start_k),
        samples_of(0.5),
    )
    assert set(block.validity["FR"]) == {Validity.INVALID}


def test_measured_mode_forces_the_disc(form: str, make_car: Any) -> None:
    """The disc is what the thermocouple says, and free when it is gone."""
    del form
    role = ROLE_INDEX["temp_fl_disc"]
    estimator = Estimator(
        make_car(heat={"mode": "measured"}), {SPEED: 500_000, role: 500_000}
    )
    feed(
        estimator,
        [(at, role, 500.0 + at * 1e-5) for at in range(0, SECOND, 10_000)],
    )
    # the step that ends at 0.95 s has the sample before, of 0.94 s
    assert estimator.state("FL")["disc"] == pytest.approx(509.4)
    feed(estimator, [(1_500_000, TICK, 0.0)])
    held = estimator.state("FL")["disc"]
    feed(estimator, [(200 * SECOND, TICK, 0.0)])
    assert estimator.state("FL")["disc"] < held - 1.0


def test_friction_history_leaves_measured_heat_alone(
    fast: Kernel, make_car: Any
) -> None:
    """With Feed-Back the effect on friction changes nothing."""
    assert fast is not None
    states = []
    for mode in ("ff", "fb"):
        for effects in ([], [{"name": "friction_history"}]):
            car = make_car(
                heat={"mode": mode, "assume_powertrain_torque_nm": 5000.0},
                effect=effects,
            )
            estimator = Estimator(car, PRESENT)
            feed(estimator, samples_of(30.0))
            states.append(estimator.state("FL")["disc"])
    assert states[1] < states[0] - 1.0
    assert states[3] == states[2] > 300.0


def test_parked_for_a_day_is_at_ambient(car: Any) -> None:
    """All nodes settle and the history is known, whatever was before."""
    estimator = Estimator(car, PRESENT)
    feed(estimator, samples_of(60.0, pressure=5e6))
    hot = estimator.state("FL")["disc"]
    blocks = feed(estimator, samples_of(1.0, 24 * 3600 * SECOND, 0.0, 0.0))
    assert hot > 400.0
    assert estimator.history_known
    assert estimator.state("FL")["disc"] == pytest.approx(293.15)
    assert joined(blocks)[3][0] & FLAGS["settled"]


def test_counts(car: Any) -> None:
    """Late, dropped and jumps are counted for the status frame."""
    estimator = Estimator(car, PRESENT)
    feed(estimator, samples_of(2.0))
    feed(estimator, [(1_500_000, SPEED, 15.0), (10**16, SPEED, 15.0)])
    feed(estimator, samples_of(0.5, -3600 * SECOND))
    assert estimator.counts == {"late": 1, "dropped": 3, "jumps": 1}


def test_what_can_not_be_built(
    make_car: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors for users: an effect, a share, the kernel's name."""
    for sections in (
        {"effect": [{"name": "no_such_effect"}]},
        {"effect": [{"name": "wet_disc", "parameters": {"strength": 9.0}}]},
        {"thermal": {"heat_partition_correction_factor": 500.0}},
    ):
        with pytest.raises(ConfigError, match="FL"):
            Estimator(make_car(**sections), PRESENT)
    monkeypatch.setenv(VARIABLE, "warp")
    with pytest.raises(UsageError, match="warp"):
        Estimator(make_car(), PRESENT)


def test_a_car_that_stood_forgets_all_that_was_found(make_car: Any) -> None:
    """What spoke against its heat, and what nothing proved."""
    estimator = Estimator(make_car(), {})
    for trust in (estimator.trust, estimator.unproven):
        trust.count(20.0)
        assert any(trust.export()["_held_s"].values())

    estimator.park_doubts(1e6)

    for trust in (estimator.trust, estimator.unproven):
        assert not any(trust.export()["_held_s"].values())

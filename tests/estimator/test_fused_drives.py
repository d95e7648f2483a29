"""Fused heat on simulated drives: pushed cars, wrong sensors, who brakes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.channels import CHANNELS, FLAGS, VEHICLE_CHANNELS
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.estimator import STEP_US, Estimator
from bstm_daemon.estimator.input_history import InputHistory
from bstm_daemon.estimator.state import (
    export_state,
    restore_state,
    resume_state,
)
from bstm_daemon.model.heat.learned import LEARNED_NAMES
from bstm_daemon.roles import ROLE_INDEX, ROLES
from bstm_daemon.simulation import load_drive, simulate

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation import SimulatedDrive

    Columns = Mapping[str, np.ndarray[Any, Any]]

CAR = Path(__file__).parents[2] / "config" / "example_vehicle.toml"
WHEELS = tuple(f"wheel_speed_{corner}" for corner in ("fl", "fr", "rl", "rr"))
BUS = (
    *WHEELS,
    *("vehicle_speed", "primary_pressure", "secondary_pressure"),
    *("acceleration_longitudinal", "acceleration_lateral", "yaw_rate"),
    *("powertrain_torque", "motor_torque", "gear", "clutch_open"),
    *("brake_switch", "abs_active", "esc_active", "tc_active"),
)
ACCELERATION = "acceleration_longitudinal"
HOUR_US = 3_600_000_000


class Steps(InputHistory):
    """Adds every step's power up [J], and its standard deviation."""

    def __init__(self, corners: int) -> None:
        super().__init__(corners * len(CHANNELS), 1)
        self.energy = np.zeros(corners)
        self.spread = np.zeros(corners)

    def add(self, rows: memoryview, steps: int) -> None:
        table = np.frombuffer(rows).reshape(steps, -1, len(CHANNELS))
        sums = STEP_US * 1e-6 * table.sum(axis=0)
        self.energy += sums[:, CHANNELS.index("brake_power_w")]
        self.spread += sums[:, CHANNELS.index("brake_power_std_w")]


@dataclass
class Drive:
    """What the estimator makes of a drive."""

    estimator: Estimator
    vehicle: np.ndarray[Any, Any]
    flags: int
    energy: np.ndarray[Any, Any]
    spread: np.ndarray[Any, Any]
    real: np.ndarray[Any, Any]
    ff_j: float

    def last(self, name: str) -> float:
        """Return the vehicle's channel at the end."""
        return float(self.vehicle[-1, VEHICLE_CHANNELS.index(name)])

    def has(self, name: str) -> bool:
        """Return whether the bit was set at any time."""
        return bool(self.flags & FLAGS[name])

    @property
    def error(self) -> float:
        """Return the heat's, all corners together."""
        return float(self.energy.sum() / self.real.sum() - 1.0)

    @property
    def untaught(self) -> bool:
        """Return whether the states are those of a first start."""
        return self.last("friction_scale") == 1.0 and (
            self.last("mass_kg") == self.estimator.config.vehicle.mass_kg
        )


@cache
def driven(name: str) -> SimulatedDrive:
    """Return a drive of the example car with good sensors."""
    return simulate(load_drive(name), preset="road", sensors="n2", seed=1)


@cache
def configured(mass_kg: float = 0.0, structure: str = "thesis") -> Config:
    """Return the example car in mode fused, of another mass where given."""
    config, _ = load_vehicle(CAR)
    heat = config.heat.model_copy(update={"mode": "fused"})
    vehicle = config.vehicle
    if mass_kg:
        vehicle = vehicle.model_copy(update={"mass_kg": mass_kg})
    thermal = config.thermal.model_copy(update={"structure": structure})
    return config.model_copy(
        update={"heat": heat, "vehicle": vehicle, "thermal": thermal}
    )


def estimate(
    name: str,
    *more: str,
    columns: Columns | None = None,
    document: dict[str, Any] | None = None,
    mass_kg: float = 0.0,
    structure: str = "thesis",
) -> Drive:
    """Let the estimator see the drive, with other *columns* where given.

    *more* roles are mapped; *document* is the state of an hour before.
    """
    real = driven(name)
    given = dict(real.roles) | dict(columns or {})
    roles = [*BUS, *more]
    numbers = np.array([ROLE_INDEX[role] for role in roles], np.int32)
    start_us = 10 * HOUR_US
    stamps = np.rint(real.time_s[::2] * 1e6).astype(np.int64) + start_us
    values = np.column_stack([given[role][::2] for role in roles])
    present = {int(n): round(ROLES[n].timeout_s * 1e6) for n in numbers}
    estimator = Estimator(configured(mass_kg, structure), present)
    if document is not None:
        resume_state(estimator, document, HOUR_US, start_us)
    steps = Steps(len(estimator.plan.corners))
    estimator.input_history = steps
    blocks = estimator.advance(
        np.repeat(stamps, len(roles)),
        np.tile(numbers, len(stamps)),
        values.astype(np.float64).ravel(),
    )
    vehicle = np.concatenate([np.frombuffer(b.vehicle) for b in blocks])
    last = np.frombuffer(blocks[-1].rows).reshape(
        -1, len(estimator.plan.corners), len(CHANNELS)
    )[-1]
    flags = np.concatenate([np.frombuffer(b.flags, "q") for b in blocks])
    return Drive(
        estimator,
        vehicle.reshape(-1, len(VEHICLE_CHANNELS)),
        int(np.bitwise_or.reduce(flags)),
        steps.energy,
        steps.spread,
        np.asarray(real.brake_energy_j[-1]),
        float(last[:, CHANNELS.index("brake_energy_ff_j")].sum()),
    )


@cache
def taught_nothing(mass_kg: float = 0.0) -> Drive:
    """Return a drive in the city after a first start."""
    return estimate("city", mass_kg=mass_kg)


@pytest.fixture(scope="module")
def rich() -> Drive:
    """Return the drive that teaches most."""
    return estimate("rich")


@pytest.mark.slow
def test_an_ordinary_drive_is_right_and_suspects_nothing(rich: Drive) -> None:
    assert rich.error == pytest.approx(0.0, abs=0.04)
    assert abs(rich.ff_j / rich.real.sum() - 1.0) > 0.1
    assert rich.last("mass_kg") == pytest.approx(2194.0, rel=0.03)
    assert not rich.flags >> 40


@pytest.mark.slow
def test_a_friction_law_carries_what_fades_in_bends() -> None:
    """On a track nothing is learned, the disc's temperature tells."""
    plain = estimate("track")
    law = estimate("track", structure="extended")

    assert plain.error > 0.2
    assert abs(plain.error) < 2.0 * plain.spread.sum() / plain.real.sum()
    assert law.error == pytest.approx(0.0, abs=0.08)


@pytest.mark.slow
def test_a_pushed_car_without_the_role_teaches_nothing() -> None:
    """Eq 4.7: pushed along against its brakes for 25 minutes."""
    pushed = estimate("simalp")

    assert pushed.has("external_force_suspected")
    assert pushed.untaught
    assert pushed.energy.sum() == pytest.approx(pushed.ff_j)


@pytest.mark.slow
def test_a_pushed_car_with_the_role_is_weighed() -> None:
    """The push is a force like the engine's: no suspicion, friction found."""
    pushed = estimate("simalp", "external_force")

    assert not pushed.has("external_force_suspected")
    assert not pushed.untaught
    assert abs(pushed.error) < 2.0 * pushed.spread.sum() / pushed.real.sum()
    assert abs(pushed.error) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [
        *("in-g", "reversed"),
        *(
            pytest.param(one, marks=pytest.mark.full)
            for one in ("stuck", "half", "swapped")
        ),
    ],
)
def test_a_wrong_accelerometer_is_named_and_not_learned_away(
    fault: str,
) -> None:
    """And its heat is then that of the pressure."""
    roles = driven("rich").roles
    felt = roles[ACCELERATION]
    column = {
        "swapped": roles["acceleration_lateral"],
        "stuck": np.full_like(felt, 0.3),
        "reversed": -felt,
        "half": 0.5 * felt,
        "in-g": felt / 9.80665,
    }[fault]
    wrong = estimate("rich", columns={ACCELERATION: column})

    assert wrong.has("acceleration_scale")
    assert wrong.untaught
    assert wrong.energy.sum() == pytest.approx(wrong.ff_j, rel=0.01)


@pytest.mark.slow
def test_a_wrong_wheel_radius_is_named() -> None:
    roles = driven("rich").roles
    columns = {role: 1.08 * roles[role] for role in (*WHEELS, "vehicle_speed")}
    columns["gnss_speed"] = roles["vehicle_speed"]
    wrong = estimate("rich", "gnss_speed", columns=columns)

    assert wrong.has("wheel_radius")
    assert wrong.untaught


@pytest.mark.slow
def test_a_dead_pressure_is_named_and_the_motion_heats() -> None:
    """The friction stays as it was; the heat is that of the motion."""
    nothing = np.zeros_like(driven("rich").roles["primary_pressure"])
    dead = estimate(
        "rich",
        columns={"primary_pressure": nothing, "secondary_pressure": nothing},
    )

    assert dead.has("pressure_dead")
    assert dead.last("friction_scale") == 1.0
    assert dead.error == pytest.approx(0.0, abs=0.05)


@pytest.mark.slow
def test_braking_by_an_assistant_is_found() -> None:
    """No pressure tells of most of it (effect 39)."""
    found = estimate("assist")

    assert found.ff_j < 0.3 * found.real.sum()
    assert found.has("braking_unpressed")
    assert found.error == pytest.approx(0.0, abs=0.1)


@pytest.mark.slow
def test_recovery_is_no_brake_heat() -> None:
    recovered = estimate("regen")

    assert recovered.error == pytest.approx(0.0, abs=0.04)
    assert not recovered.has("braking_unpressed")


@pytest.mark.slow
def test_single_wheels_that_are_braked_have_a_wide_interval() -> None:
    """Stability and traction control without wheel pressures."""
    found = estimate("slippery")

    assert found.ff_j < 0.5 * found.real.sum()
    assert 0.6 < found.energy.sum() / found.real.sum() < 1.4
    assert found.spread.sum() > 0.15 * found.real.sum()
    assert abs(found.error) < 2.0 * found.spread.sum() / found.real.sum()


@pytest.mark.slow
def test_what_is_learned_goes_on_in_the_next_drive(rich: Drive) -> None:
    document = export_state(rich.estimator)
    begun = estimate("city", document=document)
    afresh = taught_nothing()
    column = VEHICLE_CHANNELS.index("mass_std_kg")

    assert begun.vehicle[0, column] < 0.3 * afresh.vehicle[0, column]
    assert begun.error == pytest.approx(0.0, abs=0.04)


@pytest.mark.parametrize("fault", ["", "other car", "impossible"])
def test_a_restart_takes_over_what_can_have_been_learned(
    rich: Drive, fault: str
) -> None:
    """Values and ages go on in any case, what was learned if it holds."""
    document = json.loads(json.dumps(export_state(rich.estimator)))
    if fault == "impossible":
        mass_ratio = rich.estimator.samples.memory().observer.known.x[0]
        numbers = document["samples"]["numbers"]
        numbers[numbers.index(mass_ratio)] = 9.0
    present = {
        ROLE_INDEX[role]: round(ROLES[ROLE_INDEX[role]].timeout_s * 1e6)
        for role in BUS
    }
    mass_kg = 1800.0 if fault == "other car" else 0.0
    fresh = Estimator(configured(mass_kg), present)

    assert restore_state(fresh, document, resume=True).resumed
    learned = [one.samples.learned() for one in (fresh, rich.estimator)]
    if fault:
        assert learned[0] is None
    else:
        assert learned[0] == learned[1]


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["other car", "impossible", "incomplete"])
def test_what_does_not_hold_is_not_taken_over(rich: Drive, fault: str) -> None:
    """Of a car configured otherwise, out of bounds, or cut short."""
    document = export_state(rich.estimator)
    document["learned"] = {**document["learned"]}
    numbers = document["learned"]["numbers"] = {
        **document["learned"]["numbers"]
    }
    mass_kg = 0.0
    if fault == "other car":
        mass_kg = 1800.0
    elif fault == "impossible":
        numbers["mass_ratio"] = 9.0
    else:
        del numbers[LEARNED_NAMES[-1]]
    begun = estimate("city", document=document, mass_kg=mass_kg)
    afresh = taught_nothing(mass_kg)

    column = VEHICLE_CHANNELS.index("mass_std_kg")
    assert begun.vehicle[0, column] == afresh.vehicle[0, column]

"""Feed-Back without a pressure: what brakes, and what only looks like it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pytest

from bstm_daemon.roles import CORNERS, ROLE_INDEX
from bstm_daemon.simulation.drives import load_drive, parse_drive
from bstm_daemon.simulation.simulate import simulate
from bstm_daemon.simulation.vehicle import NOMINAL

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bstm_daemon.native.loader import Kernel
    from bstm_daemon.simulation.simulate import SimulatedDrive

    from .conftest import Run

    Signals = dict[str, Any]
    Spoil = Callable[[Signals], None]

WHEELS: Final = tuple(f"wheel_speed_{name.lower()}" for name in CORNERS)
MOTION: Final = (*WHEELS, "acceleration_longitudinal")
TORQUE: Final = "powertrain_torque"
PEDAL: Final = ("brake_switch", "brake_pedal_travel", "brake_torque")
SYSTEMS: Final = ("abs_active", "esc_active", "tc_active")
ALL: Final = (*MOTION, TORQUE, *PEDAL, *SYSTEMS)
LAUNCHES: Final = """
[drive]
name = "launches"
description = "the rear axle spins, then stops from 60 km/h"

[[segment]]
repeat = 4

[[segment.segment]]
speed_kmh = 30.0
rate_ms2 = 4.0
gear = 1
slip = [0.0, 0.0, -0.4, -0.4]

[[segment.segment]]
speed_kmh = 90.0
rate_ms2 = 3.5
gear = 2
slip = [0.0, 0.0, -0.15, -0.15]

[[segment.segment]]
speed_kmh = 90.0
duration_s = 15.0
gear = 5

[[segment.segment]]
speed_kmh = 60.0
rate_ms2 = 0.6
gear = 3

[[segment.segment]]
speed_kmh = 0.0
rate_ms2 = 3.0
gear = 3

[[segment.segment]]
parked = true
duration_s = 3.0
"""
STEP_S: Final = 0.05
EVERY: Final = 2


@pytest.fixture(scope="module")
def drives() -> Mapping[str, SimulatedDrive]:
    """Return each drive, simulated with good sensors."""
    made = {"launches": parse_drive(LAUNCHES, "launches.toml")}
    made |= {name: load_drive(name) for name in ("city", "assist")}
    return {
        name: simulate(drive, sensors="n1", seed=1)
        for name, drive in made.items()
    }


class Heat:
    """Heat [J] of a drive, its truth, and the part of it while released."""

    def __init__(self, drive: SimulatedDrive, run: Run) -> None:
        """Compare *run* with *drive*, step by step."""
        self.run = run
        power = sum(np.array(run.column("brake_power_w", c)) for c in range(4))
        ends = np.array(run.times) * 1e-6
        energy = np.cumsum(drive.brake_power_w.sum(axis=1)) * 0.01
        true = np.diff(np.interp(ends, drive.time_s, energy), prepend=0.0)
        # the force lags the pedal by some tenths of a second
        near = np.convolve(true > 1.0, np.ones(13), "same") > 0.0
        self.true_j = float(energy[-1])
        self.braking_j = float(power[near].sum()) * STEP_S
        self.released_j = float(power[~near].sum()) * STEP_S


@pytest.fixture(scope="module")
def heat(
    drives: Mapping[str, SimulatedDrive],
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
    compiled: Kernel,
) -> Callable[..., Heat]:
    """Return what runs a drive: (its name, roles, spoil, settings)."""

    def run(
        name: str,
        roles: tuple[str, ...] = ALL,
        spoil: Spoil | None = None,
        **settings: Any,
    ) -> Heat:
        drive = drives[name]
        signals = {role: drive.roles[role][::EVERY].copy() for role in roles}
        if spoil is not None:
            spoil(signals)
        car = make_car(
            *(make_corner(corner) for corner in CORNERS),
            vehicle={
                "mass_kg": NOMINAL.mass_kg,
                "wheel_radius_m": NOMINAL.wheel_radius_m,
                "drag_area_m2": NOMINAL.drag_area_m2,
                "front_share": 0.7,
            },
            heat={"mode": "fb", **settings},
        )
        stamps = np.rint(drive.time_s[::EVERY] * 1e6).astype(np.int64)
        numbers = np.array([ROLE_INDEX[role] for role in roles])
        samples = zip(
            np.repeat(stamps, len(roles)).tolist(),
            np.tile(numbers, len(stamps)).tolist(),
            np.column_stack([signals[r] for r in roles]).ravel().tolist(),
            strict=True,
        )
        run = start(car, compiled, *roles)
        run.room = 100_000
        return Heat(drive, run.feed(list(samples)))

    return run


def torque(scale: float, offset_nm: float) -> Spoil:
    """Return what makes the torque read wrongly."""

    def spoil(signals: Signals) -> None:
        signals[TORQUE] = scale * signals[TORQUE] + offset_nm

    return spoil


def drive_torque(scale: float) -> Spoil:
    """Return what makes the torque forward read wrongly."""

    def spoil(signals: Signals) -> None:
        read = signals[TORQUE]
        signals[TORQUE] = np.where(read > 0.0, scale * read, read)

    return spoil


def stuck(share: float) -> Spoil:
    """Return what holds the pedal's signals at 0 from *share* on."""

    def spoil(signals: Signals) -> None:
        for role in {*PEDAL} & signals.keys():
            signals[role][int(share * len(signals[role])) :] = 0.0

    return spoil


# Where the pedal is released, nothing brakes


@pytest.mark.parametrize(
    ("name", "spoil", "same"),
    [
        ("launches", None, 1),
        ("launches", torque(1.1, 300.0), 0),
        ("launches", torque(0.8, 0.0), 0),
        ("launches", drive_torque(1.25), 1),
        pytest.param("city", None, 1, marks=pytest.mark.slow),
        pytest.param(*("city", torque(1.1, 300.0), 0), marks=pytest.mark.slow),
        ("assist", None, 1),
    ],
)
def test_no_heat_while_the_pedal_is_released(
    heat: Callable[..., Heat], name: str, spoil: Spoil | None, same: int
) -> None:
    """Wheelspin, wrong torque; cruise control shows in the brake torque."""
    found = heat(name, ALL, spoil)
    bare = heat(name, (*MOTION, TORQUE, *SYSTEMS))

    assert found.released_j < 0.02 * found.braking_j
    assert not any(found.run.flag("switch_contradicts"))
    # what is wrong with the torque is wrong with the brakes' heat too
    if same:
        assert found.braking_j == pytest.approx(bare.braking_j, rel=0.02)
    assert found.braking_j > 0.95 * found.true_j


@pytest.mark.parametrize("role", PEDAL)
@pytest.mark.parametrize(
    "name", ["launches", pytest.param("city", marks=pytest.mark.slow)]
)
def test_each_signal_of_the_pedal_is_enough(
    heat: Callable[..., Heat], name: str, role: str
) -> None:
    roles = (*MOTION, TORQUE, *SYSTEMS)
    found = heat(name, (*roles, role), torque(1.1, 300.0))
    without = heat(name, roles, torque(1.1, 300.0))

    assert without.released_j > 0.4 * without.braking_j
    assert found.released_j < 0.02 * found.braking_j
    assert found.braking_j > 0.95 * without.braking_j


@pytest.mark.parametrize("slope", ["accelerometer", "flat"])
@pytest.mark.parametrize("high", [1.0, 1.25])
def test_slip_of_the_driven_axle_is_no_braking(
    heat: Callable[..., Heat], slope: str, high: float
) -> None:
    """No pedal is mapped: what grips again does not brake."""
    roles = (*MOTION, TORQUE)
    found = heat("launches", roles, drive_torque(high), slope=slope)

    assert found.released_j < 0.05 * found.braking_j
    assert found.braking_j == pytest.approx(found.true_j, rel=0.07)


# The pedal fails hot


@pytest.mark.parametrize("share", [0.0, 0.5])
@pytest.mark.parametrize("roles", [PEDAL, PEDAL[:1]], ids=["all", "switch"])
def test_a_pedal_stuck_at_rest_hides_no_braking(
    heat: Callable[..., Heat], roles: tuple[str, ...], share: float
) -> None:
    found = heat("launches", (*MOTION, TORQUE, *roles), stuck(share))
    sound = heat("launches", (*MOTION, TORQUE, *roles))

    flagged = found.run.flag("switch_contradicts")
    assert flagged[-1]
    # by the second stop, a round of 43 s later
    assert (flagged.index(True) - share * len(flagged)) * STEP_S < 90.0
    assert not any(sound.run.flag("switch_contradicts"))
    # one that never showed anything counts for nothing; later it hides light
    # braking and the begin of hard braking, until it is found
    least = 1.0 if share == 0.0 else 0.83
    assert found.braking_j > (least - 1e-3) * sound.braking_j


@pytest.mark.slow
def test_assistants_brake_without_the_switch(
    heat: Callable[..., Heat],
) -> None:
    """Without the brake torque the motion tells, from 0.5 m/s2 on."""
    for more, settings in (
        ((TORQUE,), {}),
        ((), {"assume_powertrain_torque_nm": 0.0}),
    ):
        roles = (*MOTION, *more, "brake_switch")
        found = heat("assist", roles, **settings)
        assert found.braking_j > found.true_j


@pytest.mark.slow
def test_interventions_count_though_the_pedal_rests(
    heat: Callable[..., Heat],
) -> None:
    """A system that brakes single wheels needs no pedal."""
    found = heat("city", (*MOTION, TORQUE, "brake_switch", "tc_active"))
    always = heat(
        "city",
        (*MOTION, TORQUE, "brake_switch", "tc_active"),
        lambda signals: signals["tc_active"].fill(1.0),
    )
    bare = heat("city", (*MOTION, TORQUE), torque(1.0, 0.0))

    assert always.released_j == pytest.approx(bare.released_j, rel=0.05)
    assert found.braking_j == pytest.approx(always.braking_j, rel=0.02)


@pytest.mark.parametrize("seen", [True, False])
def test_what_a_motor_recovers_is_no_braking_of_a_pedal_at_rest(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
    seen: bool,  # noqa: FBT001
) -> None:
    """2.5 m/s2 by the motor alone, with the accelerator released."""
    car = make_car(
        *(make_corner(name) for name in CORNERS), heat={"mode": "fb"}
    )
    roles = ("vehicle_speed", MOTION[-1], TORQUE, "motor_torque", PEDAL[0])
    run = start(car, kernel, *roles)
    for i in range(800):
        braked = seen and i < 100
        accel = -0.3 if braked or i < 100 else -2.8
        motor = 0.0 if i < 100 else -2.5 * 2194.0 * 0.3418
        values = (20.0, accel - braked, 0.0, motor, float(braked))
        at_us = 50_000 * i
        run.feed([(at_us, *one) for one in zip(roles, values, strict=True)])

    power = run.column("brake_power_w")
    assert (max(power[:90]) > 1e3) is seen
    assert max(power[120:]) == 0.0
    assert not any(run.flag("switch_contradicts"))

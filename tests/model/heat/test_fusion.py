"""Where the fused power comes from, corner by corner."""

from __future__ import annotations

from math import isnan
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.model.heat.fusion import _torque_std

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.native.loader import Kernel

    from .conftest import Run

CORNERS = ("FL", "FR", "RL", "RR")
WHEELS = tuple(f"wheel_speed_{name.lower()}" for name in CORNERS)
PRESSURES = tuple(f"wheel_pressure_{name.lower()}" for name in CORNERS)
ROLES = (
    "vehicle_speed",
    *WHEELS,
    "primary_pressure",
    "acceleration_longitudinal",
    "powertrain_torque",
    "motor_torque",
    "esc_active",
    "tc_active",
    "abs_active",
)
MASS_KG = 2194.0
ROTATING_KG = 3.0809 / 0.3418**2
PER_PA = 2.0 * 2.83e-3 * 0.38 * 0.13 / 0.3418  # N/Pa of a corner
ROLLING = 0.014 * 9.80665


@pytest.fixture
def fused(
    start: Callable[..., Run], make_car: Any, make_corner: Any
) -> Callable[..., Run]:
    """Return what starts a pass: (kernel, *roles), share of the front 0.7."""

    def make(kernel: Kernel | None, *roles: str) -> Run:
        car = make_car(
            *(make_corner(name) for name in CORNERS), heat={"mode": "fused"}
        )
        return start(car, kernel, *roles)

    return make


def resistance_n(v: float) -> float:
    return 0.5 * 1.2 * 0.7 * v**2 + 4.0 * v + MASS_KG * ROLLING


def steady(
    roles: tuple[str, ...], seconds: float, v: float = 15.0, **values: float
) -> list[tuple[int, str, float]]:
    """Return samples at constant speed; wheels as the car but for *values*."""
    held = dict.fromkeys(roles, 0.0)
    held |= {role: v for role in ("vehicle_speed", *WHEELS) if role in roles}
    held |= values
    return [
        (at, role, value)
        for at in range(0, round(seconds * 1e6), 50_000)
        for role, value in held.items()
    ]


def powers(run: Run) -> list[float]:
    """Return the last power of each corner [W]."""
    return [run.column("brake_power_w", c)[-1] for c in range(4)]


def downhill(brake_n: float, v: float = 15.0) -> dict[str, float]:
    """What is felt where the brakes hold the speed with *brake_n*."""
    felt = -(brake_n + resistance_n(v)) / MASS_KG
    return {"acceleration_longitudinal": felt}


def test_braking_without_pressure_heats_by_the_share(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """Distance control holds the car downhill; nobody has pressed."""
    run = fused(kernel, *ROLES)
    run.feed(steady(ROLES, 8.0, **downhill(3000.0)))

    assert powers(run) == pytest.approx(
        [0.35 * 45e3, 0.35 * 45e3, 0.15 * 45e3, 0.15 * 45e3], rel=1e-3
    )
    assert all(run.flag("braking_unpressed")[40:])
    spread = [run.column("brake_power_std_w", c)[-1] for c in range(4)]
    assert all(
        0.1 < s / p < 0.5 for s, p in zip(spread, powers(run), strict=True)
    )


def test_no_energy_is_lost_before_it_is_sure(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    run = fused(kernel, *ROLES)
    run.feed(steady(ROLES, 8.0, **downhill(3000.0)))
    total = sum(sum(run.column("brake_power_w", c)) * 0.05 for c in range(4))

    assert total == pytest.approx(45e3 * 8.0, rel=0.03)


@pytest.mark.parametrize(("share", "counted"), [(1.9, 0.9), (1.6, 0.0)])
def test_heat_that_a_small_pressure_does_not_explain_is_not_lost(
    kernel: Kernel | None,
    fused: Callable[..., Run],
    share: float,
    counted: float,
) -> None:
    """Braking beyond any friction of the linings falls on all by the share."""
    run = fused(kernel, *ROLES)
    pressed_w = 4.0 * PER_PA * 5e5 * 15.0
    run.feed(
        steady(
            ROLES,
            3.0,
            **downhill(share * pressed_w / 15.0),
            primary_pressure=5e5,
            abs_active=0.0,
            esc_active=1.0,
        )
    )

    extra = counted * pressed_w
    assert powers(run) == pytest.approx(
        [0.25 * pressed_w + own * extra for own in (0.35, 0.35, 0.15, 0.15)],
        rel=0.02,
    )
    assert run.flag("braking_unpressed")[-1] is (counted > 0.0)


def test_motor_and_engine_heat_no_brake(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """The same descent, held by either."""
    for role in ("motor_torque", "powertrain_torque"):
        run = fused(kernel, *ROLES)
        run.feed(
            steady(ROLES, 8.0, **downhill(3000.0), **{role: -3000.0 * 0.3418})
        )

        assert powers(run) == [0.0] * 4
        assert not any(run.flag("braking_unpressed"))


def test_a_spinning_wheel_takes_what_traction_control_brakes(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """The engine drives it, so more is missing than the car resists."""
    run = fused(kernel, *ROLES)
    run.feed(
        steady(
            ROLES,
            4.0,
            v=6.0,
            wheel_speed_fl=8.4,
            powertrain_torque=(2500.0 + resistance_n(6.0)) * 0.3418,
            tc_active=1.0,
        )
    )
    found = powers(run)

    assert found[0] == pytest.approx(2500.0 * 8.4, rel=0.02)
    assert found[1:] == [0.0] * 3
    assert run.column("brake_power_std_w", 0)[-1] > 0.5 * found[0]


def test_spinning_wheels_share_by_what_they_slip_beyond_a_sound_tyre(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """8 % of slip are the tyre's; 12 and 32 % beyond it are braked."""
    run = fused(kernel, *ROLES)
    run.feed(
        steady(
            ROLES,
            4.0,
            v=6.0,
            wheel_speed_fl=1.2 * 6.0,
            wheel_speed_fr=1.4 * 6.0,
            wheel_speed_rl=1.07 * 6.0,
            powertrain_torque=(2500.0 + resistance_n(6.0)) * 0.3418,
            tc_active=1.0,
        )
    )

    shares = [
        p / (w * 6.0 * 2500.0)
        for p, w in zip(powers(run), (1.2, 1.4, 1, 1), strict=True)
    ]
    assert shares == pytest.approx(
        [0.12 / 0.44, 0.32 / 0.44, 0.0, 0.0], rel=0.02
    )


def test_pressures_at_the_wheels_say_which_one_is_braked(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """Stability control presses the front right brake alone."""
    roles = (*ROLES, *PRESSURES)
    run = fused(kernel, *roles)
    brake_n = PER_PA * 30e5
    run.feed(
        steady(
            roles,
            4.0,
            **downhill(brake_n),
            wheel_pressure_fr=30e5,
            esc_active=1.0,
        )
    )

    assert powers(run) == pytest.approx([0.0, brake_n * 15.0, 0.0, 0.0])


def test_anti_lock_takes_its_magnitude_from_the_motion(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """The line holds 60 bar, the wheels are let go to a third of it."""
    run = fused(kernel, *ROLES)
    real = 4.0 * PER_PA * 20e5
    run.feed(
        steady(
            ROLES,
            4.0,
            **downhill(real),
            primary_pressure=60e5,
            abs_active=1.0,
        )
    )

    assert sum(powers(run)) == pytest.approx(real * 15.0, rel=0.02)


@pytest.mark.parametrize(
    "silent", ["acceleration_longitudinal", "powertrain_torque"]
)
def test_without_motion_pressure_alone(
    kernel: Kernel | None, fused: Callable[..., Run], silent: str
) -> None:
    run = fused(kernel, *ROLES)
    samples = steady(ROLES, 4.0, primary_pressure=10e5)
    run.feed([s for s in samples if s[1] != silent])

    assert powers(run) == pytest.approx([PER_PA * 10e5 * 15.0] * 4)
    spread = run.column("brake_power_std_w")[-1] / powers(run)[0]
    assert 0.2 < spread < 0.5


def test_without_pressure_motion_alone(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """The pressure's frames have stopped: told, and heated all the same."""
    run = fused(kernel, *ROLES)
    samples = steady(ROLES, 8.0, **downhill(3000.0))
    run.feed([s for s in samples if s[1] != "primary_pressure"])

    assert sum(powers(run)) == pytest.approx(45e3, rel=1e-3)
    assert run.flag("heat_substituted")[-1]


def test_the_lightest_pressure_counts_while_the_pedal_is_down(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """0.6 bar is below the threshold of Feed-Forward."""
    roles = (*ROLES, "brake_switch")
    found = []
    for pedal in (0.0, 1.0):
        run = fused(kernel, *roles)
        run.feed(
            steady(
                roles,
                2.0,
                **downhill(4.0 * PER_PA * 0.6e5),
                primary_pressure=0.6e5,
                brake_switch=pedal,
            )
        )
        found.append(sum(powers(run)))

    assert found[0] == 0.0
    assert found[1] == pytest.approx(4.0 * PER_PA * 0.6e5 * 15.0, rel=0.02)


def test_channels_of_other_modes_are_not_known(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    run = start(make_car(), kernel, *ROLES)
    run.feed(steady(ROLES, 1.0, primary_pressure=10e5))

    for name in ("mass_kg", "grade", "friction_scale"):
        assert all(map(isnan, run.of_car(name)))
    assert all(map(isnan, run.column("brake_power_std_w")))


@pytest.mark.parametrize(
    ("known", "drive_ms2", "std_ms2"),
    [(False, 2.0, 0.2), (True, 2.0, 0.09), (True, -2.0, 0.45)],
)
def test_a_driving_torque_is_known_by_where_it_comes_from(
    known: bool,  # noqa: FBT001
    drive_ms2: float,
    std_ms2: float,
) -> None:
    """Assumed, driving 3 %, retarding 15 %; the car has 2/3 of its mass."""
    step: Any = SimpleNamespace(torque_known=known, drive=drive_ms2)

    assert abs(_torque_std(step, 1.5)) == pytest.approx(std_ms2)

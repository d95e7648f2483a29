"""Ranges and rates of the inputs, at their ends, in both forms."""

from __future__ import annotations

from math import inf, nextafter, sqrt
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.model.heat.check_rules import Limits, limits_of
from bstm_daemon.model.heat.motion_checks import wrong_scale
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.native.loader import Kernel

    from .conftest import Run

RANGES = {
    # no car does 540 km/h
    "vehicle_speed": (-150.0, 150.0),
    "wheel_speed_fl": (-150.0, 150.0),
    # an empty sensor's offset to the burst of a hydraulic line
    "primary_pressure": (-5e5, 400e5),
    "secondary_pressure": (-5e5, 400e5),
    "wheel_pressure_fl": (-5e5, 400e5),
    # 10 g are a crash
    "acceleration_longitudinal": (-100.0, 100.0),
    "powertrain_torque": (-200e3, 200e3),
    "external_force": (-1e6, 1e6),
    "ambient_temperature": (200.0, 360.0),
    "temp_fl_disc": (200.0, 2300.0),
}
STEPS = {
    # a change that is always believed, and per second beside
    "vehicle_speed": (3.0, 60.0),
    "wheel_speed_fl": (3.0, 200.0),
    "primary_pressure": (20e5, 2000e5),
    "secondary_pressure": (20e5, 2000e5),
    "wheel_pressure_fl": (20e5, 2000e5),
    "acceleration_longitudinal": (15.0, 500.0),
    "powertrain_torque": (20e3, 500e3),
    "ambient_temperature": (10.0, 5.0),
    "temp_fl_disc": (100.0, 500.0),
}
FROM = {
    "primary_pressure": 150e5,
    "secondary_pressure": 150e5,
    "wheel_pressure_fl": 150e5,
    "ambient_temperature": 300.0,
    "temp_fl_disc": 400.0,
}


@pytest.fixture
def believed(
    start: Callable[..., Run], make_car: Any, kernel: Kernel | None
) -> Callable[..., float | None]:
    """Return what takes (time [s], value) of a role and says its last one."""

    def last(role: str, *samples: tuple[float, float]) -> float | None:
        run = start(make_car(), kernel, role)
        run.feed([(round(at_s * 1e6), role, one) for at_s, one in samples])
        found: float | None = run.state.last_value(ROLE_INDEX[role])
        return found

    return last


@pytest.mark.parametrize("role", RANGES)
def test_a_value_is_believed_up_to_the_end_of_its_range(
    believed: Callable[..., float | None], role: str
) -> None:
    for end, beyond in zip(RANGES[role], (-inf, inf), strict=True):
        assert believed(role, (1.0, end)) == end
        assert believed(role, (1.0, nextafter(end, beyond))) is None


@pytest.mark.parametrize("role", STEPS)
def test_a_value_is_believed_as_long_as_it_can_have_got_there(
    believed: Callable[..., float | None], role: str
) -> None:
    """A step at once, and the rate over the 50 ms since the last one."""
    base = FROM.get(role, 0.0)
    step, rate_per_s = STEPS[role]
    most = step + 0.05 * rate_per_s
    for sign in (1.0, -1.0):
        near = base + sign * most * (1.0 - 1e-6)
        far = base + sign * most * (1.0 + 1e-6)
        assert believed(role, (1.0, base), (1.05, near)) == near
        assert believed(role, (1.0, base), (1.05, far)) == base


def test_a_role_that_nobody_knows_limits_of_has_none() -> None:
    assert limits_of("brake_switch") == Limits(-inf, inf, inf, 0.0)
    assert limits_of("external_force").step == inf


@pytest.mark.parametrize(
    ("speed", "acceleration", "correlation", "wrong"),
    [
        # (m/s2)^2 s of each, and their correlation
        (10.0, 20.0, 1.0, False),
        (10.0, 23.0, 1.0, True),
        (23.0, 10.0, 1.0, True),
        (10.0, 40.0, 0.78, True),
        (10.0, 40.0, 0.77, False),
        # below 1.6 the product itself must be 0.3 beyond the limit
        (0.5, 2.0, 1.0, False),
        (0.8, 3.1, 1.0, True),
    ],
)
def test_a_wrong_scale_is_beyond_noise_and_slopes(
    speed: float, acceleration: float, correlation: float, *, wrong: bool
) -> None:
    """More than 1.45 times, with a squared correlation above 0.6."""
    memory: Any = SimpleNamespace(
        rate_square=speed,
        accel_square=acceleration,
        accel_rate=correlation * sqrt(speed * acceleration),
    )

    assert wrong_scale(memory) is wrong

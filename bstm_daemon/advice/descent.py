"""P3 and A4: engine braking on a descent.

Braking that takes the car's own kinetic energy ends by itself. The rest of the
brake power comes from the slope: if it stays high, the gear is too high
(thesis, 7.2.2 and 7.2.4).
"""

from __future__ import annotations

from math import exp, isfinite
from typing import TYPE_CHECKING, ClassVar, Final

from bstm_daemon.estimate import Downshift
from bstm_daemon.estimator.memory import (
    AnyNumber,
    Flag,
    Int64,
    Machine,
    Number,
)
from bstm_daemon.units import UNITS

if TYPE_CHECKING:
    from bstm_daemon.advice.conditions import Conditions
    from bstm_daemon.config.sections import Config

SLOWEST_MS: Final = 3.0
"""Below this speed a lower gear gives no more braking."""

RELEASE_SHARE: Final = 0.5
"""The advice ends when the power has fallen to this share."""

SETTLE_US: Final = 8_000_000
"""After a shift the driver is left alone for this long."""


class Descent(Machine):
    """Low-pass of the slope's power, and the advice and request it causes."""

    MEMORY: ClassVar = {
        "slope_power_w": Number,
        "excessive": Flag,
        "_last": tuple[Int64, AnyNumber] | None,
        "_gear": AnyNumber | None,
        "_quiet_until_us": Int64 | None,
    }

    def __init__(self, config: Config) -> None:
        """Begin on a level road."""
        self._config = config.advice
        self._mass_kg = config.vehicle.mass_kg
        self.slope_power_w = 0.0
        self.excessive = False
        self._last: tuple[int, float] | None = None
        self._gear: float | None = None
        self._quiet_until_us: int | None = None

    def update(self, now: Conditions) -> tuple[Downshift, Downshift]:
        """Return the advice to the driver and the request to the gearbox."""
        self._filter(now)
        limit_w = self._config.descent_power_w
        if self.excessive:
            limit_w *= RELEASE_SHARE
        moving = isfinite(now.speed_ms) and now.speed_ms >= SLOWEST_MS
        self.excessive = moving and self.slope_power_w >= limit_w
        shift = Downshift.NONE
        if self.excessive and self._can_shift(now):
            shift = Downshift.SHIFT_DOWN
        gearbox = self._config.gearbox
        return (
            shift if gearbox == "manual" else Downshift.NONE,
            shift if gearbox == "automatic" else Downshift.NONE,
        )

    def _filter(self, now: Conditions) -> None:
        if not (isfinite(now.speed_ms) and isfinite(now.brake_power_w)):
            self._last = None
            return
        last, self._last = self._last, (now.time_us, now.speed_ms)
        if last is None or not 0 < now.time_us - last[0] <= 1_000_000:
            return
        dt_s = (now.time_us - last[0]) * 1e-6
        kinetic_w = (
            0.5 * self._mass_kg * (last[1] ** 2 - now.speed_ms**2) / dt_s
        )
        share = 1.0 - exp(-dt_s / self._config.descent_window_s)
        power_w = now.brake_power_w - kinetic_w
        # braking while speed rises is not caused by the slope
        if now.brake_power_w <= 0.0:
            power_w = 0.0
        self.slope_power_w += share * (power_w - self.slope_power_w)

    def _can_shift(self, now: Conditions) -> bool:
        gear = now.driver.get("gear")
        before, self._gear = self._gear, gear
        if gear is not None and before is not None and gear != before:
            self._quiet_until_us = now.time_us + SETTLE_US
        if (
            self._quiet_until_us is not None
            and now.time_us < self._quiet_until_us
        ):
            return False
        if gear is not None and gear <= 1:
            return False
        if now.flag("clutch_open"):
            return False
        engine_rad_s = now.driver.get("engine_speed")
        limit_rad_s = self._config.shift_below_rpm * UNITS["rpm"].factor
        return engine_rad_s is None or engine_rad_s < limit_rad_s

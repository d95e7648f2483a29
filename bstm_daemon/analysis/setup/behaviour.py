"""Whether a signal behaves in a recording like the role its name suggests.

Speeds of one car agree with each other; an accelerometer follows the change
of speed, up to the road's grade; a brake pressure is zero most of the time
and the car slows down while it is not. All figures are kept as text, for the
comments of the proposed configuration.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.analysis.setup.recording import Samples, Series
from bstm_daemon.units import UNITS

_STEP_S: Final = 0.05
_SMOOTH_S: Final = 0.5
_LONGEST_GAP_S: Final = 2.0
_MOVING_MS: Final = 3.0
_MOVED_MS: Final = 2.0
_LONGEST_GRID: Final = 1_000_000
_SPEED_AGREEMENT: Final = 0.05
_CORRELATION: Final = 0.7
_PROVEN: Final = 0.85
_OFFSET_MS2: Final = 0.5
_DISTINCT: Final = 3
# a scale in here may be the road's grade, the noise, or the wheel's radius
_TRUSTED_SCALE: Final = (0.8, 1.25)
_ENOUGH_S: Final = 10.0
_SLOWED_MS2: Final = 2.0
_SELDOM: Final = 0.4
"""Only a brake is seldom applied and slows the car so much more."""

ON_STAND: Final = "a stand or roller, as the accelerometer shows no motion"


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a recording supports a role.

    Args:
        fits: false where it contradicts the role.
        reason: the figures.
        sign: factor of the value, with *scale*.
        scale: factor of the value.
        proven: true where the figures show the role, whatever the name.
        flaws: how many things are wrong with a signal that fits.
    """

    fits: bool
    reason: str
    sign: int = 1
    scale: float = 1.0
    proven: bool = False
    flaws: int = 0


class Motion:
    """Speed of the car and its change on one grid, from several signals.

    It is the median of the signals; one that stays at zero while others move
    does not count. ``seen`` marks where the grid is in no gap of them,
    ``on_stand`` is to be set where the wheels turn and the car stands.
    """

    def __init__(self, speeds: Mapping[str, Samples]) -> None:
        """Take *speeds* in m/s, by any name."""
        stamps = [one.time_s for one in speeds.values() if len(one.time_s)]
        begin = min((float(one.min()) for one in stamps), default=0.0)
        end = max((float(one.max()) for one in stamps), default=0.0)
        step = max(_STEP_S, (end - begin) / _LONGEST_GRID)
        self.grid_s: Series = np.arange(begin, end, step)
        self.step_s = step
        columns = [self.on_grid(one) for one in speeds.values()]
        moved = [one for one in columns if one.max(initial=0.0) > _MOVED_MS]
        self.known = bool(moved) and len(self.grid_s) > _SMOOTH_S / step
        self._compared = len(moved) > 1
        self.speed_ms: Series = (
            np.median(moved, axis=0) if moved else np.zeros_like(self.grid_s)
        )
        self.seen = np.zeros(len(self.grid_s), np.bool_)
        for one in speeds.values():
            self.seen |= _is_between(self.grid_s, one.time_s)
        self.moving = self.seen & (self.speed_ms > _MOVING_MS)
        self.on_stand = False
        self.change_ms2: Series = (
            np.gradient(self.smooth(self.speed_ms), step)
            if self.known
            else np.zeros_like(self.grid_s)
        )

    @property
    def moving_s(self) -> float:
        """Time in motion [s]."""
        return float(np.count_nonzero(self.moving)) * self.step_s

    def on_grid(self, samples: Samples) -> Series:
        """Return *samples* at the times of the grid."""
        order = np.argsort(samples.time_s, kind="stable")
        return np.interp(
            self.grid_s, samples.time_s[order], samples.value[order]
        )

    def smooth(self, values: Series) -> Series:
        """Return the moving mean over half a second."""
        count = max(1, round(_SMOOTH_S / self.step_s))
        padded = np.pad(values, (count // 2, count - 1 - count // 2), "edge")
        return np.convolve(padded, np.full(count, 1 / count), "valid")

    def speed_verdict(self, speed: Samples) -> Verdict:
        """Judge a speed in m/s against the car's."""
        column = self.on_grid(speed)
        if column.max(initial=0.0) <= _MOVED_MS:
            there = "while other speeds move" if self.known else "throughout"
            if self.on_stand:
                there += f": {ON_STAND}"
            return Verdict(
                fits=self.on_stand or not self.known,
                reason=f"at most {column.max(initial=0.0):.2g} m/s {there}",
            )
        if not self.moving.any():
            return Verdict(fits=True, reason="the car hardly moves")
        error = np.abs(column - self.speed_ms)[self.moving]
        off = float(np.median(error / self.speed_ms[self.moving]))
        top = float(column.max())
        reason = f"up to {top:.1f} m/s, " + (
            f"{100 * off:.1f} % off the other speeds"
            if self._compared
            else "the only speed"
        )
        return Verdict(fits=off <= _SPEED_AGREEMENT, reason=reason)

    def acceleration_verdict(self, acceleration: Samples) -> Verdict:
        """Judge an acceleration in m/s2 by regression on the change of speed.

        Least squares ``dv/dt = scale * a + offset`` while the car moves.
        """
        if self.on_stand:
            words = f"nothing to check it with on {ON_STAND}"
            return Verdict(fits=True, reason=words)
        if self.moving_s < _ENOUGH_S:
            return Verdict(
                fits=True, reason="the car moves too little to check it"
            )
        x = self.smooth(self.on_grid(acceleration))[self.moving]
        y = self.change_ms2[self.moving]
        if float(np.std(x)) == 0.0 or float(np.std(y)) == 0.0:
            return Verdict(fits=False, reason="it never changes")
        slope, offset = (float(one) for one in np.polyfit(x, y, 1))
        correlation = float(np.corrcoef(x, y)[0, 1])
        reason = (
            f"dv/dt of the speeds = {slope:.3f} x value {offset:+.2f} m/s2, "
            f"r = {correlation:.2f} over {self.moving_s:.0f} s"
        )
        if abs(correlation) < _CORRELATION:
            return Verdict(fits=False, reason=reason)
        sign = 1 if slope > 0 else -1
        low, high = _TRUSTED_SCALE
        # noise lowers the slope: the other regression bounds it from above
        bounds = abs(slope), abs(slope) / correlation**2
        is_off = bounds[1] < low or bounds[0] > high
        scale = round(abs(slope), 3) if is_off else 1.0
        if is_off:
            reason += f": the stated scale is off by {1 / scale:.2f}"
        if sign < 0:
            reason += ": positive while the car slows down"
        return Verdict(
            fits=True,
            reason=reason,
            sign=sign,
            scale=scale,
            proven=abs(correlation) > _PROVEN,
            flaws=int(is_off) + int(sign < 0) + int(abs(offset) > _OFFSET_MS2),
        )

    def pressure_verdict(self, pressure: Samples) -> Verdict:
        """Judge a pressure in any unit by when it is there.

        It counts as applied above a twentieth of its highest value.
        """
        value = pressure.value
        distinct = len(np.unique(value))
        top = float(value.max(initial=0.0))
        if distinct < _DISTINCT:
            return Verdict(
                fits=False,
                reason=f"takes only {distinct} values up to {top:g}: a flag "
                "or not connected, no pressure",
            )
        if not self.known:
            return Verdict(
                fits=True, reason=f"0 to {top:g}, no speed to compare"
            )
        rest = float(np.quantile(value, 0.05))
        column = self.on_grid(pressure)
        applied = column > rest + 0.05 * (top - rest)
        braking = applied & self.moving
        rolling = ~applied & self.moving
        braking_s = float(np.count_nonzero(braking)) * self.step_s
        share = (
            float(np.mean(applied[self.moving])) if self.moving.any() else 0.0
        )
        standing = applied & self.seen & ~self.moving
        standing_s = float(np.count_nonzero(standing)) * self.step_s
        reason = (
            f"{rest:g} to {top:g}, applied {100 * share:.0f} % of the time on "
            f"the move and {standing_s:.0f} s below {_MOVING_MS:g} m/s"
        )
        if braking_s < 1.0 or not rolling.any():
            return Verdict(
                fits=True,
                reason=f"{reason}; too little braking there to check it with",
            )
        while_on = float(np.mean(self.change_ms2[braking]))
        while_off = float(np.mean(self.change_ms2[rolling]))
        reason += (
            f"; dv/dt is {while_on:.2f} m/s2 while it is applied, "
            f"{while_off:.2f} else"
        )
        return Verdict(
            fits=while_on < while_off + 0.3,
            reason=reason,
            proven=while_on < while_off - _SLOWED_MS2
            and braking_s > _ENOUGH_S
            and share < _SELDOM,
        )


def _is_between(grid_s: Series, time_s: Series) -> npt.NDArray[np.bool_]:
    """Return which times have a stamp before and after, close together."""
    stamps = np.sort(time_s)
    if len(stamps) < 2:
        return np.zeros(len(grid_s), np.bool_)
    after = np.searchsorted(stamps, grid_s).clip(1, len(stamps) - 1)
    return np.asarray(stamps[after] - stamps[after - 1] < _LONGEST_GAP_S)


def to_ms(samples: Samples, unit: str, wheel_radius_m: float) -> Samples:
    """Return a speed given in *unit* in m/s; angular ones by the radius."""
    found = UNITS[unit]
    factor = found.factor
    if found.quantity == "angular_speed":
        factor *= wheel_radius_m
    return type(samples)(samples.time_s, samples.value * factor)


def to_si(samples: Samples, unit: str) -> Samples:
    """Return a value given in *unit* in SI."""
    found = UNITS[unit]
    value = samples.value * found.factor + found.offset
    return type(samples)(samples.time_s, value)

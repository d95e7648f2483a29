"""The channels of a recording on one time grid, faults masked out.

A value is interpolated between two samples that are no further apart than
the role's timeout, and absent (NaN) elsewhere: holding the last one instead
would delay a 10 Hz signal by 50 ms against a 100 Hz one.
"""

from collections.abc import Iterable, Mapping
from typing import Final

import numpy as np

from bstm_daemon.analysis.quality.limits import GRID_S, LONGEST_LAG_S, WINDOW_S
from bstm_daemon.analysis.quality.recording import Recording, Series
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.config.sections import Config
from bstm_daemon.roles import LONGITUDINAL, ROLE_INDEX
from bstm_daemon.units import UNITS, Unit

HALF: Final = round(WINDOW_S / GRID_S / 2)
"""Grid points on each side of a difference quotient."""

_NO_SAMPLES: Final = Series(np.empty(0), np.empty(0))
_BREAK_S: Final = 60.0
_MARGIN: Final = round((LONGEST_LAG_S + WINDOW_S) / GRID_S)


def common_times(series: Iterable[Series]) -> Column:
    """Return the grid [s] over all *series*, (n,).

    Pauses of more than a minute, such as a stray stamp makes, are left out;
    around them lie points without a value, so that nothing reaches across.
    """
    used = [
        np.unique(np.floor(one.time_s / GRID_S).astype(np.int64))
        for one in series
        if len(one)
    ]
    if not used:
        return np.empty(0)
    steps = np.unique(np.concatenate(used))
    cuts = np.flatnonzero(np.diff(steps) > _BREAK_S / GRID_S)
    firsts = steps[np.concatenate(([0], cuts + 1))]
    lasts = steps[np.concatenate((cuts, [len(steps) - 1]))]
    return GRID_S * np.concatenate(
        [
            np.arange(first - _MARGIN, last + _MARGIN + 1)
            for first, last in zip(firsts, lasts, strict=True)
        ]
    )


def at_times(series: Series, time_s: Column, longest_s: float) -> Column:
    """Return *series* at *time_s*, (n,), NaN where no value is valid."""
    if len(series) < 2:
        return np.full(len(time_s), np.nan)
    after = np.searchsorted(series.time_s, time_s, "right")
    inner = (after > 0) & (after < len(series))
    place = np.clip(after, 1, len(series) - 1)
    width = series.time_s[place] - series.time_s[place - 1]
    value = np.interp(time_s, series.time_s, series.value)
    return np.where(inner & (width <= longest_s), value, np.nan)


def difference_quotient(value: Column) -> Column:
    """Return the mean rate of *value* over the window around each point."""
    rate = np.full(len(value), np.nan)
    if len(value) > 2 * HALF:
        rate[HALF:-HALF] = (value[2 * HALF :] - value[: -2 * HALF]) / WINDOW_S
    return rate


def window_mean(value: Column) -> Column:
    """Return the mean of *value* over the same window (trapezoids).

    The counterpart of :func:`difference_quotient`: of a rate, it is exactly
    the difference quotient of its integral.
    """
    mean = np.full(len(value), np.nan)
    if len(value) > 2 * HALF:
        weights = np.ones(2 * HALF + 1)
        weights[[0, -1]] = 0.5
        known = np.isfinite(value)
        total = np.convolve(np.where(known, value, 0.0), weights, "valid")
        count = np.convolve(known, np.ones(2 * HALF + 1), "valid")
        full = count > 2 * HALF + 0.5
        mean[HALF:-HALF] = np.where(full, total / (2 * HALF), np.nan)
    return mean


def without(
    value: Column, time_s: Column, spans: Iterable[tuple[float, float]]
) -> Column:
    """Return *value* with NaN in the *spans* of time."""
    kept = value.copy()
    for first_s, last_s in spans:
        kept[(time_s >= first_s) & (time_s <= last_s)] = np.nan
    return kept


def median_of(columns: Mapping[str, Column]) -> Column:
    """Return the median over the channels that have a value, (n,).

    *columns* holds one channel at least.
    """
    stack = np.array(list(columns.values()))
    known = np.isfinite(stack)
    result = np.full(stack.shape[1], np.nan)
    some = known.any(axis=0)
    result[some] = np.nanmedian(stack[:, some], axis=0)
    return result


def shifted(value: Column, steps: int) -> Column:
    """Return *value* later by *steps* grid points, NaN where it ends."""
    gap = np.full(min(abs(steps), len(value)), np.nan)
    if steps > 0:
        return np.concatenate((gap, value[: len(value) - len(gap)]))
    return np.concatenate((value[len(gap) :], gap))


class Channels:
    """Values of roles at ``time_s``, (n,) each, NaN where absent.

    ``dead`` are roles to leave out, ``spans`` stretches of time of a role to
    leave out: the checks add to them as they find faults.
    """

    def __init__(
        self, recording: Recording, config: Config, timeouts_us: Iterable[int]
    ) -> None:
        """Put every role of *recording* on one grid."""
        self.config = config
        self.recording = recording
        self.series: Mapping[str, Series] = recording.series
        self.timeouts_s = [timeout * 1e-6 for timeout in timeouts_us]
        self.time_s = common_times(recording.series.values())
        self.dead: set[str] = set()
        self.on_stand = False
        self.spans: dict[str, list[tuple[float, float]]] = {}
        self._grid: dict[str, Column] = {}
        self.speed = np.full(len(self.time_s), np.nan)
        self.speed_roles: tuple[str, ...] = ()

    def timeout_s(self, role: str) -> float:
        """Return how long a value of *role* counts as present."""
        return self.timeouts_s[ROLE_INDEX[role]]

    def raw(self, role: str) -> Column:
        """Return *role* on the grid, as it came."""
        if role not in self._grid:
            series = self.series.get(role, _NO_SAMPLES)
            timeout_s = self.timeout_s(role)
            self._grid[role] = at_times(series, self.time_s, timeout_s)
        return self._grid[role]

    def value(self, role: str) -> Column:
        """Return *role* on the grid without its frozen stretches."""
        spans = self.spans.get(role)
        value = self.raw(role)
        return without(value, self.time_s, spans) if spans else value

    def alive(self, roles: Iterable[str]) -> list[str]:
        """Return which of *roles* are in the log and not dead."""
        return [
            role
            for role in roles
            if role in self.series and role not in self.dead
        ]

    def set_speed(self, roles: Iterable[str]) -> None:
        """Take the median of *roles* as the speed of the car, none: absent."""
        self.speed_roles = tuple(roles)
        if not self.speed_roles:
            self.speed = np.full(len(self.time_s), np.nan)
            return
        self.speed = median_of({r: self.value(r) for r in self.speed_roles})

    def speed_rate(self) -> Column:
        """Return dv/dt of the car [m/s2]."""
        return difference_quotient(self.speed)

    def acceleration(self) -> Column:
        """Return the accelerometer over the same window [m/s2]."""
        return window_mean(self.value(LONGITUDINAL))

    def unit(self, role: str) -> tuple[str, float]:
        """Return the configured unit of *role* and its factor to SI."""
        name = self.config.signals[role].unit
        return name, self._factor(role, UNITS[name])

    def _factor(self, role: str, unit: Unit) -> float:
        """Return the factor of *unit* to SI, to m/s for a wheel that turns."""
        if unit.quantity == "angular_speed" and "wheel" in role:
            return unit.factor * self.config.vehicle.wheel_radius_m
        return unit.factor

    def unit_for_scale(
        self, role: str, scale: float, tolerance: float
    ) -> str | None:
        """Return the unit that *role* seems to be in, None if no unit does.

        It reads *scale* times the true value in the configured one.
        """
        configured, factor = self.unit(role)
        quantity = UNITS[configured].quantity
        ratios = {
            name: abs(scale) * self._factor(role, unit) / factor
            for name, unit in UNITS.items()
            if unit.quantity == quantity and name != configured
        }
        misses = [(abs(np.log(ratio)), name) for name, ratio in ratios.items()]
        miss, nearest = min(misses, default=(np.inf, None))
        return nearest if miss <= np.log1p(tolerance) else None


def unit_ratio(
    quantity: str, scale: float, tolerance: float
) -> tuple[str, str] | None:
    """Return two units of *quantity* whose ratio *scale* is, else None.

    The nearest pair, ``1 first = scale second``.
    """
    units = [(n, u) for n, u in UNITS.items() if u.quantity == quantity]
    misses = [
        (abs(float(np.log(abs(scale) * small.factor / large.factor))), a, b)
        for a, large in units
        for b, small in units
        if a != b
    ]
    if not misses:
        return None
    miss, first, second = min(misses)
    return (first, second) if miss <= np.log1p(tolerance) else None

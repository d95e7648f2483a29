"""Samples of different rates on one time grid.

A value is interpolated between two samples that are no further apart than
the role's timeout, and absent (NaN) elsewhere: holding the last one instead
would delay a 10 Hz signal by 50 ms against a 100 Hz one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.quality.limits import GRID_S, LONGEST_LAG_S, WINDOW_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from bstm_daemon.analysis.quality.recording import Series
    from bstm_daemon.analysis.statistics.series import Column

HALF: Final = round(WINDOW_S / GRID_S / 2)
"""Grid points on each side of a difference quotient."""

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
    moved: Column = np.full(len(value), np.nan)
    if abs(steps) >= len(value):
        return moved
    if steps > 0:
        moved[steps:] = value[:-steps]
    elif steps < 0:
        moved[:steps] = value[-steps:]
    else:
        moved[:] = value
    return moved

"""Fit of two readings of one quantity: scale, offset, lag, correlation.

The scale is that of the geometric mean line, which treats both channels
alike: ordinary regression would blame noise of the reference on the scale.
Its bounds are the two ordinary regressions, between which the true scale lies
whatever the noise of either side (Frisch 1934); a verdict needs the whole
interval. Outliers are left out by their median deviation, and a line that
leans on a minority (wheels that spin in every launch) decides nothing: the
medians must show the same scale and offset.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.channels import difference_quotient, shifted
from bstm_daemon.analysis.statistics.series import Column, Mask

_OUTLIER: Final = 5.0
_MAD_TO_SD: Final = 1.4826
_ROUNDS: Final = 8
_COARSE: Final = 4
_LARGE: Final = 0.2
_FLOORS: Final = 4.0
_LEANS: Final = 0.03
_FEWEST: Final = 20
_LAG_FEWEST: Final = 60
_BLOCK: Final = round(60.0 / limits.GRID_S)
_BLOCKS: Final = 12
"""The lag is sought in this many minutes at most."""


@dataclass(frozen=True, slots=True)
class Fit:
    """``channel(t) = scale * reference(t - lag_s) + offset``.

    ``scale_low`` and ``scale_high`` bound the scale; ``correlation`` is that
    of all samples, ``residual_rms`` that of the kept ones, in the channel's
    unit. ``ratio`` is the median of channel over reference, where that is
    large, ``difference`` that of channel minus reference (plus, where the sign
    is wrong). ``lag_s`` is None if no sharp change determines it. ``samples``
    counts common grid points, ``outliers`` the share left out.
    """

    scale: float
    scale_low: float
    scale_high: float
    offset: float
    lag_s: float | None
    correlation: float
    residual_rms: float
    samples: int
    outliers: float
    ratio: float
    difference: float

    @property
    def seconds(self) -> float:
        """Time that both channels were present."""
        return self.samples * limits.GRID_S

    def beyond(self, tolerance: float) -> bool:
        """Whether line and medians are beyond ``1 / tolerance .. tolerance``.

        Both on one side of it.
        """
        scales = abs(self.scale_low), abs(self.scale_high), abs(self.ratio)
        return min(scales) > tolerance or max(scales) < 1 / tolerance

    @property
    def leans(self) -> bool:
        """Whether the median ratio differs from the scale by 3 % or more."""
        return abs(self.ratio - self.scale) > _LEANS * abs(self.scale)

    def offset_beyond(self, tolerance: float) -> bool:
        """Whether line and medians are off by more than *tolerance*."""
        return min(abs(self.offset), abs(self.difference)) > tolerance


def fit_channels(
    reference: Column,
    channel: Column,
    floor: float,
    where: Mask | None = None,
    *,
    lagged: bool = True,
) -> Fit | None:
    """Fit *channel* on *reference*, (n,) on the grid, NaN where absent.

    *floor* is a residual, in the reference's unit, that makes no point an
    outlier; *where* limits the fit (not the lag) to some points; without
    *lagged* no lag is sought. None where fewer than 20 points are left or one
    of the channels is constant.
    """
    lag_s = find_lag(reference, channel) if lagged else None
    steps = 0 if lag_s is None else round(lag_s / limits.GRID_S)
    x, y = shifted(reference, steps), channel
    both = np.isfinite(x) & np.isfinite(y)
    if where is not None:
        both &= where
    x, y = x[both], y[both]
    if len(x) < _FEWEST:
        return None
    correlation = _correlation(x, y)
    if correlation is None:
        return None
    kept = _kept(x, y, floor)
    inner = _correlation(x[kept], y[kept])
    if inner is None:
        kept, inner = np.ones(len(x), np.bool_), correlation
    x_kept, y_kept = x[kept], y[kept]
    scale = float(np.copysign(y_kept.std() / x_kept.std(), inner))
    offset = float(y_kept.mean() - scale * x_kept.mean())
    residual = y_kept - scale * x_kept - offset
    usual = _LARGE * float(np.percentile(np.abs(x), 95))
    large = np.abs(x) > min(_FLOORS * floor, max(floor, usual))
    return Fit(
        scale=scale,
        scale_low=scale * abs(inner),
        scale_high=scale / max(abs(inner), 1e-9),
        offset=offset,
        lag_s=lag_s,
        correlation=correlation,
        residual_rms=float(np.sqrt(np.mean(residual**2))),
        samples=len(x),
        outliers=float(1.0 - np.count_nonzero(kept) / len(x)),
        ratio=float(np.median(y[large] / x[large])) if large.any() else scale,
        difference=float(np.median(y - np.copysign(x, x * inner))),
    )


def find_lag(reference: Column, channel: Column) -> float | None:
    """Return the lag of *channel* [s], None if it is not clear.

    The peak of the cross-correlation of the changes over 0.5 s, to a part of
    a grid step by a parabola through it and its neighbours.
    """
    x_rate, y_rate = map(difference_quotient, (reference, channel))
    x, y = _busiest(limits.WINDOW_S * x_rate, limits.WINDOW_S * y_rate)
    reach = round(limits.LONGEST_LAG_S / limits.GRID_S)
    found: dict[int, float] = {}
    for k in range(-reach, reach + 1, _COARSE):
        found[k] = _lagged_correlation(x, y, k)
    best = max(found, key=lambda k: abs(found[k]))
    for k in range(best - _COARSE, best + _COARSE + 1):
        if abs(k) <= reach and k not in found:
            found[k] = _lagged_correlation(x, y, k)
    best = max(found, key=lambda k: abs(found[k]))
    peak = abs(found[best])
    if peak < limits.LAG_CORRELATION or abs(best) >= reach:
        return None
    before, after = (abs(found.get(best + k, peak)) for k in (-1, 1))
    bend = before - 2.0 * peak + after
    part = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float((best + np.clip(part, -0.5, 0.5)) * limits.GRID_S)


def spread(value: Column) -> float:
    """Return the width of the middle 90 % of *value*, 0 where all NaN."""
    known = value[np.isfinite(value)]
    if not len(known):
        return 0.0
    low, high = np.percentile(known, (5, 95))
    return float(high - low)


def _busiest(x: Column, y: Column) -> tuple[Column, Column]:
    """Return the minutes in which *x* changes most, where there are many."""
    blocks = len(x) // _BLOCK
    if blocks <= _BLOCKS:
        return x, y
    power = np.nan_to_num(x[: blocks * _BLOCK]).reshape(blocks, _BLOCK) ** 2
    chosen = np.sort(np.argsort(power.sum(axis=1))[-_BLOCKS:])
    gap = np.full(round(limits.LONGEST_LAG_S / limits.GRID_S), np.nan)

    def joined(value: Column) -> Column:
        parts = [
            part
            for block in chosen.tolist()
            for part in (value[block * _BLOCK : (block + 1) * _BLOCK], gap)
        ]
        return np.concatenate(parts)

    return joined(x), joined(y)


def _lagged_correlation(x: Column, y: Column, steps: int) -> float:
    late = shifted(x, steps)
    both = np.isfinite(late) & np.isfinite(y)
    if np.count_nonzero(both) < _LAG_FEWEST:
        return 0.0
    return _correlation(late[both], y[both]) or 0.0


def _correlation(x: Column, y: Column) -> float | None:
    if len(x) < 2:
        return None
    x, y = x - x.mean(), y - y.mean()
    # not x @ y: the threads of a BLAS cost more than they save here
    size = float(np.sqrt(np.sum(x * x) * np.sum(y * y)))
    smallest = len(x) * 1e-18
    if size <= smallest:
        return None
    return float(np.clip(np.sum(x * y) / size, -1.0, 1.0))


def _kept(x: Column, y: Column, floor: float) -> Mask:
    """Return the inliers: points near the line of the majority."""
    slope = _start_slope(x, y)
    offset = float(np.median(y - slope * x))
    kept = np.ones(len(x), np.bool_)
    for _ in range(_ROUNDS):
        residual = np.abs(y - slope * x - offset)
        limit = max(
            _OUTLIER * _MAD_TO_SD * float(np.median(residual)),
            floor * abs(slope),
        )
        now = residual <= limit
        if np.array_equal(now, kept) or np.count_nonzero(now) < _FEWEST:
            break
        kept = now
        inner = _correlation(x[kept], y[kept])
        spread_x = float(x[kept].std())
        if inner is None or spread_x == 0.0:
            break
        slope = float(np.copysign(y[kept].std() / spread_x, inner))
        offset = float(np.median(y[kept] - slope * x[kept]))
    return kept


def _start_slope(x: Column, y: Column) -> float:
    """Theil's incomplete slope: the median of low-against-high pairs."""
    order = np.argsort(x, kind="stable")
    half = len(x) // 2
    low, high = order[:half], order[-half:]
    dx = x[high] - x[low]
    wide = dx > 0.2 * float(np.ptp(x))
    if not wide.any():
        return 0.0
    return float(np.median((y[high] - y[low])[wide] / dx[wide]))

"""A drive in few numbers: peaks, margin, brake energy, validity.

The table on screen, the HTML page and JSON say the same because all three
take it from :func:`summarize`. Times are seconds since the first row.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    from bstm_daemon.results import Results

    Column = npt.NDArray[np.float64]

SUMMARY_NODES: Final = ("disc", "pad_front", "pad_back", "fluid")
"""Nodes whose peaks a summary holds."""

VALIDITY_NAMES: Final = ("valid", "degraded", "invalid")
"""What the codes 0, 1 and 2 of a validity column mean."""

STANDING_MS: Final = 0.5
"""At or below this a vehicle stands: wheel-speed sensors fall silent there."""

MOVING_MS: Final = 1.0
"""Above this it has driven off; between the two it does what it did."""

SHORTEST_STOP_S: Final = 10.0
"""A stop that lasts less (a crossing) is no heat soak."""


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest temperature of a node.

    ``after_stop_s`` counts from the last stop before the peak; where none
    came before, from the first one after it, negative. None without a stop.
    ``validity`` is the code of the estimate at the peak. ``at_end``: it is
    the last row, so the real peak comes after the log.
    """

    temperature_c: float
    time_s: float
    after_stop_s: float | None
    validity: int
    at_end: bool


@dataclass(frozen=True, slots=True)
class CornerSummary:
    """One corner. None stands for what the results do not hold.

    ``energy_j`` is the brake energy that heated the model, ``energy_ff_j``
    and ``energy_fb_j`` those of the two heat models. ``validity_shares``
    are fractions of the rows, in the order of :data:`VALIDITY_NAMES`.
    """

    corner: str
    modelled: bool
    peaks: dict[str, Peak]
    margin_k: float | None
    margin_time_s: float | None
    wet_boiling_point_c: float | None
    energy_j: float | None
    energy_ff_j: float | None
    energy_fb_j: float | None
    validity_shares: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class DriveSummary:
    """A drive and its corners, front axle first."""

    start_s: float
    duration_s: float
    distance_m: float | None
    top_speed_ms: float | None
    standing_s: float | None
    stops_s: tuple[float, ...]
    corners: tuple[CornerSummary, ...]


def summarize(results: Results) -> DriveSummary:
    """Return the summary of *results*; columns may be missing or NaN."""
    time_s = results.columns["time_s"]
    start_s = float(time_s[0]) if len(time_s) else 0.0
    elapsed_s = results.elapsed_s
    speed_ms = results.columns.get("speed_ms")
    stops_s: tuple[float, ...] = ()
    standing_s = None
    if speed_ms is not None:
        stops_s = find_stops(elapsed_s, speed_ms)
        standing_s = _integral(
            elapsed_s, (speed_ms <= STANDING_MS).astype(float)
        )
    return DriveSummary(
        start_s=start_s,
        duration_s=float(elapsed_s[-1]) if len(elapsed_s) else 0.0,
        distance_m=_distance_m(results, elapsed_s),
        top_speed_ms=_extreme(speed_ms, largest=True),
        standing_s=standing_s,
        stops_s=stops_s,
        corners=tuple(
            _corner(results, name, elapsed_s, stops_s)
            for name in front_first(results.corners)
        ),
    )


def summary_json(summary: DriveSummary) -> dict[str, object]:
    """Return *summary* as JSON-ready data; None for what is unknown."""
    return asdict(summary)


def front_first(corners: tuple[str, ...]) -> tuple[str, ...]:
    """Return *corners* with the front axle first, left before right."""
    known = ("FL", "FR", "RL", "RR")
    return tuple(
        sorted(
            corners,
            key=lambda name: (
                known.index(name) if name in known else len(known),
                name,
            ),
        )
    )


def find_stops(elapsed_s: Column, speed_ms: Column) -> tuple[float, ...]:
    """Return when the vehicle came to rest for a while.

    A vehicle that stands in the first row has not stopped. A NaN speed
    changes nothing.

    Args:
        elapsed_s: shape (n,), rising.
        speed_ms: shape (n,).

    Returns:
        Start of each standstill of :data:`SHORTEST_STOP_S` or more.
    """
    standing = _held(speed_ms <= STANDING_MS, speed_ms > MOVING_MS)
    edges = np.flatnonzero(np.diff(standing.astype(np.int8))) + 1
    bounds = [*edges.tolist(), len(elapsed_s) - 1]
    return tuple(
        float(elapsed_s[first])
        for first, after in pairwise(bounds)
        if standing[first]
        and elapsed_s[after] - elapsed_s[first] >= SHORTEST_STOP_S
    )


def _held(
    begins: npt.NDArray[np.bool_], ends: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    """Latch: true from a row of *begins* until a row of *ends*."""
    row = np.arange(len(begins))
    decided = np.maximum.accumulate(np.where(begins | ends, row, -1))
    latched: npt.NDArray[np.bool_] = (decided >= 0) & begins[decided]
    return latched


def _corner(
    results: Results,
    name: str,
    elapsed_s: Column,
    stops_s: tuple[float, ...],
) -> CornerSummary:
    def column(key: str) -> Column | None:
        return results.columns.get(f"{name}.{key}")

    validity = column("validity")
    peaks = {}
    for node in SUMMARY_NODES:
        values = column(f"{node}_c")
        row = _extreme_row(values, largest=True)
        if values is None or row is None:
            continue
        time_s = float(elapsed_s[row])
        peaks[node] = Peak(
            temperature_c=float(values[row]),
            time_s=time_s,
            after_stop_s=_after_stop(time_s, stops_s),
            validity=_code(validity, row),
            at_end=0 < row == len(values) - 1,
        )
    margin_k = column("margin_k")
    least = _extreme_row(margin_k, largest=False)
    return CornerSummary(
        corner=name,
        modelled=name in results.modelled,
        peaks=peaks,
        margin_k=_extreme(margin_k, largest=False),
        margin_time_s=None if least is None else float(elapsed_s[least]),
        wet_boiling_point_c=_boiling_point_c(column("fluid_c"), margin_k),
        energy_j=_integral(elapsed_s, column("brake_power_w")),
        energy_ff_j=_integral(elapsed_s, column("brake_power_ff_w")),
        energy_fb_j=_integral(elapsed_s, column("brake_power_fb_w")),
        validity_shares=_shares(validity),
    )


def _after_stop(time_s: float, stops_s: tuple[float, ...]) -> float | None:
    if not stops_s:
        return None
    before = [stop for stop in stops_s if stop <= time_s]
    return time_s - (before[-1] if before else stops_s[0])


def _code(validity: Column | None, row: int) -> int:
    if validity is None or np.isnan(validity[row]):
        return 0
    return int(validity[row])


def _shares(validity: Column | None) -> tuple[float, float, float] | None:
    if validity is None or not len(validity):
        return None
    valid, degraded, invalid = (
        float((validity == code).sum()) / len(validity)
        for code in range(len(VALIDITY_NAMES))
    )
    return valid, degraded, invalid


def _boiling_point_c(
    fluid_c: Column | None, margin_k: Column | None
) -> float | None:
    if fluid_c is None or margin_k is None:
        return None
    return _extreme(fluid_c + margin_k, largest=False)


def _extreme_row(values: Column | None, *, largest: bool) -> int | None:
    if values is None or not np.isfinite(values).any():
        return None
    return int(np.nanargmax(values) if largest else np.nanargmin(values))


def _extreme(values: Column | None, *, largest: bool) -> float | None:
    row = _extreme_row(values, largest=largest)
    return None if values is None or row is None else float(values[row])


def _integral(elapsed_s: Column, rate: Column | None) -> float | None:
    """Integrate *rate*, a row being the mean since the row before it.

    Rows that hold no number, and steps back in time, add nothing.
    """
    if rate is None or not np.isfinite(rate).any():
        return None
    steps_s = np.maximum(np.diff(elapsed_s, prepend=elapsed_s[:1]), 0.0)
    known = np.isfinite(rate)
    return float(np.sum(rate[known] * steps_s[known]))


def _distance_m(results: Results, elapsed_s: Column) -> float | None:
    """Travelled distance: the estimator's own counter where it is kept."""
    counter = results.columns.get("distance_m")
    if counter is not None and np.isfinite(counter).any():
        known = counter[np.isfinite(counter)]
        return float(known[-1] - known[0])
    return _integral(elapsed_s, results.columns.get("speed_ms"))

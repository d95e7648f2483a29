"""A drive in few numbers: peaks, margin, brake energy, validity.

The table on screen, the HTML page and JSON say the same because all three
take it from here; :mod:`bstm_daemon.report.tally` makes it. Times are seconds
since the first row.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from bstm_daemon.report.findings import Finding

SUMMARY_NODES: Final = ("disc", "pad_front", "pad_back", "fluid")
"""Nodes whose peaks a summary holds."""

VALIDITY_NAMES: Final = ("valid", "degraded", "invalid")
"""What the codes 0, 1 and 2 of a validity column mean."""


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
    findings: tuple[Finding, ...] = ()
    """What spoke against the inputs, and when the heat was not known."""


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

"""``bstm verify`` in words: tables for terminal and page, and JSON."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING, Any

from bstm_daemon.matching.verification import LIMITS, coverage, judged

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.matching.verification import NodeErrors, Verdict

ERROR_HEAD = (
    *("drive", "corner", "node", "RMS", "largest", "braking", "driving"),
    *("soak", "last 20 min"),
)
PEAK_HEAD = (
    *("drive", "corner", "node", "measured [degC]", "estimated [degC]"),
    *("apart [K]", "at [min]", "apart [min]"),
)
VERDICT_HEAD = ("limits", "drive", "corner", "requirement", "value", "verdict")


def error_rows(errors: Sequence[NodeErrors]) -> list[tuple[str, ...]]:
    """Return RMS and largest error of each node, RMS by phase [K]."""
    return [
        (
            one.drive,
            one.corner,
            one.node.replace("_", " "),
            f"{one.rms_k:.1f}",
            f"{one.largest_k:.1f}",
            *(
                f"{one.phase_rms_k[name]:.1f} / {one.phase_max_k[name]:.1f}"
                if name in one.phase_rms_k
                else "-"
                for name in ("braking", "driving", "soak")
            ),
            f"{one.last_k:+.1f}",
        )
        for one in errors
    ]


def peak_rows(errors: Sequence[NodeErrors]) -> list[tuple[str, ...]]:
    """Return height and time of each node's peak."""
    return [
        (
            one.drive,
            one.corner,
            one.node.replace("_", " "),
            f"{one.peak.measured_c:.1f}",
            f"{one.peak.estimated_c:.1f}",
            f"{one.peak.apart_k:+.1f}",
            "-"
            if isnan(one.peak.measured_s)
            else f"{one.peak.measured_s / 60.0:.1f}",
            "-"
            if isnan(one.peak.apart_s)
            else f"{one.peak.apart_s / 60.0:+.1f}",
        )
        for one in errors
    ]


def verdict_rows(verdicts: Sequence[Verdict]) -> list[tuple[str, ...]]:
    """Return a row for each requirement."""
    return [
        (
            one.limits,
            one.drive,
            one.corner,
            one.what,
            f"{one.value:.1f} of {one.limit:g}",
            "met" if one.passed else "NOT MET",
        )
        for one in verdicts
    ]


def all_verdicts(errors: Sequence[NodeErrors]) -> list[Verdict]:
    """Return the verdicts of every set of limits."""
    return [
        verdict
        for limits in LIMITS.values()
        for verdict in judged(errors, limits)
    ]


def summary_line(errors: Sequence[NodeErrors]) -> str:
    """Return which sets of limits are met, and the coverage."""
    parts = []
    for limits in LIMITS.values():
        verdicts = judged(errors, limits)
        met = sum(one.passed for one in verdicts)
        parts.append(f"{limits.name}: {met} of {len(verdicts)} met")
    inside, counted = coverage(errors)
    if counted:
        parts.append(
            f"90 % interval covers {inside} of {counted} "
            f"({100.0 * inside / counted:.0f} %)"
        )
    else:
        parts.append("no 90 % interval: the configuration has no [accuracy]")
    return "; ".join(parts)


def verify_text(errors: Sequence[NodeErrors]) -> str:
    """Return the whole result for a terminal."""
    blocks = [
        "error, estimated less measured [K]; by phase RMS / largest",
        *table(ERROR_HEAD, error_rows(errors)),
        "",
        "highest temperatures",
        *table(PEAK_HEAD, peak_rows(errors)),
        "",
        *table(VERDICT_HEAD, verdict_rows(all_verdicts(errors))),
        "",
        summary_line(errors),
    ]
    return "\n".join(blocks)


def verify_json(errors: Sequence[NodeErrors]) -> dict[str, Any]:
    """Return the result for machines; None where a number is not known."""
    inside, counted = coverage(errors)
    return {
        "nodes": [
            {
                "drive": one.drive,
                "corner": one.corner,
                "node": one.node,
                "rms_k": _number(one.rms_k),
                "largest_k": _number(one.largest_k),
                "phase_rms_k": dict(one.phase_rms_k),
                "phase_max_k": dict(one.phase_max_k),
                "peak_measured_c": one.peak.measured_c,
                "peak_estimated_c": one.peak.estimated_c,
                "peak_measured_s": _number(one.peak.measured_s),
                "peak_apart_s": _number(one.peak.apart_s),
                "last_20_min_k": one.last_k,
                "covered": list(one.covered),
            }
            for one in errors
        ],
        "verdicts": [
            {
                "limits": one.limits,
                "drive": one.drive,
                "corner": one.corner,
                "requirement": one.what,
                "value": one.value,
                "limit": one.limit,
                "met": one.passed,
            }
            for one in all_verdicts(errors)
        ],
        "covered": inside,
        "counted": counted,
    }


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return *head* and *rows* as lines with columns aligned."""
    widths = [
        max(len(row[i]) for row in (head, *rows)) for i in range(len(head))
    ]
    return [
        "  ".join(
            cell.ljust(width) for cell, width in zip(row, widths, strict=True)
        ).rstrip()
        for row in (head, *rows)
    ]


def _number(value: float) -> float | None:
    return None if isnan(value) else value

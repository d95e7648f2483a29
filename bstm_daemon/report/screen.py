"""The summary of a drive as plain text, at most 100 columns wide."""

from __future__ import annotations

from typing import Final

from bstm_daemon.report.drive_statistics import (
    SUMMARY_NODES,
    VALIDITY_NAMES,
    CornerSummary,
    DriveSummary,
)
from bstm_daemon.report.text import columns, percent, wrapped
from bstm_daemon.report.timescale import HOUR_S, clock, duration

VALIDITY_MARKS: Final = (" ", "~", "!")
"""Behind a peak whose estimate is valid, degraded, invalid."""

HEADINGS: Final = (
    *("corner", "disc", "pad front", "pad back", "fluid"),
    *("after stop", "margin", "MJ", "FF", "FB"),
)


def summary_table(summary: DriveSummary) -> str:
    """Return *summary* as lines of text.

    Per corner the peak temperature [degC] of each node and when it was, how
    long after the stop the fluid peaked, the least margin to the wet boiling
    point [K], and the brake energy [MJ]: as it heated the model, by
    Feed-Forward, by Feed-Back. Below the table what was valid and why the
    rest was not, which inputs were suspect, and when the heat was not known.
    """
    with_hours = summary.duration_s >= HOUR_S
    rows: list[tuple[str, ...]] = [HEADINGS]
    rows += [_cells(corner, with_hours) for corner in summary.corners]
    form = "h:min:s" if with_hours else "min:s"
    caption = (
        f"peak temperatures in degC at {form}; "
        "margin to the wet boiling point; brake energy in MJ"
    )
    lines = [_drive_line(summary), caption, *columns(rows)]
    if any((corner.after_stop_s or 0.0) < 0.0 for corner in summary.corners):
        lines.append("after stop, negative: time before the first stop")
    lines += _validity_lines(summary)
    if summary.reasons:
        lines.append("not valid because of")
        lines += wrapped([one.text for one in summary.reasons])
    lines += wrapped([one.text for one in summary.findings], mark="")
    return "\n".join(lines)


def _drive_line(summary: DriveSummary) -> str:
    parts = [duration(summary.duration_s)]
    if summary.distance_m is not None:
        parts.append(f"{summary.distance_m / 1000:.1f} km")
    if summary.top_speed_ms is not None:
        parts.append(f"at most {summary.top_speed_ms * 3.6:.0f} km/h")
    if summary.standing_s is not None:
        parts.append(f"{duration(summary.standing_s)} standing")
    return ", ".join(parts)


def _cells(corner: CornerSummary, with_hours: bool) -> tuple[str, ...]:  # noqa: FBT001
    peaks = []
    for node in SUMMARY_NODES:
        peak = corner.peaks.get(node)
        if peak is None:
            peaks.append("-")
            continue
        mark = VALIDITY_MARKS[peak.validity]
        at = clock(peak.time_s, with_hours=with_hours)
        peaks.append(f"{peak.temperature_c:.0f}{mark}{at:>7}")
    after_s = corner.after_stop_s
    return (
        corner.corner,
        *peaks,
        "-" if after_s is None else clock(after_s),
        "-" if corner.margin_k is None else f"{corner.margin_k:.0f} K",
        *map(_megajoule, corner.energies_j),
    )


def _megajoule(energy_j: float | None) -> str:
    if energy_j is None:
        return "-"
    energy_mj = energy_j / 1e6
    # three figures are more than the heat models are worth
    decimals = 2 if abs(energy_mj) < 9.995 else 1
    return f"{energy_mj:.{decimals}f}"


def _validity_lines(summary: DriveSummary) -> list[str]:
    """Return what was valid; corners that agree share a line."""
    alike: dict[str, list[str]] = {}
    for corner in summary.corners:
        if not corner.modelled:
            text = "no temperatures: not modelled"
        elif corner.validity_shares is None:
            text = "validity not recorded"
        else:
            text = ", ".join(
                f"{percent(share)} {name}"
                for name, share in zip(
                    VALIDITY_NAMES, corner.validity_shares, strict=True
                )
                if share > 0.0
            )
        alike.setdefault(text, []).append(corner.corner)
    lines = [f"{' '.join(names)}: {text}" for text, names in alike.items()]
    rising = [
        corner.corner
        for corner in summary.corners
        if "fluid" in corner.peaks and corner.peaks["fluid"].at_end
    ]
    if rising:
        lines.append(
            f"{' '.join(rising)}: fluid still rising at the end of the log"
        )
    marked = {
        peak.validity
        for corner in summary.corners
        for peak in corner.peaks.values()
    } - {0}
    if marked:
        meaning = ", ".join(
            f"{VALIDITY_MARKS[code]} {VALIDITY_NAMES[code]}"
            for code in sorted(marked)
        )
        lines.append(f"peak marks: {meaning}")
    return lines

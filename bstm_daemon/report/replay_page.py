"""The page of ``bstm replay``: facts, summary, linked plots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from bstm_daemon import __version__
from bstm_daemon.report.drive_curves import DriveCurves
from bstm_daemon.report.drive_statistics import (
    SUMMARY_NODES,
    VALIDITY_NAMES,
    CornerSummary,
    DriveSummary,
    Peak,
)
from bstm_daemon.report.replay_figure import KEYS, drive_plots
from bstm_daemon.report.shell import Cell, Page, Section, Table
from bstm_daemon.report.text import percent
from bstm_daemon.report.timescale import HOUR_S, clock, duration, start_text

SAMPLE_COUNTS: Final = {
    "late": "late samples",
    "dropped": "dropped samples",
    "jumps": "clock jumps",
}
"""Words for the estimator's counts; others are shown by their own name."""

DASH: Final = "\N{EN DASH}"
"""Stands for what is not known."""

PLOT_NOTE: Final = (
    "Drag to zoom: all time axes follow. Double-click for the whole drive. "
    "Click a name to hide its curve. Solid: estimate; dotted in the same "
    "colour: sensor."
)

NEAR_K: Final = 30.0
"""A margin below it is worth a warning colour."""

DOUBTFUL: Final = 0.01
"""Share of a drive that is not valid from which on the first sentence has
it."""


@dataclass(frozen=True)
class ReplayFacts:
    """Facts about a replay besides its results.

    ``refused`` counts lines, frames and samples by reason, ``counts`` what
    the estimator saw (late, dropped, jumps).
    """

    title: str
    log: str
    vehicle_id: str
    configuration: str
    heat_mode: str
    refused: Mapping[str, int]
    counts: Mapping[str, int]
    compiled: bool
    warnings: Sequence[str] = ()
    lines: int = 0
    frames: int = 0


def replay_page(
    summary: DriveSummary, curves: DriveCurves, facts: ReplayFacts
) -> Page:
    """Return the page of a replay."""
    warnings = (*facts.warnings, *(one.text for one in summary.findings))
    bare = [one.corner for one in summary.corners if not one.modelled]
    note = PLOT_NOTE
    if bare:
        note += f" {', '.join(bare)}: not modelled, no temperatures."
    sections = [
        Section(
            "The drive",
            keys=KEYS,
            plots=drive_plots(curves, summary),
            across=1,
            note=note,
        ),
        Section("Summary", _corners(summary), note=_corners_note(summary)),
        *_reasons(summary),
        Section("Replay", facts=_facts(facts, summary), folded=True),
    ]
    if warnings:
        known = Section(
            "Notes on this replay", lines=warnings, kind="warnings"
        )
        sections.insert(1, known)
    subtitle = [
        facts.vehicle_id,
        start_text(summary.start_s),
        duration(summary.duration_s),
    ]
    if summary.distance_m is not None:
        subtitle.append(f"{summary.distance_m / 1000:.1f} km")
    return Page(
        facts.title,
        sections,
        _tiles(summary),
        _lead(summary),
        subtitle=" · ".join(filter(None, subtitle)),
    )


def _lead(summary: DriveSummary) -> str | Cell:
    """Return what the drive did to the brake fluid, in a sentence or two."""
    known = [c for c in summary.corners if "fluid" in c.peaks]
    if not known:
        return "No temperature of a brake fluid was estimated."
    corner = max(known, key=lambda c: c.peaks["fluid"].temperature_c)
    peak = corner.peaks["fluid"]
    when = _when(peak, summary.duration_s >= HOUR_S)
    text = (
        f"The brake fluid was hottest at {corner.corner}, "
        f"{peak.temperature_c:.0f} °C, {when}"
    )
    if peak.validity:
        text += " estimate that may be too low"
    margins = [c.margin_k for c in known if c.margin_k is not None]
    tone = ""
    if margins:
        least_k = min(margins)
        tone = "" if peak.validity else "good"
        if least_k < NEAR_K:
            tone = "bad"
        if least_k < 0.0:
            text += f": {-least_k:.0f} K above the boiling point of wet fluid"
        else:
            text += f": {least_k:.0f} K were left to boiling with wet fluid"
    shares = [c.validity_shares for c in known if c.validity_shares]
    doubtful = max((1.0 - share[0] for share in shares), default=0.0)
    if doubtful > DOUBTFUL:
        text += f". Not valid for {percent(doubtful)} of the drive"
        if summary.reasons:
            most = summary.reasons[0].share
            words = [r.words for r in summary.reasons if r.share > most / 2]
            text += f", mostly because of: {', '.join(words)}"
    return Cell(f"{text}.", tone=tone)


def _tiles(summary: DriveSummary) -> list[tuple[str, str]]:
    """Return the extremes over all corners."""
    with_hours = summary.duration_s >= HOUR_S
    tiles = []
    margins = [
        (one.margin_k, one)
        for one in summary.corners
        if one.margin_k is not None
    ]
    if margins:
        margin_k, corner = min(margins, key=lambda entry: entry[0])
        text = f"least margin to wet boiling, {corner.corner}"
        if corner.wet_boiling_point_c is not None:
            text += f" ({corner.wet_boiling_point_c:.0f} °C)"
        tiles.append((f"{margin_k:.0f} K", text))
    for node, heading in (
        ("fluid", "hottest fluid"),
        ("pad_back", "hottest pad back"),
        ("disc", "hottest disc"),
    ):
        known = [one for one in summary.corners if node in one.peaks]
        if known:
            corner = max(known, key=lambda c: c.peaks[node].temperature_c)
            peak = corner.peaks[node]
            # a disc is hottest while it brakes, long after another stop
            when = _when(peak, with_hours, after_stop=node != "disc")
            text = f"{heading}, {corner.corner} {when}"
            tiles.append((f"{peak.temperature_c:.0f} °C", text))
    return tiles


def _when(
    peak: Peak,
    with_hours: bool,  # noqa: FBT001
    *,
    after_stop: bool = True,
) -> str:
    """Return when a peak was, with *after_stop* counted from a stop before."""
    text = f"at {clock(peak.time_s, with_hours=with_hours)}"
    since_s = peak.after_stop_s if after_stop else None
    if since_s is not None and since_s > 0.0:
        text = f"{clock(since_s)} after the stop"
    if peak.at_end:
        text += ", still rising"
    if peak.validity:
        text += f", {VALIDITY_NAMES[peak.validity]}"
    return text


def _corners(summary: DriveSummary) -> Table:
    """Return peaks, margin, energies and validity, a row a corner."""
    with_hours = summary.duration_s >= HOUR_S
    return Table(
        (
            *("corner", "margin", "fluid", "after stop"),
            *("disc", "pad front", "pad back", "used", "FF", "FB"),
            "degraded / invalid",
        ),
        [_corner_row(corner, with_hours) for corner in summary.corners],
        (
            *(("", 1), ("least", 1), ("fluid peak [°C]", 2)),
            *(("peak [°C] and when", 3), ("brake energy [MJ]", 3)),
            ("rows valid /", 1),
        ),
    )


def _corner_row(corner: CornerSummary, with_hours: bool) -> list[str | Cell]:  # noqa: FBT001
    after_s = corner.after_stop_s
    shares = corner.validity_shares
    return [
        corner.corner,
        DASH if corner.margin_k is None else f"{corner.margin_k:.0f} K",
        _peak(corner.peaks.get("fluid"), with_hours),
        DASH if after_s is None else clock(after_s),
        *(
            _peak(corner.peaks.get(node), with_hours)
            for node in SUMMARY_NODES
            if node != "fluid"
        ),
        *(DASH if e is None else f"{e / 1e6:.2f}" for e in corner.energies_j),
        DASH if shares is None else " / ".join(map(percent, shares)),
    ]


def _peak(peak: Peak | None, with_hours: bool) -> str | Cell:  # noqa: FBT001
    if peak is None:
        return DASH
    text = f"{peak.temperature_c:.0f}"
    if peak.validity:
        text += f" ({VALIDITY_NAMES[peak.validity]})"
    at = clock(peak.time_s, with_hours=with_hours)
    return Cell(text, f"{at}, still rising" if peak.at_end else at)


def _reasons(summary: DriveSummary) -> list[Section]:
    """Return why estimates were not valid, if there was a reason."""
    if not summary.reasons:
        return []
    with_hours = summary.duration_s >= HOUR_S
    rows = [
        [
            one.words,
            duration(one.total_s),
            percent(one.share),
            clock(one.from_s, with_hours=with_hours),
            " ".join(one.corners),
        ]
        for one in summary.reasons
    ]
    head = ("reason", "time", "of the drive", "from", "corners")
    heading = "Why estimates are not valid"
    return [Section(heading, Table(head, rows), folded=True)]


def _corners_note(summary: DriveSummary) -> str:
    form = "h:min:s" if summary.duration_s >= HOUR_S else "min:s"
    return (
        f"Peaks of the estimate, times as {form} since the start; the stop is "
        "the last one before the peak, else the first one after it, then "
        "negative; margin to the wet boiling point. Brake energy: used to "
        "heat the model, by Feed-Forward (FF), by Feed-Back (FB)."
    )


def _facts(facts: ReplayFacts, summary: DriveSummary) -> list[tuple[str, str]]:
    rows = [
        ("log", facts.log),
        ("vehicle", facts.vehicle_id),
        ("configuration", facts.configuration),
        ("heat mode", facts.heat_mode),
        ("kernel", "compiled" if facts.compiled else "pure Python"),
        ("program", f"bstm-daemon {__version__}"),
    ]
    if summary.top_speed_ms is not None:
        rows.append(("top speed", f"{summary.top_speed_ms * 3.6:.0f} km/h"))
    if summary.standing_s is not None:
        stops = len(summary.stops_s)
        text = f"{duration(summary.standing_s)}, {stops} stop"
        rows.append(("standing", text + "s" * (stops != 1)))
    # a drive on a virtual bus has no log to count lines of
    if facts.lines:
        rows.append(("lines read", _count(facts.lines)))
        rows.append(("frames used", _count(facts.frames)))
    refused = ", ".join(
        f"{_count(number)} {reason.replace('_', ' ')}"
        for reason, number in facts.refused.items()
        if number
    )
    rows.append(("refused", refused or "none"))
    return rows + [
        (SAMPLE_COUNTS.get(name, name.replace("_", " ")), _count(number))
        for name, number in facts.counts.items()
    ]


def _count(number: int) -> str:
    # a narrow no-break space groups the digits (ISO 80000-1)
    return f"{number:,}".replace(",", "\u202f")

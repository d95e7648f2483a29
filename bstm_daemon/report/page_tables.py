"""The page's tables and headline figures as escaped HTML."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Final

from bstm_daemon.report.screen import percent
from bstm_daemon.report.summary import (
    SUMMARY_NODES,
    VALIDITY_NAMES,
    CornerSummary,
    DriveSummary,
    Peak,
)
from bstm_daemon.report.timescale import HOUR_S, clock
from bstm_daemon.report.traces import NODE_COLOURS, NODE_LABELS

if TYPE_CHECKING:
    from collections.abc import Iterable

DASH: Final = "\N{EN DASH}"
"""Stands for what is not known."""


def headline_tiles(summary: DriveSummary) -> str:
    """Return the extremes over all corners as large figures."""
    with_hours = summary.duration_s >= HOUR_S
    tiles = []
    for node, heading in (
        ("disc", "hottest disc"),
        ("pad_back", "hottest pad back"),
        ("fluid", "hottest fluid"),
    ):
        hottest = max(
            (
                (corner.peaks[node], corner.corner)
                for corner in summary.corners
                if node in corner.peaks
            ),
            key=lambda entry: entry[0].temperature_c,
            default=None,
        )
        if hottest is not None:
            peak, name = hottest
            text = f"{heading}, {name} {_when(peak, with_hours)}"
            tiles.append((f"{peak.temperature_c:.0f} °C", text))
    least = min(
        (
            (corner.margin_k, corner)
            for corner in summary.corners
            if corner.margin_k is not None
        ),
        key=lambda entry: entry[0],
        default=None,
    )
    if least is not None:
        margin_k, corner = least
        text = f"least margin to wet boiling, {corner.corner}"
        if corner.wet_boiling_point_c is not None:
            text += f" ({corner.wet_boiling_point_c:.0f} °C)"
        tiles.append((f"{margin_k:.0f} K", text))
    if not tiles:
        return ""
    return (
        '<div class="tiles">'
        + "".join(
            f'<div class="tile"><b>{escape(value)}</b>'
            f"<span>{escape(text)}</span></div>"
            for value, text in tiles
        )
        + "</div>"
    )


def corner_table(summary: DriveSummary) -> str:
    """Return peaks, margin, energies and validity, a row a corner."""
    with_hours = summary.duration_s >= HOUR_S
    peaks = "".join(
        f'<th style="color:{NODE_COLOURS[node]}">{NODE_LABELS[node]}</th>'
        for node in SUMMARY_NODES
    )
    body = "".join(
        _corner_row(corner, with_hours) for corner in summary.corners
    )
    form = "h:min:s" if with_hours else "min:s"
    return (
        '<div class="scroll"><table class="corners"><thead>'
        '<tr><th></th><th colspan="4">peak [°C] and when</th>'
        "<th>fluid peak</th><th>least</th>"
        '<th colspan="3">brake energy [MJ]</th>'
        "<th>rows valid /</th></tr>"
        f"<tr><th>corner</th>{peaks}<th>after stop</th><th>margin</th>"
        "<th>used</th><th>FF</th><th>FB</th>"
        "<th>degraded / invalid</th></tr></thead>"
        f"<tbody>{body}</tbody></table></div>"
        f'<p class="note">Peaks of the estimate, times as {form} since the '
        "start; the stop is the last one before the peak, else the first one "
        "after it, then negative; margin to the wet boiling point. Brake "
        "energy: used to heat the model, by Feed-Forward (FF), by Feed-Back "
        "(FB).</p>"
    )


def facts_list(rows: Iterable[tuple[str, str]]) -> str:
    """Return *rows*, label and text, as a list of terms."""
    return (
        '<dl class="facts">'
        + "".join(
            f"<div><dt>{escape(label)}</dt><dd>{escape(text)}</dd></div>"
            for label, text in rows
        )
        + "</dl>"
    )


def _corner_row(corner: CornerSummary, with_hours: bool) -> str:  # noqa: FBT001
    cells = []
    for node in SUMMARY_NODES:
        peak = corner.peaks.get(node)
        if peak is None:
            cells.append(DASH)
            continue
        cell = f"{peak.temperature_c:.0f}"
        if peak.validity:
            cell += f" ({VALIDITY_NAMES[peak.validity]})"
        at = clock(peak.time_s, with_hours=with_hours)
        if peak.at_end:
            at += ", still rising"
        cells.append(f"{cell} <small>{at}</small>")
    fluid = corner.peaks.get("fluid")
    after_s = None if fluid is None else fluid.after_stop_s
    cells.append(DASH if after_s is None else clock(after_s))
    cells.append(
        DASH if corner.margin_k is None else f"{corner.margin_k:.0f} K"
    )
    cells += [
        DASH if energy_j is None else f"{energy_j / 1e6:.2f}"
        for energy_j in (
            corner.energy_j,
            corner.energy_ff_j,
            corner.energy_fb_j,
        )
    ]
    shares = corner.validity_shares
    cells.append(
        DASH if shares is None else escape(" / ".join(map(percent, shares)))
    )
    row = "".join(f"<td>{cell}</td>" for cell in cells)
    return f"<tr><th>{escape(corner.corner)}</th>{row}</tr>"


def _when(peak: Peak, with_hours: bool) -> str:  # noqa: FBT001
    """Say when a peak was, by the stop if it came after one."""
    text = f"at {clock(peak.time_s, with_hours=with_hours)}"
    if peak.after_stop_s is not None and peak.after_stop_s > 0.0:
        text = f"{clock(peak.after_stop_s)} after the stop"
    if peak.at_end:
        text += ", still rising"
    if peak.validity:
        text += f", {VALIDITY_NAMES[peak.validity]}"
    return text

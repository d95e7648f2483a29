"""One self-contained HTML page a replay: facts, summary, linked plots.

The page needs no network: plotly.js is inside. Its content security policy
allows the three scripts by their SHA-256 and nothing else, so a name from a
DBC, a log or a configuration stays text whatever it holds.
"""

from __future__ import annotations

import base64
import hashlib
import json
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.errors import MissingExtraError
from bstm_daemon.files import replacing
from bstm_daemon.report.figure import Figure, replay_figure
from bstm_daemon.report.layout import EPOCH
from bstm_daemon.report.page_parts import SCRIPT, STYLE
from bstm_daemon.report.page_tables import (
    corner_table,
    facts_list,
    headline_tiles,
)
from bstm_daemon.report.timescale import duration, start_text

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from bstm_daemon.report.summary import DriveSummary
    from bstm_daemon.report.traces import DriveCurves

SAMPLE_COUNTS: Final = {
    "late": "late samples",
    "dropped": "dropped samples",
    "jumps": "clock jumps",
}
"""Words for the estimator's counts; others are shown by their own name."""


@dataclass(frozen=True)
class ReportFacts:
    """What a page says of a replay besides its results.

    ``refused`` counts lines, frames and samples by reason, ``counts`` what
    the estimator saw (late, dropped, jumps); ``rows`` are further facts as
    label and text.
    """

    title: str
    logs: tuple[str, ...]
    vehicle_id: str
    configuration: str
    heat_mode: str
    lines: int
    frames: int
    refused: Mapping[str, int]
    counts: Mapping[str, int]
    kernel: str
    version: str
    warnings: tuple[str, ...] = ()
    rows: tuple[tuple[str, str], ...] = field(default=())


def write_replay_report(
    path: Path,
    summary: DriveSummary,
    curves: DriveCurves,
    facts: ReportFacts,
) -> None:
    """Write a replay as one HTML page to *path*, whole or not at all.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    page = replay_page(summary, curves, facts)
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def replay_page(
    summary: DriveSummary, curves: DriveCurves, facts: ReportFacts
) -> str:
    """Return the page of a replay.

    Raises:
        MissingExtraError: plotly is not installed.
    """
    library = plotly_js()
    figure = replay_figure(curves, summary)
    policy = (
        "default-src 'none'; style-src 'unsafe-inline'; "
        "img-src data: blob:; script-src "
        + " ".join(hash_source(script) for script in (library, SCRIPT))
    )
    buttons = "".join(
        f'<button type="button" aria-pressed="false">{view.name}</button>'
        for view in figure.views
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(facts.title)}</title>
<style>{STYLE}</style>
</head>
<body>
<main>
<h1>{escape(facts.title)}</h1>
<p class="under">{escape(_subtitle(summary, facts))}</p>
{headline_tiles(summary)}
{_warnings(facts, summary)}
<section>
<h2>Summary</h2>
{corner_table(summary)}
</section>
<section>
<div class="views">{buttons}
<span class="key"><i class="degraded"></i>degraded estimate
<i class="suspect"></i>suspect input, heat of the other source
<i class="invalid"></i>invalid estimate, missing input, unknown heat</span>
</div>
<div id="plot"></div>
<noscript>The plots need JavaScript.</noscript>
<p class="note">Drag to zoom: all time axes follow. Double-click for the whole
drive. Click a name at the right to hide its curve. Solid: estimate; dotted in
the same colour: measured.</p>
</section>
<section>
<h2>Replay</h2>
{facts_list(_facts(facts, summary))}
</section>
<footer>bstm-daemon {escape(facts.version)}. Estimate and advice, not a
safety function.</footer>
</main>
<script type="application/json" id="drive">{_figure_json(figure)}</script>
<script>{library}</script>
<script>{SCRIPT}</script>
</body>
</html>
"""


def script_safe_json(value: object) -> str:
    """Return *value* as JSON that can stand inside a ``script`` element.

    ``<``, ``>`` and ``&`` occur only in strings, where their escapes mean
    the same; without them no text can end the element or open a comment.

    Raises:
        ValueError: *value* holds NaN or infinity.
    """
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for mark in "<>&":
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return text


def plotly_js() -> str:
    """Source of plotly.js; raises MissingExtraError without plotly."""
    try:
        from plotly.offline import get_plotlyjs  # noqa: PLC0415
    except ImportError as error:
        package, purpose = "plotly", "the HTML report"
        raise MissingExtraError(package, "report", purpose) from error
    library: str = get_plotlyjs()
    # a parser ends the element at this mark even inside a string
    return library.replace("</script", r"<\/script")


def hash_source(script: str) -> str:
    """Source expression of a content security policy for *script*."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def _figure_json(figure: Figure) -> str:
    views: list[dict[str, Any]] = [
        {
            "traces": view.traces,
            "named": view.named,
            "layout": view.layout,
        }
        for view in figure.views
    ]
    return script_safe_json(
        {
            "epoch": f"{EPOCH.isoformat()}Z",
            "traces": figure.traces,
            "views": views,
        }
    )


def _subtitle(summary: DriveSummary, facts: ReportFacts) -> str:
    parts = [facts.vehicle_id]
    start = start_text(summary.start_s)
    if start is not None:
        parts.append(start)
    parts.append(duration(summary.duration_s))
    if summary.distance_m is not None:
        parts.append(f"{summary.distance_m / 1000:.1f} km")
    return " · ".join(parts)


def _warnings(facts: ReportFacts, summary: DriveSummary) -> str:
    said = [*facts.warnings, *(found.text for found in summary.findings)]
    if not said:
        return ""
    items = "".join(f"<li>{escape(text)}</li>" for text in said)
    return (
        f'<section class="warnings"><h2>To know of this replay</h2>'
        f"<ul>{items}</ul></section>"
    )


def _facts(facts: ReportFacts, summary: DriveSummary) -> list[tuple[str, str]]:
    """Return label and text of every fact, not yet escaped."""
    rows = [
        ("log" if len(facts.logs) == 1 else "logs", ", ".join(facts.logs)),
        ("vehicle", facts.vehicle_id),
        ("configuration", facts.configuration),
        ("heat mode", facts.heat_mode),
        ("kernel", facts.kernel),
        ("program", f"bstm-daemon {facts.version}"),
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
    rows.append(
        (
            "refused",
            ", ".join(
                f"{_count(number)} {reason.replace('_', ' ')}"
                for reason, number in facts.refused.items()
                if number
            )
            or "none",
        )
    )
    rows += [
        (SAMPLE_COUNTS.get(name, name.replace("_", " ")), _count(number))
        for name, number in facts.counts.items()
    ]
    return [*rows, *facts.rows]


def _count(number: int) -> str:
    # a narrow no-break space groups the digits (ISO 80000-1)
    return f"{number:,}".replace(",", "\u202f")

"""One self-contained HTML page of tables and single plots."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Final

from bstm_daemon.files import replacing
from bstm_daemon.report.layout import EPOCH
from bstm_daemon.report.page import (
    hash_source,
    plotly_js,
    script_safe_json,
)
from bstm_daemon.report.page_parts import STYLE
from bstm_daemon.report.quality_parts import QUALITY_STYLE

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bstm_daemon.report.plots import Plot

PLOT_STYLE: Final = """
.pairs { display: grid; gap: 8px 16px;
  grid-template-columns: repeat(auto-fit, minmax(430px, 1fr)); }
.trios { display: grid; gap: 8px 16px;
  grid-template-columns: repeat(auto-fit, minmax(330px, 1fr)); }
.plain td:first-child, .plain th:first-child { text-align: left; }
.plain td.words { white-space: normal; }
.plain .scroll + ul { margin-top: 10px; }
.plot { min-height: 280px; min-width: 0; }
.plot h3 { font-size: 13px; margin: 8px 0 0; }
"""

SHORT: Final = 24
"""Characters of a cell that stay on one line; longer ones are words, which
wrap instead of pushing the table out of the page."""

SCRIPT: Final = r"""
"use strict";
const page = JSON.parse(document.getElementById("page").textContent);
const epoch = Date.parse(page.epoch);
const config = { responsive: true, displayModeBar: false };
async function drawAll() {
  for (const [i, plot] of page.plots.entries()) {
    if (plot.clock) {
      for (const trace of plot.data) {
        trace.x = trace.x.map(
          (s) => new Date(epoch + s * 1000).toISOString().slice(0, -1));
      }
    }
    await Plotly.newPlot("plot-" + i, plot.data, plot.layout, config);
  }
  document.body.dataset.drawn = "yes";
}
drawAll();
"""


@dataclass(frozen=True, slots=True)
class Table:
    """A table: headings and rows of text; the first column is the name."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class PageSection:
    """A part of the page: ``plots`` are pairs of title and plot.

    ``across`` is how many of them stand side by side, 1 to 3.
    """

    heading: str
    table: Table | None = None
    plots: tuple[tuple[str, Plot], ...] = ()
    lines: tuple[str, ...] = ()
    note: str = ""
    across: int = 2


@dataclass(frozen=True, slots=True)
class PageHead:
    """What stands above: ``tiles`` are pairs of a figure and its meaning."""

    title: str
    subtitle: str
    version: str
    tiles: tuple[tuple[str, str], ...] = ()


def write_plot_page(
    path: Path, head: PageHead, sections: Sequence[PageSection]
) -> None:
    """Write the page to *path*, whole or not at all.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    page = plot_page(head, sections)
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def plot_page(head: PageHead, sections: Sequence[PageSection]) -> str:
    """Return the page; every text in it is escaped.

    Raises:
        MissingExtraError: plotly is not installed.
    """
    library = plotly_js()
    policy = (
        "default-src 'none'; style-src 'unsafe-inline'; "
        "img-src data: blob:; script-src "
        + " ".join(hash_source(script) for script in (library, SCRIPT))
    )
    plots = [plot for part in sections for _, plot in part.plots]
    data = script_safe_json(
        {
            "epoch": f"{EPOCH.isoformat()}Z",
            "plots": [
                {"data": p.data, "layout": p.layout, "clock": p.clock}
                for p in plots
            ],
        }
    )
    body, first = [], 0
    for part in sections:
        body.append(_section(part, first))
        first += len(part.plots)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(head.title)}</title>
<style>{STYLE}{QUALITY_STYLE}{PLOT_STYLE}</style>
</head>
<body>
<main>
<h1>{escape(head.title)}</h1>
<p class="under">{escape(head.subtitle)}</p>
{_tiles(head.tiles)}
{"".join(body)}
<noscript>The plots need JavaScript.</noscript>
<footer>bstm-daemon {escape(head.version)}. Estimate and advice, not a
safety function.</footer>
</main>
<script type="application/json" id="page">{data}</script>
<script>{library}</script>
<script>{SCRIPT}</script>
</body>
</html>
"""


def _tiles(tiles: Sequence[tuple[str, str]]) -> str:
    if not tiles:
        return ""
    return (
        '<div class="tiles">'
        + "".join(
            f'<div class="tile"><b>{escape(figure)}</b>'
            f"<span>{escape(text)}</span></div>"
            for figure, text in tiles
        )
        + "</div>"
    )


def _section(part: PageSection, first: int) -> str:
    text = f'<section class="plain"><h2>{escape(part.heading)}</h2>'
    if part.table is not None:
        text += _table(part.table)
    if part.lines:
        items = "".join(f"<li>{escape(line)}</li>" for line in part.lines)
        text += f"<ul>{items}</ul>"
    if part.plots:
        kind = {1: "", 3: ' class="trios"'}.get(part.across, ' class="pairs"')
        text += f"<div{kind}>" + "".join(
            f'<div class="plot"><h3>{escape(title)}</h3>'
            f'<div id="plot-{first + i}"></div></div>'
            for i, (title, _) in enumerate(part.plots)
        )
        text += "</div>"
    if part.note:
        text += f'<p class="note">{escape(part.note)}</p>'
    return text + "</section>"


def _is_words(text: str) -> bool:
    return len(text) > SHORT


def _kind(words: bool) -> str:  # noqa: FBT001
    return "words" if words else "number"


def _table(table: Table) -> str:
    columns = [
        [row[place] for row in table.rows]
        for place in range(1, len(table.head))
    ]
    # of reasons and descriptions, not of figures with a reason among them
    of_words = [
        2 * sum(map(_is_words, cells)) > len(cells) for cells in columns
    ]
    head = "".join(
        f'<th class="{_kind(words)}">{escape(name)}</th>'
        for name, words in zip(table.head[1:], of_words, strict=True)
    )
    rows = "".join(
        f"<tr><th>{escape(row[0])}</th>"
        + "".join(
            f'<td class="{_kind(words or _is_words(text))}">'
            f"{escape(text)}</td>"
            for text, words in zip(row[1:], of_words, strict=True)
        )
        + "</tr>"
        for row in table.rows
    )
    return (
        '<div class="scroll"><table><thead><tr>'
        f"<th>{escape(table.head[0])}</th>{head}</tr></thead>"
        f"<tbody>{rows}</tbody></table></div>"
    )

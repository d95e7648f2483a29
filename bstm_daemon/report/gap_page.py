"""The page of ``bstm gap``: the map, the candidates, before and after."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.gap.locating import TEMPERATURES_C, labels
from bstm_daemon.gap.residual_heat import REGIMES
from bstm_daemon.gap.showing import BASELINES, CONFIGURED, EXTENDED
from bstm_daemon.report.advice_words import (
    ADVICE_HEAD,
    advice_headline,
    advice_rows,
)
from bstm_daemon.report.gap_words import (
    CANDIDATE_HEAD,
    CELL_HEAD,
    ERROR_HEAD,
    answer_tile,
    candidate_rows,
    cell_rows,
    change,
    error_rows,
    headline,
    naming_lines,
    place_lines,
    probability_tile,
    shown_lines,
    strength_tile,
    unnamed_lines,
)
from bstm_daemon.report.plot_page import (
    PageHead,
    PageSection,
    Table,
    write_plot_page,
)
from bstm_daemon.report.plots import Plot, curve, plot, time_plot
from bstm_daemon.report.traces import BLUE, VERMILION

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bstm_daemon.gap.locating import Cell, Located
    from bstm_daemon.gap.naming import Naming
    from bstm_daemon.gap.showing import Curve, Shown
    from bstm_daemon.gap.workflow import Gap

ORDER: Final = ("disc", "pad_front", "pad_back", "fluid", "caliper")
CLEAR: Final = 3.0
"""Standard deviations from which a cell of the map has its full colour."""

SCALE: Final = (
    (0.0, "#2166ac"),
    (0.25, "#92c5de"),
    (0.5, "#f7f7f7"),
    (0.75, "#f4a582"),
    (1.0, "#b2182b"),
)
MOST_CELLS: Final = 12
BARS: Final = 10
WEAK_EVIDENCE: Final = 5.0
"""The axis of the bars ends no earlier: what is next to nothing looks so."""


def write_gap_page(
    path: Path,
    gaps: Sequence[Gap],
    *,
    subtitle: str,
    version: str,
    remarks: Sequence[str] = (),
) -> None:
    """Write what *gaps* found to *path*, *remarks* beside each answer.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    sections = []
    for gap in gaps:
        prefix = f"{', '.join(gap.corners)}: "
        if gap.located is not None:
            sections.append(_map_section(prefix, gap.located))
        if gap.naming is not None:
            sections.append(_naming_section(prefix, gap, remarks))
        if gap.advice:
            sections.append(advice_section(prefix, gap))
        if gap.shown is not None:
            sections += _shown_sections(prefix, gap.shown)
        if gap.before is not None and gap.after is not None:
            sections.insert(
                -len({one.drive for one in gap.shown.curves})
                if gap.shown
                else len(sections),
                _maps_section(prefix, gap.before, gap.after),
            )
        if gap.located is not None:
            sections.append(_tables_section(prefix, gap.located))
    head = PageHead("Gap", subtitle, version, head_tiles(gaps))
    write_plot_page(path, head, sections)


def head_tiles(gaps: Sequence[Gap]) -> tuple[tuple[str, str], ...]:
    """Return the answer's tiles, of the first corners that lack something."""
    found = [
        one for one in gaps if one.naming is not None and one.naming.found
    ]
    gap = (*found, *gaps)[0]
    of = f", {', '.join(gap.corners)}" if len(gaps) > 1 else ""
    tiles = []
    if gap.naming is not None:
        answer, meaning = answer_tile(gap.naming)
        tiles += [(answer, f"{meaning}{of}"), probability_tile(gap.naming)]
    if gap.fit is not None:
        tiles += [
            strength_tile(name, strength, gap.fit.deviations[name])
            for name, strength in gap.fit.strengths.items()
        ]
    if gap.shown is not None:
        word, one = change(gap.shown.shrinks[CONFIGURED])
        tiles.append(
            (f"{one.factor:.1f} x", f"{word} gap, tunables re-fitted")
        )
    return tuple(tiles)


def _map_section(prefix: str, located: Located) -> PageSection:
    return PageSection(
        f"{prefix}where the heat is missing",
        plots=(("", heat_map(located.cells)),),
        lines=tuple(place_lines(located)),
        across=1,
        note="Heat that the model lacks at a part while its measured "
        "neighbours are held to their thermocouples. Red: the real part "
        "takes up more heat than the model gives it; blue: less. Pale: within "
        f"{CLEAR:g} standard deviations of what sensors and the form of the "
        "model explain. Mean of the corners.",
    )


def _maps_section(prefix: str, before: Located, after: Located) -> PageSection:
    return PageSection(
        f"{prefix}the map of the same drives, before and after",
        plots=(
            ("as configured", heat_map(before.cells)),
            ("with the effect", heat_map(after.cells)),
        ),
        across=1,
    )


def heat_map(cells: Sequence[Cell]) -> Plot:
    """Return the map: nodes against regime and temperature of the node."""
    bins = [
        name.removesuffix(" °C").replace(" to ", "-")
        for name in labels(TEMPERATURES_C, "°C")
    ]
    written = labels(TEMPERATURES_C, "degC")
    columns = [
        (regime, number)
        for regime in REGIMES
        for number in range(len(bins))
        if any(c.regime == regime and c.bin == written[number] for c in cells)
    ]
    nodes = [n for n in ORDER if any(c.node == n for c in cells)]
    by_place = {(c.node, c.regime, c.bin): c for c in cells}
    z: list[list[float | None]] = []
    text: list[list[str]] = []
    hover: list[list[str]] = []
    for node in reversed(nodes):
        row: list[float | None] = []
        words, tips = [], []
        for regime, number in columns:
            cell = by_place.get((node, regime, written[number]))
            row.append(None if cell is None else _shade(cell.z))
            words.append("" if cell is None else _kilojoules(cell))
            tips.append(
                ""
                if cell is None
                else f"{node} {regime} {bins[number]} °C: "
                f"{1e-3 * cell.energy_j:+.1f} kJ ± "
                f"{1e-3 * cell.deviation_j:.1f}, {cell.windows} half minutes"
            )
        z.append(row)
        text.append(words)
        hover.append(tips)
    data: dict[str, Any] = {
        "type": "heatmap",
        "x": [
            [regime for regime, _ in columns],
            [bins[number] for _, number in columns],
        ],
        "y": [n.replace("_", " ") for n in reversed(nodes)],
        "z": z,
        "text": text,
        "texttemplate": "%{text}",
        "hovertext": hover,
        "hoverinfo": "text",
        "zmin": -1.0,
        "zmax": 1.0,
        "xgap": 2,
        "ygap": 2,
        "colorscale": [list(pair) for pair in SCALE],
        "colorbar": {
            "tickvals": [-1.0, -0.5, 0.0, 0.5, 1.0],
            "ticktext": ["too much", "", "as measured", "", "missing"],
            "thickness": 12,
        },
    }
    return plot(
        [data],
        "",
        "",
        height=130 + 62 * len(nodes),
        margin={"l": 90, "b": 90},
        xaxis={
            "type": "multicategory",
            "showgrid": False,
            "tickangle": 0,
            "tickfont": {"size": 10.5},
            "title": {
                "text": "temperature of the part [°C], what the car does",
                "standoff": 12,
            },
        },
        yaxis={"type": "category", "showgrid": False, "tickmode": "auto"},
    )


def _shade(z: float) -> float:
    """Return the colour of *z*: full only well beyond :data:`CLEAR`."""
    size = abs(z) / CLEAR
    shade = 0.25 * size if size < 1.0 else 1.0 - 0.5 / size
    return shade if z >= 0.0 else -shade


def _kilojoules(cell: Cell) -> str:
    mark = "" if abs(cell.z) >= CLEAR else "·"
    if mark:
        return mark
    return f"{1e-3 * cell.energy_j:+.0f} kJ"


def _naming_section(
    prefix: str, gap: Gap, remarks: Sequence[str]
) -> PageSection:
    naming = gap.naming
    if naming is None:
        return PageSection(prefix)
    lines = [*remarks, *naming_lines(naming)]
    lines += unnamed_lines(gap)
    if gap.silent:
        lines.append(f"not excited by these drives: {', '.join(gap.silent)}")
    return PageSection(
        f"{prefix}{headline(gap)}",
        Table(CANDIDATE_HEAD, tuple(candidate_rows(naming))),
        plots=(
            ("how far each effect beats 'nothing'", evidence_bars(naming)),
        ),
        lines=tuple(lines),
        across=1,
        note="Every effect is simulated on these drives and fitted together "
        "with all tunables. A strength of 1 is typical; sd is of the noise "
        "alone.",
    )


def advice_section(prefix: str, gap: Gap) -> PageSection:
    """Return the table of drives that could be driven next."""
    return PageSection(
        f"{prefix}which drive next",
        Table(ADVICE_HEAD, tuple(advice_rows(gap))),
        lines=(advice_headline(gap),),
        note="Worlds are drawn from what these drives leave open; each is "
        "driven with the model itself, its noise added, and named as it "
        "would be. The Bayes factor is that of the true effect over its best "
        f"rival; now it is {gap.advice[0].now:+.1f}.",
    )


def evidence_bars(naming: Naming) -> Plot:
    """Return the log Bayes factor of the likeliest candidates as bars."""
    best = [
        one
        for one in naming.candidates[:BARS]
        if one.log_evidence > 0.0 or one is naming.candidates[0]
    ]
    data = {
        "type": "bar",
        "orientation": "h",
        "x": [float(f"{one.log_evidence:.4g}") for one in reversed(best)],
        "y": [escape(one.name.replace("_", " ")) for one in reversed(best)],
        "marker": {
            "color": [
                VERMILION if one.name in naming.names else "#9aa5b1"
                for one in reversed(best)
            ]
        },
        "showlegend": False,
    }
    most = max(one.log_evidence for one in best)
    least = min(0.0, *(one.log_evidence for one in best))
    return plot(
        [data],
        "logarithm of the Bayes factor",
        "",
        height=110 + 26 * len(best),
        xaxis={"range": [1.05 * least, max(1.05 * most, WEAK_EVIDENCE)]},
        margin={"l": 190},
        yaxis={"type": "category", "showgrid": False, "tickmode": "auto"},
    )


def _shown_sections(prefix: str, shown: Shown) -> list[PageSection]:
    where = "held-out drives" if shown.held_out else "the fitted drives"
    sections = [
        PageSection(
            f"{prefix}before and after on {where}",
            Table(ERROR_HEAD, tuple(error_rows(shown))),
            lines=tuple(shown_lines(shown)),
        )
    ]
    for drive in dict.fromkeys(one.drive for one in shown.curves):
        own = [one for one in shown.curves if one.drive == drive]
        sections.append(
            PageSection(
                f"{prefix}temperatures on {drive}",
                plots=tuple(
                    (one.node.replace("_", " "), _curves(one)) for one in own
                ),
                note="Black: measured. Orange: with the effect, tunables "
                "re-fitted; what is adopted leaves them as configured.",
            )
        )
    return sections


def _curves(one: Curve) -> Plot:
    looks = {
        CONFIGURED: ("#9aa5b1", "solid"),
        BASELINES[1]: ("#b8a05a", "dot"),
        BASELINES[2]: (BLUE, "dash"),
        EXTENDED: (VERMILION, "solid"),
    }
    data = [
        curve(one.time_s, one.measured_c, "measured", "#000000", width=2.6)
    ]
    data += [
        curve(one.time_s, one.model_c[name], name, colour, dash=dash)
        for name, (colour, dash) in looks.items()
    ]
    span = (0.0, float(one.time_s[-1]))
    return time_plot(data, "temperature [°C]", span, height=320)


def _tables_section(prefix: str, located: Located) -> PageSection:
    cells = [*located.by_speed, *located.by_pressure, *located.by_time]
    return PageSection(
        f"{prefix}residual heat by speed, pressure and time",
        Table(CELL_HEAD, tuple(cell_rows(cells)[:MOST_CELLS])),
        note="The plainest; all are in the JSON file.",
    )

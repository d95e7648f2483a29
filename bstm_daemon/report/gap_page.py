"""``bstm gap`` as page and as JSON: map, candidates, before and after."""

from collections.abc import Mapping, Sequence
from html import escape
from textwrap import wrap
from typing import Any, Final

from bstm_daemon.analysis.gap.changes import name_of
from bstm_daemon.analysis.gap.holdout_comparison import (
    BASELINES,
    CONFIGURED,
    EXTENDED,
    NodeErrors,
    Shown,
    Shrink,
)
from bstm_daemon.analysis.gap.naming import Naming
from bstm_daemon.analysis.gap.residual_heat import (
    REGIMES,
    TEMPERATURES_C,
    Cell,
    Located,
    labels,
)
from bstm_daemon.analysis.gap.workflow import Gap
from bstm_daemon.report import gap as words
from bstm_daemon.report import plots
from bstm_daemon.report.json_file import picked
from bstm_daemon.report.shell import Page, Section, Table

ORDER: Final = ("disc", "pad_front", "pad_back", "fluid", "caliper")
CLEAR: Final = 3.0
"""Standard deviations from which a cell of the map has a colour."""

SCALE: Final = (
    (0.0, "#2166ac"),
    (0.25, "#92c5de"),
    (0.5, "#f7f7f7"),
    (0.75, "#f4a582"),
    (1.0, "#b2182b"),
)
_NAMES_AXIS: Final = {
    "type": "category",
    "showgrid": False,
    "tickmode": "auto",
}
MOST_CELLS: Final = 12
BARS: Final = 10

LABEL_CHARACTERS: Final = 26
"""In a line of a bar's name, which may have several."""

WEAK_EVIDENCE: Final = 5.0
"""Least end of the bars' axis, so that weak evidence looks weak."""


def gap_page(
    gaps: Sequence[Gap], subtitle: str, remarks: Sequence[str] = ()
) -> Page:
    """Return the page of *gaps*, with *remarks* beside each answer.

    The curves before and after come first, statistics are folded.
    """
    sections = []
    for gap in gaps:
        found = []
        if gap.shown is not None:
            found += _curve_sections(gap.shown)
        if gap.located is not None:
            found.append(_map_section(gap.located))
        if gap.before is not None and gap.after is not None:
            found.append(_maps_section(gap.before, gap.after))
        if gap.naming is not None:
            found += _naming_sections(gap.naming, gap, remarks)
        if gap.advice:
            found.append(_advice_section(gap))
        if gap.shown is not None:
            found.append(
                Section(
                    f"errors on {words.shown_where(gap.shown)}, by model",
                    Table(words.ERROR_HEAD, words.error_rows(gap.shown)),
                    lines=words.shown_lines(gap.shown),
                    folded=True,
                )
            )
        if gap.located is not None:
            found.append(_tables_section(gap.located))
        sections += [one.of(", ".join(gap.corners)) for one in found]
    first = _first(gaps)
    lead = f"{', '.join(first.corners)}: {words.sentence(first)}"
    tiles = head_tiles(gaps)
    return Page("Gap", sections, tiles, lead, subtitle=subtitle)


def _first(gaps: Sequence[Gap]) -> Gap:
    """Return the first of *gaps* that lacks something, else the first."""
    found = [
        one for one in gaps if one.naming is not None and one.naming.found
    ]
    return (*found, *gaps)[0]


def head_tiles(gaps: Sequence[Gap]) -> list[tuple[str, str]]:
    """Return the answer's tiles, of the first corners that lack something."""
    gap = _first(gaps)
    of = f", {', '.join(gap.corners)}" if len(gaps) > 1 else ""
    tiles = []
    if gap.naming is not None:
        answer, meaning = words.answer_tile(gap.naming)
        tiles += [
            (answer, f"{meaning}{of}"),
            words.probability_tile(gap.naming),
        ]
    if gap.fit is not None:
        tiles += words.strength_tiles(gap.fit)
    if gap.shown is not None:
        word, one = words.change(gap.shown.shrinks[CONFIGURED])
        tiles.append((f"{one.factor:.1f} x", f"{word} gap, as written"))
    return tiles


def _map_section(located: Located) -> Section:
    return Section(
        "where the heat is missing",
        plots=(("missing heat [kJ]", heat_map(located.cells)),),
        lines=words.place_lines(located),
        note="Heat that the model lacks at a part, with its measured "
        "neighbours held at their thermocouples. Red: the real part gets more "
        "heat than in the model; blue: less. A dot: within "
        f"{CLEAR:g} standard deviations of the errors of sensors and model "
        "form. Mean of the corners.",
    )


def _maps_section(before: Located, after: Located) -> Section:
    cells = (*before.cells, *after.cells)
    return Section(
        "the map of the same drives, before and after",
        plots=(
            ("as configured [kJ]", heat_map(before.cells, cells)),
            ("as written [kJ]", heat_map(after.cells, cells)),
        ),
        folded=True,
    )


def heat_map(cells: Sequence[Cell], scale: Sequence[Cell] = ()) -> plots.Plot:
    """Return the map: regime and temperature of the node against nodes.

    Colour and text are both the missing heat [kJ]; the ends of the colours
    are the largest of *scale*, or of *cells*.
    """
    by_place = {(c.node, c.regime, c.bin): c for c in cells}
    nodes = [n for n in ORDER if any(c.node == n for c in cells)]
    # the first row is drawn at the bottom
    rows = [
        (regime, name)
        for regime in REGIMES[::-1]
        for name in labels(TEMPERATURES_C, "degC")[::-1]
        if any((c.regime, c.bin) == (regime, name) for c in cells)
    ]
    places = [[by_place.get((n, *row)) for n in nodes] for row in rows]
    shown_kj = [abs(_clear_kj(c)) for c in scale or cells]
    most_kj = max(*shown_kj, 1.0) if shown_kj else 1.0
    data: dict[str, Any] = {
        "type": "heatmap",
        "x": [n.replace("_", "<br>") for n in nodes],
        "y": [f"{regime} {_range(name)} °C" for regime, name in rows],
        "z": [[one and _clear_kj(one) for one in row] for row in places],
        "text": [[_kilojoules(one) for one in row] for row in places],
        "texttemplate": "%{text}",
        "hovertext": [[_tip(one) for one in row] for row in places],
        "hoverinfo": "text",
        "zmin": -most_kj,
        "zmax": most_kj,
        "xgap": 2,
        "ygap": 2,
        "colorscale": [list(pair) for pair in SCALE],
        "colorbar": {
            "title": {"text": "missing heat [kJ]", "side": "right"},
            "thickness": 12,
        },
    }
    return plots.plot(
        [data],
        "",
        "",
        height=90 + 26 * len(rows),
        margin={"l": 130},
        xaxis=_NAMES_AXIS,
        yaxis=_NAMES_AXIS,
    )


def _clear_kj(cell: Cell) -> float:
    """Return the missing heat, 0 where it is not clear."""
    return round(1e-3 * cell.energy_j, 1) if abs(cell.z) >= CLEAR else 0.0


def _range(name: str) -> str:
    return name.removesuffix(" degC").replace(" to ", "-")


def _kilojoules(cell: Cell | None) -> str:
    if cell is None:
        return ""
    return f"{_clear_kj(cell):+.0f}" if abs(cell.z) >= CLEAR else "·"


def _tip(cell: Cell | None) -> str:
    if cell is None:
        return ""
    return (
        f"{cell.node} {cell.regime} {_range(cell.bin)} °C: "
        f"{1e-3 * cell.energy_j:+.1f} kJ ± {1e-3 * cell.deviation_j:.1f}, "
        f"{cell.windows} half minutes"
    )


def _naming_sections(
    naming: Naming, gap: Gap, remarks: Sequence[str]
) -> list[Section]:
    lines = [*remarks, *words.naming_lines(naming), *words.unnamed_lines(gap)]
    if gap.silent:
        silent = ", ".join(map(name_of, gap.silent))
        lines.append(f"not excited by these drives: {silent}")
    return candidate_sections(
        words.headline(gap),
        naming,
        lines,
        "Every effect is simulated on these drives and fitted together "
        "with all tunables. A strength of 1 is typical; sd is of the noise "
        "alone.",
    )


def candidate_sections(
    heading: str, naming: Naming, lines: Sequence[str], note: str = ""
) -> list[Section]:
    """Return the candidates as bars, and folded the statistics of each."""
    title = "evidence of each effect against 'nothing'"
    return [
        Section(heading, plots=((title, evidence_bars(naming)),), across=1),
        Section(
            "statistics of the candidates",
            Table(words.CANDIDATE_HEAD, words.candidate_rows(naming)),
            lines=lines,
            note=note,
            folded=True,
        ),
    ]


def _advice_section(gap: Gap) -> Section:
    return Section(
        "which drive next",
        Table.of(words.ADVICE, gap.advice),
        note="Cars are drawn at random from the posterior of these drives; "
        "each drive is simulated with the model itself, with its noise, and "
        "searched. The Bayes factor compares the true effect with its best "
        f"rival; now it is {words.signed(gap.advice[0].now)}.",
    )


def evidence_bars(naming: Naming) -> plots.Plot:
    """Return the log Bayes factor of the likeliest candidates as bars."""
    # the best is drawn at the top, behind all others
    best = [
        one
        for one in naming.candidates[:BARS][::-1]
        if one.log_evidence > 0.0 or one is naming.candidates[0]
    ]
    colours = [
        plots.VERMILION if one.name in naming.names else "#9aa5b1"
        for one in best
    ]
    labels = [
        wrap(escape(name_of(one.name).replace("_", " ")), LABEL_CHARACTERS)
        for one in best
    ]
    data = {
        "type": "bar",
        "orientation": "h",
        "x": [float(f"{one.log_evidence:.4g}") for one in best],
        "y": ["<br>".join(lines) for lines in labels],
        "marker": {"color": colours},
        "showlegend": False,
    }
    most = max(one.log_evidence for one in best)
    least = min(0.0, *(one.log_evidence for one in best))
    return plots.plot(
        [data],
        "logarithm of the Bayes factor",
        "",
        height=110 + max(26, 17 * max(map(len, labels))) * len(best),
        xaxis={"range": [1.05 * least, max(1.05 * most, WEAK_EVIDENCE)]},
        margin={"l": 190},
        yaxis=_NAMES_AXIS,
    )


def _curve_sections(shown: Shown) -> list[Section]:
    drives = dict.fromkeys(one.drive for one in shown.errors)
    return [
        Section(
            f"before and after on {drive}",
            plots=tuple(
                (_before_and_after(one), _curves(one))
                for one in shown.errors
                if one.drive == drive
            ),
            note="Before: as configured. After: as it is written, effect or "
            "change with the tunables fitted beside it. Click a pale name "
            "for the other models.",
        )
        for drive in drives
    ]


def _before_and_after(one: NodeErrors) -> str:
    before_k, after_k = one.rms_k[CONFIGURED], one.rms_k[EXTENDED]
    node = one.node.replace("_", " ")
    return f"{node}: RMS error {before_k:.1f} K before, {after_k:.1f} K after"


def _curves(one: NodeErrors) -> plots.Plot:
    looks = {
        CONFIGURED: ("before", plots.GREY, "solid"),
        EXTENDED: ("after", plots.VERMILION, "solid"),
        BASELINES[1]: (BASELINES[1], plots.ORANGE, "dot"),
        BASELINES[2]: (BASELINES[2], plots.BLUE, "dash"),
    }
    data = [
        plots.curve(
            one.time_s, one.measured_c, "measured", plots.BLACK, width=2.6
        )
    ]
    data += [
        plots.curve(one.time_s, one.model_c[key], name, colour, dash=dash)
        | ({} if key in {CONFIGURED, EXTENDED} else {"visible": "legendonly"})
        for key, (name, colour, dash) in looks.items()
    ]
    span = (0.0, float(one.time_s[-1]))
    return plots.time_plot(data, "temperature [°C]", span, height=320)


def _tables_section(located: Located) -> Section:
    cells = [*located.by_speed, *located.by_pressure, *located.by_time]
    cells.sort(key=lambda one: -abs(one.z))
    return Section(
        "residual heat by speed, pressure and time",
        Table.of(words.CELLS, cells[:MOST_CELLS]),
        note="The plainest; all are in the JSON file.",
        folded=True,
    )


def gap_json(gap: Gap) -> dict[str, Any]:
    """Return everything that was found as plain data."""
    found = picked(gap, "corners", "recordings", "points")
    found["headline"] = words.headline(gap)
    if gap.located is not None:
        found["places"] = [
            picked(one, "node", "regime", "energy_j", standard_deviations="z")
            | {"other": one.other or None}
            for one in gap.located.places
        ]
        for name in ("cells", "by_speed", "by_pressure", "by_time"):
            found[name] = getattr(gap.located, name)
    if gap.naming is not None:
        found["naming"] = naming_json(gap.naming)
        found["not_excited"] = gap.silent
    if gap.advice:
        found["advice"] = advice_json(gap)
    if gap.fit is not None:
        found["strengths"] = gap.fit.strengths
        found["strength_deviations"] = gap.fit.deviations
        found["strength_noise_deviations"] = gap.fit.noise_deviations
        found["strength_intervals"] = {
            name: gap.fit.interval(name) for name in gap.fit.strengths
        }
    if gap.shown is not None:
        found["shown"] = _shown_json(gap.shown)
    return found


def naming_json(naming: Naming) -> dict[str, Any]:
    """Return the answer as plain data."""
    return picked(
        naming,
        *("answer", "names", "probability", "reason", "explained"),
        *("unknown_place", "best_placebo_z", "cross_validated"),
        unknown_log_bayes_factor="unknown_evidence",
    ) | {
        "candidates": [
            picked(
                one,
                *("name", "strength", "deviation", "z"),
                log_bayes_factor="log_evidence",
                detectable_strength="reach",
            )
            | {"probability": naming.odds[one.name]}
            for one in naming.candidates
        ]
    }


def _shown_json(shown: Shown) -> dict[str, Any]:
    def factors(shrinks: Mapping[str, Shrink]) -> dict[str, list[float]]:
        return {
            name: [one.factor, one.lower, one.upper]
            for name, one in shrinks.items()
        }

    return picked(shown, "held_out", "bends") | {
        "errors": [
            picked(
                one, *("drive", "node", "rms_k", "peak_error_k", "peak_late_s")
            )
            for one in shown.errors
        ],
        "shrink": factors(shown.shrinks),
        "fluid_shrink": factors(shown.fluid_shrinks),
        "moved": {
            name: dict(zip(shown.keys, moved, strict=True))
            for name, moved in shown.moved.items()
        },
    }


def advice_json(gap: Gap) -> dict[str, Any]:
    """Return the advice as plain data."""
    return {
        "members": gap.members,
        "log_bayes_factor_now": gap.advice[0].now,
        "drives": [
            picked(
                one,
                *("drive", "description", "duration_s", "log_bayes_factor"),
                named_right="named",
                named_wrong="wrong",
            )
            for one in gap.advice
        ],
    }

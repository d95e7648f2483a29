"""The page of ``bstm match``: values, stages, and figure 5.2 of the thesis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.matching.curves import curves_of
from bstm_daemon.matching.identifiability import correlations
from bstm_daemon.report.match_words import (
    STAGE_HEAD,
    VALUE_HEAD,
    fit_line,
    notes,
    short,
    stage_rows,
    value_rows,
)
from bstm_daemon.report.plot_page import (
    PageHead,
    PageSection,
    Table,
    write_plot_page,
)
from bstm_daemon.report.plots import Plot, curve, time_plot
from bstm_daemon.report.traces import NODE_COLOURS

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bstm_daemon.matching.curves import Curves
    from bstm_daemon.matching.drives import Drive
    from bstm_daemon.matching.matcher import Match
    from bstm_daemon.matching.refine import Refinement


def write_match_page(
    path: Path,
    matches: Sequence[Match],
    drives: Sequence[Drive],
    *,
    subtitle: str,
    version: str,
) -> None:
    """Write what *matches* found in *drives* to *path*.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    sections = []
    for match in matches:
        prefix = f"{', '.join(match.corners)}: "
        sections += [
            PageSection(
                f"{prefix}matched values",
                Table(VALUE_HEAD, tuple(value_rows(match.joint))),
                lines=(fit_line(match.joint), *notes(match)),
                note="sd: standard deviation after the fit; of prior: as a "
                "share of what was believed before. Values without the name "
                "of a section are keys of [thermal].",
            ),
            PageSection(
                f"{prefix}stages (thesis chapter 5)",
                Table(STAGE_HEAD, tuple(stage_rows(match))),
                note="Neighbours of the fitted part follow their measured "
                "temperatures; the joint refinement begins at these values.",
            ),
        ]
        if match.table_4_1 is not None:
            sections.append(
                PageSection(
                    f"{prefix}Table 4.1 alone",
                    Table(VALUE_HEAD, tuple(value_rows(match.table_4_1))),
                    lines=(fit_line(match.table_4_1),),
                )
            )
        sections.append(
            PageSection(
                f"{prefix}correlations of the matched values",
                _correlations(match.joint),
            )
        )
        sections += _drawn(match, drives)
    head = PageHead("Match", subtitle, version, _tiles(matches))
    write_plot_page(path, head, sections)


def _tiles(matches: Sequence[Match]) -> tuple[tuple[str, str], ...]:
    rms = matches[0].joint.rms_k
    return tuple(
        (f"{value:.1f} K", f"RMS {node.replace('_', ' ')}")
        for node, value in rms.items()
    )


def _correlations(fit: Refinement) -> Table:
    found = correlations(fit)
    names = [str(i + 1) for i in range(len(fit.keys))]
    rows = tuple(
        (
            f"{i + 1} {short(key)}",
            *(f"{found[i, j]:+.2f}" if j < i else "" for j in range(i)),
            *("" for _ in range(len(fit.keys) - i)),
        )
        for i, key in enumerate(fit.keys)
    )
    return Table(("value", *names), rows)


def _drawn(match: Match, drives: Sequence[Drive]) -> list[PageSection]:
    sections = []
    curves = curves_of(match, drives)
    for drive in drives:
        for corner in match.corners:
            own = [
                one
                for one in curves
                if one.drive == drive.name
                and one.corner == corner
                and one.couple in NODE_COLOURS
            ]
            if own:
                sections.append(
                    PageSection(
                        f"{drive.name}, {corner}: measured and matched "
                        "(thesis figure 5.2)",
                        plots=(
                            ("temperatures", _temperatures(own)),
                            ("matched less measured", _residuals(own)),
                        ),
                        across=1,
                        note="Thick: measured; thin: matched; dashed: as "
                        "configured before.",
                    )
                )
    return sections


def _temperatures(curves: Sequence[Curves]) -> Plot:
    data = []
    for one in curves:
        name, colour = one.couple.replace("_", " "), NODE_COLOURS[one.couple]
        data += [
            curve(one.time_s, one.measured_c, name, colour, width=4.0)
            | {"opacity": 0.4},
            curve(one.time_s, one.after_c, name, colour, legend=False),
            curve(
                one.time_s, one.before_c, name, colour,
                dash="4px,4px", width=1.0, legend=False,
            ),
        ]  # fmt: skip
    span = (0.0, float(curves[0].time_s[-1]))
    return time_plot(data, "temperature [°C]", span, height=420)


def _residuals(curves: Sequence[Curves]) -> Plot:
    data = [
        curve(
            one.time_s,
            _smooth(one.after_c - one.measured_c),
            one.couple.replace("_", " "),
            NODE_COLOURS[one.couple],
        )
        for one in curves
    ]
    span = (0.0, float(curves[0].time_s[-1]))
    return time_plot(data, "error [K], mean of 10 s", span)


def _smooth(error: np.ndarray) -> np.ndarray:
    """Return the running mean over 10 s, (n,)."""
    return np.convolve(error, np.full(21, 1.0 / 21.0), "same")

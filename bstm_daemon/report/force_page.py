"""The page of ``bstm gap`` where there is no thermocouple."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bstm_daemon.report.force_words import (
    force_headline,
    force_lines,
    sight_lines,
)
from bstm_daemon.report.gap_page import evidence_bars
from bstm_daemon.report.gap_words import (
    CANDIDATE_HEAD,
    answer_tile,
    candidate_rows,
    probability_tile,
    strength_tile,
)
from bstm_daemon.report.layout import AXIS_COLOUR
from bstm_daemon.report.plot_page import (
    PageHead,
    PageSection,
    Table,
    write_plot_page,
)
from bstm_daemon.report.plots import cloud, curve, plot, time_plot
from bstm_daemon.report.traces import BLUE, VERMILION

if TYPE_CHECKING:
    from pathlib import Path

    from bstm_daemon.gap.heat_only import ForceCurve, ForceGap


def write_force_page(
    path: Path, gap: ForceGap, *, subtitle: str, version: str
) -> None:
    """Write what the forces told to *path*.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    naming = gap.naming
    sections = [
        PageSection(
            force_headline(gap),
            Table(CANDIDATE_HEAD, tuple(candidate_rows(naming))),
            plots=(
                ("how far each effect beats 'nothing'", evidence_bars(naming)),
            ),
            lines=tuple(force_lines(gap)),
            across=1,
        )
    ]
    sections += [_drive_section(one) for one in gap.curves]
    sections.append(
        PageSection("what forces can tell", lines=tuple(sight_lines(gap)))
    )
    moved_mj = 1e-6 * gap.motion_j
    tiles = (
        answer_tile(naming),
        probability_tile(naming),
        *(
            strength_tile(name, strength, gap.deviations[name])
            for name, strength in gap.strengths.items()
        ),
        (
            f"{1e-6 * gap.pressed_j:.1f} MJ",
            f"braking work by pressure; {moved_mj:.1f} MJ by motion",
        ),
    )
    write_plot_page(path, PageHead("Gap", subtitle, version, tiles), sections)


def _drive_section(one: ForceCurve) -> PageSection:
    """Return both forces over time, and their difference over the force."""
    span = (0.0, max(float(one.time_s[-1]), 1.0))
    motion_kn, pressed_kn = 1e-3 * one.motion_n, 1e-3 * one.pressed_n
    over_time = [
        curve(one.time_s, motion_kn, "by motion", BLUE),
        curve(one.time_s, pressed_kn, "by pressure", VERMILION),
    ]
    apart = [cloud(motion_kn, pressed_kn - motion_kn, "", VERMILION)]
    return PageSection(
        f"brake force of the car on {one.drive}",
        plots=(
            (
                "over time",
                time_plot(over_time, "force [kN]", span, height=340),
            ),
            (
                "how much more by pressure than by motion",
                plot(
                    apart,
                    "force by motion [kN]",
                    "difference [kN]",
                    height=340,
                    yaxis={"zerolinecolor": AXIS_COLOUR},
                ),
            ),
        ),
        note="A point is a window of 1 s or more. With nothing missing the "
        "difference is nothing at every force.",
    )

"""The page of ``bstm gap`` where there is no thermocouple."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bstm_daemon.report.force_words import (
    force_headline,
    force_lines,
    sight_lines,
)
from bstm_daemon.report.gap_page import evidence_bars
from bstm_daemon.report.gap_words import CANDIDATE_HEAD, candidate_rows
from bstm_daemon.report.plot_page import (
    PageHead,
    PageSection,
    Table,
    write_plot_page,
)
from bstm_daemon.report.plots import curve, time_plot
from bstm_daemon.report.traces import BLUE, VERMILION

if TYPE_CHECKING:
    from pathlib import Path

    from bstm_daemon.gap.heat_only import ForceGap


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
    for one in gap.curves:
        span = (0.0, max(float(one.time_s[-1]), 1.0))
        data = [
            curve(one.time_s, one.motion_n, "by motion", BLUE),
            curve(one.time_s, one.pressed_n, "by pressure", VERMILION),
        ]
        sections.append(
            PageSection(
                one.drive,
                plots=(
                    (
                        "brake force of the car",
                        time_plot(data, "force [N]", span, height=340),
                    ),
                ),
                across=1,
            )
        )
    sections.append(
        PageSection("what forces can tell", lines=tuple(sight_lines(gap)))
    )
    tiles = (
        (" or ".join(naming.names).replace("_", " ") or "nothing", "missing"),
        (f"{1e-6 * gap.pressed_j:.2f} MJ", "braking work by pressure"),
        (f"{1e-6 * gap.motion_j:.2f} MJ", "by motion"),
    )
    write_plot_page(path, PageHead("Gap", subtitle, version, tiles), sections)

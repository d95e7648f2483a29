"""The page of ``bstm verify``: figures 5.2 and 6.4 to 6.8 of the thesis."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING, Final

from bstm_daemon.matching.verification import LIMITS, coverage, judged
from bstm_daemon.report.plot_page import (
    PageHead,
    PageSection,
    Table,
    write_plot_page,
)
from bstm_daemon.report.plots import Plot, curve, time_plot
from bstm_daemon.report.traces import NODE_COLOURS
from bstm_daemon.report.verify_words import (
    ERROR_HEAD,
    PEAK_HEAD,
    VERDICT_HEAD,
    all_verdicts,
    error_rows,
    peak_rows,
    summary_line,
    verdict_rows,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bstm_daemon.matching.verification import NodeErrors


LONG_S: Final = 7200.0
"""Of the drive of figure 6.8."""


def write_verify_page(
    path: Path,
    errors: Sequence[NodeErrors],
    *,
    required: str,
    subtitle: str,
    version: str,
) -> None:
    """Write *errors*, their verdicts and figures to *path*.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    verdicts = all_verdicts(errors)
    missed = [one for one in verdicts if not one.passed]
    sections = [
        PageSection(
            "Verdict",
            Table(VERDICT_HEAD, tuple(verdict_rows(missed)))
            if missed
            else None,
            lines=(summary_line(errors),),
            note="Only what is not met is listed. thesis: section 1.3; floor "
            "and goal: the project's own, narrower limits.",
        ),
        PageSection(
            "Error, estimated less measured [K]",
            Table(ERROR_HEAD, tuple(error_rows(errors))),
            note="By phase RMS / largest. Pad back and fluid are measured as "
            "means over 30 s; the disc is judged below 650 degC.",
        ),
        PageSection(
            "Highest temperatures", Table(PEAK_HEAD, tuple(peak_rows(errors)))
        ),
    ]
    for drive, corner in dict.fromkeys((e.drive, e.corner) for e in errors):
        own = [e for e in errors if (e.drive, e.corner) == (drive, corner)]
        sections.append(
            PageSection(
                f"{drive}, {corner}: measured and estimated (thesis "
                f"{_figure(own)})",
                plots=(
                    ("temperatures", _temperatures(own)),
                    ("estimated less measured", _residuals(own)),
                ),
                across=1,
                note="Thick: measured; thin: estimated.",
            )
        )
    write_plot_page(
        path,
        PageHead("Verification", subtitle, version, _tiles(errors, required)),
        sections,
    )


def _figure(errors: Sequence[NodeErrors]) -> str:
    """Return which figures of the thesis show such a drive.

    6.4 to 6.7 differ from 5.2 by the car and its wheels, which a log does not
    tell; 6.8 is a long drive.
    """
    long = max(one.time_s[-1] for one in errors) >= LONG_S
    return "figure 6.8" if long else "figures 5.2, 6.4 to 6.7"


def _tiles(
    errors: Sequence[NodeErrors], required: str
) -> tuple[tuple[str, str], ...]:
    verdicts = judged(errors, LIMITS[required])
    passed = all(one.passed for one in verdicts)
    tiles = [("met" if passed else "NOT MET", f"limits: {required}")]
    fluid = [one for one in errors if one.node == "fluid"]
    if fluid:
        largest = max(one.largest_k for one in fluid)
        tiles.append((f"{largest:.1f} K", "fluid, largest error"))
        late = [
            abs(one.peak.apart_s)
            for one in fluid
            if not isnan(one.peak.apart_s)
        ]
        if late:
            tiles.append((f"{max(late) / 60.0:.1f} min", "fluid, peak time"))
    inside, counted = coverage(errors)
    if counted:
        share = f"{100.0 * inside / counted:.0f} %"
        tiles.append((share, f"of {counted} within the 90 % interval"))
    return tuple(tiles)


def _temperatures(errors: Sequence[NodeErrors]) -> Plot:
    data = []
    for one in errors:
        name, colour = one.node.replace("_", " "), NODE_COLOURS[one.node]
        data += [
            curve(one.time_s, one.measured_c, name, colour, width=4.0)
            | {"opacity": 0.4},
            curve(one.time_s, one.estimated_c, name, colour, legend=False),
        ]
    return time_plot(data, "temperature [°C]", _span(errors), height=420)


def _residuals(errors: Sequence[NodeErrors]) -> Plot:
    data = [
        curve(
            one.time_s,
            one.error_k,
            one.node.replace("_", " "),
            NODE_COLOURS[one.node],
        )
        for one in errors
    ]
    return time_plot(data, "error [K]", _span(errors))


def _span(errors: Sequence[NodeErrors]) -> tuple[float, float]:
    return 0.0, max(float(one.time_s[-1]) for one in errors)

"""The plots of a page as PNG and SVG files, by kaleido and Chromium."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.errors import UsageError, require_packages
from bstm_daemon.files import make_folder
from bstm_daemon.report.plots import PAPER, Plot, stamp

if TYPE_CHECKING:
    from bstm_daemon.report.shell import Page

FORMATS: Final = ("png", "svg")
WIDTH_PX: Final = 1000
SCALE: Final = 2
"""Pixels of a PNG for one of the plot: sharp in print at 17 cm."""

LONGEST_NAME: Final = 60
"""Characters of a file's name, its number and its ending aside."""


def require_figure_packages() -> None:
    """Refuse figures before the work for them.

    Raises:
        MissingExtraError: kaleido or plotly is not installed.
        UsageError: there is no Chromium.
    """
    require_packages(
        "kaleido", "plotly", extra="figures", purpose="--figures DIR"
    )
    from choreographer.browsers.chromium import (  # noqa: PLC0415  (an extra)
        Chromium,
    )

    if Chromium.find_browser(skip_local=False) is None:
        msg = (
            "--figures DIR draws with Chromium or Chrome, and none is "
            "installed: apt-get install chromium"
        )
        raise UsageError(msg)


def write_figures(folder: Path, page: Page) -> list[Path]:
    """Write each plot of *page* as PNG and SVG into *folder*.

    Args:
        folder: made where it is missing.
        page: a command's page; names are number, heading and title.

    Returns:
        The files.

    Raises:
        MissingExtraError: kaleido or plotly is not installed.
        UsageError: there is no Chromium.
        FileAccessError: *folder* can not be written.
    """
    require_figure_packages()
    from plotly.io import write_images  # noqa: PLC0415  (an extra)

    make_folder(folder)
    figures: list[dict[str, Any]] = []
    paths: list[Path] = []
    for section in page.sections:
        for title, plot in section.plots:
            number = len(figures) // len(FORMATS) + 1
            name = re.sub(r"\W+", "-", f"{section.heading} {title}").strip("-")
            stem = f"{number:02d}-{name[:LONGEST_NAME].lower().rstrip('-')}"
            for form in FORMATS:
                figures.append(_drawn(plot, title))
                paths.append(folder / f"{stem}.{form}")
    if figures:
        write_images(
            figures, paths, width=WIDTH_PX, scale=SCALE, validate=False
        )
    return paths


def _drawn(plot: Plot, title: str) -> dict[str, Any]:
    """Return *plot* on white with *title*, its times as dates."""
    data = plot.data
    if plot.clock:
        data = [one | {"x": [*map(stamp, one["x"])]} for one in data]
    margin = {**plot.layout["margin"], "t": 60}
    more = margin["t"] - plot.layout["margin"]["t"]
    white = {"paper_bgcolor": PAPER, "plot_bgcolor": PAPER}
    layout = (
        plot.layout
        | white
        | {
            "margin": margin,
            "height": plot.layout["height"] + more,
            "title": {"text": title, "x": 0.02, "font": {"size": 14}},
        }
    )
    return {"data": data, "layout": layout}

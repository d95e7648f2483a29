"""The page of every command: sections of data that one template renders.

A page needs no network: plotly.js is inside. Its content security policy
allows its two scripts by their SHA-256 and nothing else, and the template
escapes every text, so a name from a DBC, a log or a configuration stays text
whatever it holds. Its plots become PNG and SVG files by kaleido and Chromium.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon import __version__
from bstm_daemon.errors import UsageError, require_packages
from bstm_daemon.files import make_folder, replacing
from bstm_daemon.report.json_file import own_fields
from bstm_daemon.report.plots import (
    EPOCH,
    PAPER,
    NodeCurve,
    Plot,
    node_plots,
    stamp,
)

if TYPE_CHECKING:
    from jinja2 import Environment

    from bstm_daemon.report.text import Columns, T

TEMPLATES: Final = Path(__file__).parent / "templates"

LONGEST_FIGURE: Final = 24
"""Characters of a cell that stay on one line; a longer text wraps instead of
pushing the table out of the page."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A text with a small ``detail`` behind it, coloured by ``tone``.

    Tones are ``good``, ``bad``, ``none``, or empty. ``href`` is the address of
    the page that the text leads to.
    """

    text: str
    detail: str = ""
    tone: str = ""
    href: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Headings and rows of cells; the first column is the name.

    ``groups`` stand above the headings: a text and the columns it spans.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    groups: Sequence[tuple[str, int]] = ()

    @classmethod
    def of(cls, columns: Columns[T], items: Iterable[T]) -> Table:
        """Return the table with a row for each of *items*."""
        return cls(columns.head, columns.rows(items))

    def kinds(self) -> list[str]:
        """Return ``words`` for columns of reasons, ``number`` for figures.

        A column of figures stays one with a reason among them.
        """
        return [
            "words" if 2 * sum(map(is_words, cells)) > len(cells) else "number"
            for cells in (
                [row[place] for row in self.rows]
                for place in range(1, len(self.head))
            )
        ]


def is_words(cell: str | Cell) -> bool:
    """Return whether *cell* is too long to stay on one line."""
    text = cell if isinstance(cell, str) else f"{cell.text} {cell.detail}"
    return len(text) > LONGEST_FIGURE


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page, drawn in the order of the fields.

    ``facts`` are pairs of label and text, ``keys`` of a shade and its
    meaning, ``plots`` of title and plot, of which ``across`` stand side by
    side, 1 to 3. ``kind`` is ``plain``, ``warnings`` or ``faults``. What is
    ``folded`` shows its heading until the reader opens it.
    """

    heading: str
    table: Table | None = None
    facts: Sequence[tuple[str, str]] = ()
    lines: Sequence[str] = ()
    keys: Sequence[tuple[str, str]] = ()
    plots: Sequence[tuple[str, Plot]] = ()
    note: str = ""
    across: int = 2
    kind: str = "plain"
    badge: Cell | None = None
    folded: bool = False

    @property
    def views(self) -> list[str]:
        """The choices of the reader: each shows some of the plots."""
        return [*dict.fromkeys(p.view for _, p in self.plots if p.view)]

    def of(self, subject: str) -> Section:
        """Return it with *subject*, if any, before its heading."""
        heading = f"{subject}: {self.heading}" if subject else self.heading
        return replace(self, heading=heading)


def node_section(
    heading: str, nodes: Sequence[NodeCurve], error: tuple[str, str], note: str
) -> Section:
    """Return temperatures of *nodes* above their errors.

    *error* is what the errors are, and the title of their axis.
    """
    what, axis_title = error
    temperatures, errors = node_plots(nodes, axis_title)
    return Section(
        heading,
        plots=(("temperatures", temperatures), (what, errors)),
        across=1,
        note=note,
    )


@dataclass(frozen=True, slots=True)
class Page:
    """Content of a command's page.

    ``lead`` is the answer in a sentence for a person, ``tiles`` below it are
    pairs of a figure and its meaning.
    """

    title: str
    sections: Sequence[Section]
    tiles: Sequence[tuple[str, str]] = ()
    lead: str | Cell = ""
    subtitle: str = field(default="", kw_only=True)


def write_page(path: Path, page: Page) -> None:
    """Write *page* as one HTML file to *path*, whole or not at all.

    Raises:
        MissingExtraError: plotly or jinja2 is not installed.
        FileAccessError: *path* can not be written.
    """
    text = render(page)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def require_page_packages() -> None:
    """Refuse a page before the work for it.

    Raises:
        MissingExtraError: plotly or jinja2 is not installed.
    """
    require_packages(
        "plotly", "jinja2", extra="report", purpose="the HTML report"
    )


def template_environment() -> Environment:
    """Return what loads a template; it escapes all texts."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415  (an extra)

    return Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def render(page: Page) -> str:
    """Return *page* as HTML.

    Raises:
        MissingExtraError: plotly or jinja2 is not installed.
        ValueError: a plot holds NaN or infinity.
    """
    require_page_packages()
    from plotly.offline import get_plotlyjs  # noqa: PLC0415  (an extra)

    # a parser ends the element at this mark even inside a string
    library = get_plotlyjs().replace("</script", r"<\/script")
    style, script = (
        (TEMPLATES / name).read_text(encoding="utf-8")
        for name in ("page.css", "page.js")
    )
    environment = template_environment()
    environment.policies["json.dumps_kwargs"] = {
        "allow_nan": False,
        "separators": (",", ":"),
    }
    environment.tests["words"] = is_words
    return environment.get_template("shell.html").render(
        page=page,
        policy="default-src 'none'; style-src 'unsafe-inline'; "
        "img-src data: blob:; script-src "
        f"{_hash_source(library)} {_hash_source(script)}",
        style=style,
        script=script,
        library=library,
        data=_data(page),
        version=__version__,
    )


def _hash_source(script: str) -> str:
    """Return the source expression of a security policy for *script*."""
    digest = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def _data(page: Page) -> dict[str, Any]:
    """Return what the page's script draws."""
    return {
        "epoch": f"{EPOCH.isoformat()}Z",
        "plots": [
            own_fields(plot, "view")
            for section in page.sections
            for _, plot in section.plots
        ],
    }


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
    from choreographer.browsers.chromium import Chromium  # noqa: PLC0415  (an extra)

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

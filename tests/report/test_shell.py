"""The page of every command: whole, self-contained, safe."""

import base64
import hashlib
import json
import re
import shutil
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from choreographer.browsers.chromium import Chromium

from bstm_daemon.errors import FileAccessError, MissingExtraError, UsageError
from bstm_daemon.report.plots import BLUE, curve, plot, time_plot
from bstm_daemon.report.shell import (
    Cell,
    Page,
    Section,
    Table,
    render,
    require_figure_packages,
    write_figures,
    write_page,
)

HOSTILE = "</script><img src=x onerror=\"alert('x')\">{{x}}<!--&amp;\u2028"


class Reader(HTMLParser):
    """What a browser would build of a page: elements and text."""

    def __init__(self) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.text: list[str] = []
        self._inside = ""

    def handle_starttag(
        self, tag: str, attrs: list[tuple[str, str | None]]
    ) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside = tag
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        del tag
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside != "style":
            self.text.append(data)


def _read(page: str) -> Reader:
    reader = Reader()
    reader.feed(page)
    reader.close()
    return reader


@pytest.fixture(scope="module")
def hostile() -> str:
    """Return a page with every part of a section, all text hostile."""
    x = np.arange(3.0)
    return render(
        Page(
            HOSTILE,
            [
                Section(
                    HOSTILE,
                    Table(
                        (HOSTILE, "b"),
                        [(HOSTILE, HOSTILE), ("c", Cell(HOSTILE, HOSTILE))],
                        ((HOSTILE, 2),),
                    ),
                    facts=[(HOSTILE, HOSTILE)],
                    lines=[HOSTILE],
                    keys=[("invalid", HOSTILE)],
                    plots=[
                        (
                            HOSTILE,
                            replace(
                                plot([curve(x, x, HOSTILE, "#0")], "", ""),
                                view=HOSTILE,
                            ),
                        )
                    ],
                    note=HOSTILE,
                    badge=Cell(HOSTILE),
                ),
                Section(HOSTILE),
            ],
            [(HOSTILE, HOSTILE)],
            Cell(HOSTILE, tone="good"),
            subtitle=HOSTILE,
        )
    )


def test_hostile_names_stay_text(hostile: str) -> None:
    reader = _read(hostile)

    tags = [tag for tag, _ in reader.elements]
    assert "img" not in tags
    assert tags.count("script") == len(reader.scripts) == 3
    assert not [
        name
        for _, attributes in reader.elements
        for name in attributes
        if name.startswith("on")
    ]
    # as often as a part has it, the title twice
    assert "".join(reader.text).count(HOSTILE) == 22


def test_json_can_not_leave_its_element(hostile: str) -> None:
    text = _read(hostile).scripts[0]

    assert not set("<>&\u2028") & set(text)
    assert "&lt;img" in json.loads(text)["plots"][0]["data"][0]["name"]


def test_nan_never_reaches_the_page() -> None:
    drawn = plot([{"y": [float("nan")]}], "x", "y")

    with pytest.raises(ValueError, match="JSON"):
        render(Page("", [Section("", plots=[("", drawn)])]))


def test_page_needs_no_network(hostile: str) -> None:
    elements = _read(hostile).elements

    assert not [a for _, a in elements if {"src", "href"} & a.keys()]
    assert "plotly.js v" in hostile


def test_policy_allows_exactly_the_scripts_of_the_page(hostile: str) -> None:
    reader = _read(hostile)
    (policy,) = [
        attributes["content"]
        for tag, attributes in reader.elements
        if tag == "meta" and "http-equiv" in attributes
    ]
    code = [
        script
        for script, (_, attributes) in zip(
            reader.scripts,
            [e for e in reader.elements if e[0] == "script"],
            strict=True,
        )
        if "type" not in attributes
    ]

    assert policy is not None
    assert policy.startswith("default-src 'none'")
    assert re.findall(r"sha256-([^']+)", policy) == [
        base64.b64encode(hashlib.sha256(s.encode()).digest()).decode()
        for s in code
    ]
    assert "unsafe-inline" not in policy.split("script-src")[1]


def test_long_words_of_a_table_wrap() -> None:
    why = "no cooling long and warm enough in these drives"
    section = Section("", Table(("a", "b", "c"), [("x", "1.2 K", why)]))

    page = render(Page("", [section]))

    assert f'<td class="words">{why}</td>' in page
    assert '<th class="words">c</th>' in page
    assert '<td class="number">1.2 K</td>' in page
    assert '<th class="number">b</th>' in page


def test_a_column_of_figures_stays_one_with_a_reason_in_it() -> None:
    why = "no cooling long and warm enough in these drives"
    rows = (("x", "1"), ("y", why), ("z", "3"))

    page = render(Page("", [Section("", Table(("a", "b"), rows))]))

    assert '<th class="number">b</th>' in page
    assert f'<td class="words">{why}</td>' in page
    assert page.count('<td class="number">') == 2


def test_statistics_are_folded_and_the_rest_is_open() -> None:
    sections = [
        Section("the answer", lines=["seen"]),
        Section("statistics", lines=["unseen"], folded=True),
    ]

    page = render(Page("", sections, lead="It fits."))

    before, folded = page.split("<details><summary>")
    assert "<li>seen</li>" in before
    assert "It fits.</p>" in before
    assert folded.index("statistics") < folded.index("</summary>")
    assert folded.index("unseen") < folded.index("</details>")


def test_written_page_is_whole_and_the_same_each_time(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("older")
    page = Page("a", [Section("b", lines=["c"])])

    write_page(path, page)

    assert path.read_text(encoding="utf-8") == render(page)
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileAccessError, match="missing"):
        write_page(tmp_path / "missing" / "report.html", Page("a", []))


@pytest.mark.parametrize("package", ["jinja2", "plotly"])
def test_without_a_package_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    # None in sys.modules is how Python itself marks an import as barred
    monkeypatch.setitem(sys.modules, package, None)

    with pytest.raises(
        MissingExtraError,
        match=rf"'{package}'.*bstm-daemon\[report\]",
    ):
        write_page(tmp_path / "r.html", Page("a", []))
    assert not list(tmp_path.iterdir())


CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


def page() -> Page:
    x = np.arange(0.0, 100.0)
    drawn = time_plot([curve(x, x, "disc", BLUE)], "[°C]", (0.0, 100.0))
    section = Section("Front / axle", plots=[("disc: RMS 3.0 K", drawn)])
    return Page("drive", [Section("words"), section])


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on PATH")
def test_each_plot_is_a_png_and_an_svg(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "figures"

    paths = write_figures(folder, page())

    assert [path.name for path in paths] == [
        "01-front-axle-disc-rms-3-0-k.png",
        "01-front-axle-disc-rms-3-0-k.svg",
    ]
    png, svg = paths
    header = png.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    assert int.from_bytes(header[16:20], "big") == 2000
    text = svg.read_text(encoding="utf-8")
    assert "disc: RMS 3.0 K" in text
    # seconds are shown as the page shows them
    assert ">1:00<" in text


def test_without_a_browser_the_reader_is_told_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Chromium, "find_browser", lambda **_: None)

    with pytest.raises(UsageError, match="chromium"):
        require_figure_packages()


def test_without_the_package_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "kaleido", None)

    with pytest.raises(MissingExtraError, match=r"bstm-daemon\[figures\]"):
        require_figure_packages()

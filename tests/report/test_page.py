"""The HTML page: whole, self-contained, safe."""

import base64
import dataclasses
import hashlib
import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.errors import FileAccessError, MissingExtraError
from bstm_daemon.report.page import (
    ReportFacts,
    replay_page,
    script_safe_json,
    write_replay_report,
)
from bstm_daemon.report.summary import DriveSummary
from bstm_daemon.report.tally import summarize
from bstm_daemon.report.traces import DriveCurves
from bstm_daemon.results import Results

FACTS = ReportFacts(
    title="Brake temperatures: descent.log",
    logs=("descent.log",),
    vehicle_id="example",
    configuration="example_vehicle.toml",
    heat_mode="ff",
    lines=1_234_567,
    frames=1_200_000,
    refused={"wrong_length": 3, "checksum": 0},
    counts={"late": 4, "dropped": 0, "jumps": 1},
    kernel="compiled",
    version="0.1.0",
    warnings=("refused: 3 wrong length",),
    rows=(("driver", "none"),),
)

HOSTILE = "</script><img src=x onerror=\"alert('x')\">{{x}}<!--&amp;\u2028"


def _drawn(results: Results) -> tuple[DriveSummary, DriveCurves]:
    curves = DriveCurves()
    curves.write(results)
    return summarize(results), curves


def _page(results: Results, facts: ReportFacts) -> str:
    return replay_page(*_drawn(results), facts)


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
def page(descent: Results) -> str:
    return _page(descent, FACTS)


def test_page_shows_facts_and_figures(page: str) -> None:
    text = " ".join(" ".join(_read(page).text).split())

    for shown in (
        "Brake temperatures: descent.log",
        "example · 2023-11-14 22:13:20 UTC · 1 h 25 min · 15.0 km",
        "607 °C",
        "hottest fluid, FL 10:29 after the stop",
        "least margin to wet boiling, FL (155 °C)",
        "refused: 3 wrong length",
        "1 234 567",
        "late samples 4",
        "clock jumps 1",
        "driver none",
        "97.8 % / 1.6 % / 0.6 %",
    ):
        assert shown in text
    assert "0 checksum" not in text


def test_page_needs_no_network(page: str) -> None:
    elements = _read(page).elements

    assert not [a for _, a in elements if {"src", "href"} & a.keys()]
    assert "plotly.js v" in page


def test_policy_allows_exactly_the_scripts_of_the_page(page: str) -> None:
    reader = _read(page)
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


def test_page_stays_small(page: str) -> None:
    """85 minutes at 10 Hz: 8 MB and plotly.js would be too much to mail."""
    drive, library, _ = _read(page).scripts

    assert len(drive) < 4_000_000
    assert len(page.encode()) - len(library.encode()) < 8_000_000


def test_hostile_names_stay_text(descent: Results) -> None:
    facts = dataclasses.replace(
        FACTS,
        title=HOSTILE,
        logs=(HOSTILE, HOSTILE),
        vehicle_id=HOSTILE,
        configuration=HOSTILE,
        heat_mode=HOSTILE,
        kernel=HOSTILE,
        version=HOSTILE,
        refused={HOSTILE: 1},
        counts={HOSTILE: 1},
        warnings=(HOSTILE,),
        rows=((HOSTILE, HOSTILE),),
    )
    columns = {
        key.replace("FL.", f"{HOSTILE}."): column
        for key, column in descent.columns.items()
    }
    results = Results(columns, (HOSTILE, "FR"), (HOSTILE, "FR"))

    reader = _read(_page(results, facts))

    tags = [tag for tag, _ in reader.elements]
    assert "img" not in tags
    assert tags.count("script") == len(reader.scripts) == 3
    assert not [
        name
        for _, attributes in reader.elements
        for name in attributes
        if name.startswith("on")
    ]
    drive = json.loads(reader.scripts[0])
    assert any("&lt;img" in trace["name"] for trace in drive["traces"])
    assert "".join(reader.text).count(HOSTILE) >= 10


def test_json_can_not_leave_its_element() -> None:
    value = {HOSTILE: [HOSTILE, "<!--", "]]>", 1.5, None]}

    text = script_safe_json(value)

    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == value


def test_nan_never_reaches_the_page() -> None:
    with pytest.raises(ValueError, match="JSON"):
        script_safe_json(float("nan"))


def test_page_is_the_same_each_time(descent: Results, page: str) -> None:
    assert _page(descent, FACTS) == page


def test_written_page_is_whole(
    tmp_path: Path, descent: Results, page: str
) -> None:
    path = tmp_path / "report.html"
    path.write_text("older")

    write_replay_report(path, *_drawn(descent), FACTS)

    assert path.read_text(encoding="utf-8") == page
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]


def test_a_folder_that_is_missing_is_named(
    tmp_path: Path, descent: Results
) -> None:
    path = tmp_path / "missing" / "report.html"

    with pytest.raises(FileAccessError, match="missing"):
        write_replay_report(path, *_drawn(descent), FACTS)


def test_without_plotly_the_extra_is_named(
    tmp_path: Path, descent: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    # None in sys.modules is how Python itself marks an import as barred
    monkeypatch.setitem(sys.modules, "plotly.offline", None)

    with pytest.raises(MissingExtraError, match=r"bstm-daemon\[report\]"):
        write_replay_report(tmp_path / "r.html", *_drawn(descent), FACTS)
    assert not list(tmp_path.iterdir())


def test_results_with_one_row_have_a_page() -> None:
    columns = {
        "time_s": np.zeros(1),
        "FL.fluid_c": np.full(1, 20.0),
        "FL.validity": np.zeros(1),
    }

    reader = _read(_page(Results(columns, ("FL",), ("FL",)), FACTS))

    assert "hottest fluid, FL at 0:00" in " ".join(reader.text)

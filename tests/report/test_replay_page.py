"""The page of a replay: facts, figures, hostile names."""

import dataclasses
import json
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from bstm_daemon.replay.results import Results
from bstm_daemon.report.drive_curves import DriveCurves
from bstm_daemon.report.drive_statistics import DriveStatistics
from bstm_daemon.report.replay_page import ReplayFacts, replay_page
from bstm_daemon.report.shell import render

FACTS = ReplayFacts(
    title="Brake temperatures: descent.log",
    log="descent.log",
    vehicle_id="example",
    configuration="example_vehicle.toml",
    heat_mode="ff",
    lines=1_234_567,
    frames=1_200_000,
    refused={"wrong_length": 3, "checksum": 0},
    counts={"late": 4, "dropped": 0, "jumps": 1},
    compiled=True,
    warnings=("refused: 3 wrong length",),
)

HOSTILE = "</script><img src=x onerror=\"alert('x')\">{{x}}<!--&amp;"


def _page(results: Results, facts: ReplayFacts) -> str:
    curves, statistics = DriveCurves(), DriveStatistics()
    curves.write(results)
    statistics.write(results)
    return render(replay_page(statistics.summary(), curves, facts))


def _text(page: str) -> str:
    """Return what a reader sees of *page* without its plots."""
    body = page[page.index("<main>") : page.index("</main>")]
    return " ".join(unescape(re.sub("<[^>]*>", " ", body)).split())


def _scripts(page: str) -> list[str]:
    return re.findall(r"<script[^>]*>(.*?)</script>", page, re.DOTALL)


@pytest.fixture(scope="module")
def page(descent: Results) -> str:
    return _page(descent, FACTS)


def test_page_shows_facts_and_figures(page: str) -> None:
    text = _text(page)

    for shown in (
        "Brake temperatures: descent.log",
        "example · 2023-11-14 22:13:20 UTC · 1 h 25 min · 15.0 km",
        "607 °C",
        "hottest fluid, FL 10:29 after the stop",
        "least margin to wet boiling, FL (155 °C)",
        "The brake fluid was hottest at FL, 129 °C, 10:29 after the stop",
        "26 K were left to boiling with wet fluid. Not valid for 2.2 %",
        "RL, RR: not modelled, no temperatures.",
        "refused: 3 wrong length",
        "1 234 567",
        "late samples 4",
        "clock jumps 1",
        "97.8 % / 1.6 % / 0.6 %",
        "Why estimates are not valid",
        "heat unknown 30 s 0.6 % 0:15:00 FL FR",
    ):
        assert shown in text
    assert "0 checksum" not in text


@pytest.mark.slow
def test_a_disc_is_hottest_while_it_brakes_whenever_the_car_stopped(
    descent: Results,
) -> None:
    """What follows a stop is the fluid, also after one on the way."""
    columns = {name: one.copy() for name, one in descent.columns.items()}
    columns["speed_ms"][600:1200] = 0.0
    columns["FL.disc_c"][5000] = 700.0

    text = _text(_page(replace(descent, columns=columns), FACTS))

    assert "700 °C hottest disc, FL at 0:08:20" in text
    assert "hottest fluid, FL 10:29 after the stop" in text


def test_page_stays_small(page: str) -> None:
    """85 minutes at 10 Hz: 8 MB and plotly.js would be too much to mail."""
    drive, library, _ = _scripts(page)

    assert len(drive) < 4_000_000
    assert len(page.encode()) - len(library.encode()) < 8_000_000


@pytest.mark.slow
def test_hostile_names_stay_text(descent: Results) -> None:
    facts = dataclasses.replace(
        FACTS,
        title=HOSTILE,
        log=HOSTILE,
        vehicle_id=HOSTILE,
        configuration=HOSTILE,
        heat_mode=HOSTILE,
        refused={HOSTILE: 1},
        counts={HOSTILE: 1},
        warnings=(HOSTILE,),
    )
    columns = {
        key.replace("FL.", f"{HOSTILE}."): column
        for key, column in descent.columns.items()
    }
    results = Results(columns, (HOSTILE, "FR"), (HOSTILE, "FR"))

    page = _page(results, facts)

    assert "<img" not in page
    drive, _, _ = _scripts(page)
    assert any(
        "&lt;img" in trace["name"]
        for plot in json.loads(drive)["plots"]
        for trace in plot["data"]
    )
    assert _text(page).count(HOSTILE) >= 10


def test_results_with_one_row_have_a_page() -> None:
    columns = {
        "time_s": np.zeros(1),
        "FL.fluid_c": np.full(1, 20.0),
        "FL.validity": np.zeros(1),
    }

    page = _page(Results(columns, ("FL",), ("FL",)), FACTS)

    assert "hottest fluid, FL at 0:00" in _text(page)

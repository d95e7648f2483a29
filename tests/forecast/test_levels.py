"""Levels and advice of each simulated drive, against all members marched.

What keeps members from being marched must change no level, no warning and no
advice at any publication, and not the time that a message tells to wait.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast.car_forecast import CarForecast
from bstm_daemon.forecast.course_risk import CourseRisk
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.replay.columns import stream_log
from bstm_daemon.replay.results import Collector
from bstm_daemon.simulation import drive_names, load_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from pathlib import Path

    from bstm_daemon.replay.results.builder import Column

pytestmark = [
    pytest.mark.skipif(load_kernel() is None, reason="hours in pure Python"),
    pytest.mark.slow,
]

QUICK: Final = "alpine-descent"
"""The drive that is not left to the full tests; its levels rise."""


@pytest.fixture(scope="module")
def log(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path: Path = tmp_path_factory.mktemp("levels") / f"{request.param}.log"
    driven = simulate(load_drive(request.param), sensors="n2")
    encoder = Encoder(shipped_file("dbc/example_vehicle.dbc"))
    write_candump(path, driven, encoder)
    return path


def decided(log: Path, start: str) -> dict[str, Column]:
    """Return the columns of levels and of advice."""
    vehicle = load_vehicle(shipped_file("config/example_vehicle.toml"))
    rows = Collector()
    stream_log(
        *(*vehicle, log, [rows]), state="cold" if start == "cold" else None
    )
    return {
        name: column
        for name, column in rows.results().columns.items()
        if name.endswith("_level") or name.startswith("advice_")
    }


@pytest.mark.parametrize("start", ["cold", "unknown"])
@pytest.mark.parametrize(
    "log",
    [
        pytest.param(name, marks=() if name == QUICK else pytest.mark.full)
        for name in sorted(drive_names())
    ],
    indirect=True,
)
def test_nothing_that_is_decided_depends_on_which_members_are_marched(
    log: Path, start: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = decided(log, start)
    monkeypatch.setattr(CarForecast, "is_sure", lambda *_: False)
    monkeypatch.setattr(CarForecast, "_twin", lambda *_: None)
    monkeypatch.setattr(CourseRisk, "_raise_ceiling", lambda *_: None)
    every = decided(log, start)

    assert len(found) == 17
    assert log.stem != QUICK or found["risk_level"].any()
    differ = {
        name: int(np.sum(~((column == every[name]) | np.isnan(column))))
        for name, column in found.items()
        if not np.array_equal(column, every[name], equal_nan=True)
    }
    assert not differ

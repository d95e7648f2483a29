"""Levels and advice of each simulated drive, against all members marched.

What keeps members from being marched must change no level, no warning and no
advice at any publication, and not the time that a message tells to wait. Of a
duty no members are marched: its time, or the bound, is compared with theirs.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast import course_risk
from bstm_daemon.forecast.car_forecast import CarForecast, Corner
from bstm_daemon.forecast.corner_march import CornerMarch
from bstm_daemon.forecast.course_risk import CourseRisk
from bstm_daemon.forecast.march import DUTY_STEPS, Job, _inputs
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.replay.columns import stream_log
from bstm_daemon.replay.results import Collector
from bstm_daemon.simulation import drive_names, load_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from pathlib import Path

    from bstm_daemon.forecast.corner_march import Start
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


each_drive = pytest.mark.parametrize(
    "log",
    [
        pytest.param(name, marks=() if name == QUICK else pytest.mark.full)
        for name in sorted(drive_names())
    ],
    indirect=True,
)


@pytest.mark.full
@pytest.mark.parametrize("start", ["cold", "unknown"])
@each_drive
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


def members_on_duty(
    corner: Corner | CornerMarch, start: Start
) -> dict[float, float]:
    """Return the members' probability of vapour by the time on duty [s]."""
    ensemble, duty, factor = corner.ensemble, start.duty, start.factor
    width = factor * ensemble.spread.duty_heat
    air_k = ensemble.ambients_k(duty.ambient_k, factor)
    power_w = [
        duty.power_w * max(1.0 + width * draw["duty_heat"], 0.0)
        for draw in ensemble.draws
    ]
    job = Job(
        ensemble.batch(load_kernel()),
        ensemble.fluid,
        ensemble.states(start.state, duty.ambient_k, factor),
        _inputs(
            [
                duty._replace(ambient_k=air, power_w=power)
                for air, power in zip(air_k, power_w, strict=True)
            ]
        ),
        DUTY_STEPS,
    )
    job.advance(len(DUTY_STEPS))
    course = job.course()
    return {
        time_s: course.probability(i, start.boiling)
        for i, time_s in enumerate(course.times_s)
    }


@each_drive
def test_the_time_on_duty_is_that_of_its_members(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To first order: what it misses is hardly more than a tenth."""
    told: list[tuple[float, dict[float, float]]] = []
    bounded = [0.0]
    first_order = course_risk._on_duty
    bound = CornerMarch.on_duty_k

    def compared(
        corner: Corner, start: Start, *of: Any
    ) -> tuple[float, float]:
        peak_k, told_s = first_order(corner, start, *of)
        told.append((told_s, members_on_duty(corner, start)))
        return peak_k, told_s

    def looked_at(
        march: CornerMarch, start: Start, *, is_present: bool
    ) -> float:
        most_k = bound(march, start, is_present=is_present)
        if most_k <= start.boiling.lowest_k:
            bounded.extend(members_on_duty(march, start).values())
        return most_k

    monkeypatch.setattr(course_risk, "_on_duty", compared)
    monkeypatch.setattr(CornerMarch, "on_duty_k", looked_at)
    decided(log, "cold")

    assert max(bounded) == 0.0
    assert len(told) + len(bounded) > 1
    assert log.stem != QUICK or sum(0.0 < at_s < inf for at_s, _ in told)
    for told_s, risks in told:
        own_s = next((t for t, risk in risks.items() if risk >= 0.1), inf)
        if told_s == inf:
            assert max(risks.values()) <= 0.135
        else:
            assert 0.07 <= risks[told_s] <= 0.28
            assert own_s == inf or abs(told_s - own_s) <= 150.0

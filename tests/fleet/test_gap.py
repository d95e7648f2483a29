"""The search of each car of a lake, and what the cars share."""

from __future__ import annotations

import json
import re
from contextlib import closing, nullcontext
from dataclasses import asdict, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.cli import fleet as cli
from bstm_daemon.cli.main import main
from bstm_daemon.errors import LogError
from bstm_daemon.fleet import gap as gap_module
from bstm_daemon.fleet.drive import FAILED, FOREIGN
from bstm_daemon.fleet.gap import (
    CarJob,
    cars_of,
    failures_of,
    gap_lines,
    groups_of,
    search_car,
)
from bstm_daemon.fleet.lake import Lake
from bstm_daemon.fleet.plan import Plan
from bstm_daemon.simulation import simulate
from bstm_daemon.simulation.drives import parse_drive
from bstm_daemon.simulation.parameters import Effects
from bstm_daemon.simulation.recorder import Encoder, write_candump

from ..cli.test_gap import DRIVE, EXAMPLE  # noqa: TID252  (no package)
from .conftest import DBC
from .test_learning import car

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path


def jobs_of(root: Path) -> list[CarJob]:
    lake = Lake(root)
    with closing(Plan(lake)) as plan:
        cars, failures = cars_of(lake, plan, 8, anyway=False)
    assert failures == []
    return sorted(cars, key=lambda one: one.last.vehicle)


def result_of(
    name: str, strengths: Mapping[str, float] | None, heat_w: float
) -> dict[str, Any]:
    """Return what a search writes of one group of corners."""
    one = car(name, strengths, answer="name" if strengths else "nothing")
    cell = {
        "node": "disc",
        "regime": "braking",
        "bin": "",
        "windows": 10,
        "energy_j": 300.0 * heat_w,
        "deviation_j": 300.0,
    }
    return {
        "corners": ["FL", "FR"],
        "cells": [cell],
        "headline": name,
        "naming": {"answer": one.answer},
        "equations": {
            key: value if key == "names" else value.tolist()
            for key, value in asdict(one.equations).items()
        },
    }


class Future:
    """A search that ends in this process."""

    def __init__(self, job: CarJob, lost: str = "", state: str = "") -> None:
        self.job, self.lost, self.state = job, lost, state

    def cancelled(self) -> bool:
        return self.state == "cancelled"

    def exception(self) -> Exception | None:
        return RuntimeError(self.lost) if self.lost else None

    def result(self) -> int:
        return FOREIGN if self.state == "foreign" else search_car(self.job)


class Client:
    """Searches in this process."""

    loop = None

    def __init__(self, **ends: str) -> None:
        self.ends = ends

    def map(
        self, _: Any, jobs: Sequence[CarJob], *, pure: bool
    ) -> list[Future]:
        assert not pure
        return [Future(job, **self.ends) for job in jobs]


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Search in this process, with results as they were made up.

    Returns the names of the cars that were searched. All have
    gap_conduction, car1 a sensor besides and much heat; car4 fails.
    """
    names: list[str] = []

    def search(job: CarJob) -> dict[str, Any]:
        name = job.last.vehicle
        names.append(name)
        if name == "car4":
            raise LogError("own.log: no pressure")  # noqa: EM101, TRY003
        strengths = {"gap_conduction": 1.0}
        if name == "car1":
            strengths |= {"thermocouple_offset": 1.2}
        heat_w = 90.0 if name == "car1" else float(name[-1])
        group = result_of(name, strengths, heat_w)
        return {"message": None, "left_out": [], "groups": [group]}

    monkeypatch.setattr(gap_module, "_searched", search)
    monkeypatch.setattr(cli, "connect", lambda *_: nullcontext(Client()))
    monkeypatch.setattr(
        "distributed.as_completed", lambda futures, **_: futures
    )
    return names


def test_what_the_type_has_a_sensor_and_the_odd_one_out(
    make_fleet: Callable[..., Any],
    searched: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    fleet = make_fleet(8, [0])
    fleet.plan()
    lake, result = str(fleet.lake.root), fleet.folder / "gap.json"
    asked = ["fleet", "gap", lake, "--json", str(result)]

    assert main(asked) == 1

    out = capsys.readouterr().out
    assert "car, FL, FR: 7 cars searched" in out
    lines = [line for line in out.splitlines() if line.startswith("  ")]
    rows = {line.split()[0]: line for line in lines}
    assert "the type" in rows["gap_conduction"]
    assert "7 of 7 cars" in rows["gap_conduction"]
    assert "a sensor of car1" in rows["thermocouple_offset"]
    assert "1 of 7 cars" in rows["thermocouple_offset"]
    assert "odd one out: car1: disc, braking +90 W" in out
    assert "- car4: own.log: no pressure" in out
    found = json.loads(result.read_text("utf-8"))
    assert found["failures"] == ["car4: own.log: no pressure"]
    first, second = found["groups"][0]["findings"]
    assert (first["names"], first["scope"]) == (["gap_conduction"], "type")
    assert second["strengths"]["car1"] == pytest.approx([1.2, 0.1])

    # of one configuration, which nobody matched
    types = fleet.folder / "types"
    main([*asked, "-o", str(types)])
    assert "it needs two matched cars" in capsys.readouterr().out
    (types / "car.toml").write_text("mine", "utf-8")
    assert main([*asked, "-o", str(types)]) == 2
    assert "give --force" in capsys.readouterr().err

    # only what failed or has changed is searched again
    searched.clear()
    fleet.log("car2", 0).touch()
    fleet.plan()
    main(asked)
    assert sorted(searched) == ["car2", "car4"]


def test_a_car_that_fails_costs_itself(
    make_fleet: Callable[..., Any],
) -> None:
    """Some seconds are too short to be searched: the message says so."""
    fleet = make_fleet(1, [0])
    fleet.plan()
    (job,) = jobs_of(fleet.lake.root)

    assert search_car(job) == FAILED

    (line,) = failures_of([job])
    assert line.startswith("car0: drive0.log")
    assert groups_of([job]) == []
    assert job.result()["key"] != job.key


def test_forces_of_a_car_that_nobody_weighed_are_not_searched(
    make_fleet: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = make_fleet(1, [0])
    car = fleet.folder / "car.toml"
    text = car.read_text("utf-8")
    guess = re.sub(
        "(?m)^(mass_kg = [0-9.]+).*$", r"\1  # typical", text, count=1
    )
    assert guess != text
    car.write_text(guess, "utf-8")
    fleet.plan()
    (job,) = jobs_of(fleet.lake.root)
    drive = SimpleNamespace(measured={}, roles=())
    forces = SimpleNamespace(name="drive0", drive=drive, present={})
    monkeypatch.setattr(gap_module, "read_recording", lambda *_: forces)
    monkeypatch.setattr(gap_module, "check_inputs", lambda *_: None)

    def search(*_: Any) -> None:
        raise LogError("searched")  # noqa: EM101

    monkeypatch.setattr(gap_module, "find_force_gap", search)

    for anyway, said in (
        (False, "mass_kg is a typical value"),
        (True, "searched"),
    ):
        own = replace(job, anyway=anyway)
        assert search_car(own) == FAILED
        assert said in failures_of([own])[0]


def test_a_worker_of_another_program_searches_nothing(
    make_fleet: Callable[..., Any],
) -> None:
    fleet = make_fleet(1, [0])
    fleet.plan()
    (job,) = jobs_of(fleet.lake.root)
    other = CarJob(job.root, job.drives, "", False, {"bstm": "9"})

    assert search_car(other) == FOREIGN
    assert failures_of([other]) == ["car0: no result"]


def test_a_lost_worker_a_broken_log_and_a_missing_configuration(
    make_fleet: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
    searched: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    fleet = make_fleet(2, [0])
    fleet.log("car1", 0).write_text("no log", "utf-8")
    fleet.plan()
    lost = nullcontext(Client(lost="killed"))
    monkeypatch.setattr(cli, "connect", lambda *_: lost)

    assert main(["fleet", "gap", str(fleet.lake.root)]) == 1

    out = capsys.readouterr().out
    assert "- car0: RuntimeError: killed" in out
    assert "- car1: no drive that can be read" in out
    assert searched == []
    for state, said in (("foreign", "another program"), ("cancelled", "gone")):
        ends = nullcontext(Client(state=state))
        monkeypatch.setattr(cli, "connect", lambda *_, own=ends: own)
        assert main(["fleet", "gap", str(fleet.lake.root)]) != 0
        assert said in "".join(capsys.readouterr())
    (fleet.folder / "car.toml").unlink()
    assert main(["fleet", "gap", str(fleet.lake.root)]) == 1
    assert "car.toml: " in capsys.readouterr().out


def test_cars_that_were_not_matched_get_no_names(
    make_fleet: Callable[..., Any],
    searched: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fleet = make_fleet(2, [0])
    fleet.plan()
    group = result_of("car", None, 1.0)
    del group["naming"]
    group["equations"] = None
    monkeypatch.setattr(
        *(gap_module, "_searched"),
        lambda _: {"message": None, "left_out": [], "groups": [group]},
    )
    jobs = jobs_of(fleet.lake.root)
    for job in jobs:
        search_car(job)

    lines = gap_lines(groups_of(jobs))

    assert lines == [
        "car, FL, FR: 2 cars searched",
        "  not matched, no names (--anyway): car0, car1",
    ]
    assert searched == []


def test_by_forces_the_odd_one_out_brakes_otherwise_than_its_type(
    make_fleet: Callable[..., Any],
    searched: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fleet = make_fleet(8, [0])
    fleet.plan()

    def search(job: CarJob) -> dict[str, Any]:
        name = job.last.vehicle
        ratio = 1.5 if name == "car6" else 1.0 + 0.01 * int(name[-1])
        work = {"pressure": 1e6 * ratio, "motion": 1e6}
        group = result_of(name, None, 1.0) | {"braking_work_j": work}
        group |= {"corners": [], "cells": []}
        return {"message": None, "left_out": [], "groups": [group]}

    monkeypatch.setattr(gap_module, "_searched", search)
    jobs = jobs_of(fleet.lake.root)
    for job in jobs:
        search_car(job)

    (group,) = groups_of(jobs)

    ((place, value, unit, z),) = group.odd.pop("car6")
    assert (group.odd, searched) == ({}, [])
    assert (place, unit) == ("work of pressure over that of motion", "%")
    assert value == pytest.approx(50.0)
    assert z > 10.0
    head, nothing, odd = gap_lines(groups_of(jobs))
    assert head == "car, by forces: 8 cars searched"
    assert nothing.strip().startswith("nothing")
    assert "car6: work of pressure over that of motion +50 %" in odd


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the searched lake of a simulated type.

    a0 to a2 have a conducting gap, b0 to b2 nothing, c0 slow thermocouples.
    One configuration is matched to a further drive of none.
    """
    folder = tmp_path_factory.mktemp("type")
    hidden = {
        **{f"a{i}": {"gap_conduction": 1.8 + 0.2 * i} for i in range(3)},
        **{f"b{i}": {} for i in range(3)},
        "c0": {"thermocouple_lag": 2.0},
        "match": {},
    }
    for seed, (name, effects) in enumerate(hidden.items()):
        log = folder / "logs" / name / "own.log"
        log.parent.mkdir(parents=True)
        drive = simulate(
            parse_drive(DRIVE, "own"),
            preset=Effects(**effects),
            sensors="n1",
            seed=10 + seed,
        )
        write_candump(log, drive, Encoder(DBC))
    matched = folder / "matched.toml"
    log.rename(folder / "match.log")
    main(
        [
            *("match", str(folder / "match.log"), "-c", str(EXAMPLE)),
            *("-o", str(matched), "--plain"),
        ]
    )
    (folder / "fleet.toml").write_text(
        '[[vehicle]]\nlogs = "{vehicle}/*.log"\nconfig = "matched.toml"\n'
        'type = "golf"\n',
        "utf-8",
    )
    root = folder / "lake"
    logs, vehicles = str(folder / "logs"), str(folder / "fleet.toml")
    plan = ["fleet", "plan", logs, "--vehicles", vehicles, "-o", str(root)]
    assert main(plan) == 0
    assert main(["fleet", "gap", str(root), "--jobs", "1"]) == 0
    return root


@pytest.mark.slow
@pytest.mark.full
@pytest.mark.parametrize(
    ("cars", "expected"),
    [
        ("a0 a1 a2", {"gap_conduction": ("type", "a0 a1 a2")}),
        ("a0 a1 b0 b1", {"gap_conduction": ("car", "a0 a1")}),
        ("b0 b1 a2 b2", {"gap_conduction": ("car", "a2")}),
        ("b0 b1 b2", {}),
        ("b0 c0 b1 b2", {"thermocouple_lag": ("sensor", "c0")}),
        (
            "a0 b0 c0 a1 a2",
            {
                "gap_conduction": ("car", "a0 a1 a2"),
                "thermocouple_lag": ("sensor", "c0"),
            },
        ),
    ],
)
def test_an_effect_hidden_in_all_in_some_in_one_in_none(
    lake: Path, cars: str, expected: Mapping[str, Sequence[str]]
) -> None:
    jobs = {job.last.vehicle: job for job in jobs_of(lake)}

    (group,) = groups_of([jobs[name] for name in cars.split()])

    assert {
        one.names[0]: (one.scope, " ".join(sorted(one.carriers)))
        for one in group.findings
    } == expected
    for one in group.findings:
        assert one.probability > 0.95
        if one.scope == "type":
            # another form than the catalogue's
            assert one.strength == pytest.approx(2.0, rel=0.25)

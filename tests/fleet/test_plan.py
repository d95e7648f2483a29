"""The plan: order, names, what is refused, what is not read again."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.errors import ConfigError, FileAccessError, UsageError
from bstm_daemon.fleet import plan as plan_module
from bstm_daemon.fleet.plan import Fleet, Plan, Vehicles

if TYPE_CHECKING:
    from collections.abc import Callable


@pytest.mark.parametrize(
    ("pattern", "log", "vehicle"),
    [
        ("{vehicle}/*.log", "/data/car7/a.log", "car7"),
        ("{vehicle}/*.log", "/data/car7/may/a.log", "may"),
        ("logs/{vehicle}/**/*.blf", "/logs/car7/a/b/c.blf", "car7"),
        ("logs/{vehicle}/**/*.blf", "/logs/car7/c.blf", "car7"),
        ("logs/{vehicle}/**/*.blf", "/logs/car7/c.log", None),
        ("{vehicle}_*.mf4", "/x/AB 12_2024.mf4", "AB 12"),
        ("{vehicle}.?", "/x/car+1.a", "car+1"),
        ("data/{vehicle}.log", "/mydata/a.log", None),
    ],
)
def test_a_pattern_fits_the_end_of_a_path(
    pattern: str, log: str, vehicle: str | None
) -> None:
    found = Vehicles(logs=pattern, config="car.toml")

    assert found.vehicle_of(Path(log)) == vehicle


def fleet(folder: Path, text: str) -> Fleet:
    path = folder / "fleet.toml"
    path.write_text(text, "utf-8")
    return Fleet(path)


def test_the_first_table_that_fits_names_car_and_configuration(
    tmp_path: Path,
) -> None:
    found = fleet(
        tmp_path,
        """
[[vehicle]]
id = "press car"
logs = "press/*.log"
config = "special.toml"
type = "golf"
map = {can1 = "drive"}
[[vehicle]]
logs = "{vehicle}/*.log"
config = "cars/{vehicle}.toml"
""",
    )

    press = found.assign(Path("/data/press/a.log"))
    other = found.assign(Path("/data/car7/a.log"))

    assert press is not None
    assert press.vehicle == "press car"
    assert press.config == tmp_path / "special.toml"
    assert (press.type, press.map) == ("golf", {"can1": "drive"})
    assert other is not None
    assert other.config == tmp_path / "cars" / "car7.toml"
    assert other.type == "car7"
    assert found.assign(Path("/data/readme.md")) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "vehicle: missing"),
        ("vehicle = 3", "must be a list"),
        ("cars = 3", "cars = 3: unknown key"),
        (
            '[[vehicle]]\nlogs = "*.log"\nconfig = "a.toml"',
            "needs {vehicle} once",
        ),
        (
            '[[vehicle]]\nlogs = "{vehicle}.log"\nid = "a"\nconfig = "a"',
            "or an 'id' instead",
        ),
        (
            '[[vehicle]]\nlogs = "{vehicle}.log"\nconfg = "a.toml"',
            "did you mean 'config'",
        ),
    ],
)
def test_a_mistake_is_named(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError) as raised:
        fleet(tmp_path, text)

    assert words in str(raised.value)
    assert "fleet.toml" in str(raised.value)


def test_a_chain_is_in_the_order_of_its_begins(
    make_fleet: Callable[..., Any], recorded: list[bytes]
) -> None:
    """Not of its names; the car with most data comes first."""
    fleet = make_fleet(2, [1, 2, 3])
    late = fleet.log("car0", 2)
    late.rename(late.with_name("a.log"))
    fleet.log("car1", 9).write_bytes(recorded[0])

    assert fleet.plan() == []

    names = [drive.name for drive in fleet.chain("car0")]
    assert names == ["drive1", "a", "drive3"]
    first = fleet.chain("car1")[0]
    assert (first.name, first.first_us // 10**6) == ("drive9", 1_700_000_000)
    plan = Plan(fleet.lake)
    assert plan.vehicles() == ["car1", "car0"]
    assert (len(plan), plan.cars()) == (7, 2)
    plan.close()


def test_logs_are_added_and_one_that_is_as_it_was_is_not_opened(
    make_fleet: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = make_fleet(1, [0, 1])
    fleet.plan(fleet.log("car0", 0))
    assert [drive.name for drive in fleet.chain("car0")] == ["drive0"]
    opened = []
    begin = plan_module._begin

    def noted(path: Any, assigned: Any) -> Any:
        opened.append(path.name)
        return begin(path, assigned)

    monkeypatch.setattr(plan_module, "_begin", noted)

    fleet.plan()
    os.utime(fleet.log("car0", 0))
    fleet.plan()

    assert opened == ["drive1.log", "drive0.log"]
    assert len(fleet.chain("car0")) == 2


def test_logs_that_begin_together_are_refused_by_name(
    make_fleet: Callable[..., Any],
) -> None:
    """And the plan stays as it was."""
    fleet = make_fleet(1, [0])
    fleet.plan()
    twin = fleet.log("car0", 0).with_name("twin.log")
    twin.write_bytes(fleet.log("car0", 0).read_bytes())

    with pytest.raises(UsageError, match=r"car0: .*drive0.log and .*twin.log"):
        fleet.plan()

    assert [drive.name for drive in fleet.chain("car0")] == ["drive0"]


def test_a_log_of_no_car_is_refused_where_it_was_named(
    make_fleet: Callable[..., Any],
) -> None:
    fleet = make_fleet(1, [0])
    other = fleet.folder / "logs" / "car0" / "notes.txt"
    other.write_text("no log")

    fleet.plan()
    with pytest.raises(UsageError, match=r"notes\.txt"):
        fleet.plan(other)
    with pytest.raises(FileAccessError, match=r"none\.log"):
        fleet.plan(other.with_name("none.log"))

    assert len(fleet.chain("car0")) == 1


def test_a_log_without_a_begin_has_the_place_of_its_name(
    make_fleet: Callable[..., Any],
) -> None:
    fleet = make_fleet(1, [0, 1, 2, 3])
    fleet.log("car0", 2).write_bytes(b"")
    fleet.log("car0", 0).write_bytes(b"no log\n")

    found = fleet.plan()

    assert [drive.name for drive in found] == ["drive0", "drive2"]
    assert "drive2.log: the log is empty" in str(found[1].problem)
    names = [drive.name for drive in fleet.chain("car0")]
    assert names == ["drive0", "drive1", "drive2", "drive3"]


def test_logs_of_one_name_get_names_of_their_own(
    make_fleet: Callable[..., Any], recorded: list[bytes]
) -> None:
    fleet = make_fleet(1, [0])
    (fleet.folder / "fleet.toml").write_text(
        '[[vehicle]]\nlogs = "logs/{vehicle}/**/*.log"\nconfig = "car.toml"\n'
    )
    for day, log in enumerate(recorded):
        path = fleet.folder / "logs" / "car0" / str(day) / "drive0.log"
        path.parent.mkdir()
        path.write_bytes(log.replace(b"(17", b"(1%d" % day))

    fleet.plan()

    names = [drive.name for drive in fleet.chain("car0")]
    assert len(set(names)) == 4
    assert "drive0" in names
    assert all(name.startswith("drive0") for name in names)


def test_without_a_plan_there_is_nothing_to_read(
    make_fleet: Callable[..., Any],
) -> None:
    with pytest.raises(FileAccessError, match="bstm fleet plan"):
        Plan(make_fleet(1, [0]).lake)

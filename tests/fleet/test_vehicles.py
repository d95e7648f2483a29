"""``fleet.toml``: path patterns, and every mistake by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from bstm_daemon.errors import ConfigError
from bstm_daemon.fleet.vehicles import Fleet, Vehicles


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

"""Configuration files: what is accepted, and the words for what is not."""

import math
import tomllib
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bstm_daemon.config.reading import (
    draft_of,
    load_config,
    naming_file,
    read_draft,
)
from bstm_daemon.config.rules import usable_signals
from bstm_daemon.config.sections import Config
from bstm_daemon.config.wording import toml_text
from bstm_daemon.errors import ConfigError, FileAccessError

MISTAKES = tomllib.loads(
    Path(__file__).with_name("config_mistakes.toml").read_text("utf-8")
)["mistake"]
SHIPPED = sorted((Path(__file__).parents[2] / "config").glob("*.toml"))

BASE = """\
[vehicle]
id = "car"
mass_kg = 2194.0
wheel_radius_m = 0.3418

[[bus]]
name = "chassis"
dbc = "car.dbc"

[signals.vehicle_speed]
message = "WheelSpeeds"
signal = "Speed"
unit = "km/h"

[signals.primary_pressure]
message = "Brake"
signal = "Pressure"
unit = "bar"

[[corner]]
name = "FL"
piston_area_m2 = 2.827e-3
effective_radius_m = 0.13
disc = {mass_kg = 7.5, swept_area_m2 = 0.085, total_area_m2 = 0.14}
pad = {area_m2 = 6.5e-3, thickness_m = 0.011}
"""

REAR = """
[[corner]]
name = "RR"
circuit = "secondary"
piston_area_m2 = 1.385e-3
effective_radius_m = 0.12
disc = {mass_kg = 5.0, swept_area_m2 = 0.07, total_area_m2 = 0.10}
pad = {area_m2 = 4.2e-3, thickness_m = 0.010}
"""

SPEED = """\
[signals.vehicle_speed]
message = "WheelSpeeds"
signal = "Speed"
unit = "km/h"
"""
PRESSURE = """\
[signals.primary_pressure]
message = "Brake"
signal = "Pressure"
unit = "bar"
"""


def write(folder: Path, text: str) -> Path:
    """Write *text* as a configuration file and return its path."""
    path = folder / "car.toml"
    path.write_text(text, encoding="utf-8")
    return path


def problems(folder: Path, text: str) -> list[str]:
    """Return the problems of *text* without the file's name."""
    path = write(folder, text)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert caught.value.exit_code == 78
    prefix = f"{path}: "
    assert all(line.startswith(prefix) for line in caught.value.problems)
    return [line.removeprefix(prefix) for line in caught.value.problems]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_files_load(path: Path) -> None:
    """Every file under config/ is valid and has four disc corners."""
    assert len(load_config(path).disc_corners()) == 4


def test_smallest_file(tmp_path: Path) -> None:
    """The mandatory keys are enough; the rest has defaults."""
    config = load_config(write(tmp_path, BASE))

    assert config.vehicle.mass_kg == 2194.0
    assert config.heat.mode == "ff"
    assert config.signals["primary_pressure"].unit == "bar"
    assert not config.publish.enabled


def test_all_sections_arrive(tmp_path: Path) -> None:
    """Each optional section of the file reaches the configuration."""
    text = f"""{BASE}{REAR}
[thermal]
disc_emissivity = 0.7
[cooling]
blend_end_ms = 4
[heat]
slope = "flat"
[fluid]
grade = "DOT3"
changed = 2024-05-31
[[effect]]
name = "disc_wear"
parameters = {{strength = 1}}
[publish]
id_base = 0x400
"""

    config = load_config(write(tmp_path, text))

    assert config.thermal.disc_emissivity == 0.7
    assert config.cooling.blend_end_ms == 4.0
    assert config.heat.slope == "flat"
    assert config.fluid.changed == date(2024, 5, 31)
    assert config.effect[0].parameters == {"strength": 1.0}
    assert config.publish.id_base == 0x400
    assert [corner.name for corner in config.corner] == ["FL", "RR"]


def table_only() -> str:
    """Return BASE with the roles as columns and without a bus."""
    return (
        BASE.replace('[[bus]]\nname = "chassis"\ndbc = "car.dbc"\n', "")
        .replace('message = "WheelSpeeds"\nsignal = "Speed"', 'column = "v"')
        .replace('message = "Brake"\nsignal = "Pressure"', 'column = "p"')
    )


def test_a_table_needs_no_bus(tmp_path: Path) -> None:
    """Roles that are columns make a configuration without a bus."""
    text = table_only() + '[table]\ntime = "t"\n'

    config = load_config(write(tmp_path, text))

    assert config.bus == []
    assert config.table is not None
    assert config.table.time == "t"
    assert config.signals["vehicle_speed"].column == "v"


def test_a_table_cannot_publish(tmp_path: Path) -> None:
    """Frames need a bus to be sent on, columns need a table."""
    text = table_only() + "[publish]\nenabled = true\n"

    assert problems(tmp_path, text) == [
        (
            "[table]: missing, [signals.vehicle_speed] is a column: give "
            "'time', the column with the time, or 'rate_hz'"
        ),
        "[publish] enabled = true: needs a [[bus]] to send on",
    ]


@pytest.mark.parametrize(
    "mistake", MISTAKES, ids=lambda mistake: mistake["say"][0]
)
def test_mistake(tmp_path: Path, mistake: dict[str, Any]) -> None:
    """Each kind of mistake is worded with place, value and remedy."""
    put = mistake["put"]
    find = mistake.get("find")
    assert find is None or find in BASE
    text = f"{BASE}\n{put}\n" if find is None else BASE.replace(find, put, 1)

    assert mistake["say"] == problems(tmp_path, text)


def test_key_before_any_section(tmp_path: Path) -> None:
    """A key above the first section is pointed out as such."""
    found = problems(tmp_path, f"mass_kg = 3\n{BASE}")

    assert len(found) == 1
    assert found[0].startswith("mass_kg = 3: is before any section")


def test_empty_file_names_what_is_needed(tmp_path: Path) -> None:
    """An empty file is told all mandatory sections."""
    expected = [
        f"{section}: missing, every file needs it"
        for section in (
            "[vehicle]",
            "[[bus]]",
            "[signals.<role>]",
            "[[corner]]",
        )
    ]

    assert expected == problems(tmp_path, "")


def test_same_corner_twice(tmp_path: Path) -> None:
    """Two sections for one wheel brake are refused."""
    text = BASE + BASE[BASE.index("[[corner]]") :]

    assert problems(tmp_path, text) == [
        "[[corner]] FL name: given twice, one section a wheel brake"
    ]


def test_drums_alone(tmp_path: Path) -> None:
    """Without any disc there is nothing to estimate."""
    drum = (
        '[[corner]]\nname = "RR"\ntype = "drum"\npiston_area_m2 = '
        "3e-4\neffective_radius_m = 0.11\n"
    )

    found = problems(tmp_path, BASE[: BASE.index("[[corner]]")] + drum)

    assert found == [
        '[[corner]]: all are drums, at least one must be a "disc"'
    ]


def test_every_section_is_reported_at_once(tmp_path: Path) -> None:
    """Mistakes in five sections give five lines from one reading."""
    text = (
        BASE.replace("mass_kg = 2194.0", "mass_kg = -3")
        .replace('dbc = "car.dbc"', "")
        .replace('unit = "km/h"', 'unit = "bar"')
        .replace("mass_kg = 7.5", "mass_kg = 0")
        .replace('name = "FL"', 'name = "FL"\nthermal.pad_emissivity = 2')
    )

    sections = [line.split(" ")[0] for line in problems(tmp_path, text)]

    assert sections == [
        "[vehicle]",
        "[[bus]]",
        "[[corner]]",
        "[signals.vehicle_speed]",
        "[[corner]]",
    ]


@pytest.mark.parametrize(
    ("heat", "roles"),
    [
        ('mode = "ff"', {"wheel_speed_rl": "rpm", "wheel_pressure_fl": "bar"}),
        ('mode = "fb"', {"vehicle_speed": "m/s", "powertrain_torque": "Nm"}),
        (
            'mode = "fb"\nassume_powertrain_torque_nm = 0.0',
            {"vehicle_speed": "m/s"},
        ),
        ('mode = "measured"', {"temp_fl_disc": "degC"}),
    ],
)
def test_enough_roles_for_the_heat_mode(
    tmp_path: Path, heat: str, roles: dict[str, str]
) -> None:
    """Each mode is content with its mandatory roles."""
    signals = "".join(
        f'[signals.{role}]\nmessage = "M"\nsignal = "S"\nunit = "{unit}"\n'
        for role, unit in roles.items()
    )
    text = BASE.replace(SPEED, signals).replace(PRESSURE, "")

    config = load_config(write(tmp_path, f"{text}\n[heat]\n{heat}\n"))

    assert set(config.signals) == set(roles)


def test_secondary_pressure_serves_its_circuit_only(tmp_path: Path) -> None:
    """A corner of the primary circuit still needs its own pressure."""
    text = BASE.replace("primary_pressure", "secondary_pressure") + REAR
    text += '[heat]\nmode = "ff"\n'

    assert problems(tmp_path, text) == [
        (
            '[heat] mode = "ff": needs a pressure for corner FL, configure '
            "one of [signals.primary_pressure], [signals.wheel_pressure_fl]"
        )
    ]


def test_toml_syntax_error_has_line_and_column(tmp_path: Path) -> None:
    """A syntax error names file, line and column."""
    text = BASE.replace("mass_kg = 2194.0", "mass_kg 2194.0")

    (line,) = problems(tmp_path, text)

    assert line.startswith("line 3, column 9: ")


def test_syntax_error_at_the_end(tmp_path: Path) -> None:
    """An unfinished file says so."""
    (line,) = problems(tmp_path, BASE + 'x = "')

    assert "column" in line or line.startswith("end of document: ")


def test_not_utf8(tmp_path: Path) -> None:
    """A file in another encoding names the byte."""
    path = tmp_path / "car.toml"
    path.write_bytes(b'[vehicle]\nid = "S\xe4"\n')

    with pytest.raises(ConfigError, match="byte 17: is not UTF-8"):
        load_config(path)


@pytest.mark.parametrize("name", ["none.toml", "."])
def test_file_that_cannot_be_read(tmp_path: Path, name: str) -> None:
    """A missing file or a folder is an access error with its reason."""
    path = tmp_path / name

    with pytest.raises(FileAccessError, match="give a readable") as caught:
        load_config(path)

    assert str(path) in str(caught.value)


def test_naming_file_leaves_other_errors_alone() -> None:
    """Only configuration problems get the file's name."""
    lost = FileAccessError("gone")

    with pytest.raises(FileAccessError) as caught, naming_file(Path("a.toml")):
        raise lost

    assert caught.value is lost


def test_usable_signals_leave_out_the_broken(tmp_path: Path) -> None:
    """DBC checks run on the signals that are right as far as known."""
    text = BASE.replace('unit = "bar"', 'unit = "m"') + (
        '[signals.yaw_rate]\nmessage = "M"\nsignal = "S"\nunit = '
        '"rad/s"\nbus = "body"\n'
    )

    draft, found = read_draft(write(tmp_path, text))

    assert len(found) == 2
    assert list(usable_signals(draft)) == ["vehicle_speed"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("a", '"a"'),
        (True, "true"),
        (math.nan, "nan"),
        (3, "3"),
        ([1, 2], "[1, 2]"),
        ({"day": date(2024, 5, 31)}, '{"day": "2024-05-31"}'),
    ],
)
def test_values_are_shown_as_written(value: object, text: str) -> None:
    """A message quotes a value the way the file has it."""
    assert text == toml_text(value)


def test_long_values_are_shortened() -> None:
    """A message stays one readable line."""
    assert len(toml_text(list(range(100)))) == 60


scalars = st.one_of(
    st.none().map(lambda _: date(2024, 5, 31)),
    st.booleans(),
    st.integers(-5, 5),
    st.floats(),
    st.sampled_from(["FL", "disc", "bar", "all", "chassis", "", "x"]),
)
values = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=2)
        | st.dictionaries(
            st.sampled_from(["name", "temperature_c", "value", "mass_kg"]),
            inner,
            max_size=2,
        )
    ),
    max_leaves=4,
)


@st.composite
def documents(draw: st.DrawFn) -> dict[str, Any]:
    """Draw a document with known section and key names but any values."""
    document: dict[str, Any] = {}
    for name in draw(st.sets(st.sampled_from(sorted(Config.model_fields)))):
        keys = ["name", "unit", "bus", "thermal", "pad", "mode", "speed_ms"]
        table = st.dictionaries(st.sampled_from(keys), values, max_size=3)
        role = st.sampled_from(["yaw_rate", "pitch", "x"])
        document[name] = draw(
            table
            | st.lists(table, max_size=2)
            | st.dictionaries(role, table, max_size=2)
            | values
        )
    return document


@settings(max_examples=25, deadline=None)
@given(documents())
@example({"corner": [date(2024, 5, 31)]})
@example({"corner": [{"piston_diameter_mm": 10**400}]})
def test_any_document_gets_worded_problems(document: dict[str, Any]) -> None:
    """Whatever the values are, the answer is a list of lines."""
    _, found = draft_of(document)

    assert found
    assert all(line and "\n" not in line for line in found)


def test_a_bus_that_is_ignored_is_an_interface_left_out(
    tmp_path: Path,
) -> None:
    """It has no DBC and is no bus of the car."""
    ignored = '[[bus]]\nname = "can7"\nignore = true\n\n[[bus]]'

    config = load_config(write(tmp_path, BASE.replace("[[bus]]", ignored, 1)))

    assert config.bus[0].ignored_interfaces == ["can7"]
    assert "can7" not in [bus.name for bus in config.bus]

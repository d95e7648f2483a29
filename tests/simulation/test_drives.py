"""Drive files: the packaged ones load, mistakes are named."""

from pathlib import Path

import pytest

from bstm_daemon.errors import ConfigError, FileAccessError, UsageError
from bstm_daemon.simulation import (
    drive_names,
    load_drive,
    parse_drive,
    read_drive,
    simulate,
)

HEAD = '[drive]\nname = "d"\ndescription = "x"\n'


def test_packaged_drives_load_under_their_names() -> None:
    assert {"simalp", "alpine-descent"} <= set(drive_names())
    for name in drive_names():
        assert load_drive(name).name == name


def test_unknown_name_says_where_the_known_are() -> None:
    with pytest.raises(UsageError, match="simulate --list has them"):
        load_drive("nordschleife")


def test_drive_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(HEAD + "[[segment]]\nspeed_kmh = 50.0\n")

    assert read_drive(path).segment[0].speed_kmh == 50.0


def test_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none.toml"

    with pytest.raises(FileAccessError, match=r"none\.toml"):
        read_drive(path)


def test_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")

    with pytest.raises(ConfigError, match=r"binary\.toml: not a UTF-8"):
        read_drive(path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[drive", "f.toml: not TOML"),
        (HEAD, "f.toml: segment: "),
        (HEAD + "segment = []", "f.toml: segment: "),
        (
            HEAD + "[[segment]]\nspeed_kmh = -3.0\n",
            r"f.toml: segment\[1\].speed_kmh: ",
        ),
        (
            HEAD + "[[segment]]\nspeed_kmh = 3.0\nspeeed = 3\n",
            r"f.toml: segment\[1\].speeed: unknown key",
        ),
        (
            HEAD + "[[segment]]\nduration_s = 3.0\n",
            r"f.toml: segment\[1\]: needs exactly one",
        ),
        (
            HEAD + "[[segment]]\nspeed_kmh = 3.0\nparked = true\n",
            r"f.toml: segment\[1\]: needs exactly one",
        ),
        (
            HEAD + "[[segment]]\nparked = true\n",
            r"f.toml: segment\[1\]: 'parked' needs 'duration_s'",
        ),
        (
            HEAD + "[[segment]]\nspeed_kmh = 3.0\nrepeat = 3\n",
            r"f.toml: segment\[1\]: 'repeat' needs",
        ),
        (
            HEAD
            + "[[segment]]\nspeed_kmh = 3.0\nduration_s = 3\ndistance_m = 3",
            r"f.toml: segment\[1\]: 'duration_s' and 'distance_m'",
        ),
        (
            HEAD + "[[segment]]\nuntil_speed_kmh = 3.0\ndistance_m = 3",
            r"f.toml: segment\[1\]: 'until_speed_kmh' and 'distance_m'",
        ),
        (
            HEAD
            + "[[segment]]\nspeed_kmh = 3.0\nbrake_force_n = 3\n"
            + "brake_pressure_bar = 3",
            r"f.toml: segment\[1\]: 'brake_pressure_bar' and",
        ),
        (
            HEAD + "[[segment]]\nspeed_kmh = 3.0\nslip = [0.1, 0.1]\n",
            r"f.toml: segment\[1\].slip: ",
        ),
        (
            HEAD + "[[segment]]\nspeed_kmh = 3.0\nslip = [1.1, 0, 0, 0]\n",
            r"f.toml: segment\[1\]: 'slip' needs four shares",
        ),
        (
            HEAD
            + "[[segment]]\nspeed_kmh = 3.0\n"
            + "corner_pressure_bar = [-1, 0, 0, 0]\n",
            r"f.toml: segment\[1\]: 'corner_pressure_bar' needs four",
        ),
        (
            HEAD
            + "[[segment]]\nparked = true\nduration_s = 3.0\n"
            + "corner_pressure_bar = [1, 0, 0, 0]\n",
            r"f.toml: segment\[1\]: 'corner_pressure_bar' needs 'speed",
        ),
        (
            HEAD + "[[segment]]\nspeed_kmh = 3.0\npressure_rise_bar_s = 1\n",
            r"f.toml: segment\[1\]: 'pressure_rise_bar_s' needs",
        ),
        (
            HEAD
            + "[[segment]]\nrepeat = 2\n[[segment.segment]]\n"
            + "speed_kmh = nan\n",
            r"f.toml: segment\[1\].segment\[1\].speed_kmh: ",
        ),
    ],
)
def test_mistake_names_file_and_key(text: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        parse_drive(text, "f.toml")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("segments", "problem"),
    [
        (
            (
                "[[segment]]\nspeed_kmh = 90.0\n"
                "[[segment]]\nparked = true\nduration_s = 5.0\n"
            ),
            r"d: segment\[2\]: parked at 90 km/h",
        ),
        (
            "[[segment]]\nspeed_kmh = 90.0\nduration_s = 5.0\n",
            r"d: segment\[1\]: duration_s: 90 km/h takes 25.0 s",
        ),
        (
            "[[segment]]\nspeed_kmh = 36.0\ndistance_m = 20.0\n",
            r"d: segment\[1\]: distance_m: 36 km/h takes 50 m",
        ),
        (
            (
                "[[segment]]\nspeed_kmh = 36.0\n"
                "[[segment]]\nuntil_speed_kmh = 80.0\n"
            ),
            r"d: segment\[2\]: until_speed_kmh: not reached",
        ),
    ],
)
def test_drive_that_cannot_be_driven_names_the_segment(
    segments: str, problem: str
) -> None:
    with pytest.raises(ConfigError, match=problem):
        simulate(parse_drive(HEAD + segments, "f.toml"))


def test_repeats_unroll_with_their_places() -> None:
    text = (
        HEAD
        + "[[segment]]\nrepeat = 2\n"
        + "[[segment.segment]]\nspeed_kmh = 50.0\n"
        + "[[segment.segment]]\nspeed_kmh = 30.0\n"
        + "[[segment]]\nspeed_kmh = 0.0\n"
    )

    flat = list(parse_drive(text, "f.toml").flat())

    assert [place for place, _ in flat] == [
        "segment[1].segment[1]",
        "segment[1].segment[2]",
        "segment[1].segment[1]",
        "segment[1].segment[2]",
        "segment[2]",
    ]

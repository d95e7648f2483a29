"""The file that is proposed: complete, and honest about what is not known."""

import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest
from cantools.database.can import Database

from bstm_daemon.analysis.setup.proposal import propose
from bstm_daemon.analysis.setup.recording import Recording
from bstm_daemon.analysis.setup.writing import (
    bus_section,
    configuration_text,
    notes_of,
)
from bstm_daemon.config.heat import automatic_mode
from bstm_daemon.config.reading import draft_of
from bstm_daemon.errors import ConfigError

Maker = Callable[..., Database]


def text_of(database: Database, name: str = "car.dbc") -> str:
    folder = Path("/somewhere")
    dbc = folder / "dbc" / name
    source = bus_section(
        None, dbc=dbc, folder=folder / "config", strict=False, encoding="utf-8"
    )
    return configuration_text(
        propose(database, None), None, origin=dbc, source=source
    )


@pytest.mark.parametrize(
    ("signals", "mode", "assumed"),
    [
        (["SPEED m/s"], "fb", 0.0),
        (["SPEED m/s", "BrakePressure bar"], "ff", None),
        (["SPEED m/s", "BRAKE %"], "fb", 0.0),
        (["SPEED m/s", "WheelTorque Nm"], "fb", None),
        (["WS_FL rad/s", "BrakePressure bar"], "ff", None),
        (
            [
                "SPEED m/s",
                "BrakePressure bar",
                "WheelTorque Nm",
                "LongAccel m/s2",
            ],
            "fused",
            None,
        ),
    ],
)
def test_the_mode_follows_what_is_sure(
    make_database: Maker, signals: list[str], mode: str, assumed: float | None
) -> None:
    draft, problems = draft_of(tomllib.loads(text_of(make_database(signals))))

    assert problems == []
    assert draft.heat is not None
    assert draft.heat.mode == "auto"
    assert (
        automatic_mode(draft.heat, draft.corner, draft.signals.keys()) == mode
    )
    assert draft.heat.assume_powertrain_torque_nm == assumed


def test_names_are_quoted_and_paths_relative(make_database: Maker) -> None:
    table = tomllib.loads(
        text_of(make_database(["SPEED m/s"]), 'my "own" car\u00e9.dbc')
    )

    assert table["bus"][0]["dbc"] == '../dbc/my "own" car\u00e9.dbc'
    assert table["bus"][0]["strict"] is False
    assert table["vehicle"]["id"] == 'my "own" car\u00e9'


def test_an_unsure_role_becomes_active_by_removing_marks(
    make_database: Maker,
) -> None:
    text = text_of(make_database(["SPEED m/s", "BRAKE %"]))

    marked = "# [signals.primary_pressure]"
    assert marked in text
    start = text.index(marked)
    section = text[start : text.index("\n\n", start)].replace("# ", "")
    table = tomllib.loads(section)["signals"]["primary_pressure"]
    assert table == {"message": "M0", "signal": "BRAKE", "unit": "bar"}


def test_without_a_sure_speed_the_best_guess_is_marked(
    make_database: Maker, tmp_path: Path
) -> None:
    database = make_database(["SPEED m/s"])
    proposal = propose(database, Recording("can0", 1.0))
    assert proposal.sure == ()

    text = configuration_text(
        proposal, None, origin=tmp_path / "a.dbc", source=""
    )

    assert "UNSURE, check: its frame is not in the log" in text
    assert "vehicle_speed" in tomllib.loads(text)["signals"]


def test_without_any_speed_there_is_no_file(make_database: Maker) -> None:
    with pytest.raises(ConfigError, match="name and unit of a speed"):
        text_of(make_database(["BrakePressure bar"]))


def test_what_the_dbc_does_not_explain_is_said() -> None:
    recording = Recording(
        unknown=[f"{number:03X}" for number in range(30)],
        others={"can1": (40, 3)},
    )

    first, second = notes_of(recording)

    assert first.startswith("30 ids in the log are not in the DBC: 000, 001")
    assert first.endswith("017 and 6 more.")
    assert "can1 was left out: 3 of its 40 ids" in second

"""``bstm check`` prints what is overlooked in a DBC with strict = false."""

import json
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle

ROOT = Path(__file__).parents[2]
TOYOTA = ROOT / "config" / "toyota_rav4.toml"


def test_a_warning_names_bus_file_line_message_and_signals(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["check", str(TOYOTA)]) == 0

    (line,) = [
        line
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("warning: ")
    ]
    assert line.startswith("warning: [[bus]] powertrain ../dbc/third_party/")
    assert "line 245: message 'PCS_HUD': signals overlap: SET_ME_X10" in line


def test_the_json_has_the_warnings(tmp_path: Path) -> None:
    result = tmp_path / "result.json"

    assert main(["check", str(TOYOTA), "--json", str(result)]) == 0

    (warning,) = json.loads(result.read_text("utf-8"))["warnings"]
    assert "message 'PCS_HUD'" in warning


def test_two_messages_of_one_id_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The line has file, id and both names; loading logs it as well."""
    dbc = (ROOT / "dbc" / "example_vehicle.dbc").read_text("utf-8")
    (tmp_path / "car.dbc").write_text(f"{dbc}\nBO_ 416 Other: 8 ESC\n")
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    path = tmp_path / "car.toml"
    path.write_text(text.replace("../dbc/example_vehicle.dbc", "car.dbc"))

    assert main(["check", str(path)]) == 0

    printed = capsys.readouterr()
    (line,) = [
        line for line in printed.out.splitlines() if line.startswith("warning")
    ]
    assert line.startswith("warning: [[bus]] chassis car.dbc: line ")
    assert "'Other': has the id 0x1A0 of message 'WheelSpeeds'" in line
    assert not printed.err
    with capture_logs() as logged:
        load_vehicle(path)
    (entry,) = logged
    assert entry["log_level"] == "warning"
    assert (entry["bus"], entry["dbc"]) == ("chassis", "car.dbc")
    assert "has the id 0x1A0 of message 'WheelSpeeds'" in entry["defect"]


def test_a_dbc_without_defects_gives_none(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["check", str(ROOT / "config" / "example_vehicle.toml")]) == 0

    assert "warning" not in capsys.readouterr().out

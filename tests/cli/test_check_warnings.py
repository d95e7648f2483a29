"""``bstm check`` prints what is overlooked in a DBC with strict = false."""

import json
from pathlib import Path

import pytest

from bstm_daemon.cli.main import main

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


def test_a_dbc_without_defects_gives_none(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["check", str(ROOT / "config" / "example_vehicle.toml")]) == 0

    assert "warning" not in capsys.readouterr().out

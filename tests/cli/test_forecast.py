"""``bstm forecast``: a saved state told to a workshop."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.service import state_file

ROOT = Path(__file__).parents[2]
CAR = ROOT / "config" / "example_vehicle.toml"

pytestmark = pytest.mark.skipif(
    load_kernel() is None, reason="seconds a corner in pure Python"
)


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """Return the state of a car whose front brakes have just been hot."""
    engine = Engine(*load_vehicle(CAR), history_known=True)
    document = engine.export_state()
    for name in ("FL", "FR"):
        corner = document["corners"][name]
        corner |= {key: 600.0 for key in corner if key.startswith("pad_")}
        corner |= {"disc": 900.0, "fluid": 390.0, "backplate": 480.0}
    path = tmp_path / "car.state"
    document |= {"wall_us": 1_760_000_000_000_000}
    path.write_bytes(state_file.encode(document))
    return path


def test_what_a_workshop_reads(
    state: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Hot in front, cold behind; screen and JSON agree."""
    out = tmp_path / "forecast.json"
    before = state.read_bytes()

    code = main(
        ["forecast", "--now", str(state), "-c", str(CAR), "--json", str(out)]
    )

    assert code == 0
    assert state.read_bytes() == before
    lines = capsys.readouterr().out.splitlines()
    assert "history known" in lines[1]
    assert "not a safety function" in lines[-2]
    found = json.loads(out.read_text("utf-8"))
    front, rear = found["corners"]["FL"], found["corners"]["RL"]
    assert front["peak_c"] > front["fluid_c"]
    assert front["risk"] >= front["risk_now"]
    assert front["risk"] > rear["risk"] == 0.0
    assert rear["level"] == "normal"
    assert rear["safe_in_s"] == 0.0
    row = next(line for line in lines if line.startswith("FL"))
    assert f"{front['peak_c']:.0f}" in row
    assert front["level"] in row


def test_a_state_that_is_not_there(tmp_path: Path) -> None:
    code = main(
        ["forecast", "--now", str(tmp_path / "no.state"), "-c", str(CAR)]
    )

    assert code == 74


def test_a_state_of_another_car(
    state: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = state_file.read(state).document
    assert document is not None
    state.write_bytes(state_file.encode(document | {"vehicle_id": "another"}))

    assert main(["forecast", "--now", str(state), "-c", str(CAR)]) == 2
    assert "another" in capsys.readouterr().err


def test_the_state_is_never_overwritten(state: Path) -> None:
    before = state.read_bytes()

    code = main(
        [
            *("forecast", "--now", str(state), "-c", str(CAR)),
            *("--json", str(state)),
        ]
    )

    assert code == 2
    assert state.read_bytes() == before

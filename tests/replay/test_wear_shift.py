"""How far worn linings move a replay, and the line that says so."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle, read_state
from bstm_daemon.config.estimates import WearConfig
from bstm_daemon.replay.columns import stream_log
from bstm_daemon.replay.results import Collector

if TYPE_CHECKING:
    from bstm_daemon.replay.columns import Run
    from bstm_daemon.replay.results import Results

GOLDEN = Path(__file__).parents[1] / "golden"
LOG = GOLDEN / "logs" / "circuits.log.gz"
CAR = GOLDEN / "circuits.toml"
NODES = ("disc", "pad_front", "pad_back", "fluid")


def replayed(
    car: str = "circuits", log: str = "circuits", **wear: float
) -> tuple[Run, Results]:
    """Replay a golden log, from the state beside it where there is one."""
    config, signal_map = load_vehicle(GOLDEN / f"{car}.toml")
    changed = config.wear.model_copy(update=wear)
    saved = GOLDEN / "logs" / f"{log}.state"
    rows = Collector()
    run = stream_log(
        config.model_copy(update={"wear": changed}),
        signal_map,
        GOLDEN / "logs" / f"{log}.log.gz",
        [rows],
        state=read_state(saved, "--state") if saved.exists() else "cold",
        forecast=False,
    )
    return run, rows.results()


@pytest.mark.parametrize(
    ("car", "log"), [("circuits", "circuits"), ("alpine", "restart")]
)
def test_the_largest_difference_and_its_place(car: str, log: str) -> None:
    """That of two replays, of all published nodes at all times."""
    run, worn = replayed(car, log, model_follows=True, pad_wear_m3_j=1e-10)
    _, still = replayed(car, log, model_follows=False, pad_wear_m3_j=1e-10)

    shift = run.wear_shift
    assert shift is not None
    moved = {
        (corner, node): worn.columns[f"{corner}.{node}_c"]
        - still.columns[f"{corner}.{node}_c"]
        for corner in worn.modelled
        for node in NODES
    }
    most = max(np.abs(column).max() for column in moved.values())
    own = moved[shift.corner, shift.node]
    row = int(np.abs(own).argmax())
    assert most > 3.0
    assert abs(shift.kelvin) == pytest.approx(most, abs=1e-9)
    assert shift.kelvin == pytest.approx(own[row], abs=1e-9)
    at_s = worn.columns["time_s"][row]
    assert shift.time_us * 1e-6 == pytest.approx(at_s)


def test_by_default_the_model_is_that_of_the_configured_linings() -> None:
    """Whatever the linings wear, no temperature moves; wear is estimated."""
    default = WearConfig().model_follows
    run, worn = replayed(model_follows=default)
    _, none = replayed(
        model_follows=default, pad_wear_m3_j=1e-20, disc_wear_m3_j=0.0
    )

    assert run.wear_shift is None
    one, other = worn.columns, none.columns
    for name in one:
        if "thickness" not in name and "disc_loss" not in name:
            assert one[name].tobytes() == other[name].tobytes(), name
    thickness_m = one["FL.pad_thickness_m"]
    assert thickness_m[0] - thickness_m[-1] > 5e-4
    assert one["FL.disc_loss_m"][-1] > 5e-5


def test_wear_that_is_not_noticed_moves_nothing() -> None:
    run, _ = replayed(
        "stops", "stops", model_follows=True, pad_wear_m3_j=1e-20
    )

    assert run.wear_shift is not None
    assert run.wear_shift.kelvin == 0.0


@pytest.mark.parametrize(("follows", "lines"), [("true", 1), ("false", 0)])
def test_the_summary_says_that_wear_moved_it(
    follows: str,
    lines: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In one line, on the screen and on the page."""
    text = CAR.read_text(encoding="utf-8")
    for name in ("../../dbc/example_vehicle.dbc", "bus.dbc"):
        text = text.replace(f'"{name}"', f'"{GOLDEN / name}"')
    followed = "model_follows = true"
    assert followed in text
    text = text.replace(followed, f"model_follows = {follows}")
    car, page = tmp_path / "car.toml", tmp_path / "page.html"
    car.write_text(text, encoding="utf-8")

    code = main(["replay", str(LOG), "-c", str(car), "--report", str(page)])

    out = capsys.readouterr().out
    assert code == 0
    assert out.count("wear moved the estimate by up to") == lines
    assert page.read_text().count("wear moved the estimate by") == lines

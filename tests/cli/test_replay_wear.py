"""Wear that the thermal model follows, and the line that says so."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.estimates import WearConfig
from bstm_daemon.report.timescale import clock
from tests.replayed import replay_log

if TYPE_CHECKING:
    from bstm_daemon.replay.results import Results

GOLDEN = Path(__file__).parents[1] / "golden"
CAR = GOLDEN / "circuits.toml"
LOG = GOLDEN / "logs" / "circuits.log.gz"
NODES = ("disc", "pad_front", "pad_back", "fluid")


def replayed(**wear: float) -> Results:
    """Replay linings that wear fifty times too fast."""
    config, signal_map = load_vehicle(CAR)
    changed = config.model_copy(
        update={"wear": config.wear.model_copy(update=wear)}
    )
    return replay_log(changed, signal_map, LOG, forecast=False).results


def test_by_default_the_model_is_that_of_the_configured_linings() -> None:
    """Whatever the linings wear, no temperature moves; wear is estimated."""
    default = WearConfig().model_follows
    worn = replayed(model_follows=default)
    none = replayed(
        model_follows=default, pad_wear_m3_j=1e-20, disc_wear_m3_j=0.0
    )

    one, other = worn.columns, none.columns
    for name in one:
        if "thickness" not in name and "disc_loss" not in name:
            assert one[name].tobytes() == other[name].tobytes(), name
    thickness_m = one["FL.pad_thickness_m"]
    assert thickness_m[0] - thickness_m[-1] > 5e-4
    assert one["FL.disc_loss_m"][-1] > 5e-5


@pytest.mark.slow
def test_the_summary_says_by_how_much_wear_moved_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The largest difference of two replays, on the screen and the page."""
    worn, still = replayed(), replayed(model_follows=False)
    page = tmp_path / "page.html"

    assert (
        main([*("replay", str(LOG), "-c", str(CAR)), "--report", str(page)])
        == 0
    )

    said = re.findall(
        r"wear moved the estimate by up to (\S+) K \((\w+) (\w+), ([\d:]+)",
        capsys.readouterr().out,
    )
    moved_k = {
        (node, corner): worn.columns[f"{corner}.{node}_c"]
        - still.columns[f"{corner}.{node}_c"]
        for corner in worn.modelled
        for node in NODES
    }
    where = max(moved_k, key=lambda place: np.abs(moved_k[place]).max())
    row = int(np.abs(moved_k[where]).argmax())
    time_s = worn.columns["time_s"]
    assert abs(moved_k[where][row]) > 5.0
    assert said == [
        (
            f"{moved_k[where][row]:+.0f}",
            *where,
            clock(time_s[row] - time_s[0]),
        )
    ]
    assert page.read_text("utf-8").count("wear moved the estimate by up") == 1


@pytest.mark.parametrize(
    ("key", "value"),
    [("model_follows", "false"), ("pad_wear_m3_j", "1e-20")],
)
def test_no_line_where_wear_moved_nothing(
    key: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It is not followed, or there is none."""
    text = (GOLDEN / "stops.toml").read_text("utf-8")
    dbc = "../../dbc/example_vehicle.dbc"
    wear = {"model_follows": "true", "pad_wear_m3_j": "2e-11", key: value}
    lines = [f"{name} = {number}" for name, number in wear.items()]
    text = re.sub(r"(?m)^pad_wear_m3_j = .*$", "\n".join(lines), text)
    car = tmp_path / "car.toml"
    car.write_text(text.replace(dbc, str(GOLDEN / dbc)), "utf-8")

    assert "model_follows" in text
    log = GOLDEN / "logs" / "stops.log.gz"
    assert main(["replay", str(log), "-c", str(car), "--start", "cold"]) == 0

    out = capsys.readouterr().out
    assert "pad front" in out
    assert "wear moved" not in out

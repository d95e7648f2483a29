"""What ``init`` makes of every recording with a DBC, without a hand edit."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.reading import load_config
from tests.replayed import replay_log

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config

REAL = os.environ.get("BSTM_REAL_DATA")

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        not REAL, reason="BSTM_REAL_DATA names no folder of recordings"
    ),
]

SUBARU_DBC = "subaru-wrx-sti-candump/sample_can_spec.dbc"
WHEELS = {f"wheel_speed_{corner}" for corner in ("fl", "fr", "rl", "rr")}
ENGINE = {"engine_speed", "gear", "clutch_open"}
BENDS = {"acceleration_lateral", "yaw_rate"}
SPEED = "vehicle_speed"
LONG = "acceleration_longitudinal"

RECORDED = {
    "subaru": (
        SUBARU_DBC,
        "subaru-wrx-sti-candump/*.log",
        {*WHEELS, *ENGINE, *BENDS, SPEED, LONG, "primary_pressure"},
        {"park_brake"},
    ),
    "gt86": (
        SUBARU_DBC,
        "gt86-on-stand-candump/*.log",
        {*WHEELS, *ENGINE, *BENDS, SPEED, LONG},
        {"primary_pressure", "park_brake"},
    ),
    "toyota": (
        "toyota-rav4-comma2k19/toyota_new_mc_pt_generated.dbc",
        "toyota-rav4-comma2k19/*.log",
        {*WHEELS, *BENDS, SPEED, LONG, "engine_speed", "engine_torque"},
        {"primary_pressure", "brake_switch", "park_brake", "gear"},
    ),
    "uwfe": (
        "uwfe-fsae-ev-can/2024CAR.dbc",
        "uwfe-fsae-ev-can/*.log",
        {"wheel_speed_rl", "wheel_speed_rr", "primary_pressure"},
        {"wheel_speed_fl", "wheel_speed_fr", "motor_torque"},
    ),
    "canedge": (
        "canedge-obd-gnss-mf4/canmod-gps.dbc",
        "canedge-obd-gnss-mf4/*.MF4",
        {SPEED, LONG, "pitch", "altitude"},
        set(),
    ),
}
"""DBC, logs, the roles that are sure, and some that are not."""

NAMED = {
    "Model3CAN": ("brake_switch", "VCLEFT_brakeSwitchPressed"),
    "ford_fusion_2018_pt": (LONG, "VehLong_A_Actl"),
    "hyundai_kia_generic": ("engine_speed", "Cluster_Engine_RPM"),
    "tesla_model3_party": (SPEED, "ESP_vehicleSpeed"),
    "vw_mqb": ("primary_pressure", "ESP_Bremsdruck"),
    "vw_pq": ("engine_speed", "Motordrehzahl"),
}
"""A signal that is right by name and unit alone."""


def proposed(out: Path, dbc: str, *logs: Path) -> Config:
    """Return what init writes to *out* for *dbc* and *logs*."""
    listed = [word for log in logs for word in ("--log", str(log))]
    path = Path(str(REAL)) / dbc
    assert main(["init", "--dbc", str(path), *listed, "-o", str(out)]) == 0
    return load_config(out)


@pytest.mark.parametrize("name", RECORDED)
def test_roles_of_a_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """And check and replay run with the file, without a map."""
    dbc, pattern, sure, unsure = RECORDED[name]
    logs = sorted(Path(str(REAL)).glob(pattern))
    if name == "canedge":
        pytest.importorskip("asammdf")
    out = tmp_path / "car.toml"

    config = proposed(out, dbc, *logs)

    assert set(config.signals) == sure
    text = out.read_text("utf-8")
    assert all(f"# [signals.{role}]" in text for role in unsure)
    capsys.readouterr()
    for log in logs:
        # on a stand the wheels do not show the car's motion
        code = main(["check", str(out), "--log", str(log)])
        assert code == int(name == "gt86")
        said = capsys.readouterr().out
        assert "\nBAD" not in said
        assert ("stand or roller?" in said) == (name == "gt86")
        # what init is sure of, check finds too
        assert "track" in said or "right minus left" not in text
        words = ["replay", str(log), "-c", str(out), "--no-forecast"]
        assert main(words) == 0
        if name == "gt86":
            loaded, signal_map = load_vehicle(out)
            found = replay_log(loaded, signal_map, log, forecast=False)
            disc_c = found.results.columns["FL.disc_c"]
            assert np.ptp(disc_c) < 1.0  # it was 85 K


def test_the_axes_of_a_rotated_module(tmp_path: Path) -> None:
    """Gravity lies on X; -Y is the longitudinal axis (README)."""
    pytest.importorskip("asammdf")
    dbc, pattern, *_ = RECORDED["canedge"]
    (log,) = Path(str(REAL)).glob(pattern)

    one = proposed(tmp_path / "car.toml", dbc, log).signals[LONG]

    assert (one.signal, one.sign) == ("AccelerationY", -1)


@pytest.mark.parametrize("name", NAMED)
def test_roles_by_names_alone(tmp_path: Path, name: str) -> None:
    """No selector is the gear, no flag of a parking brake is the brake."""
    role, signal = NAMED[name]

    config = proposed(tmp_path / "car.toml", f"dbc-in-the-wild/{name}.dbc")

    assert config.signals[role].signal == signal
    assert "park_brake" not in config.signals
    assert "clutch_open" not in config.signals
    assert ("gear" in config.signals) == (name == "vw_mqb")

"""Public DBC files of seven cars, each with a small configuration on it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from bstm_daemon.cli.main import main

REAL = os.environ.get("BSTM_REAL_DATA")

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        not REAL, reason="BSTM_REAL_DATA names no folder of recordings"
    ),
]

WILD = {
    "Model3CAN": ("ID175WheelSpeed.WheelSpeedFL175", "km/h", True),
    "ford_fusion_2018_pt": ("WheelSpeed_CG1.WhlFl_W_Meas", "rad/s", False),
    "hyundai_kia_generic": ("WHL_SPD11.WHL_SPD_FL", "km/h", True),
    "tesla_model3_party": ("ESP_B.ESP_vehicleSpeed", "km/h", False),
    "volvo_v60_2015_pt": ("VehicleSpeed1.VehicleSpeed", "km/h", False),
    "vw_mqb": ("ESP_19.ESP_VL_Radgeschw_02", "km/h", True),
    "vw_pq": ("Bremse_3.Radgeschw__VL_4_1", "km/h", True),
}
"""A speed of each, its unit, and whether the file has defects."""

WILD_CAR = """
[vehicle]
id = "wild"
mass_kg = 1600.0
wheel_radius_m = 0.32
[[bus]]
name = "car"
dbc = "{dbc}"
strict = {strict}
[signals.wheel_speed_fl]
message = "{message}"
signal = "{signal}"
unit = "{unit}"
[heat]
mode = "fb"
assume_powertrain_torque_nm = 0.0
[[corner]]
name = "FL"
piston_area_m2 = 2.5e-3
effective_radius_m = 0.12
disc = {{mass_kg = 6.0, swept_area_m2 = 0.08, total_area_m2 = 0.13}}
pad = {{area_m2 = 5.8e-3, thickness_m = 0.011}}
"""


@pytest.mark.parametrize("name", WILD)
def test_a_configuration_on_a_public_dbc_passes_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """All seven load without strict; the defective ones say so or refuse."""
    source, unit, has_defects = WILD[name]
    message, signal = source.split(".")
    dbc = Path(str(REAL)) / "dbc-in-the-wild" / f"{name}.dbc"
    codes, warned = {}, {}
    for strict in ("false", "true"):
        path = tmp_path / f"{strict}.toml"
        path.write_text(
            WILD_CAR.format(
                dbc=dbc.as_posix(),
                strict=strict,
                message=message,
                signal=signal,
                unit=unit,
            ),
            encoding="utf-8",
        )
        codes[strict] = main(["check", str(path)])
        warned[strict] = "warning: " in capsys.readouterr().out

    assert codes == {"false": 0, "true": 78 if has_defects else 0}
    assert warned == {"false": has_defects, "true": False}

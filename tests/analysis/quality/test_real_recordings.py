"""Real recordings with known faults (BSTM_REAL_DATA)."""

import os
from pathlib import Path

import pytest

from bstm_daemon.analysis.quality.finding import Quality
from bstm_daemon.analysis.quality.judge import judge
from bstm_daemon.analysis.quality.recording import read_recording
from bstm_daemon.bus.signals.signal_map import compile_signal_map
from bstm_daemon.config.reading import load_config

REAL = os.environ.get("BSTM_REAL_DATA")
ROOT = Path(__file__).parents[3]
SUBARU = ROOT / "config" / "subaru_wrx_sti.toml"
TOYOTA = ROOT / "config" / "toyota_rav4.toml"
SUBARU_LOG = "subaru-wrx-sti-candump/can_sample.log"
TOYOTA_LOG = "toyota-rav4-comma2k19/rav4_bus0_bus1.converted.candump.log"
STAND_LOG = "gt86-on-stand-candump/vsslog.log"
UWFE = "uwfe-fsae-ev-can"

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        REAL is None, reason="BSTM_REAL_DATA names no folder of recordings"
    ),
]

ACCELERATION = "acceleration_longitudinal"


def quality_of(config: Path, log: str, base: Path | None = None) -> Quality:
    loaded = load_config(config)
    plan = compile_signal_map(
        loaded.bus,
        loaded.signals,
        base or config.parent,
        loaded.vehicle.wheel_radius_m,
    )
    overrides = {"can1": ""} if log == TOYOTA_LOG else {}
    path = Path(str(REAL)) / log
    return judge(read_recording([path], plan, overrides), loaded, plan)


def edited(config: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    """Write *config* with each (old, new) replaced into *folder*."""
    text = config.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / config.name
    path.write_text(text, encoding="utf-8")
    return path


def wrong(quality: Quality) -> set[tuple[str, str]]:
    return {
        (finding.fault, role)
        for finding in quality.findings
        if finding.wrong
        for role in finding.roles
    }


def test_subaru_as_its_dbc_says(tmp_path: Path) -> None:
    """The DBC's +0.15 m/s2 a count is wrong in sign and scale."""
    raw = edited(SUBARU, tmp_path, ("scale = 0.6667\nsign = -1\n", ""))

    quality = quality_of(raw, SUBARU_LOG, SUBARU.parent)

    assert wrong(quality) == {("sign", ACCELERATION), ("scale", ACCELERATION)}
    (fit,) = [
        one.fit
        for one in quality.comparisons
        if one.title == "accelerometer against dv/dt"
    ]
    assert fit is not None
    assert fit.scale == pytest.approx(-1.5, abs=0.1)
    usable = {mode.mode: mode.usable for mode in quality.modes}
    assert usable["ff"]
    assert not usable["fb"]


def test_subaru_as_configured() -> None:
    quality = quality_of(SUBARU, SUBARU_LOG)

    assert wrong(quality) == set()
    assert quality.usable
    wheels = [
        one
        for one in quality.comparisons
        if one.reference_name == "vehicle_speed"
        and one.channel_name.startswith("wheel")
    ]
    assert len(wheels) == 4
    for one in wheels:
        assert one.fit is not None
        assert one.fit.scale == pytest.approx(1.0, abs=0.005)
    # it brakes while creeping only
    assert any(
        text.startswith("primary_pressure against deceleration")
        for text in quality.not_judged
    )


def test_toyota_sign(tmp_path: Path) -> None:
    raw = edited(TOYOTA, tmp_path, ('"m/s2"\nsign = -1\n', '"m/s2"\n'))

    turned = quality_of(raw, TOYOTA_LOG, TOYOTA.parent)
    shipped = quality_of(TOYOTA, TOYOTA_LOG)

    assert wrong(turned) == {("sign", ACCELERATION)}
    assert not turned.usable
    assert wrong(shipped) == set()
    assert shipped.usable


def test_car_on_a_stand() -> None:
    """Numbers only: rear wheels turn, front ones stand, nothing is felt."""
    quality = quality_of(SUBARU, STAND_LOG)

    assert wrong(quality) == set()
    (finding,) = [f for f in quality.findings if f.fault != "missing"]
    assert finding.fault == "axles-disagree"
    assert finding.roles == ("wheel_speed_fl", "wheel_speed_fr")
    assert finding.text.startswith("axles disagree: stand or roller?")
    (back,) = [mode for mode in quality.modes if mode.mode == "fb"]
    assert any("axles disagree" in text for text in back.problems)


CORNER = """
[[corner]]
name = "{name}"
circuit = "{circuit}"
piston_area_m2 = 8e-4
piston_count = 2
effective_radius_m = 0.08
disc.mass_kg = 1.0
disc.swept_area_m2 = 0.02
disc.total_area_m2 = 0.04
pad.area_m2 = 1.5e-3
pad.thickness_m = 0.008
"""

SIGNAL = """
[signals.{role}]
message = "{message}"
signal = "{signal}"
unit = "{unit}"
"""


@pytest.fixture
def uwfe(tmp_path: Path) -> Path:
    """Return a configuration of the formula car and its DBC, mended.

    The DBC has value tables of unknown messages, and frames on the bus have
    8 bytes where it says 6 and 5.
    """
    dbc = Path(str(REAL)) / UWFE / "2024CAR.dbc"
    lines = dbc.read_text(encoding="cp1252", errors="replace").splitlines()
    text = "\n".join(line for line in lines if not line.startswith("VAL_"))
    for old, new in (
        ("VCU_Data: 6", "VCU_Data: 8"),
        ("WSBFL_BrakeTemp: 5", "WSBFL_BrakeTemp: 8"),
    ):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "car.dbc").write_text(text, encoding="cp1252")
    sources = [
        (f"wheel_speed_{c.lower()}", "WheelSpeedKPH", f"{c}SpeedKPH", "km/h")
        for c in ("FL", "FR", "RL", "RR")
    ]
    sources += [
        ("primary_pressure", "VCU_Data", "FrontBrakePressure", "psi"),
        (
            "secondary_pressure",
            "WSBFL_BrakePressure",
            "RearBrakePressure",
            "psi",
        ),
        ("temp_fl_disc", "WSBFL_BrakeTemp", "BrakeTempFront", "degC"),
    ]
    path = tmp_path / "car.toml"
    path.write_text(
        '[vehicle]\nid = "formula"\nmass_kg = 300.0\nwheel_radius_m = 0.23\n'
        '[[bus]]\nname = "car"\ndbc = "car.dbc"\nstrict = false\n'
        + "".join(
            SIGNAL.format(role=r, message=m, signal=s, unit=u)
            for r, m, s, u in sources
        )
        + "".join(
            CORNER.format(
                name=c, circuit="primary" if c[0] == "F" else "secondary"
            )
            for c in ("FL", "FR", "RL", "RR")
        ),
        encoding="utf-8",
    )
    return path


def test_uwfe_faults(uwfe: Path) -> None:
    """Front wheels dead, rear ones frozen, a temperature that is none."""
    log = f"{UWFE}/NewMotor_LOGS91_LOGS0.converted.candump.log"

    quality = quality_of(uwfe, log)

    found = wrong(quality)
    assert found - {("offset", "primary_pressure")} == {
        ("dead", "wheel_speed_fl"),
        ("dead", "wheel_speed_fr"),
        ("frozen", "wheel_speed_rl"),
        ("frozen", "wheel_speed_rr"),
        ("mis-wired", "temp_fl_disc"),
    }
    texts = {f.roles[0]: f.text for f in quality.findings}
    assert "107.96 km/h from 79.9 s" in texts["wheel_speed_rl"]
    assert "secondary_pressure (r = 0.9999" in texts["temp_fl_disc"]
    assert not any(mode.usable for mode in quality.modes)
    pressures = [
        one
        for one in quality.comparisons
        if one.title == "secondary_pressure against primary_pressure"
    ]
    assert [one.agrees for one in pressures] == [True]

"""``bstm gap`` on recordings of others; docs/real-data.md has the figures."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from bstm_daemon.analysis.gap.heat_only import find_force_gap
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.gap.workflow import find_gap
from bstm_daemon.cli.vehicle import load_vehicle

ROOT = Path(__file__).parents[2]
DATA = os.environ.get("BSTM_REAL_DATA")
TOYOTA = Path(
    DATA or ".",
    "toyota-rav4-comma2k19/rav4_bus0_bus1.converted.candump.log",
)
F1 = Path(DATA or ".", "f1-five-channel")

FLAT = """
[cooling]
speed_ms = [0.0, 10.0, 50.0, 100.0]
s_per_s = [0.045, 0.045, 0.045, 0.045]
form = "conductance"

[accuracy]
disc_k = 6.0
disc_share = 0.04
"""
"""One coefficient for all speeds: that of Spain, fitted by hand."""

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        DATA is None or not TOYOTA.exists() or not F1.exists(),
        reason="BSTM_REAL_DATA does not name the folder of the recordings",
    ),
]


def test_toyota_brakes_without_pressure() -> None:
    config, signal_map = load_vehicle(ROOT / "config" / "toyota_rav4.toml")
    recording = read_recording(TOYOTA, config, signal_map, {"can1": ""})

    found = find_force_gap(config, [recording])

    assert found.naming.names == ("brake_without_pressure",)
    assert found.naming.probability > 0.99
    assert found.strengths["brake_without_pressure"] == pytest.approx(
        1.0, abs=0.25
    )
    assert found.pressed_j == 0.0
    assert found.after_ms2 < 0.3 * found.before_ms2
    assert "friction_fade" in found.unseen


@pytest.mark.slow
def test_f1_discs_are_cooled_by_the_wind(tmp_path: Path) -> None:
    """With a constant coefficient both tracks ask for the same effect.

    One leaves a band of speed beside it.
    """
    text = (ROOT / "tests" / "real" / "f1.toml").read_text("utf-8")
    text = text.replace("disc.mass_kg = 1.5", "disc.mass_kg = 1.36")
    car = tmp_path / "f1.toml"
    car.write_text(text + FLAT, encoding="utf-8")
    config, signal_map = load_vehicle(car)
    spain, hungary = (
        read_recording(F1 / f"{name}.converted.csv", config, signal_map)
        for name in ("Spain", "Hungary")
    )

    wind, band = "speed_dependent_convection", "cooling_band"
    for recording, answer, names in (
        (spain, "undecided", (wind, band)),
        (hungary, "name", (wind,)),
    ):
        (found,) = find_gap(config, [recording], until="name")
        naming = found.naming

        assert naming is not None
        assert naming.answer == answer
        assert naming.names == names
        assert [one.name for one in naming.candidates[:2]] == [wind, band]
        assert naming.candidates[0].strength == pytest.approx(1.0, abs=0.3)
        evidence = [one.log_evidence for one in naming.candidates[:3]]
        assert evidence[0] > evidence[1] + 1.0
        assert evidence[1] > evidence[2] + 1.0

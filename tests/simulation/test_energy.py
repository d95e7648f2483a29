"""The ledger of a whole drive, term by term."""

import pytest

from bstm_daemon.simulation import (
    SimulatedDrive,
    parse_drive,
    simulate,
)
from bstm_daemon.units import GRAVITY_MS2

from ..drive_ledger import EnergyLedger, energy_ledger  # noqa: TID252  (no package)

HEAD = '[drive]\nname = "d"\ndescription = "x"\n'


def ledger(segments: str) -> EnergyLedger:
    """Return the ledger of a drive of *segments*."""
    return energy_ledger(simulate(parse_drive(HEAD + segments, "f.toml")))


def test_height_becomes_heat() -> None:
    got = ledger(
        "[[segment]]\nspeed_kmh = 36.0\n"
        "[[segment]]\nspeed_kmh = 36.0\ndistance_m = 1000.0\n"
        "grade_percent = -10.0\n"
        "[[segment]]\nspeed_kmh = 0.0\nrate_ms2 = 2.0\n"
    )

    # 1000 m along the road at 10 %
    assert got.potential == pytest.approx(
        2194.0 * GRAVITY_MS2 * 99.5, rel=0.005
    )
    assert 0.7 < got.brakes / got.potential < 0.95
    assert got.push == 0.0
    assert abs(got.residual) < 1e-5


def test_push_is_booked_as_push(simalp: SimulatedDrive) -> None:
    got = energy_ledger(simalp)

    # 2.13 kN over 15 km
    assert got.push == pytest.approx(2130.0 * 15e3, rel=0.01)
    assert got.engine == got.engine_drag == got.regeneration == 0.0
    assert abs(got.residual) < 1e-5


def test_slip_heats_tyres_and_spin_comes_from_the_engine() -> None:
    segment = (
        "[[segment]]\nspeed_kmh = 72.0\n"
        "[[segment]]\nspeed_kmh = 72.0\nduration_s = 20.0\n"
        "corner_pressure_bar = [20.0, 0.0, 0.0, 0.0]\nslip = [{}, 0, 0, 0]\n"
    )
    held, slipping, spinning = (
        ledger(segment.format(slip)) for slip in (0.0, 0.2, -0.5)
    )

    assert held.tyres == 0.0
    assert slipping.tyres == pytest.approx(0.2 * held.brakes)
    assert slipping.brakes == pytest.approx(0.8 * held.brakes)
    assert spinning.brakes == pytest.approx(1.5 * held.brakes)
    assert spinning.engine - held.engine == pytest.approx(0.5 * held.brakes)
    for got in (held, slipping, spinning):
        assert abs(got.residual) < 1e-4


def test_residual_shows_what_is_missing() -> None:
    closed = EnergyLedger(100.0, 0, 0, 0, 80.0, 20.0, 0, 0, 0)
    leaking = EnergyLedger(100.0, 0, 0, 0, 80.0, 15.0, 0, 0, 0)

    assert closed.residual == 0.0
    assert leaking.residual == pytest.approx(0.05)

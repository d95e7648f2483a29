"""Units: the figures themselves, and that each has one quantity."""

from math import isfinite, pi

import pytest

from bstm_daemon.units import UNITS, to_celsius, unit_named


@pytest.mark.parametrize(
    ("unit", "value", "si"),
    [
        ("km/h", 36.0, 10.0),
        ("mph", 60.0, 26.8224),
        ("rpm", 60.0, 2 * pi),
        ("deg/s", 180.0, pi),
        ("bar", 1.0, 1e5),
        ("MPa", 0.75, 7.5e5),
        # one pound-force (4.4482216152605 N) a square inch (25.4 mm)
        ("psi", 1.0, 4.4482216152605 / 0.0254**2),
        ("g", 1.0, 9.80665),
        ("degC", -273.15, 0.0),
        ("degC", 100.0, 373.15),
        ("degF", 212.0, 373.15),
        ("degF", -40.0, 233.15),
        ("deg", 90.0, pi / 2),
        ("ft", 100.0, 30.48),
        ("%", 12.0, 0.12),
        ("kNm", 1.5, 1500.0),
        ("bool", 1.0, 1.0),
    ],
)
def test_value_in_si(unit: str, value: float, si: float) -> None:
    """A known value in each kind of unit has its known SI value."""
    found = UNITS[unit]

    assert found.factor * value + found.offset == pytest.approx(si)


def test_every_unit_is_a_usable_map() -> None:
    """No unit maps everything to one value or to infinity."""
    assert all(
        unit.factor > 0 and isfinite(unit.factor) and isfinite(unit.offset)
        for unit in UNITS.values()
    )


def test_every_quantity_has_its_si_unit() -> None:
    """Each quantity can be given in SI, so nothing needs a detour."""
    quantities = {unit.quantity for unit in UNITS.values()}
    si = {
        unit.quantity
        for unit in UNITS.values()
        if (unit.factor, unit.offset) == (1.0, 0.0)
    }

    assert quantities == si


def test_to_celsius() -> None:
    """Kelvin to degrees Celsius is the way back of the unit degC."""
    celsius = UNITS["degC"]

    assert to_celsius(celsius.factor * 155.0 + celsius.offset) == (
        pytest.approx(155.0)
    )


@pytest.mark.parametrize(
    ("unit", "texts"),
    [
        ("m/s2", "m/s2; m/s^2; m/s²; m/s/s; m/s**2; m/(s^2); m s-2; M/S^2"),
        ("m/s2", "meters per second squared; Unit_MeterPerSeconSquar; mps2"),
        ("Nm", "Nm; N*m; N.m; N-m; N·m; newton meters; torque:N.m"),
        ("degC", "deg C; °C; degC; C; degrees Celsius; Unit_DegreCelsi"),
        ("km/h", "km/h; kph; kmh; KPH; km/hr; Unit_KiloMeterPerHour"),
        ("mph", "MPH; mph; miles per hour; mi/h"),
        ("rpm", "rpm; 1/min; U/min; min-1; rev/min; revolutions per minute"),
        ("rad/s", "rad/s; radians/second; rad/sec; rads"),
        ("deg/s", "°/s; deg/sec; degrees per second; degps"),
        ("%", "%; percent; Prozent"),
        ("", "; -; s; ms; V; hPa; furlong; l/h; SED"),
    ],
)
def test_spellings_of_a_unit(unit: str, texts: str) -> None:
    assert {unit_named(text.strip()) for text in texts.split(";")} == {unit}

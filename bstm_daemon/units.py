"""SI inside, other units at the edges.

A unit is a linear map ``si = factor * value + offset``. Each belongs to one
quantity, so that a pressure given in ``km/h`` is refused when the
configuration is loaded, not noticed when a brake is cold.
"""

from dataclasses import dataclass
from math import pi
from typing import Final

KELVIN_OFFSET: Final = 273.15
"""0 degC in kelvin."""

GRAVITY_MS2: Final = 9.80665
"""Standard gravity (CGPM 1901)."""

STEFAN_BOLTZMANN_W_M2K4: Final = 5.670374419e-8
"""Stefan-Boltzmann constant (CODATA 2018)."""

AIR_DENSITY_KG_M3: Final = 1.2041
"""Dry air at 20 degC and 101 325 Pa (ISO 2533 formula)."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: its quantity and the linear map to SI."""

    quantity: str
    factor: float
    offset: float = 0.0


UNITS: Final[dict[str, Unit]] = {
    "m/s": Unit("speed", 1.0),
    "km/h": Unit("speed", 1 / 3.6),
    "mph": Unit("speed", 0.44704),
    "kn": Unit("speed", 1852 / 3600),
    "rad/s": Unit("angular_speed", 1.0),
    "deg/s": Unit("angular_speed", pi / 180),
    "rpm": Unit("angular_speed", pi / 30),
    "Pa": Unit("pressure", 1.0),
    "kPa": Unit("pressure", 1e3),
    "MPa": Unit("pressure", 1e6),
    "bar": Unit("pressure", 1e5),
    "psi": Unit("pressure", 6894.757293168361),
    "m/s2": Unit("acceleration", 1.0),
    "g": Unit("acceleration", GRAVITY_MS2),
    "Nm": Unit("torque", 1.0),
    "kNm": Unit("torque", 1e3),
    "N": Unit("force", 1.0),
    "kN": Unit("force", 1e3),
    "K": Unit("temperature", 1.0),
    "degC": Unit("temperature", 1.0, KELVIN_OFFSET),
    "degF": Unit("temperature", 5 / 9, KELVIN_OFFSET - 32 * 5 / 9),
    "rad": Unit("angle", 1.0),
    "deg": Unit("angle", pi / 180),
    "m": Unit("length", 1.0),
    "km": Unit("length", 1e3),
    "ft": Unit("length", 0.3048),
    "%": Unit("fraction", 0.01),
    "1": Unit("fraction", 1.0),
    "bool": Unit("flag", 1.0),
    "count": Unit("count", 1.0),
}
"""Every unit a configuration may name."""

_TEXTS: Final = {
    "km/h": "kmh kph kmph kilometerproh kilometerperhour kilometerperhou",
    "m/s": "mps meterpersecond",
    "kn": "knot knots kt kts",
    "m/s2": "meterpersquaresecond meterpersecondsquare meterperseconsquar "
    "m/s^2 m/s² m/s/s m/s**2 m/(s^2) mps2",
    "deg/s": "degreofarcpersecon degreepersecond °/s deg/sec degree/s degps",
    "rpm": "1/min u/min min-1 rev/min",
    "rad/s": "rads/s rad/sec rads",
    "Nm": "n·m n*m newtonmeter",
    "degC": "c °c celsius degrecelsi",
    "degF": "f °f",
    "%": "percent pct prozent",
    "deg": "° degree degrees",
}
_BY_TEXT: Final = {name.lower(): name for name in UNITS} | {
    text: unit for unit, texts in _TEXTS.items() for text in texts.split()
}


def unit_named(text: str) -> str:
    """Return the name in :data:`UNITS` of a unit written as *text*, or "".

    ``Unit_KiloMeterPerHour``, ``KPH`` and ``[km / h]`` are ``km/h``.
    """
    text = "".join(text.split()).strip("[]")
    if text in UNITS:
        return text
    return _BY_TEXT.get(text.lower().removeprefix("unit_"), "")


def to_celsius(temperature_k: float) -> float:
    """Return *temperature_k* in degrees Celsius."""
    return temperature_k - KELVIN_OFFSET

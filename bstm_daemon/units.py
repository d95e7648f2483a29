"""SI inside, other units at the edges.

A unit is a linear map ``si = factor * value + offset``. Each belongs to one
quantity, so that a pressure given in ``km/h`` is refused when the
configuration is loaded, not noticed when a brake is cold.
"""

import re
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

_WORDS: Final = (
    (r"^unit_|^[a-z ]*:", ""),
    (r"percent|prozent|pct", "%"),
    (r"per|pro(?=h)", "/"),
    (r"kilomet(er|re)s?", "km"),
    (r"met(er|re)s?", "m"),
    (r"miles?", "mi"),
    (r"newtons?", "n"),
    (r"radians?", "rad"),
    (r"°|degrees?", "deg"),
    (r"celsius", "c"),
    (r"fahrenheit", "f"),
    (r"kelvin", "k"),
    (r"squared?|²", "2"),
    (r"seconds?|secs?", "s"),
    (r"hours?|hr", "h"),
    (r"minutes?", "min"),
    (r"revolutions?|rev", "1"),
    (r"[^a-z0-9/%]", ""),
)
"""What stands for the words and marks of a unit, replaced in this order."""

_SPELLINGS: Final = {
    "km/h": "kmh kph kmph km/hou",
    "mph": "mi/h",
    "m/s": "mps ms1",
    "m/s2": "m/s/s mps2 ms2 m/2s m/sonsquar",
    "deg/s": "degps dps degreofarc/son",
    "rpm": "1/min u/min min1 r/min",
    "rad/s": "rads rads/s",
    "degC": "c degrecelsi",
    "degF": "f",
}
"""Other texts of a unit after that, apart by spaces."""

_KNOWN: Final = {name.lower(): name for name in UNITS} | {
    text: unit for unit, texts in _SPELLINGS.items() for text in texts.split()
}


def unit_named(text: str) -> str:
    """Return the name in :data:`UNITS` of the unit that *text* spells.

    ``m/s^2``, ``m/s²`` and ``meters per second squared`` are ``m/s2``. It is
    "" where *text* spells no unit.
    """
    if text in UNITS:
        return text
    spelled = text.strip().lower()
    for pattern, symbol in _WORDS:
        spelled = re.sub(pattern, symbol, spelled)
    return _KNOWN.get(spelled, "")


def to_celsius(temperature_k: float) -> float:
    """Return *temperature_k* in degrees Celsius."""
    return temperature_k - KELVIN_OFFSET

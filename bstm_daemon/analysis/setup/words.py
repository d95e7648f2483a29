"""Names and unit texts of a DBC in words that can be compared.

``WheelSpeedFL``, ``WHL_SPD_FL`` and ``FLSpeedKPH`` all hold the word ``fl``;
``KPH``, ``km/h`` and ``Unit_KiloMeterPerHour`` are the same unit.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.roles import CORNERS
from bstm_daemon.units import unit_named

if TYPE_CHECKING:
    from cantools.database.can import Signal

NAMES: Final[dict[str, Any]] = tomllib.loads(
    (Path(__file__).parent / "_data" / "names.toml").read_text("utf-8")
)
"""Words of names, and what they mean."""

# words of a name that can stand in for a unit text that is not there
_NAMED_UNITS: Final = {"kph", "kmh", "mph", "rpm", "rads", "psi", "kpa", "nm"}

_WORD: Final = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
_CORNER_WORDS: Final[dict[str, str]] = {
    corner.lower(): corner.lower() for corner in CORNERS
} | NAMES["corners"]
_CORNER_PAIRS: Final = {
    pair: x + y
    for x, axles in NAMES["axles"].items()
    for y, sides in NAMES["sides"].items()
    for axle in axles.split()
    for side in sides.split()
    # two single letters are too little, but for f and l
    if len(axle + side) > 2 or axle + side == "fl"
    for pair in ((axle, side), (side, axle))
}

_NUMBERED: Final = {"disc", "disk", "ebrake"}


def unit_of(signal: Signal) -> str:
    """Return the configuration's name of the unit of *signal*, or ""."""
    text = (signal.unit or "").strip()
    named = _NAMED_UNITS.intersection(words_of(signal.name))
    return unit_named(text or min(named, default=""))


def words_of(name: str) -> list[str]:
    """Return the words of *name*, lower case; a corner as ``fl`` ... ``rr``.

    ``WheelSpeedFL175`` gives ``wheel speed fl 175``, ``disc2`` one word.
    """
    words = [word.lower() for word in _WORD.findall(name)]
    joined: list[str] = []
    for word in words:
        if word.isdigit() and joined and joined[-1] in _NUMBERED:
            joined[-1] += word
        elif joined and (joined[-1], word) in _CORNER_PAIRS:
            joined[-1] = _CORNER_PAIRS[joined[-1], word]
        else:
            joined.append(_CORNER_WORDS.get(word, word))
    return joined

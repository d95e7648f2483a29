"""Names and unit texts of a DBC in words that can be compared.

``WheelSpeedFL``, ``WHL_SPD_FL`` and ``FLSpeedKPH`` all hold the word ``fl``;
``KPH``, ``km/h`` and ``Unit_KiloMeterPerHour`` are one unit.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from bstm_daemon.roles import CORNERS
from bstm_daemon.units import UNITS

if TYPE_CHECKING:
    from cantools.database.can import Signal

_UNIT_WORDS: Final[dict[str, str]] = {
    **dict.fromkeys(("kmh", "kph", "kmph", "kilometerproh"), "km/h"),
    **dict.fromkeys(("kilometerperhour",), "km/h"),
    **dict.fromkeys(("mps", "meterpersecond"), "m/s"),
    **dict.fromkeys(("meterpersquaresecond", "meterpersecondsquare"), "m/s2"),
    **dict.fromkeys(("degreofarcpersecon", "degreepersecond"), "deg/s"),
    **dict.fromkeys(("meterperseconsquar",), "m/s2"),
    **dict.fromkeys(("kilometerperhou",), "km/h"),
    **dict.fromkeys(("1/min", "u/min", "min-1", "rev/min"), "rpm"),
    **dict.fromkeys(("rads/s", "rad/sec", "rads"), "rad/s"),
    **dict.fromkeys(("\u00b0/s", "deg/sec", "degree/s", "degps"), "deg/s"),
    **dict.fromkeys(
        ("m/s^2", "m/s\u00b2", "m/s/s", "m/s**2", "m/(s^2)", "mps2"), "m/s2"
    ),
    **dict.fromkeys(("n\u00b7m", "n*m", "newtonmeter"), "Nm"),
    **dict.fromkeys(
        ("c", "\u00b0c", "deg c", "celsius", "degrecelsi"), "degC"
    ),
    **dict.fromkeys(("f", "\u00b0f", "deg f"), "degF"),
    **dict.fromkeys(("percent", "pct", "prozent"), "%"),
    **dict.fromkeys(("\u00b0", "degree", "degrees"), "deg"),
}
_KNOWN_UNITS: Final = {name.lower(): name for name in UNITS} | _UNIT_WORDS
# words of a name that can stand in for a unit text that is not there
_NAMED_UNITS: Final = {"kph", "kmh", "mph", "rpm", "rads", "psi", "kpa", "nm"}

_WORD: Final = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[a-z]+|[A-Z]+|\d+")
_CORNER_WORDS: Final[dict[str, str]] = {
    **{corner.lower(): corner.lower() for corner in CORNERS},
    "lf": "fl",
    "rf": "fr",
    "vl": "fl",
    "vr": "fr",
    "hl": "rl",
    "hr": "rr",
    "fntl": "fl",
    "fntr": "fr",
    "lr": "rl",
}
_CORNER_PAIRS: Final = {
    (a, b): x + y
    for front in ("front", "fr", "frt", "f", "vorn", "vorne")
    for left in ("left", "l", "le", "lh", "links")
    for a, b, x, y in ((front, left, "f", "l"), (left, front, "f", "l"))
} | {
    (a, b): x + y
    for axles, x in (
        (("front", "frt", "vorn", "vorne", "fr", "f"), "f"),
        (("rear", "re", "r", "hinten"), "r"),
    )
    for sides, y in (
        (("left", "l", "links"), "l"),
        (("right", "r", "rechts"), "r"),
    )
    for axle in axles
    for side in sides
    if len(axle) > 1 or len(side) > 1
    for a, b in ((axle, side), (side, axle))
}

_NUMBERED: Final = {"disc", "disk", "ebrake"}


def unit_of(signal: Signal) -> str:
    """Return the configuration's name of the unit of *signal*, or ""."""
    text = (signal.unit or "").strip()
    known = UNITS.get(text) and text
    found = known or _KNOWN_UNITS.get(text.lower().removeprefix("unit_"), "")
    if found or text:
        return found
    named = _NAMED_UNITS.intersection(words_of(signal.name))
    return _KNOWN_UNITS.get(min(named), "") if named else ""


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

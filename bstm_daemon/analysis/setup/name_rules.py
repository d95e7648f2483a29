"""Rules that find the role of a DBC signal from name, unit and comment.

Names are split into words and compared with the rules of ``_data/names.toml``:
``WheelSpeedFL``, ``WHL_SPD_FL`` and ``FLSpeedKPH`` all hold the word ``fl``;
``KPH``, ``km/h`` and ``Unit_KiloMeterPerHour`` are the same unit. A match is a
proposal; a log decides (:mod:`bstm_daemon.analysis.setup.judging`).
"""

import re
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from cantools.database.can import Database, Message, Signal

from bstm_daemon.bus.signals import dbc
from bstm_daemon.bus.signals.extraction import FD_LENGTHS
from bstm_daemon.roles import CORNERS, ROLE_INDEX, ROLES
from bstm_daemon.units import UNITS, unit_named

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


DERIVED: Final = 1
REQUEST: Final = 2
UNNAMED: Final = 3
"""Levels: derived from others, asked for, of a unit but not of a name."""


@dataclass(frozen=True, slots=True)
class NameMatch:
    """A signal that may play a role.

    Args:
        role: the role.
        message: the message of the signal.
        signal: the signal.
        unit: a unit of the configuration, or "" where the DBC's unit is not
            one of the role's.
        caveat: why name and unit are not enough, "" where they are.
        level: 0 for a measurement, then :data:`DERIVED`, :data:`REQUEST` and
            :data:`UNNAMED`, in the order of preference.
    """

    role: str
    message: Message
    signal: Signal
    unit: str
    caveat: str
    level: int = 0


def _expanded(text: str) -> frozenset[str]:
    """Return the words of *text*, those of the lists that it names too."""
    found: set[str] = set()
    for word in text.split():
        named = NAMES["words"][word[1:]] if word.startswith("$") else ""
        found |= _expanded(named) if named else {word}
    return frozenset(found)


@dataclass(frozen=True, slots=True)
class _Rule:
    """A name's words that speak for *role*, see ``_data/names.toml``.

    Args:
        role: a role; ``{corner}`` in it stands for the corner of the name.
        has: lists of words; the name has one of each.
        without: words that the name does not have.
        only: the other words that it may have, None for any.
        flag: only a flag plays the role.
        needs_unit: the signal's unit must be one of the role.
        message_without: words that the message's name does not have.
        caveat: why the name is not enough, "" where it is.
    """

    role: str
    has: tuple[frozenset[str], ...]
    without: frozenset[str]
    only: frozenset[str] | None = None
    flag: bool = False
    needs_unit: bool = False
    message_without: frozenset[str] = frozenset()
    caveat: str = ""

    def holds(self, words: Iterable[str]) -> bool:
        """Whether a name of *words* fits."""
        found = frozenset(words)
        others = found.difference(*self.has)
        return (
            found.isdisjoint(self.without)
            and all(found & group for group in self.has)
            and (self.only is None or others <= self.only)
        )


def _rule(
    has: list[str],
    without: str = "",
    only: str | None = None,
    message_without: str = "",
    **keys: Any,
) -> _Rule:
    return _Rule(
        has=tuple(map(_expanded, has)),
        without=_expanded(f"$not_measured {without}"),
        only=None if only is None else _expanded(only),
        message_without=_expanded(message_without),
        **keys,
    )


_RULES: Final = tuple(_rule(**keys) for keys in NAMES["rule"])
_SELECTOR: Final = {"p", "d", "park", "drive"}
_NOT_MEASURED: Final = _expanded("$not_measured")
_REQUEST: Final = _expanded("$request")
_NO_UNIT: Final = _expanded("$no_unit")
_DERIVED: Final = _expanded("$derived")
_BY_UNIT: Final = {
    "acceleration": ("acceleration_longitudinal", frozenset[str]()),
    "torque": ("powertrain_torque", _expanded("$brake steering steer motor")),
    "pressure": ("primary_pressure", _expanded("$other_pressure")),
}
"""The role that a log can show a signal of a quantity to have, whatever its
name, and words that exclude it."""


def name_matches(database: Database) -> list[NameMatch]:
    """Return the roles that readable signals of *database* may play."""
    return [
        match
        for message, signal in _readable(database)
        for match in _matches(message, signal)
    ]


def unit_matches(database: Database) -> list[NameMatch]:
    """Return the roles that a log may show, where no name says them."""
    found = []
    for message, signal in _readable(database):
        unit, words = unit_of(signal), set(words_of(signal.name))
        role, without = _BY_UNIT.get(
            UNITS[unit].quantity if unit else "", ("", frozenset())
        )
        others = _NOT_MEASURED | _REQUEST | without
        if role and words.isdisjoint(others):
            caveat = "by its unit and the log, not by its name"
            found.append(
                NameMatch(role, message, signal, unit, caveat, UNNAMED)
            )
    return found


def _readable(database: Database) -> Iterator[tuple[Message, Signal]]:
    for message in database.messages:
        if message.length <= FD_LENGTHS[-1]:
            for signal in message.signals:
                if _is_readable(message, signal):
                    yield message, signal


def _is_readable(message: Message, signal: Signal) -> bool:
    try:
        for parent, _ in dbc.multiplexers(message, signal.name):
            dbc.raw_signal(message, parent)
        dbc.raw_signal(message, signal.name)
    except dbc.UnusableSignalError:
        return False
    return True


def _matches(message: Message, signal: Signal) -> Iterator[NameMatch]:
    words = words_of(signal.name)
    corner = next((word for word in words if word.upper() in CORNERS), "")
    elsewhere = set(words_of(message.name))
    seen = set()
    for rule in _RULES:
        role = rule.role.format(corner=corner)
        if (
            ("{corner}" in rule.role) == bool(corner)
            and role not in seen
            and rule.holds(words)
            and rule.message_without.isdisjoint(elsewhere)
        ):
            match = _match(rule, role, message, signal)
            if match is not None:
                seen.add(role)
                yield _levelled(match, {*words, *elsewhere & {"debug"}})


def _levelled(match: NameMatch, words: set[str]) -> NameMatch:
    """Return *match* with the level that the *words* of its name say."""
    # "sp" is a setpoint, but of speeds the speed
    request = _REQUEST - ({"sp"} if "speed" in match.role else set())
    if words & request:
        caveats = (match.caveat, "its name says a request, no measurement")
        caveat = ", ".join(filter(None, caveats))
        return replace(match, caveat=caveat, level=REQUEST)
    return replace(match, level=DERIVED) if words & _DERIVED else match


def _match(
    rule: _Rule, role: str, message: Message, signal: Signal
) -> NameMatch | None:
    quantities = ROLES[ROLE_INDEX[role]].quantities
    unit, caveat = unit_of(signal), rule.caveat
    is_flag = rule.flag or quantities == ("flag",)
    fits = unit in UNITS and UNITS[unit].quantity in quantities
    if signal.length == 1:
        percent = fits and UNITS[unit].quantity == "fraction"
        unit = unit if percent and not is_flag else "bool"
        return (
            NameMatch(role, message, signal, unit, caveat)
            if "flag" in quantities or percent
            else None
        )
    if is_flag or (
        not fits and (rule.needs_unit or _is_other_quantity(signal, unit))
    ):
        return None
    if fits:
        caveat = _shaft(role, signal, caveat)
    elif "count" in quantities and (signal.unit or "-").lower() in _NO_UNIT:
        unit = "count"
        if role == "gear" and _SELECTOR.intersection(_texts(signal)):
            caveat = "its texts are those of the selector, not of the gear"
    else:
        unit = ""
        stated = (
            f"its stated unit is {signal.unit!r}"
            if signal.unit
            else "no unit is stated"
        )
        caveat = ", ".join(filter(None, (caveat, stated)))
    return NameMatch(role, message, signal, unit, caveat)


def _is_other_quantity(signal: Signal, unit: str) -> bool:
    """Whether the unit is that of another quantity; % may be of any."""
    known = bool(signal.unit) and unit in UNITS
    return known and UNITS[unit].quantity != "fraction"


def _texts(signal: Signal) -> set[str]:
    """Return the last words of the texts, "d" of ``DI_GEAR_D``."""
    texts = (words_of(str(one)) for one in (signal.choices or {}).values())
    return {words[-1] for words in texts if words}


def _shaft(role: str, signal: Signal, caveat: str) -> str:
    """Return *caveat*, or that a motor's torque may not be at the wheels."""
    text = words_of(str(signal.comment or ""))
    if role != "motor_torque" or {"wheel", "wheels"}.intersection(text):
        return caveat
    return "check that it is meant at the wheels, else give the gear ratio"

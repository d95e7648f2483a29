"""What the name, unit and comment of a DBC signal say about its role.

Names are taken apart into words (:mod:`bstm_daemon.setup.words`) and compared
with a table. A clue is a suspicion; a log decides
(:mod:`bstm_daemon.setup.behaviour`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.dbc import (
    UnusableSignalError,
    multiplexers,
    raw_signal,
)
from bstm_daemon.bus.extraction import FD_LENGTHS
from bstm_daemon.roles import CORNERS, ROLE_INDEX, ROLES
from bstm_daemon.setup.words import unit_of, words_of
from bstm_daemon.units import UNITS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from cantools.database.can import Database, Message, Signal

_SPEED: Final = "speed spd ws whlspd velocity vel geschw radgeschw"
_TORQUE: Final = "torque trq tq moment drehmoment"
_PRESSURE: Final = "pressure press prs pres druck bremsdruck"
_BRAKE: Final = "brake brk brakes bremse bremsdruck brems"
_ACCELERATION: Final = "accel acc acceleration beschl accl gsensor"
_TEMPERATURE: Final = "temp temperature tmp"
_WISHES: Final = (
    "target tgt set request req rqst desired limit max min cmd command "
    "allowed available soll wunsch lead rel offset bias raw qf valid status "
    "error err fault counter cnt checksum crc timestamp quality accuracy "
    "adc estimate ui display cruise anforderung vorgabewert fehler zaehler "
    "checksumme flag pulse"
)
_NO_BRAKE_PRESSURE: Final = (
    "tire tyre tpms oil fuel rail boost air ac refrigerant coolant gas seat "
    "steering ambient baro manifold"
)


@dataclass(frozen=True, slots=True)
class Clue:
    """A signal that may play a role.

    ``unit`` is a unit of the configuration, or "" where the DBC's text is
    none of the role's. ``doubt`` says why name and unit are not enough, ""
    where they are.
    """

    role: str
    message: Message
    signal: Signal
    unit: str
    doubt: str


@dataclass(frozen=True, slots=True)
class _Rule:
    """Words that a name must have (one of each group) and must not have.

    ``alone``: it must have no others.
    """

    role: str
    groups: tuple[str, ...]
    without: str = _WISHES
    flag: bool = False
    alone: bool = False
    doubt: str = ""


_RULES: Final = (
    _Rule(
        "primary_pressure",
        (f"{_BRAKE} master mc primary", f"{_PRESSURE}"),
        f"{_WISHES} {_NO_BRAKE_PRESSURE} secondary rear booster vacuum",
    ),
    _Rule(
        "primary_pressure",
        ("primary front", _PRESSURE),
        f"{_WISHES} {_NO_BRAKE_PRESSURE}",
    ),
    _Rule("primary_pressure", ("cyl", "pres press pressure"), _WISHES),
    _Rule(
        "primary_pressure",
        ("brake brk bremse",),
        alone=True,
        doubt="its name says brake but not pressure",
    ),
    _Rule(
        "secondary_pressure",
        ("secondary", _PRESSURE),
        f"{_WISHES} {_NO_BRAKE_PRESSURE}",
    ),
    _Rule(
        "secondary_pressure",
        ("rear", _BRAKE, _PRESSURE),
        f"{_WISHES} {_NO_BRAKE_PRESSURE}",
        doubt="a pressure of the rear: use it with circuit = "
        '"secondary" in the rear corners',
    ),
    _Rule(
        "acceleration_longitudinal",
        (_ACCELERATION, "long longitudinal lon x laengs lgt"),
        f"{_WISHES} pedal",
    ),
    _Rule(
        "acceleration_lateral",
        (_ACCELERATION, "lat lateral y quer"),
        f"{_WISHES} pedal",
    ),
    _Rule("yaw_rate", ("yaw gier yawrate",), f"{_WISHES} {_ACCELERATION}"),
    _Rule("pitch", ("pitch",), f"{_WISHES} rate"),
    _Rule(
        "powertrain_torque",
        ("wheel axle", _TORQUE),
        f"{_WISHES} {_BRAKE} steering motor",
    ),
    _Rule(
        "engine_torque",
        ("engine eng motor", _TORQUE),
        f"{_WISHES} steering electric regen",
        doubt="check that it is the torque at the crankshaft",
    ),
    _Rule("engine_torque", ("etqreal tqi",), _WISHES),
    _Rule("motor_torque", ("motor regen inv", _TORQUE), f"{_WISHES} steering"),
    _Rule(
        "engine_speed",
        ("engine eng motordrehzahl", f"{_SPEED} rpm motordrehzahl"),
        f"{_WISHES} wheel fan turbine pump idle",
    ),
    _Rule("engine_speed", ("rpm",), _WISHES, alone=True),
    _Rule(
        "gear",
        ("gear gang",),
        f"{_WISHES} type inf lever shifter sport reverse steering ratio "
        "landing shift",
    ),
    _Rule(
        "clutch_open",
        ("clutch kupplung",),
        f"{_WISHES} temp torque slip released",
    ),
    _Rule(
        "brake_torque",
        (_BRAKE, _TORQUE),
        f"{_WISHES} motor regen engine",
    ),
    _Rule("external_force", ("external", "force"), _WISHES),
    _Rule("altitude", ("altitude elevation",), _WISHES),
    _Rule("gnss_speed", ("gps gnss", _SPEED), f"{_WISHES} accuracy"),
    _Rule(
        "ambient_temperature",
        ("ambient outside outdoor aussen ambtemp", _TEMPERATURE),
        _WISHES,
    ),
    _Rule("rain", ("rain", "intensity sensor level amount"), _WISHES),
    _Rule(
        "brake_switch",
        (_BRAKE, "switch pressed on lamp light touched applied"),
        f"{_WISHES} park hand parking fuse current hold while power warning "
        "status module",
        flag=True,
    ),
    _Rule(
        "brake_pedal_travel",
        ("pedal", "travel"),
        f"{_WISHES} accel gas throttle clutch accelerator",
    ),
    _Rule(
        "park_brake",
        (
            "park hand parking ebrake epb handbrake parkbrake",
            f"{_BRAKE} ebrake handbrake parkbrake epb",
        ),
        f"{_WISHES} assist lamp light",
        flag=True,
    ),
    _Rule("abs_active", ("abs", "active act"), _WISHES, flag=True),
    _Rule(
        "esc_active",
        ("esc esp vdc", "active act"),
        f"{_WISHES} {_BRAKE} abs tcs lamp autohold hold",
        flag=True,
    ),
    _Rule("tc_active", ("tc tcs asr", "active act"), _WISHES, flag=True),
    _Rule("ignition", ("ignition",), f"{_WISHES} angle timing", flag=True),
)
_WHEEL_SPEED: Final = _Rule(
    "wheel_speed",
    (_SPEED + " rpm",),
    f"{_WISHES} {_TORQUE} {_TEMPERATURE} motor direction rolling rotation",
)
_WHEEL_UNIT: Final = _Rule(
    "wheel_speed",
    ("whl wheel w",),
    f"{_WISHES} {_TORQUE} {_TEMPERATURE} motor direction rolling rotation "
    f"angle {_PRESSURE}",
)
_WHEEL_PRESSURE: Final = _Rule(
    "wheel_pressure",
    (_BRAKE + " wheel", _PRESSURE),
    f"{_WISHES} {_NO_BRAKE_PRESSURE}",
)
_VEHICLE_SPEED: Final = _Rule(
    "vehicle_speed",
    (_SPEED,),
    f"{_WISHES} {_TORQUE} wheel whl ws motor engine fan wind gps gnss wiper "
    "lockout rear front turbine pump shaft",
)
_SELECTOR: Final = {"p", "d", "park", "drive"}
_NODES: Final = {
    "disc_2": ("disc2 disk2",),
    "disc": ("disc disk rotor",),
    "pad_front": ("pad", "front"),
    "pad_back": ("pad", "back"),
    "fluid": ("fluid",),
    "caliper": ("caliper",),
}


def clues_of(database: Database) -> list[Clue]:
    """Return every suspicion about the readable signals of *database*."""
    return [
        clue
        for message in database.messages
        if message.length <= FD_LENGTHS[-1]
        for signal in message.signals
        if _is_readable(message, signal)
        for clue in _clues(message, signal)
    ]


def _is_readable(message: Message, signal: Signal) -> bool:
    try:
        for parent, _ in multiplexers(message, signal.name):
            raw_signal(message, parent)
        raw_signal(message, signal.name)
    except UnusableSignalError:
        return False
    return True


def _clues(message: Message, signal: Signal) -> Iterator[Clue]:
    words = words_of(signal.name)
    corner = next((word for word in words if word.upper() in CORNERS), "")
    if corner:
        rules = _corner_rules(words, corner, signal)
    else:
        rules = (
            [(_VEHICLE_SPEED, "vehicle_speed")] if _is_vehicle(words) else []
        )
        rules += [(rule, rule.role) for rule in _RULES]
    seen = set()
    for rule, role in rules:
        if role in seen or not _holds(rule, words):
            continue
        clue = _clue(rule, role, message, signal)
        if clue is not None:
            seen.add(role)
            yield clue


def _corner_rules(
    words: list[str], corner: str, signal: Signal
) -> list[tuple[_Rule, str]]:
    rules = [
        (_WHEEL_SPEED, f"wheel_speed_{corner}"),
        (_WHEEL_PRESSURE, f"wheel_pressure_{corner}"),
    ]
    for node, groups in _NODES.items():
        rule = _Rule("temp", (_TEMPERATURE, *groups))
        if _holds(rule, words):
            return [(rule, f"temp_{corner}_{node}")]
    # "whl" names a speed where the unit says so
    if unit_of(signal) in UNITS:
        rules.append((_WHEEL_UNIT, f"wheel_speed_{corner}"))
    return rules


def _is_vehicle(words: list[str]) -> bool:
    speeds = _SPEED.split()
    others = [word for word in words if word not in speeds]
    known = {"vehicle", "veh", "car", "fahrzeug", "v", "kph", "kmh", "mph"}
    return any(word in speeds for word in words) and known.issuperset(others)


def _clue(
    rule: _Rule, role: str, message: Message, signal: Signal
) -> Clue | None:
    quantities = ROLES[ROLE_INDEX[role]].quantities
    unit, doubt = unit_of(signal), rule.doubt
    is_flag = rule.flag or quantities == ("flag",)
    fits = unit in UNITS and UNITS[unit].quantity in quantities
    if signal.length == 1:
        percent = fits and UNITS[unit].quantity == "fraction"
        unit = unit if percent and not is_flag else "bool"
        return (
            Clue(role, message, signal, unit, doubt)
            if "flag" in quantities or percent
            else None
        )
    if is_flag or (not fits and _is_other_quantity(signal, unit)):
        return None
    if fits:
        doubt = _shaft(role, signal, doubt)
    elif "count" in quantities and not signal.unit:
        unit = "count"
        if role == "gear" and _SELECTOR.intersection(_texts(signal)):
            doubt = "its texts are those of the selector, not of the gear"
    else:
        unit = ""
        said = (
            f"its unit in the DBC is {signal.unit!r}"
            if signal.unit
            else "the DBC gives no unit"
        )
        doubt = ", ".join(filter(None, (doubt, said)))
    return Clue(role, message, signal, unit, doubt)


def _is_other_quantity(signal: Signal, unit: str) -> bool:
    """Whether the unit is known and of another thing; % may be anything."""
    known = bool(signal.unit) and unit in UNITS
    return known and UNITS[unit].quantity != "fraction"


def _texts(signal: Signal) -> set[str]:
    return {str(text).lower() for text in (signal.choices or {}).values()}


def _shaft(role: str, signal: Signal, doubt: str) -> str:
    """Say that a motor's torque is perhaps not that at the wheels."""
    text = words_of(str(signal.comment or ""))
    if role != "motor_torque" or {"wheel", "wheels"}.intersection(text):
        return doubt
    return "check that it is meant at the wheels, else give the gear ratio"


def _holds(rule: _Rule, words: Iterable[str]) -> bool:
    found = {word for word in words if not word.isdigit()}
    if rule.alone and len(found) > len(rule.groups):
        return False
    return found.isdisjoint(rule.without.split()) and all(
        found.intersection(group.split()) for group in rule.groups
    )

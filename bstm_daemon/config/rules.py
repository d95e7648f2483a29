"""The rules between sections: names that must agree, roles that must exist.

A section with a problem of its own is absent from the draft. What it mentions
still counts, so that one mistake gives one message and hides no other.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError

from bstm_daemon.config import sections
from bstm_daemon.config.estimates import MatchedConfig
from bstm_daemon.config.heat import HeatConfig, heat_mode_problems
from bstm_daemon.config.service import E2eConfig, PublishConfig
from bstm_daemon.config.thermal import CoolingConfig, ThermalConfig
from bstm_daemon.config.wording import problems_of_section, toml_text
from bstm_daemon.errors import hint, nearest
from bstm_daemon.roles import ROLE_INDEX, ROLES
from bstm_daemon.units import UNITS

Table = dict[str, Any]


@dataclass(frozen=True)
class Draft:
    """A configuration file: as written, and the valid sections for the rules.

    The ``written_`` tables hold those with problems too, in file order.
    """

    document: Table
    vehicle: sections.VehicleConfig | None = None
    bus: list[sections.BusConfig] = field(default_factory=list)
    signals: dict[str, sections.SignalConfig] = field(default_factory=dict)
    corner: list[sections.CornerConfig] = field(default_factory=list)
    thermal: ThermalConfig | None = None
    cooling: CoolingConfig | None = None
    heat: HeatConfig | None = None
    effect: list[sections.EffectConfig] = field(default_factory=list)
    matched: list[MatchedConfig] = field(default_factory=list)
    publish: PublishConfig | None = None
    e2e: list[E2eConfig] = field(default_factory=list)

    @property
    def written_buses(self) -> list[Table]:
        """All tables ``[[bus]]``."""
        return _tables(self.document.get("bus"))

    @property
    def written_corners(self) -> list[Table]:
        """All tables ``[[corner]]``."""
        return _tables(self.document.get("corner"))

    @property
    def written_signals(self) -> dict[str, Table]:
        """All tables ``[signals.<role>]`` by role."""
        signals = self.document.get("signals")
        roles = signals.items() if isinstance(signals, dict) else ()
        return {role: one for role, one in roles if isinstance(one, dict)}

    @property
    def written_table(self) -> bool:
        """Whether there is a ``[table]`` with keys."""
        return bool(self.document.get("table"))

    def bus_names(self) -> list[str]:
        """List the names of the buses; the first is the default bus."""
        return _names(self.written_buses)

    def corner_names(self) -> list[str]:
        """List the names of the corners."""
        return _names(self.written_corners)


def problems_between(draft: Draft) -> list[str]:
    """List what is wrong between the sections of *draft*."""
    return [
        *_bus_problems(draft.bus),
        *(
            problem
            for role in draft.written_signals
            for problem in _signal_problems(role, draft)
        ),
        *_table_problems(draft),
        *_corner_problems(draft),
        *_heat_problems(draft),
        *_effect_problems(draft),
        *_matched_problems(draft),
        *_publish_problems(draft),
        *(
            problem
            for e2e in draft.e2e
            for problem in _e2e_problems(e2e, draft)
        ),
        *_e2e_twice(draft),
    ]


def usable_signals(draft: Draft) -> dict[str, sections.SignalConfig]:
    """Return the signals of frames without a problem, nor their bus."""
    buses = {bus.name for bus in draft.bus}
    default = next(iter(draft.bus_names()), None)
    return {
        role: signal
        for role, signal in draft.signals.items()
        if signal.column is None
        and (signal.bus or default) in buses
        and not _signal_problems(role, draft)
    }


def usable_e2e(draft: Draft) -> list[E2eConfig]:
    """Return the protections of messages that usable signals read, once."""
    read = {
        (signal.message, _bus_of(signal.bus, draft))
        for signal in usable_signals(draft).values()
    }
    found = {
        key: e2e
        for e2e in draft.e2e
        if (key := (e2e.message, _bus_of(e2e.bus, draft))) in read
    }
    return list(found.values())


def _signal_problems(role: str, draft: Draft) -> list[str]:
    where = f"[signals.{role}]"
    table = draft.written_signals[role]
    bus, unit = table.get("bus"), table.get("unit")
    problems = list(_bus_unknown(where, bus, draft))
    if "depth_m" in table and not role.endswith(("_disc", "_pad_front")):
        problems.append(
            f"{where} depth_m: only a temperature of a disc or of a pad's "
            "front has a depth below the friction face"
        )
    if role not in ROLE_INDEX:
        problems.append(f"{where}: unknown role, {hint(role, ROLE_INDEX)}")
    elif isinstance(unit, str):
        quantities = ROLES[ROLE_INDEX[role]].quantities
        if unit not in UNITS:
            reason = f"unknown unit, {hint(unit, UNITS)}"
        elif UNITS[unit].quantity not in quantities:
            reason = f"is a unit of {_words(UNITS[unit].quantity)}"
        else:
            return problems
        kinds = " or ".join(_words(quantity) for quantity in quantities)
        fitting = ", ".join(
            name
            for name, candidate in UNITS.items()
            if candidate.quantity in quantities
        )
        problems.append(
            f"{where} unit = {toml_text(unit)}: {reason}; {role} needs a unit "
            f"of {kinds}: {fitting}"
        )
    return problems


def _bus_unknown(where: str, bus: object, draft: Draft) -> Iterator[str]:
    names = draft.bus_names()
    if isinstance(bus, str) and bus not in names:
        yield (
            f"{where} bus = {toml_text(bus)}: no such [[bus]], "
            f"{hint(bus, names)}"
        )


def _tables(value: object) -> list[Table]:
    listed = value if isinstance(value, list) else []
    return [table for table in listed if isinstance(table, dict)]


def _names(tables: list[Table]) -> list[str]:
    return [
        table["name"]
        for table in tables
        if isinstance(table.get("name"), str) and table["name"]
    ]


def _words(quantity: str) -> str:
    return quantity.replace("_", " ")


def _twice(names: Iterable[str]) -> Iterator[str]:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            yield name
        seen.add(name)


def _bus_problems(buses: list[sections.BusConfig]) -> Iterator[str]:
    for name in _twice(bus.name for bus in buses):
        yield f"[[bus]] {name} name: given twice, names must differ"
    owners: dict[tuple[str, str], str] = {}
    for bus in buses:
        owner = owners.setdefault((bus.interface, bus.channel), bus.name)
        if owner != bus.name:
            yield (
                f"[[bus]] {bus.name} channel = {toml_text(bus.channel)}: "
                f"is the channel of [[bus]] {owner} already"
            )


def _table_problems(draft: Draft) -> Iterator[str]:
    tables = draft.written_signals
    columns = [role for role, table in tables.items() if "column" in table]
    frames = [role for role in tables if role not in columns]
    if columns and frames:
        yield (
            f"[signals.{columns[0]}] column: stands beside roles of frames "
            f"([signals.{frames[0]}]), use one file for a bus and one for a "
            "table"
        )
    if columns and not draft.written_table:
        yield (
            f"[table]: missing, [signals.{columns[0]}] is a column: give "
            "'time', the column with the time, or 'rate_hz'"
        )
    if draft.written_table and tables and not columns:
        yield "[table]: no role comes from a table, give a role its 'column'"


def _corner_problems(draft: Draft) -> Iterator[str]:
    for name in _twice(corner.name for corner in draft.corner):
        yield f"[[corner]] {name} name: given twice, one section a wheel brake"
    all_valid = len(draft.corner) == len(draft.written_corners) > 0
    if all_valid and all(one.type == "drum" for one in draft.corner):
        yield '[[corner]]: all are drums, at least one must be a "disc"'
    thermal = draft.thermal or ThermalConfig()
    cooling = draft.cooling or CoolingConfig()
    for corner in draft.written_corners:
        yield from _override_problems(corner, "thermal", thermal)
        yield from _override_problems(corner, "cooling", cooling)


def _override_problems(
    corner: Table, section: str, base: ThermalConfig | CoolingConfig
) -> list[str]:
    model = type(base)
    override = corner.get(section)
    if not isinstance(override, dict):
        return []
    try:
        model(**{**base.model_dump(), **override})
    except ValidationError as error:
        problems = problems_of_section(error, model, "")
        where = f"[[corner]] {corner.get('name')} {section}"
        return [
            where + (problem if problem[0] == ":" else "." + problem.lstrip())
            for problem in problems
        ]
    return []


def _heat_problems(draft: Draft) -> Iterator[str]:
    if draft.heat is None or not draft.written_corners:
        return
    # a misspelt role has its own message already
    roles = {
        role if role in ROLE_INDEX else nearest(role, ROLE_INDEX) or role
        for role in draft.written_signals
    }
    yield from heat_mode_problems(draft.heat, draft.corner, roles)


def _effect_problems(draft: Draft) -> Iterator[str]:
    for effect in draft.effect:
        if effect.corner not in {"all", *draft.corner_names()}:
            yield (
                f'[[effect]] {effect.name} corner = "{effect.corner}": '
                f"no such [[corner]], {hint('', draft.corner_names())}"
            )


def _matched_problems(draft: Draft) -> Iterator[str]:
    known = draft.corner_names()
    for one in draft.matched:
        for key, names in ("corners", one.corners), ("alike", one.alike):
            for name in names:
                if name not in known:
                    yield (
                        f'[[matched]] {key}: "{name}" is no such [[corner]], '
                        f"{hint('', known)}"
                    )


def _publish_problems(draft: Draft) -> Iterator[str]:
    publish = draft.publish
    if publish is None:
        return
    if publish.enabled and draft.written_signals and not draft.written_buses:
        yield "[publish] enabled = true: needs a [[bus]] to send on"
    yield from _bus_unknown("[publish]", publish.bus, draft)


def _bus_of(name: object, draft: Draft) -> object:
    """Return the bus that *name*, a key ``bus`` as written, stands for."""
    return next(iter(draft.bus_names()), None) if name is None else name


def _e2e_problems(e2e: E2eConfig, draft: Draft) -> Iterator[str]:
    where = f"[[e2e]] {e2e.message}"
    unknown = list(_bus_unknown(where, e2e.bus, draft))
    if unknown:
        yield from unknown
        return
    bus = _bus_of(e2e.bus, draft)
    read = {
        table["message"]
        for table in draft.written_signals.values()
        if isinstance(table.get("message"), str)
        and _bus_of(table.get("bus"), draft) == bus
    }
    if e2e.message not in read:
        meant = nearest(e2e.message, sorted(read))
        yield f"{where} message: no role is read from it" + (
            "" if meant is None else f", did you mean '{meant}'?"
        )


def _e2e_twice(draft: Draft) -> Iterator[str]:
    keys = [(one.message, _bus_of(one.bus, draft)) for one in draft.e2e]
    for message in _twice(f"{message} on {bus}" for message, bus in keys):
        yield f"[[e2e]] {message}: given twice, one section a message"

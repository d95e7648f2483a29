"""DBC files plus configured roles, compiled into one extraction plan.

:func:`compile_signal_map` is the only place where configuration and DBC
meet. It reports every problem at once, each as
``[signals.<role>] key = value: reason, what is allowed``; the caller puts
the name of the configuration file in front.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple

import structlog
from cantools.database.can import Database, Message

from bstm_daemon.bus.output.e2e import PROFILE2_BYTES, PROFILE5_BYTES
from bstm_daemon.bus.output.layout import BLOCK_IDS
from bstm_daemon.bus.signals import dbc
from bstm_daemon.bus.signals.dbc_text import DbcDefect
from bstm_daemon.bus.signals.expression import (
    Expression,
    ExpressionError,
    Name,
    parse_expression,
    signal_names,
)
from bstm_daemon.bus.signals.extraction import (
    FD_LENGTHS,
    Condition,
    FrameKey,
    MessagePlan,
    Output,
    RawSignal,
    frame_length,
)
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.config.service import E2eConfig
from bstm_daemon.config.wording import shortened
from bstm_daemon.errors import ConfigError, hint
from bstm_daemon.roles import ROLE_INDEX, ROLES
from bstm_daemon.units import UNITS, Unit

_log = structlog.get_logger(__name__)

_LARGEST: Final = sys.float_info.max


@dataclass(frozen=True, slots=True)
class SignalMap:
    """The extraction plan of a configuration.

    ``timeouts_us[role]`` is how long a value of a role counts as present,
    ``warnings[bus]`` what had to be overlooked to load the bus's DBC,
    ``protected`` the end-to-end protection that messages must carry.
    """

    buses: tuple[BusConfig, ...]
    messages: Mapping[FrameKey, MessagePlan]
    timeouts_us: tuple[int, ...]
    warnings: Mapping[str, tuple[DbcDefect, ...]] = field(default_factory=dict)
    protected: Mapping[FrameKey, E2eConfig] = field(default_factory=dict)

    def wanted(self, bus: int) -> frozenset[tuple[int, bool]]:
        """Return the (id, extended) that bus number *bus* is read for."""
        return frozenset(
            (key.can_id, key.extended)
            for key in self.messages
            if key.bus == bus
        )

    def taken_ids(self, bus: int, id_base: int) -> list[str]:
        """Return a problem for each id read on *bus* that would be ours."""
        return [
            f"[publish] id_base = 0x{id_base:X}: the id 0x{key.can_id:X} of "
            f"message {plan.name!r} would be ours, but this configuration "
            "reads it: choose another id_base"
            for key, plan in self.messages.items()
            if key.bus == bus
            and not key.extended
            and id_base <= key.can_id < id_base + BLOCK_IDS
        ]

    def roles(self) -> frozenset[int]:
        """Return the numbers of the roles that have a source."""
        return frozenset(
            output.role
            for plan in self.messages.values()
            for output in plan.outputs
        )


def log_defects(signal_map: SignalMap) -> None:
    """Log what had to be overlooked in DBC files, ids given twice loudly."""
    names = {bus.name: bus.dbc for bus in signal_map.buses}
    for bus, defects in signal_map.warnings.items():
        for defect in defects:
            if defect.same_id or not defect.harmless:
                log = _log.warning if defect.same_id else _log.info
                log("dbc_defect", bus=bus, dbc=names[bus], defect=str(defect))


def compile_signal_map(
    buses: Sequence[BusConfig],
    signals: Mapping[str, SignalConfig],
    base: Path,
    wheel_radius_m: float,
    *,
    e2e: Sequence[E2eConfig] = (),
) -> SignalMap:
    """Compile *signals* (role name to source) over the DBC files of *buses*.

    DBC paths are relative to *base*; the first bus is the default one. A
    wheel speed in an angular unit becomes m/s with *wheel_radius_m*. *e2e*
    protects messages that roles are read from. What the rules of the
    configuration hold true is not looked at again. Raises
    :class:`ConfigError` with all problems of sources and DBC files.
    """
    compiler = _Compiler(buses, base, wheel_radius_m)
    for role_name, config in signals.items():
        compiler.add(role_name, config)
    plans = compiler.plans()
    # a role with a problem may be the one that reads a protected message
    protected = (
        {}
        if compiler.problems
        else _protected(e2e, plans, buses, compiler.problems)
    )
    if compiler.problems:
        raise ConfigError(compiler.problems)
    return SignalMap(
        buses=tuple(buses),
        messages=plans,
        timeouts_us=timeouts_us(signals),
        warnings=compiler.warnings,
        protected=protected,
    )


def _protected(
    e2e: Sequence[E2eConfig],
    plans: Mapping[FrameKey, MessagePlan],
    buses: Sequence[BusConfig],
    lines: list[str],
) -> dict[FrameKey, E2eConfig]:
    """Return the frames that *e2e* protects; its problems go to *lines*."""
    problems = Problems("[[e2e]]", lines)
    plan_of = {
        (plan.name, buses[plan.key.bus].name): plan for plan in plans.values()
    }
    protected: dict[FrameKey, E2eConfig] = {}
    for config in e2e:
        plan = plan_of[config.message, config.bus or buses[0].name]
        header = PROFILE2_BYTES if config.profile == 2 else PROFILE5_BYTES
        needed = config.offset_bytes + header
        if plan.length < needed:
            reason = (
                f"has {plan.length} bytes, CRC and counter of profile "
                f"{config.profile} need {needed}"
            )
            problems.add("message", config.message, reason)
        protected[plan.key] = config
    return protected


@dataclass(slots=True)
class MessageDraft:
    """A message plan that outputs are still being added to."""

    message: Message
    signals: dict[str, RawSignal] = field(default_factory=dict)
    outputs: list[Output] = field(default_factory=list)

    def index(self, name: str) -> int:
        """Return the position of the signal *name*, added when new."""
        if name not in self.signals:
            self.signals[name] = dbc.raw_signal(self.message, name)
        return list(self.signals).index(name)

    def conditions(self, names: Iterable[str]) -> tuple[Condition, ...]:
        """Return what multiplexers must read for the signals *names*."""
        found = [
            Condition(self.index(parent), values)
            for name in names
            for parent, values in dbc.multiplexers(self.message, name)
        ]
        return tuple(dict.fromkeys(found))

    def plan(self, bus: int, length: int | None = None) -> MessagePlan:
        """Return the plan on *bus*; *length* instead of the DBC's."""
        message = self.message
        return MessagePlan(
            key=FrameKey(bus, message.frame_id, message.is_extended_frame),
            name=message.name,
            length=frame_length(message.length) if length is None else length,
            is_fd=message.is_fd,
            signals=tuple(self.signals.values()),
            outputs=tuple(self.outputs),
        )


class _Compiler:
    """Collects message plans and problems, role by role."""

    def __init__(
        self, buses: Sequence[BusConfig], base: Path, wheel_radius_m: float
    ) -> None:
        self.problems: list[str] = []
        self.warnings: dict[str, tuple[DbcDefect, ...]] = {}
        self._buses = buses
        self._wheel_radius_m = wheel_radius_m
        self._drafts: dict[FrameKey, MessageDraft] = {}
        self._databases: dict[str, Database] = {}
        for bus in buses:
            try:
                loaded = dbc.read_dbc(
                    base / bus.dbc, strict=bus.strict, encoding=bus.encoding
                )
            except ConfigError as error:
                self.problems += (
                    f"[[bus]] name = {bus.name!r}: {line}"
                    for line in error.problems
                )
                continue
            self._databases[bus.name] = loaded.database
            if loaded.warnings:
                self.warnings[bus.name] = loaded.warnings

    def plans(self) -> dict[FrameKey, MessagePlan]:
        return {
            key: draft.plan(key.bus) for key, draft in self._drafts.items()
        }

    def add(self, role_name: str, config: SignalConfig) -> None:
        """Add the role *role_name*, or the problems it has."""
        problems = Problems(f"[signals.{role_name}]", self.problems)
        conversion = conversion_of(role_name, config, self._wheel_radius_m)
        expression = _expression(config, problems)
        draft = self._draft(config, problems)
        if draft is None or expression is None:
            return
        names = signal_names(expression)
        if _all_known(config, names, draft.message, problems):
            try:
                index = min(draft.index(name) for name in names)
                conditions = draft.conditions(names)
            except dbc.UnusableSignalError as error:
                problems.add(*_source_key(config), str(error))
                return
            draft.outputs.append(
                Output(
                    ROLE_INDEX[role_name],
                    index,
                    None if isinstance(expression, Name) else expression,
                    conditions,
                    *conversion,
                )
            )

    def _draft(
        self, config: SignalConfig, problems: Problems
    ) -> MessageDraft | None:
        """Return the draft of the configured message, or note why not."""
        names = [bus.name for bus in self._buses]
        name = config.bus or names[0]
        if name not in self._databases:
            return None
        number = names.index(name)
        message = _message(
            self._databases[name], self._buses[number].dbc, config, problems
        )
        if message is None:
            return None
        key = FrameKey(number, message.frame_id, message.is_extended_frame)
        draft = self._drafts.setdefault(key, MessageDraft(message))
        if draft.message is not message:
            problems.add(
                "message",
                config.message,
                f"has the id of {draft.message.name!r}, which another role "
                "is read from: one of them must be right",
            )
            return None
        return draft


@dataclass(frozen=True, slots=True)
class Problems:
    """Where the problems of one section of the configuration go."""

    section: str
    lines: list[str]

    def add(self, key: str, value: object, reason: str) -> None:
        """Note that the *value* of *key* cannot be, for *reason*."""
        shown = shortened(repr(value))
        self.lines.append(f"{self.section} {key} = {shown}: {reason}")


class Conversion(NamedTuple):
    """From the source's unit to SI, with limits in SI, as in an output."""

    gain: float
    bias: float
    low: float
    high: float
    flag: bool


def conversion_of(
    role_name: str, config: SignalConfig, wheel_radius_m: float
) -> Conversion:
    """Return the conversion of a role, whose unit fits it.

    Args:
        role_name: The role.
        config: Its source.
        wheel_radius_m: Makes a speed of a wheel's angular speed [m].
    """
    unit = UNITS[config.unit]
    quantities = ROLES[ROLE_INDEX[role_name]].quantities
    factor = unit.factor
    if "speed" in quantities and unit.quantity == "angular_speed":
        factor *= wheel_radius_m
    return Conversion(
        gain=factor * (config.sign * config.scale),
        bias=factor * (config.sign * config.offset) + unit.offset,
        low=_limit(config.min, factor, unit, -_LARGEST),
        high=_limit(config.max, factor, unit, _LARGEST),
        flag=unit.quantity == "flag",
    )


def timeouts_us(signals: Mapping[str, SignalConfig]) -> tuple[int, ...]:
    """Return for each role how long a value of it counts as present [us]."""
    own = {role: one.timeout_s for role, one in signals.items()}
    return tuple(
        round((own.get(role.name) or role.timeout_s) * 1e6) for role in ROLES
    )


def _message(
    database: Database, file: str, config: SignalConfig, problems: Problems
) -> Message | None:
    by_name = {message.name: message for message in database.messages}
    message = by_name.get(config.message or "")
    if message is None:
        known = hint(config.message or "", by_name, "")
        problems.add("message", config.message, f"not in {file!r}, {known}")
    elif message.length > FD_LENGTHS[-1]:
        reason = f"has {message.length} bytes, a frame carries at most 64"
        problems.add("message", config.message, reason)
        return None
    return message


def _source_key(config: SignalConfig) -> tuple[str, str | None]:
    if config.expression is None:
        return "signal", config.signal
    return "expression", config.expression


def _expression(config: SignalConfig, problems: Problems) -> Expression | None:
    if config.expression is None:
        return Name(config.signal or "")
    try:
        return parse_expression(config.expression)
    except ExpressionError as error:
        problems.add("expression", config.expression, str(error))
        return None


def _all_known(
    config: SignalConfig,
    names: Sequence[str],
    message: Message,
    problems: Problems,
) -> bool:
    known = [signal.name for signal in message.signals]
    unknown = [name for name in names if name not in known]
    for name in unknown:
        what = "" if config.expression is None else f"{name!r} is "
        problems.add(
            *_source_key(config),
            f"{what}not a signal of message {message.name!r}, "
            f"{hint(name, known, '')}",
        )
    return not unknown


def _limit(
    value: float | None, factor: float, unit: Unit, default: float
) -> float:
    return default if value is None else factor * value + unit.offset

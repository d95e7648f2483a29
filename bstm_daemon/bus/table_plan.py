"""Roles that come from the columns of a signal table, as a plan.

The counterpart of :mod:`~bstm_daemon.bus.signal_map` where there are no
frames: :func:`compile_sources` gives the one or the other.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.signal_map import SignalMap, compile_signal_map
from bstm_daemon.errors import ConfigError
from bstm_daemon.roles import ROLE_INDEX, ROLES
from bstm_daemon.units import UNITS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from bstm_daemon.config import BusConfig, SignalConfig, TableConfig
    from bstm_daemon.config_service import E2eConfig

_LARGEST: Final = sys.float_info.max


@dataclass(frozen=True, slots=True)
class ColumnOutput:
    """One role out of a column: ``si = gain * cell + bias``.

    A value outside ``low .. high`` (SI, both inclusive) is no sample;
    ``flag`` makes 1.0 of anything but zero.
    """

    role: int
    column: str
    gain: float
    bias: float
    low: float
    high: float
    flag: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class TableMap(SignalMap):
    """The extraction plan of a configuration whose roles are columns."""

    table: TableConfig
    outputs: tuple[ColumnOutput, ...]

    def roles(self) -> frozenset[int]:
        """Return the numbers of the roles that have a source."""
        return frozenset(output.role for output in self.outputs)


def compile_sources(
    buses: Sequence[BusConfig],
    signals: Mapping[str, SignalConfig],
    table: TableConfig | None,
    base: Path,
    wheel_radius_m: float,
    *,
    e2e: Sequence[E2eConfig] = (),
) -> SignalMap:
    """Compile *signals*, over the DBC files of *buses* or over *table*.

    Where no role is a column this is
    :func:`~bstm_daemon.bus.signal_map.compile_signal_map`; a table has no
    frames that *e2e* could protect. Raises
    :class:`ConfigError` with all problems.
    """
    columns = [role for role, one in signals.items() if one.column is not None]
    if not columns:
        return compile_signal_map(
            buses, signals, base, wheel_radius_m, e2e=e2e
        )
    problems = [
        f"[signals.{role}] column: all roles are columns of a table, or none"
        for role in signals
        if role not in columns
    ]
    if table is None:
        problems.append(f"[table]: missing, [signals.{columns[0]}] needs it")
    outputs = []
    for role in columns:
        output = _output(role, signals[role], wheel_radius_m)
        if isinstance(output, str):
            problems.append(output)
        else:
            outputs.append(output)
    if problems or table is None:
        raise ConfigError(problems)
    own = {role: one.timeout_s for role, one in signals.items()}
    return TableMap(
        buses=tuple(buses),
        messages={},
        timeouts_us=tuple(
            round((own.get(role.name) or role.timeout_s) * 1e6)
            for role in ROLES
        ),
        table=table,
        outputs=tuple(outputs),
    )


def _output(
    role: str, config: SignalConfig, wheel_radius_m: float
) -> ColumnOutput | str:
    """Return the plan of *role*, or its problem."""
    if role not in ROLE_INDEX:
        return f"[signals.{role}]: no role has this name"
    quantities = ROLES[ROLE_INDEX[role]].quantities
    unit = UNITS.get(config.unit)
    if unit is None or unit.quantity not in quantities:
        fitting = (n for n, u in UNITS.items() if u.quantity in quantities)
        return (
            f"[signals.{role}] unit = {config.unit!r}: allowed are "
            f"{', '.join(fitting)}"
        )
    factor = unit.factor
    if "speed" in quantities and unit.quantity == "angular_speed":
        factor *= wheel_radius_m
    low, high = config.min, config.max
    return ColumnOutput(
        role=ROLE_INDEX[role],
        column=config.column or "",
        gain=factor * (config.sign * config.scale),
        bias=factor * (config.sign * config.offset) + unit.offset,
        low=-_LARGEST if low is None else factor * low + unit.offset,
        high=_LARGEST if high is None else factor * high + unit.offset,
        flag=unit.quantity == "flag",
    )

"""Roles that come from the columns of a signal table, as a plan.

The counterpart of :mod:`~bstm_daemon.bus.signals.signal_map` where there are
no frames: :func:`compile_sources` gives the one or the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bstm_daemon.bus.signals.signal_map import (
    Problems,
    SignalMap,
    compile_signal_map,
    conversion_of,
    timeouts_us,
)
from bstm_daemon.errors import ConfigError
from bstm_daemon.roles import ROLE_INDEX, ROLES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from bstm_daemon.config.sections import (
        BusConfig,
        SignalConfig,
        TableConfig,
    )
    from bstm_daemon.config.service import E2eConfig


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
    :func:`~bstm_daemon.bus.signals.signal_map.compile_signal_map`; a table has
    no frames that *e2e* could protect. Raises :class:`ConfigError` with all
    problems.
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
    for name in columns:
        config = signals[name]
        section = Problems(f"[signals.{name}]", problems)
        if name not in ROLE_INDEX:
            section.unknown_role(name)
            continue
        number = ROLE_INDEX[name]
        conversion = conversion_of(
            ROLES[number], config, wheel_radius_m, section
        )
        if conversion is not None:
            outputs.append(
                ColumnOutput(number, config.column or "", *conversion)
            )
    if problems or table is None:
        raise ConfigError(problems)
    return TableMap(
        buses=tuple(buses),
        messages={},
        timeouts_us=timeouts_us(signals),
        table=table,
        outputs=tuple(outputs),
    )

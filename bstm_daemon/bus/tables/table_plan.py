"""Roles that come from the columns of a signal table, as a plan.

The counterpart of :mod:`~bstm_daemon.bus.signals.signal_map` where there are
no frames: :func:`compile_sources` gives the one or the other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bstm_daemon.bus.signals import signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig, TableConfig
from bstm_daemon.config.service import E2eConfig
from bstm_daemon.roles import ROLE_INDEX

_UNMEASURED: Final = ("bool", "count")


@dataclass(frozen=True, slots=True)
class ColumnOutput:
    """One role out of a column: ``si = gain * cell + bias``.

    A value outside ``low .. high`` (SI, both inclusive) is no sample;
    ``flag`` makes 1.0 of anything but zero. ``unit`` is the configured one, ""
    where it does not say what the cells are in: a flag, a number, own scale.
    """

    role: int
    column: str
    gain: float
    bias: float
    low: float
    high: float
    flag: bool
    unit: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableMap(signal_map.SignalMap):
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
) -> signal_map.SignalMap:
    """Compile *signals*, over the DBC files of *buses* or over *table*.

    Where no role is a column this is
    :func:`~bstm_daemon.bus.signals.signal_map.compile_signal_map`; a table has
    no frames that *e2e* could protect. Raises
    :class:`~bstm_daemon.errors.ConfigError` with all problems.
    """
    if table is None or any(one.column is None for one in signals.values()):
        return signal_map.compile_signal_map(
            buses, signals, base, wheel_radius_m, e2e=e2e
        )
    return TableMap(
        buses=tuple(buses),
        messages={},
        timeouts_us=signal_map.timeouts_us(signals),
        table=table,
        outputs=tuple(
            ColumnOutput(
                ROLE_INDEX[name],
                config.column or "",
                *signal_map.conversion_of(name, config, wheel_radius_m),
                unit=_unit_of_cells(config),
            )
            for name, config in signals.items()
        ),
    )


def _unit_of_cells(config: SignalConfig) -> str:
    is_plain = config.scale == 1.0 and not config.offset
    return config.unit if is_plain and config.unit not in _UNMEASURED else ""

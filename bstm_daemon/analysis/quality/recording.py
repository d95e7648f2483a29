"""The samples of a log, one series a role, and the ids that were on the bus.

Several logs are one recording by their time stamps, so that a drive split
into files, or a file a bus, is judged as a whole.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from bstm_daemon.bus.opening import EventLog, resolve_interfaces
from bstm_daemon.errors import LogError
from bstm_daemon.roles import ROLES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.bus.signals.signal_map import SignalMap

_MICRO = 1e-6


@dataclass(frozen=True, slots=True)
class Series:
    """The samples of a role by rising time.

    ``time_s`` since the start of the recording, ``value`` in SI, (n,) each.
    ``backwards`` counts samples whose stamp was older than the one before.
    """

    time_s: Column
    value: Column
    backwards: int = 0

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.time_s)


@dataclass(frozen=True, slots=True)
class Recording:
    """What one or more logs hold for a configuration.

    ``series`` has the roles with at least one sample, ``seen`` counts frames
    by (bus number, id, extended) whether they were wanted or not,
    ``refused`` lines, frames and samples by reason. ``truncated`` names the
    logs whose end is missing. ``start_s`` is the log time of the start.
    """

    series: Mapping[str, Series]
    duration_s: float
    seen: Mapping[tuple[int, int, bool], int]
    refused: Mapping[str, int]
    lines: int = 0
    truncated: tuple[str, ...] = ()
    start_s: float = 0.0


def read_recording(
    paths: Sequence[Path],
    signal_map: SignalMap,
    overrides: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Read the logs *paths* for every role of *signal_map*.

    *overrides* is log interface to bus name; *progress* is called with the
    share of a log that is read. Raises
    :class:`~bstm_daemon.errors.LogError` for a log that cannot be used and
    for two logs that hold the same role at the same time, and
    :class:`~bstm_daemon.errors.FileAccessError`.
    """
    parts: dict[str, list[tuple[Path, npt.NDArray[np.int64], Column]]] = (
        defaultdict(list)
    )
    seen: Counter[tuple[int, int, bool]] = Counter()
    refused: Counter[str] = Counter()
    lines = 0
    truncated = []
    for path in paths:
        log = EventLog(path, signal_map, overrides)
        for role, time_us, value in _columns(log, progress):
            parts[role].append((path, time_us, value))
        buses = resolve_interfaces(
            log.reader.interfaces, signal_map.buses, overrides or {}
        )
        for (channel, can_id, extended), count in log.reader.seen.items():
            seen[buses[channel], can_id, extended] += count
        for counts in (log.reader.refused, log.counts):
            refused.update({str(why): count for why, count in counts.items()})
        lines += log.reader.lines
        if log.reader.truncated:
            truncated.append(path.name)
    first_us = min(int(t.min()) for p in parts.values() for _, t, _ in p)
    last_us = max(int(t.max()) for p in parts.values() for _, t, _ in p)
    return Recording(
        {
            role: _joined(role, parts[role], first_us)
            for role in (known.name for known in ROLES)
            if role in parts
        },
        (last_us - first_us) * _MICRO,
        seen,
        refused,
        lines,
        tuple(truncated),
        first_us * _MICRO,
    )


def _columns(
    log: EventLog, progress: Callable[[float], None] | None
) -> list[tuple[str, npt.NDArray[np.int64], Column]]:
    """Return role, stamps [us] and values of everything in *log*."""
    chunks: dict[int, list[tuple[npt.NDArray[np.int64], Column]]] = (
        defaultdict(list)
    )
    for events in log.events():
        for role in np.unique(events.role).tolist():
            own = events.role == role
            chunks[role].append((events.time_us[own], events.value[own]))
        if progress is not None:
            progress(log.share)
    return [
        (
            ROLES[role].name,
            np.concatenate([time for time, _ in found]),
            np.concatenate([value for _, value in found]),
        )
        for role, found in chunks.items()
    ]


def _joined(
    role: str,
    parts: list[tuple[Path, npt.NDArray[np.int64], Column]],
    first_us: int,
) -> Series:
    parts = sorted(parts, key=lambda part: int(part[1].min()))
    for (earlier, before_us, _), (later, after_us, _) in pairwise(parts):
        if before_us.max() > after_us.min():
            msg = (
                f"{later}: holds {role} at the same time as {earlier}: "
                "check them one at a time"
            )
            raise LogError(msg)
    time_us = np.concatenate([time for _, time, _ in parts])
    value = np.concatenate([value for _, _, value in parts])
    backwards = int(np.count_nonzero(np.diff(time_us) < 0))
    if backwards:
        order = np.argsort(time_us, kind="stable")
        time_us, value = time_us[order], value[order]
    return Series((time_us - first_us) * _MICRO, value, backwards)

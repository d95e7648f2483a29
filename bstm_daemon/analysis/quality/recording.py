"""The samples of a log, one series a role, and the ids that were on the bus.

Several logs are one recording by their time stamps, so that a drive split
into files, or a file a bus, is judged as a whole. A channel in figures: rate,
range, gaps, constant runs.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.analysis.statistics.series import Column, Indices
from bstm_daemon.bus.opening import EventLog, resolve_interfaces
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.errors import LogError
from bstm_daemon.roles import ROLES

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
        for role in np.flatnonzero(np.bincount(events.role)).tolist():
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


_PAUSE_S: Final = 5.0


@dataclass(frozen=True, slots=True)
class Run:
    """A stretch of one exact value: from ``start_s`` to ``end_s``."""

    start_s: float
    end_s: float
    value: float

    @property
    def length_s(self) -> float:
        """How long it lasts."""
        return self.end_s - self.start_s


@dataclass(frozen=True, slots=True)
class ChannelStatistics:
    """A channel in figures, values in SI.

    ``rate_hz`` is the mean rate outside gaps (0 for a single sample). A gap
    is time without a sample, before the first and after the last included,
    pauses of the whole bus not; ``gaps_over_timeout`` counts those longer
    than the timeout and ``missing_share`` is the share of the time in which
    the value has aged out. ``constant_share`` is that of the most frequent
    exact value in the samples, ``longest_run`` the longest stretch of one
    value, ``distinct`` the number of different values, ``step`` the smallest
    change between neighbours (0 where nothing changes).
    """

    samples: int
    rate_hz: float
    minimum: float
    maximum: float
    median: float
    longest_gap_s: float
    gaps_over_timeout: int
    missing_share: float
    constant_share: float
    longest_run: Run
    distinct: int
    step: float
    backwards: int


def channel_statistics(
    series: Series,
    duration_s: float,
    timeout_s: float,
    pauses: Sequence[tuple[float, float]] = (),
) -> ChannelStatistics:
    """Return the figures of *series*, which has at least one sample.

    *duration_s* is the length of the recording, *timeout_s* how long a value
    counts as present, *pauses* the stretches in which the bus was silent.
    """
    time_s, value = series.time_s, series.value
    steps_s = np.diff(time_s)
    close = steps_s[steps_s <= timeout_s]
    together_s = float(close.sum())
    ends = np.concatenate(([0.0], time_s, [max(duration_s, time_s[-1])]))
    gaps_s = np.diff(ends)
    on_s = duration_s
    for first_s, last_s in pauses:
        overlap = np.minimum(ends[1:], last_s) - np.maximum(ends[:-1], first_s)
        gaps_s = gaps_s - np.maximum(overlap, 0.0)
        on_s -= last_s - first_s
    aged_s = np.maximum(gaps_s - timeout_s, 0.0)
    late = gaps_s > timeout_s
    _, counts = np.unique(value, return_counts=True)
    changes = np.abs(np.diff(value))
    changes = changes[changes > 0.0]
    return ChannelStatistics(
        samples=len(series),
        rate_hz=len(close) / together_s if together_s > 0.0 else 0.0,
        minimum=float(value.min()),
        maximum=float(value.max()),
        median=float(np.median(value)),
        longest_gap_s=float(gaps_s.max()),
        gaps_over_timeout=int(np.count_nonzero(late)),
        missing_share=(
            float(min(aged_s.sum() / on_s, 1.0)) if on_s > 0.0 else 0.0
        ),
        constant_share=float(counts.max() / len(value)),
        longest_run=_longest_run(series),
        distinct=len(counts),
        step=float(changes.min()) if len(changes) else 0.0,
        backwards=series.backwards,
    )


def constant_runs(series: Series, shortest_s: float) -> list[Run]:
    """Return the stretches of one exact value of *shortest_s* or more.

    A stretch ends at its last sample: a channel that falls silent is not
    constant but absent.
    """
    starts, ends = _bounds(series)
    long = series.time_s[ends] - series.time_s[starts] >= shortest_s
    return [
        _run(series, first, last)
        for first, last in zip(
            starts[long].tolist(), ends[long].tolist(), strict=True
        )
    ]


def _run(series: Series, first: int, last: int) -> Run:
    time_s, value = series.time_s, series.value
    return Run(float(time_s[first]), float(time_s[last]), float(value[first]))


def _longest_run(series: Series) -> Run:
    starts, ends = _bounds(series)
    longest = int(np.argmax(series.time_s[ends] - series.time_s[starts]))
    return _run(series, int(starts[longest]), int(ends[longest]))


def _bounds(series: Series) -> tuple[Indices, Indices]:
    """Return first and last sample of each run of one value."""
    if not len(series):
        none = np.empty(0, np.intp)
        return none, none
    starts = np.concatenate(([0], np.flatnonzero(np.diff(series.value)) + 1))
    return starts, np.concatenate((starts[1:] - 1, [len(series) - 1]))


def bus_pauses(
    messages: Iterable[Series], duration_s: float
) -> list[tuple[float, float]]:
    """Return the stretches in which more than half of *messages* are silent.

    The ignition goes off, a recorder stops: no channel is to blame. Silent
    is a message for which :data:`_PAUSE_S` pass without a sample.
    """
    changes: list[tuple[float, int]] = []
    count = 0
    for series in messages:
        count += 1
        ends = np.concatenate(([0.0], series.time_s, [duration_s]))
        long = np.flatnonzero(np.diff(ends) > _PAUSE_S)
        changes += [(float(ends[k]), 1) for k in long]
        changes += [(float(ends[k + 1]), -1) for k in long]
    pauses = []
    silent, began_s = 0, None
    for time_s, change in sorted(changes):
        silent += change
        if began_s is None and 2 * silent > count > 1:
            began_s = time_s
        elif began_s is not None and 2 * silent <= count:
            pauses.append((began_s, time_s))
            began_s = None
    return pauses

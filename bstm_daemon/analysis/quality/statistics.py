"""Statistics of a single channel: rate, range, gaps, constant runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from bstm_daemon.analysis.quality.recording import Series
    from bstm_daemon.analysis.statistics.series import Indices

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
    time_s, value = series.time_s, series.value
    long = time_s[ends] - time_s[starts] >= shortest_s
    return [
        Run(float(time_s[first]), float(time_s[last]), float(value[first]))
        for first, last in zip(
            starts[long].tolist(), ends[long].tolist(), strict=True
        )
    ]


def _longest_run(series: Series) -> Run:
    starts, ends = _bounds(series)
    longest = int(np.argmax(series.time_s[ends] - series.time_s[starts]))
    first, last = int(starts[longest]), int(ends[longest])
    return Run(
        float(series.time_s[first]),
        float(series.time_s[last]),
        float(series.value[first]),
    )


def _bounds(
    series: Series,
) -> tuple[Indices, Indices]:
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

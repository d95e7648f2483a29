"""Replay of a recorded log at full speed: the estimator over columns.

:func:`stream_log` decodes whole chunks with NumPy and hands rows of results
to sinks.
:mod:`bstm_daemon.replay.frames` runs frame by frame, as the daemon does.
"""

from __future__ import annotations

import gc
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf, isinf, nan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import Config
from bstm_daemon.engine import Following
from bstm_daemon.errors import LogError, UsageError
from bstm_daemon.estimator.blocks import Block
from bstm_daemon.estimator.estimator import PUBLISH_US, Estimator
from bstm_daemon.estimator.memory import StateError
from bstm_daemon.estimator.state import (
    export_state,
    parked_before_us,
    resume_state,
)
from bstm_daemon.estimator.validity import HIGHEST_K, LOWEST_K
from bstm_daemon.replay.results import Part, ResultsBuilder, Sink
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from bstm_daemon.estimate import Advice, CarRisk

StartState: TypeAlias = Mapping[str, Any] | Literal["cold"] | None


AIR_SAMPLES: Final = 10
"""Values that the temperature of a cold start is the median of."""


@dataclass(frozen=True)
class Run:
    """Figures of one log's run through the estimator.

    ``refused`` counts lines, frames and samples by reason; ``counts`` has
    the estimator's own: late and dropped samples, clock jumps. ``truncated``
    is set for a gzip file without its end. ``start_known_s`` is the time
    after the first estimate from which on the start has no effect any more,
    0 where it was known and infinite where it stays unknown. ``rows`` are
    those of the sinks. ``state`` is the document of a state file, at the
    log's last sample.
    """

    lines: int
    frames: int
    refused: Counter[str]
    counts: dict[str, int]
    compiled: bool
    truncated: bool
    start_known_s: float
    rows: int
    state: dict[str, Any]


def stream_log(  # noqa: PLR0913
    config: Config,
    signal_map: SignalMap,
    path: Path,
    sinks: Sequence[Sink],
    *,
    overrides: Mapping[str, str] | None = None,
    every_us: int = PUBLISH_US,
    progress: Callable[[float], None] | None = None,
    state: StartState = None,
    forecast: bool = True,
    summaries: Sequence[Sink] = (),
) -> Run:
    """Run the estimator over the log *path*, rows going to *sinks*.

    Args:
        config: the vehicle.
        signal_map: its extraction plan.
        path: a log.
        sinks: each gets every row, in stretches as they come, with all parts
            that one of them uses; no other is computed.
        overrides: log interface name to bus name.
        every_us: time between two rows [us], a multiple of 100 000.
        progress: called with the share of the log that is read.
        state: a state file's document; ``"cold"`` for brakes as cold as the
            air; None for an unknown start.
        forecast: whether a sink may have risk, forecast and advice.
        summaries: sinks that get a row a publication, whatever *every_us*.

    Raises:
        LogError: the log is unusable, holds none of the wanted ids, or is
            too short for a single row.
        FileAccessError: it can not be read, or a sink can not be written.
        UsageError: *state* is no state of this car.
    """
    log = EventLog(path, signal_map, overrides)
    present = present_roles(signal_map)
    begin, cold = state, state == "cold"
    air_k = first_air_k(signal_map, path, overrides) if cold else None
    parts = {part for sink in (*sinks, *summaries) for part in sink.parts}
    estimator = Estimator(
        config,
        present,
        history_known=cold,
        initial_k=air_k,
        judged=bool(parts),
    )
    forecast &= Part.FORECAST in parts
    following = Following(config, estimator, present, forecast=forecast)
    monitor, advice = following.risk, AdviceSeries(following)
    builders = _builders(estimator, sinks, every_us, summaries)
    start = _Start()
    with _collected_seldom():
        for events in log.events():
            if isinstance(state, Mapping) and len(events.time_us):
                first_us = int(events.time_us[0])
                _resume(state, first_us, estimator, following)
                state = None
            samples = events.time_us, events.role, events.value
            if monitor is not None:
                monitor.ingest(*samples)
                advice.ingest(*samples)
            for block in estimator.blocks(*samples):
                start.add(block)
                more: list[list[Sequence[Any]]] = []
                if monitor is not None:
                    risks = monitor.add(block)
                    more = [[risks], [advice.add(block, risks)]]
                for builder in builders:
                    builder.add([block], *more)
            if progress is not None:
                progress(log.share)
        for builder in builders:
            builder.finish()
    if not builders[0].rows:
        msg = f"{path}: too short for a row every {every_us * 1e-6:g} s"
        raise LogError(msg)
    refused = Counter({str(why): n for why, n in log.reader.refused.items()})
    refused.update({str(why): n for why, n in log.counts.items()})
    return Run(
        log.reader.lines,
        log.reader.frames,
        refused,
        estimator.counts,
        estimator.compiled,
        log.reader.truncated,
        start.known_s,
        builders[0].rows,
        _state_after(begin, estimator, following),
    )


@contextmanager
def _collected_seldom() -> Iterator[None]:
    """Look for circles of garbage seldom: a replay makes none.

    It makes millions of tuples, and each look costs a walk over them.
    """
    before = gc.get_threshold()
    gc.set_threshold(100 * before[0], *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _state_after(
    begin: StartState, estimator: Estimator, following: Following
) -> dict[str, Any]:
    """Return what the daemon would save, its clock being that of the log.

    What only a forecast follows is taken over from *begin* without one, but
    for the levels and the advice: those are of the time then.
    """
    document = {
        "counters": {},
        "model_check": estimator.model_check.export(),
        **export_state(estimator),
    }
    clocks = {"boot_id": None, "boot_us": 0, "wall_error_us": 0}
    document |= clocks | {"wall_us": document["time_us"]}
    if following.risk is not None:
        document |= following.export()
    elif isinstance(begin, Mapping) and isinstance(begin.get("risk"), dict):
        document["risk"] = begin["risk"] | {"levels": {}}
    return document


def _resume(
    state: Mapping[str, Any],
    first_us: int,
    estimator: Estimator,
    following: Following,
) -> None:
    """Put *state* into all that a log is run through, from *first_us* on."""
    parked_us = parked_before_us(state, first_us)
    with naming_state():
        resumed = resume_state(estimator, state, parked_us, first_us)
        estimator.model_check.resume(
            state, None if resumed.resumed else (parked_us or 0) * 1e-6
        )
        following.resume(
            state, parked_us, first_us, same_drive=resumed.resumed
        )


def _builders(
    estimator: Estimator,
    sinks: Sequence[Sink],
    every_us: int,
    summaries: Sequence[Sink],
) -> list[ResultsBuilder]:
    """Return the builder of the rows of *sinks*, then that of summaries."""
    if every_us == PUBLISH_US:
        return [ResultsBuilder(estimator, [*sinks, *summaries], every_us)]
    return [
        ResultsBuilder(estimator, sinks, every_us),
        ResultsBuilder(estimator, summaries),
    ]


class _Start:
    """When the start came to have no effect any more, see :class:`Run`."""

    def __init__(self) -> None:
        self.known_s = inf
        self._begun_us: int | None = None

    def add(self, block: Block) -> None:
        if self._begun_us is None:
            self._begun_us = block.times_us[0]
        known = max(block.known_from.values(), default=0)
        if isinf(self.known_s) and known < len(block.times_us):
            self.known_s = (block.times_us[known] - self._begun_us) * 1e-6


def first_air_k(
    signal_map: SignalMap, path: Path, overrides: Mapping[str, str] | None
) -> float | None:
    """Return the air's temperature [K] where the log *path* begins.

    The median of the first values is used, because one may be wrong; None
    where the log's first samples have none.
    """
    role = ROLE_INDEX["ambient_temperature"]
    if role not in signal_map.roles():
        return None
    for events in EventLog(path, signal_map, overrides).events():
        if len(events.time_us):
            values = events.value[events.role == role][:AIR_SAMPLES]
            found = float(np.median(values)) if len(values) else nan
            return found if LOWEST_K < found < HIGHEST_K else None
    return None


class AdviceSeries:
    """The advice of :class:`Following` along columns and blocks."""

    def __init__(self, following: Following) -> None:
        """Begin where *following* is."""
        self._following = following
        self._is_held = np.zeros(len(ROLE_INDEX) + 1, bool)
        self._is_held[[*following.advisor.roles.names]] = True
        self._samples: list[tuple[int, str, float]] = []
        # no sample from a place on is earlier than this [us]
        self._earliest_us: list[int] = []

    def ingest(self, times_us: Any, roles: Any, values: Any) -> None:
        """Take arrays [n]: stamps [us], role numbers, values."""
        names = self._following.advisor.roles.names
        kept = np.flatnonzero(self._is_held[roles])
        times_us, roles, values = times_us[kept], roles[kept], values[kept]
        if np.all(np.diff(times_us) >= 0):
            # of a role's between two publications only the last one counts
            intervals = -(times_us // -PUBLISH_US)
            order = np.argsort(roles, kind="stable")
            is_same = np.diff(roles[order]) == 0
            is_same &= np.diff(intervals[order]) == 0
            counts = np.ones(len(roles), bool)
            counts[order[:-1][is_same]] = False
            times_us, roles = times_us[counts], roles[counts]
            values = values[counts]
        self._samples += zip(
            times_us.tolist(),
            map(names.__getitem__, roles.tolist()),
            values.tolist(),
            strict=True,
        )
        if len(times_us):
            earliest_us = np.minimum.accumulate(times_us[::-1])[::-1].tolist()
            self._earliest_us = [
                min(one, earliest_us[0]) for one in self._earliest_us
            ] + earliest_us

    def add(self, block: Block, risks: Sequence[CarRisk]) -> list[Advice]:
        """Return the advice at each publication of *block* with its risk."""
        found = []
        first = 0
        advise, roles = self._following.advise, self._following.advisor.roles
        for i, (time_us, risk) in enumerate(
            zip(block.times_us, risks, strict=True)
        ):
            # in the order of their arrival, as the live engine notes them
            end = bisect_right(self._earliest_us, time_us, first)
            if end > first:
                roles.waiting += self._samples[first:end]
                first = end
            found.append(advise(block.at(i), risk, None)[1])
        del self._samples[:first], self._earliest_us[:first]
        return found


@contextmanager
def naming_state() -> Iterator[None]:
    """Word for the user why a state file does not fit.

    Raises:
        UsageError: instead of a StateError from inside.
    """
    try:
        yield
    except StateError as error:
        msg = f"--state: the state does not match: {error}"
        raise UsageError(msg) from error


def present_roles(signal_map: SignalMap) -> dict[int, int]:
    """Role number to timeout [us] of each mapped role."""
    return {role: signal_map.timeouts_us[role] for role in signal_map.roles()}

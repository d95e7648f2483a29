"""A recorded log at full speed: the estimator over columns.

:func:`stream_log` decodes whole chunks with NumPy and hands rows of results
to sinks, :func:`replay_log` keeps them in memory. Frame by frame, as the
daemon does it, goes :mod:`bstm_daemon.frame_replay`.
"""

from __future__ import annotations

from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bstm_daemon.advice_course import AdviceCourse
from bstm_daemon.bus.logs import EventLog
from bstm_daemon.carry_over import (
    StateError,
    parked_before_us,
    resume_state,
)
from bstm_daemon.errors import LogError, UsageError
from bstm_daemon.estimator import PUBLISH_US, STEP_US, Estimator
from bstm_daemon.forecast.monitor import RiskMonitor
from bstm_daemon.forecast.resuming import resume_risk
from bstm_daemon.results import Collector, Results, ResultsBuilder, Sink

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from bstm_daemon.bus.signal_map import SignalMap
    from bstm_daemon.config import Config


@dataclass(frozen=True)
class Run:
    """What there is to say of one log's way through the estimator.

    ``refused`` counts lines, frames and samples by reason; ``counts`` has
    the estimator's own: late and dropped samples, clock jumps. ``truncated``
    tells of a gzip file without its end. ``settling_s`` is how long the
    unknown start is felt.
    """

    lines: int
    frames: int
    refused: Counter[str]
    counts: dict[str, int]
    compiled: bool
    truncated: bool
    settling_s: float


@dataclass(frozen=True)
class Replay(Run):
    """A run with its results."""

    results: Results


def replay_log(
    config: Config,
    signal_map: SignalMap,
    path: Path,
    overrides: Mapping[str, str] | None = None,
    every_us: int = PUBLISH_US,
    *,
    forecast: bool = True,
) -> Replay:
    """Return the run over the log *path* with all its rows in memory.

    Args and errors are those of :func:`stream_log`, which needs no more
    memory for a longer log.
    """
    rows = Collector()
    run = stream_log(
        config,
        signal_map,
        path,
        [rows],
        overrides=overrides,
        every_us=every_us,
        forecast=forecast,
    )
    return Replay(**vars(run), results=rows.results())


def stream_log(  # noqa: PLR0913
    config: Config,
    signal_map: SignalMap,
    path: Path,
    sinks: Sequence[Sink],
    *,
    overrides: Mapping[str, str] | None = None,
    every_us: int = PUBLISH_US,
    progress: Callable[[int, float | None], None] | None = None,
    state: Mapping[str, Any] | None = None,
    forecast: bool = True,
) -> Run:
    """Run the estimator over the log *path*, rows going to *sinks*.

    Args:
        config: the vehicle.
        signal_map: its extraction plan.
        path: a log.
        sinks: each gets every row, in stretches as they come.
        overrides: log interface name to bus name.
        every_us: time between two rows [us], a multiple of 100 000.
        progress: called with the number of lines read so far and the share
            of the file, None where it is not known.
        state: a state file's document; without it the history is unknown.
        forecast: whether there are columns of risk, forecast and advice.

    Raises:
        LogError: the log is unusable, holds none of the wanted ids, or is
            too short for a single row.
        FileAccessError: it can not be read, or a sink can not be written.
        UsageError: *state* is no state of this car.
    """
    log = EventLog(path, signal_map, overrides)
    present = present_roles(signal_map)
    estimator = Estimator(config, present)
    monitor = RiskMonitor(config, estimator) if forecast else None
    course = AdviceCourse(config, estimator, present)
    builder = ResultsBuilder(estimator, sinks, every_us)
    settling_s = None if state is not None else estimator.settling_s
    for events in log.events():
        if settling_s is None and state is not None and len(events.time_us):
            first_us = int(events.time_us[0])
            parked_us = parked_before_us(state, first_us)
            with naming_state():
                resumed = resume_state(estimator, state, parked_us, first_us)
                if monitor is not None:
                    resume_risk(monitor, estimator, state, parked_us, first_us)
            if resumed.resumed:
                course.resume(state.get("advice"))
            settling_s = estimator.history_left_steps * STEP_US * 1e-6
        samples = events.time_us, events.role, events.value
        if monitor is not None:
            monitor.hear(*samples)
            course.hear(*samples)
        for block in estimator.stretches(*samples):
            if monitor is None:
                builder.add([block])
                continue
            risks = monitor.add(block)
            builder.add([block], [risks], [course.add(block, risks)])
        if progress is not None:
            progress(log.reader.lines, log.share)
    builder.finish()
    if not builder.rows:
        msg = f"{path}: too short for a row every {every_us * 1e-6:g} s"
        raise LogError(msg)
    refused = Counter(
        {str(reason): count for reason, count in log.reader.refused.items()}
    )
    refused.update({str(r): count for r, count in log.counts.items()})
    return Run(
        log.reader.lines,
        log.reader.frames,
        refused,
        estimator.counts,
        estimator.compiled,
        log.reader.truncated,
        settling_s or 0.0,
    )


@contextmanager
def naming_state() -> Iterator[None]:
    """Word for the user why a state file does not fit.

    Raises:
        UsageError: instead of a StateError from inside.
    """
    try:
        yield
    except StateError as error:
        msg = f"--state: the state does not fit: {error}"
        raise UsageError(msg) from error


def present_roles(signal_map: SignalMap) -> dict[int, int]:
    """Role number to timeout [us] of each mapped role."""
    return {role: signal_map.timeouts_us[role] for role in signal_map.roles()}

"""A log replayed with all its rows in memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bstm_daemon.estimator.estimator import PUBLISH_US
from bstm_daemon.replay.columns import Run, stream_log
from bstm_daemon.replay.results import Collector, Results

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config


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
    """Return the run over the log *path* with all its rows."""
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

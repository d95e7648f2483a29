"""A recorded log at full speed: the estimator over columns, or the engine.

:func:`replay_log` decodes whole chunks with NumPy; :func:`publish_log` feeds
the same log frame by frame through :class:`~bstm_daemon.engine.Engine` and
collects the frames that a daemon beside the recorder would have sent.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.logs import EventLog, open_log, resolve_interfaces
from bstm_daemon.engine import Engine
from bstm_daemon.errors import ConfigError, LogError
from bstm_daemon.estimator import PUBLISH_US, Estimator
from bstm_daemon.files import replacing
from bstm_daemon.results import Results, ResultsBuilder

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path
    from typing import TextIO

    from bstm_daemon.bus.signal_map import SignalMap
    from bstm_daemon.config import Config
    from bstm_daemon.engine import Published

TICK_US: Final = 10_000
"""Drain interval of the live service; a replay ticks on the same grid."""


@dataclass(frozen=True)
class Replay:
    """What a replay of one log gave.

    ``refused`` counts lines, frames and samples by reason; ``counts`` has
    the estimator's own: late and dropped samples, clock jumps. ``truncated``
    tells of a gzip file without its end. ``settling_s`` is how long the
    unknown start is felt.
    """

    results: Results
    lines: int
    frames: int
    refused: Counter[str]
    counts: dict[str, int]
    compiled: bool
    truncated: bool
    settling_s: float


def replay_log(
    config: Config,
    signal_map: SignalMap,
    path: Path,
    overrides: Mapping[str, str] | None = None,
    every_us: int = PUBLISH_US,
    progress: Callable[[int, float | None], None] | None = None,
) -> Replay:
    """Run the estimator over the log *path*.

    Args:
        config: the vehicle.
        signal_map: its extraction plan.
        path: a log.
        overrides: log interface name to bus name.
        every_us: time between two rows [us], a multiple of 100 000.
        progress: called with the number of lines read so far and the share
            of the file, None where it is not known.

    Raises:
        LogError: the log is unusable, holds none of the wanted ids, or is
            too short for a single row.
        FileAccessError: it can not be read.
    """
    log = EventLog(path, signal_map, overrides)
    estimator = Estimator(config, present_roles(signal_map))
    builder = ResultsBuilder(estimator, every_us)
    for events in log.events():
        builder.add(
            estimator.advance(events.time_us, events.role, events.value)
        )
        if progress is not None:
            progress(log.reader.lines, log.share)
    if not builder.rows:
        msg = f"{path}: too short for a row every {every_us * 1e-6:g} s"
        raise LogError(msg)
    refused = Counter(
        {str(reason): count for reason, count in log.reader.refused.items()}
    )
    refused.update({str(r): count for r, count in log.counts.items()})
    return Replay(
        builder.finish(),
        log.reader.lines,
        log.reader.frames,
        refused,
        estimator.counts,
        estimator.compiled,
        log.reader.truncated,
        estimator.settling_s,
    )


def publish_log(
    config: Config,
    signal_map: SignalMap,
    path: Path,
    out: Path,
    overrides: Mapping[str, str] | None = None,
) -> int:
    """Write the frames that the engine publishes over *path* as candump.

    Returns:
        The number of frames written to *out*.

    Raises:
        LogError, FileAccessError: as :func:`replay_log`; *out* is not
            writable.
    """
    engine = Engine(config, signal_map)
    channel = _publish_channel(config)
    reader = open_log(path, None)
    written = 0
    last_us: int | None = None
    with replacing(out) as temporary, temporary.open("w") as file:
        for chunk in reader.chunks():
            buses = resolve_interfaces(
                reader.interfaces, signal_map.buses, overrides or {}
            )
            for time_us, place, can_id, extended, length, data in zip(
                chunk.time_us.tolist(),
                chunk.channel.tolist(),
                chunk.can_id.tolist(),
                chunk.extended.tolist(),
                chunk.length.tolist(),
                chunk.data,
                strict=True,
            ):
                # at the stamp of the frame before: a tick ahead of a frame
                # with a stray stamp would bear that stamp out
                if (
                    last_us is not None
                    and last_us // TICK_US != time_us // TICK_US
                ):
                    written += _write(file, channel, engine.tick(last_us))
                last_us = time_us
                payload = data[:length].tobytes()
                engine.frame(buses[place], can_id, extended, payload, time_us)
        if last_us is None:
            msg = f"{path}: no CAN frame"
            raise LogError(msg)
        written += _write(file, channel, engine.tick(last_us))
    return written


def _write(file: TextIO, channel: str, published: list[Published]) -> int:
    for time_us, frame in published:
        seconds, micros = divmod(time_us, 1_000_000)
        identifier = (
            f"{frame.can_id:08X}"
            if frame.extended
            else (f"{frame.can_id:03X}")
        )
        file.write(
            f"({seconds}.{micros:06d}) {channel} "
            f"{identifier}#{frame.data.hex().upper()}\n"
        )
    return len(published)


def _publish_channel(config: Config) -> str:
    for bus in config.bus:
        if config.publish.bus in (None, bus.name):
            return bus.channel
    msg = f"[publish] bus = {config.publish.bus!r}: no such [[bus]]"
    raise ConfigError([msg])


def present_roles(signal_map: SignalMap) -> dict[int, int]:
    """Role number to timeout [us] of each mapped role."""
    return {role: signal_map.timeouts_us[role] for role in signal_map.roles()}

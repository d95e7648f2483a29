"""Replay of a log frame by frame through the engine, as in the daemon.

The frames that come out are those that a daemon on the recorded bus would
have sent: with the daemon's start state the same, byte for byte.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Final

from bstm_daemon.bus.opening import (
    NOT_READ,
    id_text,
    open_log,
    resolve_interfaces,
)
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import Config
from bstm_daemon.engine import Engine, Published
from bstm_daemon.errors import LogError
from bstm_daemon.estimator.state import parked_before_us
from bstm_daemon.files import replacing
from bstm_daemon.replay.columns import StartState, first_air_k, naming_state

TICK_US: Final = 50_000
"""Tick of the live service by default; it does not change results."""

Frame = tuple[int, int, int, bool, bytes]
"""Stamp [us], bus number, id, extended, data."""


def publications(  # noqa: PLR0913
    config: Config,
    signal_map: SignalMap,
    path: Path,
    overrides: Mapping[str, str] | None = None,
    state: StartState = None,
    *,
    forecast: bool = True,
    progress: Callable[[float], None] | None = None,
    built: Callable[[Engine], None] | None = None,
) -> Iterator[list[Published]]:
    """Run the engine over the log *path*, tick by tick.

    Args:
        config: the vehicle.
        signal_map: its extraction plan.
        path: a log of CAN frames.
        overrides: log interface name to bus name.
        state: as of :func:`~bstm_daemon.replay.columns.stream_log`.
        forecast: whether risk and forecast are made.
        progress: called with the share of the log that is read.
        built: called with the engine, whose estimate is that of each tick.

    Yields:
        What became due; a gap of hours comes in parts.

    Raises:
        LogError: the log is unusable or has no frame.
        FileAccessError: it can not be read.
        UsageError: *state* is no state of this car.
    """
    cold = state == "cold"
    engine = Engine(
        config,
        signal_map,
        history_known=cold,
        initial_k=first_air_k(signal_map, path, overrides) if cold else None,
        forecast=forecast,
    )
    if built is not None:
        built(engine)
    frames = _frames(path, signal_map, overrides or {}, progress)
    first = next(frames, None)
    if first is None:
        msg = f"{path}: no CAN frame"
        raise LogError(msg)
    last_us = first[0]
    if isinstance(state, Mapping):
        parked_us = parked_before_us(state, last_us)
        with naming_state():
            engine.resume(state, parked_us, last_us)
    for time_us, bus, can_id, extended, data in chain([first], frames):
        # at the stamp of the frame before: a tick at a wrong time stamp
        # would confirm it
        if last_us // TICK_US != time_us // TICK_US:
            yield from engine.parts_of_tick(last_us)
        last_us = time_us
        engine.frame(bus, can_id, extended, data, time_us)
    yield from engine.parts_of_tick(last_us)


def write_frames(
    ticks: Iterable[list[Published]], channel: str, out: Path
) -> int:
    """Write the frames of *ticks* as a candump log of *channel*.

    Returns:
        The number of frames written to *out*, whole or not at all.

    Raises:
        FileAccessError: *out* is not writable.
    """
    written = 0
    with replacing(out) as temporary, temporary.open("w") as file:
        for published in ticks:
            file.writelines(_line(channel, frame) for frame in published)
            written += len(published)
    return written


def _frames(
    path: Path,
    signal_map: SignalMap,
    overrides: Mapping[str, str],
    progress: Callable[[float], None] | None,
) -> Iterator[Frame]:
    reader = open_log(path, None)
    for chunk in reader.chunks():
        buses = resolve_interfaces(
            reader.interfaces, signal_map.buses, overrides
        )
        for time_us, place, can_id, extended, data in zip(
            chunk.time_us.tolist(),
            chunk.channel.tolist(),
            chunk.can_id.tolist(),
            chunk.extended.tolist(),
            chunk.payloads(),
            strict=True,
        ):
            if buses[place] != NOT_READ:
                yield time_us, buses[place], can_id, extended, data
        if progress is not None:
            progress(reader.share)


def _line(channel: str, published: Published) -> str:
    seconds, micros = divmod(published.time_us, 1_000_000)
    frame = published.frame
    name = id_text(frame.can_id, extended=frame.extended)
    data = frame.data.hex().upper()
    return f"({seconds}.{micros:06d}) {channel} {name}#{data}\n"

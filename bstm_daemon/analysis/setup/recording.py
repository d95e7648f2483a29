"""Content of recorded logs for a DBC: which frames come, and their values.

A log may hold several buses. The interface whose frames fit the DBC best, by
id and length, is taken for the DBC's bus; the others are named and left out.
"""

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import starmap
from pathlib import Path
from typing import Final, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from cantools.database.can import Database, Message

from bstm_daemon.analysis.setup.name_rules import NameMatch
from bstm_daemon.bus.opening import NOT_READ, id_text, open_log
from bstm_daemon.bus.signals.columns import ChunkDecoder, Events
from bstm_daemon.bus.signals.extraction import FD_LENGTHS, Output, frame_length
from bstm_daemon.bus.signals.signal_map import MessageDraft, SignalMap
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.errors import LogError

Series = npt.NDArray[np.float64]
FrameId = tuple[int, bool]

Part = TypeVar("Part")

LARGEST: Final = sys.float_info.max
_LOG_GAP_S: Final = 10.0


class HasShare(Protocol):
    """A reader that says how much it has read, from 0 to 1."""

    @property
    def share(self) -> float:
        """The share."""


@dataclass(frozen=True, slots=True)
class Samples:
    """The values of one signal, in the DBC's unit, with log time."""

    time_s: Series
    value: Series

    @property
    def rate_hz(self) -> float:
        """Samples per second, gaps left out."""
        steps = np.diff(self.time_s)
        steps = steps[(steps > 0) & (steps < _LOG_GAP_S)]
        return float(1 / np.median(steps)) if len(steps) else 0.0


@dataclass(slots=True)
class Recording:
    """The values of signals in one or more logs.

    ``samples`` is keyed by message and signal name. ``unknown`` are the ids
    on the interface that the DBC does not have, ``others`` the interfaces
    left out, each with the number of its ids and of those in the DBC.
    ``lengths`` has the messages whose frames are longer than the DBC says:
    they are read here, but the daemon refuses frames of another length.
    """

    interface: str = ""
    duration_s: float = 0.0
    samples: dict[tuple[str, str], Samples] = field(default_factory=dict)
    unknown: list[str] = field(default_factory=list)
    others: dict[str, tuple[int, int]] = field(default_factory=dict)
    lengths: dict[str, int] = field(default_factory=dict)


def read_recording(
    logs: Sequence[Path],
    database: Database,
    matches: Iterable[NameMatch],
    show: Callable[[float], None] = lambda _: None,
) -> Recording:
    """Read the signals of *matches* from *logs*, joined one after the other.

    They are read twice; *show* gets the share that is done. Raises
    :class:`LogError` where no interface has a frame of the DBC, and what
    opening a log raises.
    """
    known = {
        (message.frame_id, message.is_extended_frame): message
        for message in database.messages
        if message.length <= FD_LENGTHS[-1]
    }
    seen = _seen(logs, show)
    fitting = {
        interface: sum(
            lengths.total() for key, lengths in ids.items() if key in known
        )
        for interface, ids in seen.items()
    }
    interface = max(fitting, key=lambda name: fitting[name], default="")
    if not fitting.get(interface):
        names = ", ".join(str(log) for log in logs)
        msg = (
            f"{names}: no frame has an id of the DBC; "
            f"{sum(map(len, seen.values()))} other ids are there"
        )
        raise LogError(msg)
    signals = sorted(
        {(match.message.name, match.signal.name) for match in matches}
    )
    recording = Recording(
        interface=interface,
        unknown=[
            id_text(can_id, extended=extended)
            for can_id, extended in sorted(
                seen[interface].keys() - known.keys()
            )
        ],
        others={
            name: (len(ids), len(ids.keys() & known.keys()))
            for name, ids in seen.items()
            if name != interface
        },
    )
    lengths = {}
    for key in seen[interface].keys() & known.keys():
        ((length, _),) = seen[interface][key].most_common(1)
        declared = frame_length(known[key].length)
        lengths[key] = max(length, declared)
        if length > declared:
            recording.lengths[known[key].name] = length
    plan = _plan(signals, known, lengths)
    _read_samples(logs, plan, signals, recording, show)
    return recording


def told(
    parts: Iterable[Part],
    reader: HasShare,
    done: float,
    each: float,
    show: Callable[[float], None],
) -> Iterator[Part]:
    """Yield *parts* of *reader*; *show* gets *done* and its part of *each*."""
    for part in parts:
        yield part
        show(done + each * reader.share)


def _seen(
    logs: Sequence[Path], show: Callable[[float], None]
) -> dict[str, dict[FrameId, Counter[int]]]:
    """Count the frames of each interface and id by their length."""
    seen: dict[str, dict[FrameId, Counter[int]]] = {}
    each = 0.5 / len(logs)
    for number, log in enumerate(logs):
        reader = open_log(log)
        chunks = reader.chunks()
        for chunk in told(chunks, reader, number * each, each, show):
            columns = (chunk.channel, chunk.can_id, chunk.extended)
            rows = np.array([*columns, chunk.length], np.int64)
            kinds, counts = np.unique(rows, axis=1, return_counts=True)
            for kind, count in zip(
                kinds.T.tolist(), counts.tolist(), strict=True
            ):
                channel, can_id, extended, length = kind
                ids = seen.setdefault(reader.interfaces[channel], {})
                lengths = ids.setdefault((can_id, bool(extended)), Counter())
                lengths[length] += count
    return seen


def _plan(
    signals: list[tuple[str, str]],
    known: dict[FrameId, Message],
    lengths: dict[FrameId, int],
) -> SignalMap:
    """Return a plan whose role numbers are positions in *signals*."""
    drafts = {key: MessageDraft(message) for key, message in known.items()}
    of_name = {draft.message.name: draft for draft in drafts.values()}
    for number, (owner, name) in enumerate(signals):
        # of two messages of one id, one is read
        draft = of_name.get(owner)
        if draft is not None:
            source = draft.index(name), None, draft.conditions([name])
            limits = 1.0, 0.0, -LARGEST, LARGEST
            draft.outputs.append(Output(number, *source, *limits, flag=False))
    plans = [
        draft.plan(0, lengths.get(key))
        for key, draft in drafts.items()
        if draft.outputs
    ]
    bus = BusConfig(name="log", dbc="-")
    return SignalMap(
        buses=(bus,),
        messages={plan.key: plan for plan in plans},
        timeouts_us=(),
    )


def _read_samples(
    logs: Sequence[Path],
    plan: SignalMap,
    signals: list[tuple[str, str]],
    recording: Recording,
    show: Callable[[float], None],
) -> None:
    each = 0.5 / len(logs)
    decoder = ChunkDecoder(plan)
    ids = frozenset((key.can_id, key.extended) for key in plan.messages)

    def events_of(number: int, log: Path) -> Iterator[Events]:
        reader = open_log(
            log, lambda name: ids if name == recording.interface else None
        )
        done = 0.5 + number * each
        for chunk in told(reader.chunks(), reader, done, each, show):
            buses = [
                0 if name == recording.interface else NOT_READ
                for name in reader.interfaces
            ]
            yield decoder.decode(chunk, buses)

    collect(starmap(events_of, enumerate(logs)), signals, recording)


def collect(
    logs: Iterable[Iterable[Events]],
    signals: Sequence[tuple[str, str]],
    recording: Recording,
) -> None:
    """Add the samples of *logs* to *recording*, joined one after the other.

    Args:
        logs: the events of each log; role numbers are positions in *signals*.
        signals: names of message and signal.
        recording: gets ``samples`` and ``duration_s``.
    """
    times: list[list[Series]] = [[] for _ in signals]
    values: list[list[Series]] = [[] for _ in signals]
    # a log may begin before the one read ahead of it: laid end to end
    begin_s = 0.0
    for log in logs:
        first_us: int | None = None
        last_s = begin_s
        for events in log:
            if not len(events):
                continue
            first_us = int(events.time_us[0]) if first_us is None else first_us
            stamps_s = (events.time_us - first_us) * 1e-6 + begin_s
            last_s = max(last_s, float(stamps_s.max(initial=last_s)))
            for number in np.unique(events.role).tolist():
                mine = events.role == number
                times[number].append(stamps_s[mine])
                values[number].append(events.value[mine])
        recording.duration_s += last_s - begin_s
        begin_s = last_s + _LOG_GAP_S
    for number, name in enumerate(signals):
        if times[number]:
            recording.samples[name] = Samples(
                np.concatenate(times[number]), np.concatenate(values[number])
            )

"""Logs as samples: opening, interfaces, and errors worded for the user.

This version reads the text logs of ``candump -l`` and ``-L``, also
compressed with gzip.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from bstm_daemon.bus.candump import CandumpReader, Wanted
from bstm_daemon.bus.columns import Events, decode_chunk
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.bus.signal_map import SignalMap
from bstm_daemon.config import BusConfig
from bstm_daemon.errors import FileAccessError, LogError, UsageError

NOT_READ: Final = -1
"""Bus number of an interface that ``--map IFACE=`` leaves out."""

_FORMATS: Final = (
    "candump -l text logs, plain or with the ending .gz, are read"
)
_OTHER_ENDINGS: Final = frozenset(
    {
        *(".asc", ".blf", ".csv", ".db", ".mat", ".mdf", ".mf4"),
        *(".parquet", ".pcap", ".pcapng", ".trc"),
    }
)
_GZIP_MAGIC: Final = b"\x1f\x8b"
_HEAD_BYTES: Final = 4096
_IDS_SHOWN: Final = 12


def open_log(path: Path, wanted: Wanted | None = None) -> CandumpReader:
    """Return the reader of the log *path*, for *wanted* ids or all.

    Raises :class:`FileAccessError` where the file cannot be read and
    :class:`LogError` where it is empty or in a format that is not read.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror or error}"
        raise FileAccessError(msg) from error
    if not head:
        msg = f"{path}: the log is empty"
        raise LogError(msg)
    is_gzip = head.startswith(_GZIP_MAGIC)
    endings = [ending.lower() for ending in path.suffixes]
    other = _OTHER_ENDINGS.intersection(
        endings[-2:] if is_gzip else endings[-1:]
    )
    binary = not is_gzip and b"\0" in head
    if other or binary or is_gzip != (path.suffix == ".gz"):
        what = (
            f"{min(other)} files are not read" if other else "not a text log"
        )
        if not other and is_gzip:
            what = "a gzip file without the ending .gz"
        elif not other and path.suffix == ".gz":
            what = "has the ending .gz but is no gzip file"
        msg = f"{path}: {what}: {_FORMATS}"
        raise LogError(msg)
    return CandumpReader(path, wanted)


def resolve_interfaces(
    names: Collection[str],
    buses: Sequence[BusConfig],
    overrides: Mapping[str, str],
) -> list[int]:
    """Return the bus number of each interface name.

    *overrides* maps interface names to bus names (``--map IFACE=BUS``) and
    goes before ``[[bus]] channel``; an empty bus name leaves the interface
    out (:data:`NOT_READ`). Raises :class:`LogError` listing the names that
    neither resolves, :class:`UsageError` for an unknown bus name.
    """
    numbers = {bus.name: number for number, bus in enumerate(buses)}
    channels = {
        bus.channel: number for number, bus in reversed(list(enumerate(buses)))
    }
    for name, bus in overrides.items():
        if bus and bus not in numbers:
            msg = (
                f"--map {name}={bus}: no [[bus]] is named {bus!r}, "
                f"there are: {', '.join(numbers)}"
            )
            raise UsageError(msg)
    unresolved = [
        name
        for name in names
        if name not in overrides and name not in channels
    ]
    if unresolved:
        msg = (
            f"no [[bus]] channel for the interface {', '.join(unresolved)} "
            f"(channels: {', '.join(channels)}): "
            f"use --map {unresolved[0]}=BUS with BUS one of "
            f"{', '.join(numbers)}, or --map {unresolved[0]}= to leave it out"
        )
        raise LogError(msg)
    return [
        numbers.get(overrides[name], NOT_READ)
        if name in overrides
        else channels[name]
        for name in names
    ]


class EventLog:
    """The samples of one log, in file order.

    ``reader`` has the counters of lines and ids, ``counts`` those of frames
    and samples that the decoding refused.
    """

    def __init__(
        self,
        path: Path,
        signal_map: SignalMap,
        overrides: Mapping[str, str] | None = None,
    ) -> None:
        """Open *path*; raises what :func:`open_log` raises."""
        self.reader = open_log(path, self._wanted)
        self.counts: Counter[Refusal] = Counter()
        self._signal_map = signal_map
        self._overrides = dict(overrides or {})
        self._bus_of_channel: list[int] = []

    def events(self) -> Iterator[Events]:
        """Yield the samples chunk by chunk; memory stays flat.

        Raises :class:`LogError` for an interface that no bus stands for, and
        at the end for a log without frames, without wanted ids or without a
        single sample.
        """
        samples = 0
        for chunk in self.reader.chunks():
            events = decode_chunk(
                self._signal_map, chunk, self._bus_of_channel
            )
            self.counts.update(events.counts)
            samples += len(events)
            yield events
        if not samples:
            msg = f"{self.reader.path}: {self._why_empty()}"
            raise LogError(msg)

    def _wanted(self, interface: str) -> Collection[tuple[int, bool]] | None:
        try:
            self._bus_of_channel = resolve_interfaces(
                self.reader.interfaces,
                self._signal_map.buses,
                self._overrides,
            )
        except LogError as error:
            msg = f"{self.reader.path}: {error}"
            raise LogError(msg) from error
        bus = self._bus_of_channel[self.reader.interfaces.index(interface)]
        return None if bus == NOT_READ else self._signal_map.wanted(bus)

    def _why_empty(self) -> str:
        reader = self.reader
        if not reader.seen:
            return (
                f"no data frame in {reader.lines} lines "
                f"({_listed(reader.refused)}): {_FORMATS}"
            )
        if not reader.frames:
            return (
                f"none of the wanted ids: {self._expected()} expected, "
                f"{self._seen()} seen ({_listed(reader.refused)})"
            )
        return (
            f"no sample in {reader.frames} wanted frames "
            f"({_listed(self.counts)})"
        )

    def _expected(self) -> str:
        return ", ".join(
            f"{self._signal_map.buses[key.bus].name} "
            f"{id_text(key.can_id, extended=key.extended)} ({plan.name})"
            for key, plan in sorted(self._signal_map.messages.items())
        )

    def _seen(self) -> str:
        keys = sorted(self.reader.seen)
        shown = ", ".join(
            f"{self.reader.interfaces[channel]} "
            f"{id_text(can_id, extended=extended)}"
            for channel, can_id, extended in keys[:_IDS_SHOWN]
        )
        more = len(keys) - _IDS_SHOWN
        return f"{shown} and {more} more" if more > 0 else shown


def id_text(can_id: int, *, extended: bool) -> str:
    """Return an id as candump writes it: 3 digits, or 8 when extended."""
    return f"{can_id:08X}" if extended else f"{can_id:03X}"


def _listed(counts: Counter[Refusal]) -> str:
    return ", ".join(
        f"{count} {reason.value.replace('_', ' ')}"
        for reason, count in counts.most_common()
    )

"""Logs as samples: opening, interfaces, and errors worded for the user.

The ending of a file decides what it is: a log of CAN frames in one of the
formats of :data:`FORMATS`, or a signal table. Either way :class:`EventLog`
gives its samples.
"""

import gzip
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from bstm_daemon.bus.logs.candump import CandumpReader
from bstm_daemon.bus.logs.reader import FrameReader, Wanted
from bstm_daemon.bus.logs.text_formats import TextLogReader, is_frame_csv
from bstm_daemon.bus.signals.columns import ChunkDecoder, Events
from bstm_daemon.bus.signals.reject_reason import RejectReason, listed
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.bus.tables.table_log import TableReader
from bstm_daemon.bus.tables.table_plan import TableMap
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.errors import FileAccessError, LogError, UsageError

NOT_READ: Final = -1
"""Bus number of an interface that ``--map IFACE=`` leaves out."""

FORMATS: Final = (
    "read are candump -l text logs (.log, any other ending), .asc, .blf, "
    ".trc and python-can's .csv, each also with .gz behind, .mf4, and signal "
    "tables (.csv, .tsv, .vbo, .xrk, .xrz, .mf4, .parquet, .h5, .hdf5)"
)
"""Readable formats, for messages."""

_MAGIC: Final = {
    ".blf": (b"LOGG",),
    ".mf4": (b"MDF     ", b"UnFinMF "),
    ".parquet": (b"PAR1",),
    ".h5": (b"\x89HDF\r\n\x1a\n",),
    ".hdf5": (b"\x89HDF\r\n\x1a\n",),
}
"""First bytes of a binary file, by its ending."""
_TEXTS: Final = (".asc", ".trc", ".csv", ".tsv", ".vbo")
_PACKED: Final = (".blf", *_TEXTS)
"""Endings that ``.gz`` may follow, besides candump's."""
_MESSAGES: Final = (".asc", ".blf", ".trc")
_AIM: Final = (".xrk", ".xrz")
_TABLES: Final = (*(".tsv", ".vbo", ".parquet", ".h5", ".hdf5"), *_AIM)
_EXPORTS: Final = {
    ".ld": "in MoTeC i2 export the data as CSV",
    ".drk": "in RaceStudio export the data as CSV",
    ".mdf": "save it as MDF 4 (.mf4)",
    ".dat": "save it as MDF 4 (.mf4)",
}
"""What to do with a file that is not read, by its ending."""
_OTHER_ENDINGS: Final = frozenset(
    {
        *(".mat", ".db", ".xlsx", ".xls", ".json", ".zip"),
        *(".pcap", ".pcapng", ".xz", ".bz2", ".zst", ".feather", ".bin"),
    }
)
_GZIP_MAGIC: Final = b"\x1f\x8b"
_CANDUMP: Final = "candump"
_TABLE: Final = "table"
_HEAD_BYTES: Final = 4096
_IDS_SHOWN: Final = 12


def open_log(path: Path, wanted: Wanted | None = None) -> FrameReader:
    """Return the reader of the CAN log *path*, for *wanted* ids or all.

    Raises :class:`FileAccessError` where the file cannot be read and
    :class:`LogError` where it is empty, in a format that is not read or a
    signal table.
    """
    kind = _kind_of(path)
    if kind == _TABLE:
        msg = (
            f"{path}: a signal table has no CAN frames: it is read where "
            "roles have a 'column', which 'bstm init' proposes without --dbc"
        )
        raise LogError(msg)
    if kind == _CANDUMP:
        return CandumpReader(path, wanted)
    if kind == ".mf4":
        from bstm_daemon.bus.logs.mf4 import Mf4Reader  # noqa: PLC0415

        return Mf4Reader(path, wanted)
    if kind == ".blf":
        from bstm_daemon.bus.logs.blf import BlfReader  # noqa: PLC0415

        return BlfReader(path, wanted)
    return TextLogReader(path, wanted)


def is_table(path: Path) -> bool:
    """Whether *path* can be a signal table; an MF4 file may be either.

    Raises as :func:`open_log`.
    """
    return _kind_of(path) in (_TABLE, ".mf4")


def _kind_of(path: Path) -> str:
    """Return the kind of log that *path* is, by ending and beginning."""
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
    has_gz = endings[-1:] == [".gz"]
    ending = "".join(endings[-2:-1] if has_gz else endings[-1:])
    wrong = _wrong(head, ending, is_gzip=is_gzip, has_gz=has_gz)
    if wrong:
        msg = f"{path}: {wrong}: {FORMATS}"
        raise LogError(msg)
    if ending == ".csv":
        return ending if _has_frames(path, is_gzip=is_gzip) else _TABLE
    if ending in _MESSAGES or ending == ".mf4":
        return ending
    return _TABLE if ending in _TABLES else _CANDUMP


def _wrong(head: bytes, ending: str, *, is_gzip: bool, has_gz: bool) -> str:
    """Return why a file that begins so is not read, or nothing."""
    begins = _MAGIC.get(ending, ())
    reason = ""
    if ending in _EXPORTS:
        reason = f"{ending} files are not read, {_EXPORTS[ending]}"
    elif ending in _OTHER_ENDINGS:
        reason = f"{ending} files are not read"
    elif is_gzip != has_gz:
        reason = (
            "a gzip file without the ending .gz"
            if is_gzip
            else "has the ending .gz but is no gzip file"
        )
    elif is_gzip and ending in (*_MAGIC, *_AIM) and ending not in _PACKED:
        reason = f"{ending} files packed with gzip are not read"
    elif begins and not is_gzip and not head.startswith(begins):
        reason = f"has the ending {ending} but does not begin like one"
    elif not begins and ending not in _AIM and not is_gzip and b"\0" in head:
        reason = "not a text log"
    return reason


def _has_frames(path: Path, *, is_gzip: bool) -> bool:
    """Whether a CSV file is python-can's log of frames, by its header."""
    try:
        with gzip.open(path) if is_gzip else path.open("rb") as stream:
            line = stream.readline(_HEAD_BYTES)
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        msg = f"{path}: damaged in its first line: {error}"
        raise LogError(msg) from error
    return is_frame_csv(line.decode("utf-8", "replace"))


def resolve_interfaces(
    names: Collection[str],
    buses: Sequence[BusConfig],
    overrides: Mapping[str, str],
) -> list[int]:
    """Return the bus number of each interface name.

    *overrides* maps interface names to bus names (``--map IFACE=BUS``) and
    goes before ``[[bus]] channel``, which goes before ``ignored_interfaces``;
    an empty bus name leaves the interface out (:data:`NOT_READ`). Raises
    :class:`LogError` listing the names that none resolves,
    :class:`UsageError` for an unknown bus name.
    """
    numbers = {bus.name: number for number, bus in enumerate(buses)}
    channels = {
        bus.channel: number for number, bus in reversed(list(enumerate(buses)))
    }
    ignored = {name for bus in buses for name in bus.ignored_interfaces}
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
        if name not in overrides
        and name not in channels
        and name not in ignored
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
        else channels.get(name, NOT_READ)
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
        """Open *path*: frames, or a signal table where roles are columns.

        Raises what :func:`open_log` raises, and :class:`LogError` for frames
        or a table where the configuration expects the other.
        """
        self.counts: Counter[RejectReason] = Counter()
        self._signal_map = signal_map
        self._overrides = dict(overrides or {})
        self._bus_of_channel: list[int] = []
        self.reader: FrameReader | TableReader
        kind = _kind_of(path)
        if isinstance(signal_map, TableMap):
            if kind not in (_TABLE, ".mf4"):
                msg = (
                    f"{path}: is a log of CAN frames, but the roles of the "
                    "configuration are columns of a table"
                )
                raise LogError(msg)
            self.reader = table = TableReader(path, signal_map)
            self._source: Callable[[], Iterator[Events]] = table.events
        else:
            if kind == _TABLE:
                msg = (
                    f"{path}: is a signal table, but no role of the "
                    "configuration is a 'column'"
                )
                raise LogError(msg)
            self._frames = self.reader = open_log(path, self._wanted)
            self._source = self._decoded

    @property
    def share(self) -> float:
        """How much of the file is read, from 0 to 1."""
        return self.reader.share

    def events(self) -> Iterator[Events]:
        """Yield the samples chunk by chunk; memory stays flat.

        Raises :class:`LogError` for an interface that no bus stands for or a
        column that is not there, and at the end for a log without frames,
        without wanted ids or without a single sample.
        """
        for events in self._source():
            self.counts.update(events.counts)
            yield events

    def _decoded(self) -> Iterator[Events]:
        samples = 0
        decoder = ChunkDecoder(self._signal_map)
        for chunk in self._frames.chunks():
            events = decoder.decode(chunk, self._bus_of_channel)
            samples += len(events)
            yield events
        if not samples:
            msg = f"{self.reader.path}: {self._why_empty()}"
            raise LogError(msg)

    def _wanted(self, interface: str) -> Collection[tuple[int, bool]] | None:
        try:
            self._bus_of_channel = resolve_interfaces(
                self._frames.interfaces,
                self._signal_map.buses,
                self._overrides,
            )
        except LogError as error:
            msg = f"{self._frames.path}: {error}"
            raise LogError(msg) from error
        bus = self._bus_of_channel[self._frames.interfaces.index(interface)]
        return None if bus == NOT_READ else self._signal_map.wanted(bus)

    def _why_empty(self) -> str:
        reader = self._frames
        if not reader.seen:
            return (
                f"no data frame in {reader.lines} lines "
                f"({listed(reader.refused)}): {FORMATS}"
            )
        if not reader.frames:
            return (
                f"none of the wanted ids: {self._expected()} expected, "
                f"{self._seen()} seen ({listed(reader.refused)})"
            )
        return (
            f"no sample in {reader.frames} wanted frames "
            f"({listed(self.counts)})"
        )

    def _expected(self) -> str:
        return ", ".join(
            f"{self._signal_map.buses[key.bus].name} "
            f"{id_text(key.can_id, extended=key.extended)} ({plan.name})"
            for key, plan in sorted(self._signal_map.messages.items())
        )

    def _seen(self) -> str:
        keys = sorted(self._frames.seen)
        shown = ", ".join(
            f"{self._frames.interfaces[channel]} "
            f"{id_text(can_id, extended=extended)}"
            for channel, can_id, extended in keys[:_IDS_SHOWN]
        )
        more = len(keys) - _IDS_SHOWN
        return f"{shown} and {more} more" if more > 0 else shown


def id_text(can_id: int, *, extended: bool) -> str:
    """Return an id as candump writes it: 3 digits, or 8 when extended."""
    return f"{can_id:08X}" if extended else f"{can_id:03X}"

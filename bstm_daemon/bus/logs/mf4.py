"""MF4 logs (ASAM MDF 4, bus logging) through asammdf.

Read are the raw frames, the channel groups with ``CAN_DataFrame``. The
interface is ``can`` and the bus channel as the file numbers it. Stamps are
absolute: the start of the recording plus the stamp of the frame.
"""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.bus.logs.reader import FrameReader
from bstm_daemon.bus.signals.extraction import EXTENDED_MAX, STANDARD_MAX
from bstm_daemon.bus.signals.frame_chunk import (
    PREFIX_MASKS,
    FrameChunk,
    columns_for,
    join_in_file_order,
    rows_of,
)
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.errors import FileAccessError, LogError, MissingExtraError

_FRAME: Final = "CAN_DataFrame"
_NEEDED: Final = ("ID", "DataLength", "DataBytes")
_READ: Final = (*_NEEDED, "IDE", "BusChannel")
_FIXED_LENGTH: Final = 0
"""Channel type of a value that lies in the record, all of it."""
_REFUSED: Final = {
    "CAN_ErrorFrame": RejectReason.ERROR_FRAME,
    "CAN_RemoteFrame": RejectReason.REMOTE_FRAME,
    "CAN_OverloadFrame": RejectReason.ERROR_FRAME,
}
_EXTENDED_BIT: Final = 1 << 31


class Mf4Reader(FrameReader):
    """Reads the data frames of an MF4 log.

    Several groups of data frames are merged by their stamps; within a group
    frames keep the order of the file. ``lines`` counts records.
    """

    counted = "record"
    _chunk_frames = 40_000

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames in file order.

        Raises :class:`FileAccessError`, :class:`MissingExtraError` without
        asammdf and :class:`LogError` for a damaged log or one without bus
        logging.
        """
        mdf = self._open()
        try:
            yield from self._merged(mdf)
        finally:
            mdf.close()

    def _open(self) -> Any:
        try:
            from asammdf import MDF  # noqa: PLC0415  (an extra, and slow)
        except ImportError as error:
            raise MissingExtraError(
                package="asammdf",
                extra="mf4",
                purpose=f"{self.path}: an MF4 log",
            ) from error
        try:
            self.path.open("rb").close()
        except OSError as error:
            msg = f"{self.path}: cannot be read: {error.strerror or error}"
            raise FileAccessError(msg) from error
        with quiet_asammdf():
            try:
                # the ids of all frames are not needed beforehand
                options: dict[str, Any] = {"process_bus_logging": False}
                return MDF(self.path, **options)
            except Exception as error:  # noqa: BLE001  (raises anything)
                problem = worded_damage(error)
            gc.collect()
        msg = f"{self.path}: damaged: {problem}"
        raise LogError(msg)

    def _merged(self, mdf: Any) -> Iterator[FrameChunk]:
        with self._naming_damage():
            groups = self._groups(mdf)
        if not groups:
            msg = (
                f"{self.path}: no bus logging in this MF4 file (channel "
                f"group {_FRAME}): its signals are read by roles with 'column'"
            )
            raise LogError(msg)
        total = max(sum(group.count for group in groups), 1)
        done = 0
        while True:
            for group in groups:
                self._fill(group)
            # no group has an earlier frame to come than this
            ahead = [int(g.chunk.time_us.max()) for g in groups if g.has_more]
            parts = [group.take(min(ahead, default=None)) for group in groups]
            merged = _merge(parts, self.lines + 1)
            self.lines += len(merged)
            done += len(merged)
            self.share = done / total
            yield self.wanted_frames(merged)
            if not ahead:
                return

    def _groups(self, mdf: Any) -> list[_Group]:
        start_us = round(mdf.header.start_time.timestamp() * 1e6)
        found = []
        for number, group in enumerate(mdf.groups):
            names = {channel.name for channel in group.channels}
            count = int(group.channel_group.cycles_nr)
            for name, reason in _REFUSED.items():
                if name in names and count:
                    self.lines += count
                    self.refused[reason] += count
            if {f"{_FRAME}.{name}" for name in _NEEDED} <= names:
                found.append(_Group(mdf, number, names, count, start_us))
        return found

    def _fill(self, group: _Group) -> None:
        if len(group.chunk):
            return
        with self._naming_damage():
            buses, chunk = group.read(self._chunk_frames)
        channel = np.zeros(len(buses), np.int16)
        if len(buses) and not np.equal(buses, buses[0]).all():
            found, first = np.unique(buses, return_index=True)
            for bus in found[np.argsort(first)].tolist():
                channel[buses == bus] = self.channel(f"can{bus}")
        elif len(buses):
            channel[:] = self.channel(f"can{buses[0]}")
        group.chunk = replace(chunk, channel=channel)

    @contextmanager
    def _naming_damage(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # asammdf raises anything on damage
            raise self.damaged(worded_damage(error)) from error


@contextmanager
def quiet_asammdf() -> Iterator[None]:
    """Keep asammdf's messages about a damaged file off the terminal.

    It leaves a half-built object behind whose finalizer raises as well.
    """
    hook = sys.unraisablehook
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        sys.unraisablehook = hook


def worded_damage(error: Exception) -> str:
    """Return what a library raised, with its type."""
    return f"{type(error).__name__}: {error}".rstrip(": ")


class _Group:
    """One channel group of data frames, read record by record.

    ``chunk`` has the records read and not taken yet.
    """

    def __init__(
        self, mdf: Any, number: int, names: set[str], count: int, start_us: int
    ) -> None:
        self.count = count
        self.chunk = columns_for(0)
        self._mdf = mdf
        self._number = number
        self._names = names
        self._start_us = start_us
        self._read = 0
        # asammdf can then read whole records at once
        self._is_plain = _FRAME in names and all(
            channel.channel_type == _FIXED_LENGTH
            and channel.conversion is None
            and not channel.bit_offset
            and not channel.bit_count % 8
            for channel in mdf.groups[number].channels
            if channel.name.startswith(_FRAME)
        )

    @property
    def has_more(self) -> bool:
        """Whether records are left behind those in ``chunk``."""
        return self._read < self.count

    def read(self, limit: int) -> tuple[npt.NDArray[Any], FrameChunk]:
        """Return bus channels and frames of the next records.

        *limit* at most; the lines and channels of the frames are left 0.
        """
        count = min(limit, self.count - self._read)
        if not count:
            return np.empty(0, np.int64), columns_for(0)
        seconds, columns = self._records(count)
        ids = columns["ID"].astype(np.int64)
        sizes, raw = columns["DataLength"], columns["DataBytes"]
        if not len(ids) == len(sizes) == len(raw) == count:
            msg = f"{len(ids)} of {count} records are there"
            raise ValueError(msg)
        self._read += count
        extended = (ids & _EXTENDED_BIT) != 0
        if "IDE" in columns:
            extended |= columns["IDE"] != 0
        else:
            extended |= (ids & EXTENDED_MAX) > STANDARD_MAX
        buses = columns.get("BusChannel", np.zeros(count, np.int64))
        lengths, data = _payloads(raw, sizes)
        return buses, FrameChunk(
            time_us=self._start_us + np.round(seconds * 1e6).astype("i8"),
            line=np.zeros(count, np.int64),
            channel=np.zeros(count, np.int16),
            can_id=(ids & EXTENDED_MAX).astype(np.uint32),
            extended=extended,
            length=lengths,
            data=data,
        )

    def take(self, until_us: int | None) -> FrameChunk:
        """Return what is read, up to the stamp *until_us* where given."""
        whole = self.chunk
        if until_us is None or not len(whole):
            cut = len(whole)
        else:
            # a stamp that runs backwards stays behind its predecessors
            so_far = np.maximum.accumulate(whole.time_us)
            cut = int(np.searchsorted(so_far, until_us, side="right"))
        self.chunk = rows_of(whole, slice(cut, None))
        return rows_of(whole, slice(cut))

    def _records(
        self, count: int
    ) -> tuple[npt.NDArray[np.float64], dict[str, npt.NDArray[Any]]]:
        """Return stamps and the columns that are there, of *count* records."""
        there = [n for n in _READ if f"{_FRAME}.{n}" in self._names]
        if self._is_plain:
            whole = self._get(_FRAME, count)
            return whole.timestamps, {
                name: whole.samples[f"{_FRAME}.{name}"] for name in there
            }
        signals = {
            name: self._get(f"{_FRAME}.{name}", count) for name in there
        }
        return signals["ID"].timestamps, {
            name: signal.samples for name, signal in signals.items()
        }

    def _get(self, name: str, count: int) -> Any:
        return self._mdf.get(
            name,
            group=self._number,
            raw=True,
            record_offset=self._read,
            record_count=count,
        )


def _payloads(
    raw: npt.NDArray[Any], sizes: npt.NDArray[Any]
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Return lengths and payloads, 8 or 64 wide and zero behind the length.

    A length that the bytes do not cover becomes 255, which no frame has.
    """
    rows = np.ascontiguousarray(raw).view(np.uint8).reshape(len(raw), -1)
    sizes = sizes.astype(np.int64)
    width = 8 if sizes.max() <= 8 else 64
    data = np.zeros((len(rows), width), np.uint8)
    common = min(width, rows.shape[1])
    data[:, :common] = rows[:, :common]
    masks = PREFIX_MASKS[width].take(sizes.clip(0, width), axis=0)
    data.view("<u8")[:] &= masks
    lengths = np.where(sizes > rows.shape[1], 255, sizes.clip(0, 255))
    return lengths.astype(np.uint8), data


def _merge(parts: list[FrameChunk], first_line: int) -> FrameChunk:
    """Return all frames by stamp, those of one part in their order."""
    parts = [part for part in parts if len(part)] or parts[:1]
    if len(parts) == 1:
        lines = np.arange(first_line, first_line + len(parts[0]))
        return replace(parts[0], line=lines)
    ranks = np.argsort(
        np.argsort(
            np.concatenate(
                [np.maximum.accumulate(part.time_us) for part in parts]
            ),
            kind="stable",
        )
    )
    ends = np.cumsum([len(part) for part in parts])
    numbered = [
        replace(part, line=ranks[end - len(part) : end] + first_line)
        for part, end in zip(parts, ends.tolist(), strict=True)
    ]
    return join_in_file_order(numbered)

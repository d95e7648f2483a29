"""Tables out of channels with time bases of their own: MF4, AiM XRK and XRZ.

A row is a time at which at least one of the wanted channels has a sample; the
others have none there. Nothing is interpolated. The wanted channels are held
in memory.
"""

from abc import abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import redirect_stdout
from importlib import import_module
from io import StringIO
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import structlog

from bstm_daemon.bus.logs.mf4 import quiet_asammdf
from bstm_daemon.bus.tables.binary import BinarySource, naming_damage
from bstm_daemon.bus.tables.source import Floats, TableChunk, units_in_names
from bstm_daemon.errors import LogError

_MASTERS: Final = (2, 3)
"""Channel types of MDF 4 that are the time base of a group."""
_LAST_NUMBER: Final = 5
"""Data types of MDF 4 up to this one are single numbers."""
_BUS: Final = ("CAN_", "LIN_", "FLX_", "ETH_")
"""How channels of recorded frames begin."""

_NO_GPS: Final = "NULL pointer"
"""What libxrk's default reader says of a recording without GPS. Its second
one, a preview, reads it."""

_log = structlog.get_logger(__name__)


class _ChannelSource(BinarySource):
    """A file of channels, each by its name what :meth:`_read` takes."""

    time = "time"
    _channels: dict[str, Any]
    _units: dict[str, str]

    def names(self) -> list[str]:
        """Return the names of the columns, the time first."""
        return [self.time, *self._channels]

    def units(self) -> dict[str, str]:
        """Return the unit texts that the file states, by column."""
        return units_in_names(self._channels) | self._units | {self.time: "s"}

    def chunks(self, columns: Collection[str]) -> Iterator[TableChunk]:
        """Yield the cells of *columns*; raises :class:`LogError`."""
        series: dict[str, tuple[Floats, Floats]] = {}
        with naming_damage(self._path):
            for name in columns:
                if name != self.time:
                    series[name] = self._numbers(name)
            self._close()
        empty = np.empty(0)
        stamps = np.unique(
            np.concatenate([empty, *(times for times, _ in series.values())])
        )
        rows = {
            name: np.searchsorted(stamps, times)
            for name, (times, _) in series.items()
        }
        for begin in range(0, len(stamps), self._chunk_rows):
            part = stamps[begin : begin + self._chunk_rows]
            cells = {self.time: part}
            for name, (_, values) in series.items():
                place = rows[name] - begin
                here = (place >= 0) & (place < len(part))
                cells[name] = np.full(len(part), np.nan)
                cells[name][place[here]] = values[here]
            self.share = (begin + len(part)) / len(stamps)
            lines = np.arange(begin + 1, begin + len(part) + 1)
            yield TableChunk(len(part), lines, cells)

    def _numbers(self, name: str) -> tuple[Floats, Floats]:
        times, values = self._read(self._channels[name])
        if values.ndim != 1 or values.dtype.kind not in "biuf":
            _log.warning("no single numbers", log=str(self._path), column=name)
            return np.empty(0), np.empty(0)
        good = np.isfinite(times)
        return times[good], values[good].astype(np.float64)

    def _close(self) -> None:
        """Close the file, all that is wanted of it is read."""

    @abstractmethod
    def _read(self, key: Any) -> tuple[Floats, npt.NDArray[Any]]:
        """Return times [s] and values of a channel."""


class XrkSource(_ChannelSource):
    """A recording of an AiM logger (extra ``track``), from its own zero."""

    _module, _extra = "libxrk", "track"
    _kind = "an AiM recording"

    def _open(self, library: Any) -> None:
        # the library prints what it does not know of a file
        with redirect_stdout(StringIO()) as said, np.errstate(all="ignore"):
            try:
                tables = library.aim_xrk(str(self._path)).channels
            except ValueError as error:
                if _NO_GPS not in str(error):
                    raise
                other = import_module("libxrk._aim_xrk_rs")
                tables = other.aim_xrk(str(self._path)).channels
        for line in said.getvalue().splitlines():
            _log.warning("libxrk", log=str(self._path), message=line)
        if not tables:
            msg = f"{self._path}: damaged or no AiM recording: no channel"
            raise LogError(msg)
        self._channels = {n: (table, n) for n, table in tables.items()}
        metadata_of = library.ChannelMetadata.from_channel_table
        units = {n: metadata_of(table).units for n, table in tables.items()}
        self._units = {name: unit for name, unit in units.items() if unit}

    def _read(self, key: Any) -> tuple[Floats, npt.NDArray[Any]]:
        table, name = key
        times_ms = table.column("timecodes").to_numpy()
        return times_ms / 1000.0, table.column(name).to_numpy()


class Mf4Source(_ChannelSource):
    """Decoded signals of an MDF 4 file (extra ``mf4``), since 1970.

    A name that several groups have is followed by the number of its group,
    ``speed#2``. A sample that the file marks invalid is left out, of a value
    with a text the number counts, and a channel of texts is no column.
    """

    _module, _extra = "asammdf", "mf4"
    _kind = "an MF4 log"

    def _open(self, library: Any) -> None:
        with quiet_asammdf():
            options: dict[str, Any] = {"process_bus_logging": False}
            self._mdf = library.MDF(self._path, **options)
        found = [
            (channel, place, number)
            for place, group in enumerate(self._mdf.groups)
            for number, channel in enumerate(group.channels)
            if channel.channel_type not in _MASTERS
            and channel.data_type <= _LAST_NUMBER
            and not channel.name.startswith(_BUS)
        ]
        count = Counter(channel.name for channel, *_ in found)
        self._channels, self._units = {}, {}
        for channel, place, number in found:
            is_single = count[channel.name] == 1
            name = channel.name + ("" if is_single else f"#{place}")
            self._channels[name] = place, number
            if channel.unit:
                self._units[name] = channel.unit
        if not found:
            msg = (
                f"{self._path}: no decoded signal in this MF4 file: raw CAN "
                "frames need [[bus]] with a DBC, and roles with 'message'"
            )
            raise LogError(msg)

    def _read(self, key: Any) -> tuple[Floats, npt.NDArray[Any]]:
        group, index = key
        raw = self._mdf.get(group=group, index=index, raw=True)
        signal = raw.physical(ignore_value2text_conversions=True)
        start_s = self._mdf.header.start_time.timestamp()
        return signal.timestamps + start_s, signal.samples

    def _close(self) -> None:
        self._mdf.close()

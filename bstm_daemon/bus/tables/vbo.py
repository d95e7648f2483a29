"""Racelogic VBO: a text of sections, the last of them rows of cells.

``[header]`` lists the channels by their long names, ``[column names]`` the
same by short ones, which are the names of the columns. A standard channel has
its unit in the long name (``velocity kmh``); ``[channel units]`` has those of
the last channels, which come from a CAN bus or an input module.
"""

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Final

import structlog

from bstm_daemon.bus.tables.csv_table import CsvSource, Head
from bstm_daemon.bus.tables.source import units_in_names
from bstm_daemon.errors import LogError

_ROWS: Final = "[data]"
_HEAD_LINES: Final = 10_000
_NO_UNIT: Final = ("", "(null)")
_STANDARD: Final = {"time": "hhmmss", "height": "m", "heading": "deg"}
"""Units of the channels whose long names have none."""

_log = structlog.get_logger(__name__)


class VboSource(CsvSource):
    """A VBO file; the time is that of day, hhmmss.ss in UTC."""

    time = "time"

    def _first(self, raw: Iterator[bytes]) -> list[bytes]:
        first = []
        for line in islice(raw, _HEAD_LINES):
            first.append(line)
            if line.strip().lower() == _ROWS.encode():
                break
        return first

    def _head_of(self, lines: Sequence[str]) -> Head:
        sections: dict[str, list[str]] = {}
        section: list[str] = []
        for line in map(str.strip, lines):
            if line.startswith("["):
                section = sections.setdefault(line.lower(), [])
            else:
                section.append(line)
        names = " ".join(sections.get("[column names]", [])).split()
        if not names or _ROWS not in sections:
            missing = _ROWS if names else "[column names]"
            msg = (
                f"{self._path}: no section {missing} up to line {len(lines)}: "
                "a VBO file has [header], [column names] and [data]"
            )
            raise LogError(msg)
        units = self._units_of(
            names,
            list(filter(None, sections.get("[header]", []))),
            sections.get("[channel units]", []),
        )
        return Head(names, " ", len(lines), units=units)

    def _units_of(
        self, names: list[str], channels: list[str], listed: list[str]
    ) -> dict[str, str]:
        units = {name: _STANDARD[name] for name in names if name in _STANDARD}
        # one blank line ends the section; more may be channels without unit
        texts = listed[:-1] if listed[-1:] == [""] else listed
        if len(channels) != len(names) or texts[-1:] == [""]:
            _log.warning(
                "units unknown: [header], [channel units] and [column names] "
                "do not fit each other",
                log=str(self._path),
                channels=len(channels),
                columns=len(names),
            )
            return units
        in_names = units_in_names(channels)
        units |= {
            name: in_names[channel]
            for name, channel in zip(names, channels, strict=True)
            if channel in in_names
        }
        last = zip(reversed(names), reversed(texts), strict=False)
        return units | {n: text for n, text in last if text not in _NO_UNIT}

"""The frames of a log as an MF4 file, and asammdf's own way to its signals.

For comparison with a reader that is not ours: asammdf extracts a bus logging
with a DBC into one group a message, all of its signals, as arrays.
"""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.bus.opening import open_log
from bstm_daemon.bus.signals.frame_chunk import join_in_file_order
from bstm_daemon.files import shipped_file

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from bstm_daemon.bus.signals.signal_map import SignalMap

_FRAME: Final = "CAN_DataFrame"
_FIELDS: Final = (
    *(("BusChannel", "u1"), ("ID", "<u4"), ("IDE", "u1"), ("DLC", "u1")),
    *(("DataLength", "u1"), ("DataBytes", "(8,)u1"), ("Dir", "u1")),
    *(("EDL", "u1"), ("BRS", "u1"), ("ESI", "u1")),
)
_CAN_SOURCE: Final = ("CAN", "", "", 2, 2)
"""Name, path, comment, source type bus, bus type CAN."""


@cache
def _database() -> Any:
    from asammdf.blocks.utils import load_can_database  # noqa: PLC0415

    return load_can_database(shipped_file("dbc/example_vehicle.dbc"))


def write_mf4(path: Path, log: Path) -> None:
    """Write all frames of *log*, classic ones of one interface, as MF4."""
    import asammdf  # noqa: PLC0415  (an extra)

    frames = join_in_file_order(list(open_log(log).chunks()))
    records = np.zeros(
        len(frames), [(f"{_FRAME}.{name}", kind) for name, kind in _FIELDS]
    )
    for name, column in (
        ("ID", frames.can_id),
        ("IDE", frames.extended),
        ("DLC", frames.length),
        ("DataLength", frames.length),
        ("DataBytes", frames.data),
    ):
        records[f"{_FRAME}.{name}"] = column
    start_s = int(frames.time_us[0]) // 1_000_000
    mdf: Any = asammdf.MDF(version="4.11")
    mdf.header.start_time = datetime.fromtimestamp(start_s, UTC)
    mdf.append(
        asammdf.Signal(
            samples=records,
            timestamps=(frames.time_us - start_s * 1_000_000) / 1e6,
            name=_FRAME,
            source=asammdf.Source(*_CAN_SOURCE),
        )
    )
    mdf.save(path)
    mdf.close()


def with_asammdf(
    path: Path, signal_map: SignalMap
) -> dict[int, tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]]:
    """Return stamps [us] and SI values by role, as asammdf extracts them.

    The DBC is the example car's. asammdf decodes all signals of the
    messages that it has; only the wanted ones are fetched.
    """
    import asammdf  # noqa: PLC0415

    found = {}
    with asammdf.MDF(path) as mdf:
        start_us = round(mdf.header.start_time.timestamp() * 1e6)
        extracted = mdf.extract_bus_logging({"CAN": [(_database(), 0)]})
        for plan in signal_map.messages.values():
            for output in plan.outputs:
                signal = extracted.get(
                    plan.signals[output.index].name, raw=True
                ).physical(copy=False, ignore_value2text_conversions=True)
                stamps = np.rint(signal.timestamps * 1e6).astype(np.int64)
                values = output.gain * signal.samples + output.bias
                found[output.role] = (start_us + stamps, values)
        extracted.close()
    return found

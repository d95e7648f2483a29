"""The files that a simulated drive leaves: a candump log and the truth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.files import replacing
from bstm_daemon.roles import CORNERS
from bstm_daemon.simulation.frames import START_STAMP_S, Encoder, in_order
from bstm_daemon.simulation.profile import SAMPLE_S
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bstm_daemon.simulation.simulate import SimulatedDrive

_LINES_A_WRITE: Final = 50_000


def write_candump(
    path: Path,
    drive: SimulatedDrive,
    encoder: Encoder,
    *,
    channel: str = "can0",
    start_stamp_s: float = START_STAMP_S,
    progress: Callable[[float], None] = lambda _: None,
) -> int:
    """Write *drive* as a candump log to *path*; returns the frames written.

    The file appears whole or not at all; *progress* is called with the share
    that is written. Raises :class:`~bstm_daemon.errors.FileAccessError` if it
    cannot be written.
    """
    streams = encoder.streams(drive)
    heads = [f" {channel} {s.frame_id:03X}#" for s in streams]
    digits = [2 * s.length for s in streams]
    start_us = round(start_stamp_s * 1e6)
    count = 0
    with replacing(path) as part, part.open("w", encoding="ascii") as file:
        lines: list[str] = []
        for which, stamp_us, data in in_order(streams):
            seconds, micros = divmod(start_us + stamp_us, 1_000_000)
            text = data.hex().upper()[: digits[which]]
            lines.append(f"({seconds}.{micros:06d}){heads[which]}{text}\n")
            count += 1
            if len(lines) == _LINES_A_WRITE:
                file.writelines(lines)
                lines.clear()
                progress(stamp_us * 1e-6 / drive.time_s[-1])
        file.writelines(lines)
    return count


def write_samples(path: Path, drive: SimulatedDrive) -> None:
    """Write the sensors' samples of *drive*, without frames, to *path*.

    A NumPy archive: ``time_s`` (n,) with an array (n,) per vehicle role, and
    ``slow_time_s`` (m,) with one (m,) per measured temperature; SI.
    Raises :class:`~bstm_daemon.errors.FileAccessError`.
    """
    with replacing(path) as part, part.open("wb") as file:
        np.savez_compressed(
            file,
            allow_pickle=False,
            time_s=drive.time_s,
            slow_time_s=drive.slow_time_s,
            **drive.roles,
            **drive.temperatures,
        )


def write_truth(path: Path, drive: SimulatedDrive) -> None:
    """Write the truth of *drive* to the CSV file *path*, a row a second.

    Columns: ``time_s``, ``speed_ms``, ``slope_rad``, and for each corner
    ``<corner>.<node>_c`` and ``<corner>.brake_energy_j``.
    Raises :class:`~bstm_daemon.errors.FileAccessError`.
    """
    rows = np.minimum(
        np.rint(drive.slow_time_s / SAMPLE_S).astype(int),
        len(drive.time_s) - 1,
    )
    columns = {
        "time_s": drive.slow_time_s,
        "speed_ms": drive.course.speed_ms[rows],
        "slope_rad": drive.course.slope_rad[rows],
    }
    for lane, corner in enumerate(CORNERS):
        energy = drive.brake_energy_j[:, lane]
        columns[f"{corner}.brake_energy_j"] = energy
    for node, series in drive.truth.items():
        columns[f"{node}_c"] = series - KELVIN_OFFSET
    table = np.column_stack(list(columns.values()))
    with replacing(path) as part, part.open("w", encoding="ascii") as file:
        file.write(",".join(columns) + "\n")
        for row in table.tolist():
            file.write(",".join(f"{value:.9g}" for value in row) + "\n")

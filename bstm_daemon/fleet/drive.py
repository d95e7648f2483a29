"""One drive of a lake: the task that a worker runs."""

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import FileAccessError, LogError, UsageError
from bstm_daemon.estimate import Reason
from bstm_daemon.estimator.memory import after_unseen_drive
from bstm_daemon.estimator.start import PUBLISHED_NODES
from bstm_daemon.files import make_folder, replacing
from bstm_daemon.fleet.lake import (
    Drive,
    Lake,
    Options,
    Receipt,
    hash_of_config,
    hash_of_file,
    key_of,
    program,
)
from bstm_daemon.model.wear.table import WEAR_COLUMNS
from bstm_daemon.replay.columns import Run, stream_log
from bstm_daemon.replay.results import (
    WRITERS,
    Chosen,
    Part,
    Results,
    is_one_of_few,
)
from bstm_daemon.replay.vehicle import load_vehicle
from bstm_daemon.report import drive_statistics
from bstm_daemon.service import state_file

MADE: Final = 0
SKIPPED: Final = 1
FAILED: Final = 2
FOREIGN: Final = 3
"""What a task returns: a number, so that a worker that is lost takes no result
with it. FOREIGN: the worker runs another program."""

RISKS: Final = ("risk", "risk_start_known")
"""The highest of a drive, and of the time in which its start has no effect."""

_CORNER_NUMBERS: Final = (
    *(f"{node}_peak_c" for node in drive_statistics.SUMMARY_NODES),
    *("margin_k", "brake_energy_j"),
    *RISKS,
    *drive_statistics.VALIDITY_NAMES,
    *WEAR_COLUMNS,
)
LEARNED: Final = ("mass_kg", "friction_scale", "drag_scale", "accel_bias_ms2")


@dataclass(frozen=True)
class Job:
    """A drive to replay behind *previous*, None for the first of a car.

    ``previous_key`` is the key of that one, empty without. ``program`` is
    that of the client, ``config_hash`` that of the configuration then.
    """

    root: str
    drive: Drive
    previous: Drive | None
    previous_key: str
    options: Options
    config_hash: str
    program: dict[str, str]


def replay_drive(job: Job) -> int:
    """Replay the drive of *job*, write its results and then its receipt.

    Returns:
        MADE, SKIPPED, FAILED or FOREIGN.
    """
    if job.program != program():
        return FOREIGN
    lake, drive = Lake(Path(job.root)), job.drive
    key = log_hash = ""
    try:
        _check_unchanged(drive)
        log_hash = hash_of_file(Path(drive.log))
        key = key_of(
            job.previous_key, drive, log_hash, job.config_hash, job.options
        )
        found = lake.receipt(drive)
        if found is not None and lake.is_made(drive, found, key):
            if (found.size, found.mtime_ns) != (drive.size, drive.mtime_ns):
                _write_receipt(
                    lake, job, (key, log_hash), found.last_us, found.message
                )
            return SKIPPED
        lake.clear(drive)
        last_us = _make(lake, job)
    except Exception as error:  # noqa: BLE001  (a log may hold anything)
        if isinstance(error, LogError):
            fail_drive(job, str(error), key, log_hash)
        else:
            fail_drive(job, f"{type(error).__name__}: {error}")
        return FAILED
    _write_receipt(lake, job, (key, log_hash), last_us)
    return MADE


def fail_drive(
    job: Job, message: str, key: str = "", log_hash: str = ""
) -> None:
    """Note that the drive of *job* failed, so that the next one can follow.

    The state before it becomes that behind it, as after a drive that nobody
    saw.
    """
    lake, drive = Lake(Path(job.root)), job.drive
    lake.clear(drive)
    try:
        document = _state_before(lake, job.previous)
    except FileAccessError:
        document = None
    if document is not None:
        marked = after_unseen_drive(document)
        state_file.save(lake.path(drive, "state"), state_file.encode(marked))
    before = lake.receipt(job.previous) if job.previous else None
    last_us = before.last_us if before else None
    _write_receipt(lake, job, (key, log_hash), last_us, message)


def _write_receipt(
    lake: Lake,
    job: Job,
    hashes: tuple[str, str],
    last_us: int | None,
    message: str | None = None,
) -> None:
    """Write the receipt of *job*, failed where there is a *message*.

    *hashes* are the key, empty where a new attempt may end otherwise, and
    that of the log.
    """
    drive = job.drive
    receipt = Receipt(
        *hashes,
        drive.size,
        drive.mtime_ns,
        message,
        last_us,
        job.options,
        program(),
    )
    lake.write_receipt(drive, receipt)


def _check_unchanged(drive: Drive) -> None:
    try:
        stat = Path(drive.log).stat()
    except OSError as error:
        msg = f"{drive.log}: {error.strerror}"
        raise FileAccessError(msg) from error
    if (stat.st_size, stat.st_mtime_ns) != (drive.size, drive.mtime_ns):
        msg = f"{drive.log}: has changed since 'bstm fleet plan'"
        raise FileAccessError(msg)


def _state_before(lake: Lake, previous: Drive | None) -> dict[str, Any] | None:
    """Return the state that the drive behind *previous* begins from.

    None where no drive of the car before it could be replayed.

    Raises:
        FileAccessError: it is unusable.
    """
    if previous is None:
        return None
    loaded = state_file.read(lake.path(previous, "state"))
    if loaded.problem:
        raise FileAccessError(loaded.problem)
    return loaded.document


@lru_cache(maxsize=8)
def _vehicle(config: str, expected: str) -> tuple[Config, SignalMap]:
    """Return the vehicle of *config*, whose hash is as *expected*."""
    if hash_of_config(Path(config)) != expected:
        msg = f"{config}: has changed since this run began"
        raise UsageError(msg)
    return load_vehicle(Path(config), quiet=True)


def _make(lake: Lake, job: Job) -> int:
    """Write estimates, row and state of the drive; return its last stamp."""
    drive, previous = job.drive, job.previous
    if drive.problem is not None:
        raise LogError(drive.problem)
    before = lake.receipt(previous) if previous else None
    if previous and before and (before.last_us or 0) >= drive.first_us:
        msg = (
            f"{drive.log}: begins before the end of a log before it: "
            f"{previous.log}"
        )
        raise LogError(msg)
    document = _state_before(lake, previous)
    config, signal_map = _vehicle(drive.config, job.config_hash)
    estimates, row, state = lake.files(drive)
    make_folder(estimates.parent)
    make_folder(row.parent)
    statistics = drive_statistics.DriveStatistics()
    extremes = _Extremes(forecast=job.options.forecast)
    with WRITERS["parquet"](estimates) as table:
        run = stream_log(
            config,
            signal_map,
            Path(drive.log),
            [Chosen(table, _is_kept)],
            overrides=json.loads(drive.map),
            every_us=job.options.every_us,
            state=document,
            forecast=job.options.forecast,
            summaries=[statistics, extremes],
        )
    after_hole = before is not None and before.message is not None
    _write_row(
        row, _row(drive, statistics, extremes, run, after_hole=after_hole)
    )
    state_file.save(state, state_file.encode(run.state))
    last_us: int = run.state["time_us"]
    return last_us


def _is_kept(name: str) -> bool:
    """Whether the column *name* is in a lake: of the nodes the published."""
    own = name.rpartition(".")[2]
    if own.endswith("_c"):
        return own.removesuffix("_c") in PUBLISHED_NODES
    return is_one_of_few(name) or own == "reasons"


class _Extremes:
    """Keeps the last row, and the highest risks."""

    def __init__(self, *, forecast: bool) -> None:
        self.parts = Part.ALL if forecast else Part.VALIDITY
        self.last: dict[str, float] = {}
        self.most: dict[str, float] = {}

    def write(self, rows: Results) -> None:
        columns = rows.columns
        self.last |= {n: float(c[-1]) for n, c in columns.items()}
        for corner in rows.modelled if "risk" in columns else ():
            risk = columns[f"{corner}.risk"]
            why = columns[f"{corner}.reasons"].astype(int)
            known = why & Reason.START_UNKNOWN == 0
            self._note_most(f"{corner}.risk", risk)
            self._note_most(f"{corner}.risk_start_known", risk[known])

    def _note_most(self, name: str, column: npt.NDArray[np.float64]) -> None:
        known = column[np.isfinite(column)]
        if len(known):
            most = self.most.get(name, 0.0)
            self.most[name] = max(most, float(known.max()))


def _row(
    drive: Drive,
    statistics: drive_statistics.DriveStatistics,
    rows: _Extremes,
    run: Run,
    *,
    after_hole: bool,
) -> dict[str, Any]:
    """Return the one row about *drive*."""
    summary = statistics.summary()
    corners = [_corner(one, rows) for one in summary.corners if one.modelled]
    refused = {k: int(v) for k, v in sorted(run.refused.items()) if v}
    return {
        "log": drive.log,
        "name": drive.name,
        "type": drive.type,
        "begin": datetime.fromtimestamp(drive.first_us * 1e-6, UTC),
        "duration_s": summary.duration_s,
        "distance_m": summary.distance_m,
        "top_speed_ms": summary.top_speed_ms,
        "after_hole": after_hole,
        "start_known_s": run.start_known_s,
        "truncated": run.truncated,
        "refused": sum(refused.values()),
        "refused_by_reason": json.dumps(refused),
        "clock_jumps": run.counts["jumps"],
        "findings": [one.text for one in summary.findings],
        "reasons": [one.text for one in summary.reasons],
        **{name: _number(rows.last.get(name)) for name in LEARNED},
        "corners": corners,
    }


def _corner(
    one: drive_statistics.CornerSummary, rows: _Extremes
) -> dict[str, Any]:
    peaks = {
        f"{node}_peak_c": peak.temperature_c
        for node, peak in one.peaks.items()
    }
    fluid = one.peaks.get("fluid")
    shares = one.validity_shares or (None, None, None)
    return {
        **{
            n: _number(rows.last.get(f"{one.corner}.{n}"))
            for n in WEAR_COLUMNS
        },
        **dict(zip(drive_statistics.VALIDITY_NAMES, shares, strict=True)),
        **peaks,
        "corner": one.corner,
        "fluid_peak_validity": fluid.validity if fluid else None,
        "margin_k": one.margin_k,
        **{n: rows.most.get(f"{one.corner}.{n}") for n in RISKS},
        "brake_energy_j": one.energies_j[0],
    }


def _number(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def _write_row(path: Path, row: dict[str, Any]) -> None:
    import pyarrow as pa  # noqa: PLC0415  (an extra)
    from pyarrow import parquet  # noqa: PLC0415

    real, whole, text = pa.float64(), pa.int64(), pa.string()
    corner = {"corner": text, "fluid_peak_validity": whole}
    corner |= dict.fromkeys(_CORNER_NUMBERS, real)
    kinds = {
        "begin": pa.timestamp("us", tz="UTC"),
        "corners": pa.list_(pa.struct(list(corner.items()))),
        **dict.fromkeys(("log", "name", "type", "refused_by_reason"), text),
        **dict.fromkeys(("after_hole", "truncated"), pa.bool_()),
        **dict.fromkeys(("refused", "clock_jumps"), whole),
        **dict.fromkeys(("findings", "reasons"), pa.list_(text)),
    }
    schema = pa.schema([(name, kinds.get(name, real)) for name in row])
    with replacing(path) as temporary:
        table = pa.Table.from_pylist([row], schema)
        parquet.write_table(table, temporary, compression="zstd")

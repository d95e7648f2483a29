"""The functions of ``from bstm_daemon import ...``: files in, objects out.

Paths may be texts. Every function raises what its command reports: a
:class:`~bstm_daemon.errors.BstmError` whose text names file and key.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from bstm_daemon import simulation
from bstm_daemon.analysis.gap import workflow as gap_workflow
from bstm_daemon.analysis.gap.calibration import Calibration
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.matching.coarse import guesses_of
from bstm_daemon.files import shipped_file
from bstm_daemon.replay.columns import stream_log
from bstm_daemon.replay.results import Collector, Results
from bstm_daemon.replay.vehicle import load_vehicle
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from bstm_daemon.analysis.gap.workflow import Gap
    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

File = str | Path


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A configuration that was read and checked, with its DBC files."""

    path: Path
    config: Config
    signal_map: SignalMap


def load_config(path: File) -> Vehicle:
    """Read and check a configuration and its DBC files.

    Args:
        path: the configuration (TOML).

    Returns:
        The vehicle; ``vehicle.config`` has the values by section and key.

    Raises:
        ConfigError: with every problem.
        FileAccessError: a file is missing or unreadable.
    """
    return Vehicle(Path(path), *load_vehicle(Path(path)))


def replay(
    log: File,
    vehicle: Vehicle,
    *,
    start: Literal["unknown", "cold"] = "unknown",
    every_s: float = 0.1,
) -> Results:
    """Estimate the brake temperatures of a log, as ``bstm replay`` does.

    Args:
        log: frames or a signal table.
        vehicle: of :func:`load_config`.
        start: ``cold`` where the brakes were as cold as the air.
        every_s: time between rows [s], a multiple of 0.1 s.

    Returns:
        ``columns`` by name, one value a row: ``time_s``, ``FL.disc_c`` ...

    Raises:
        LogError: the log is unusable, or has none of the signals.
        FileAccessError: it can not be read.
    """
    rows = Collector()
    stream_log(
        vehicle.config,
        vehicle.signal_map,
        Path(log),
        [rows],
        every_us=round(every_s * 1e6),
        state="cold" if start == "cold" else None,
    )
    return rows.results()


def simulate(
    drive: File,
    *,
    effects: Mapping[str, float] | None = None,
    sensors: str = "none",
    seed: int = 0,
    log: File | None = None,
) -> simulation.SimulatedDrive:
    """Drive the simulated car, as ``bstm simulate`` does.

    Args:
        drive: a name of ``bstm simulate --list``, or a TOML file.
        effects: strength of effects of its brakes by name, 1 is typical.
        sensors: errors of the sensors, ``none`` or ``n1`` to ``n4``.
        seed: of the sensors' noise.
        log: candump log to write, which :func:`replay` reads.

    Returns:
        What happened and what the sensors showed, in SI.

    Raises:
        UsageError: no such drive, effect or sensors.
        ConfigError: the file is no drive.
        FileAccessError: *log* can not be written.
    """
    strengths = simulation.preset_effects("plain")
    for name, strength in (effects or {}).items():
        strengths = strengths.with_strength(name, strength)
    path = Path(drive)
    read = simulation.read_drive(path) if path.suffix == ".toml" else None
    driven = simulation.simulate(
        read or simulation.load_drive(str(drive)),
        preset=strengths,
        sensors=sensors,
        seed=seed,
    )
    if log is not None:
        encoder = Encoder(shipped_file("dbc/example_vehicle.dbc"))
        write_candump(Path(log), driven, encoder)
    return driven


def match(
    logs: Iterable[File], vehicle: Vehicle, *, plain: bool = False
) -> list[Match]:
    """Match the model to drives with thermocouples, as ``bstm match`` does.

    Args:
        logs: drives with measured temperatures, in the order driven.
        vehicle: of :func:`load_config`.
        plain: match once, and search for nothing that may be missing.

    Returns:
        A match for each set of corners that are alike: ``joint.values``,
        their uncertainty, and ``verdict`` where a part may be missing.

    Raises:
        LogError: a log is unusable, or none has a thermocouple.
    """
    paths = [Path(log) for log in logs]
    guessed = guesses_of(vehicle.path)
    calibration = Calibration(paths, vehicle.signal_map)
    return calibration.run(
        vehicle.config, guessed, plain=plain
    ).matched.matches


def find_gap(
    logs: Iterable[File], vehicle: Vehicle, holdout: Iterable[File] = ()
) -> list[Gap]:
    """Find the effect that a model lacks, as ``bstm gap run --anyway``.

    Args:
        logs: drives with measured temperatures.
        vehicle: of :func:`load_config`, matched.
        holdout: drives that are not fitted, for before and after.

    Returns:
        What was found on each set of corners that are alike; ``adopted``
        names the effects that close the gap.

    Raises:
        LogError: a log is unusable, or none has a thermocouple.
    """
    fitted, held_out = (
        [
            read_recording(Path(log), vehicle.config, vehicle.signal_map)
            for log in some
        ]
        for some in (logs, holdout)
    )
    return gap_workflow.find_gap(vehicle.config, fitted, held_out)

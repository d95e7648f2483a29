"""A simulated drive as CAN frames, as a candump log, and its truth.

Frames are encoded with the example car's DBC, whole columns at a time. Each
message is sent at its cycle time from the DBC, staggered within it; car
messages stop with the ignition, thermocouple messages when their logger does.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message, Signal

from bstm_daemon.bus.signals.dbc import load_dbc
from bstm_daemon.errors import ConfigError
from bstm_daemon.files import replacing
from bstm_daemon.roles import CORNERS
from bstm_daemon.simulation.materials import Array
from bstm_daemon.simulation.profile import SAMPLE_S
from bstm_daemon.simulation.sensors import INSTRUMENTED
from bstm_daemon.simulation.simulate import SimulatedDrive
from bstm_daemon.units import KELVIN_OFFSET, UNITS

START_STAMP_S: Final = 1_700_000_000.0
"""Stamp of a log's first sample: fixed, so that logs are reproducible."""

_STAGGER_US: Final = 1300

VEHICLE_SIGNALS: Final[dict[str, dict[str, str]]] = {
    "Powertrain": {
        "WheelTorque": "powertrain_torque",
        "MotorTorque": "motor_torque",
        "EngineSpeed": "engine_speed",
        "Gear": "gear",
        "ClutchOpen": "clutch_open",
    },
    "WheelSpeeds": {
        f"WheelSpeed{corner}": f"wheel_speed_{corner.lower()}"
        for corner in CORNERS
    },
    "BrakePressure": {
        "PressurePrimary": "primary_pressure",
        "PressureSecondary": "secondary_pressure",
    },
    "Inertial": {
        "AccelLongitudinal": "acceleration_longitudinal",
        "AccelLateral": "acceleration_lateral",
        "YawRate": "yaw_rate",
        "VehicleSpeed": "vehicle_speed",
    },
    "BrakeTorque": {"BrakeTorqueTotal": "brake_torque"},
    "Body": {
        "BrakeSwitch": "brake_switch",
        "Ignition": "ignition",
        "ParkBrake": "park_brake",
        "AbsActive": "abs_active",
        "EscActive": "esc_active",
        "TcActive": "tc_active",
        "PedalTravel": "brake_pedal_travel",
    },
    "ExternalForce": {"ExternalForce": "external_force"},
    "Ambient": {
        "AmbientTemperature": "ambient_temperature",
        "RainIntensity": "rain",
    },
    "Satellites": {"GnssSpeed": "gnss_speed"},
}
"""Message and signal of the example DBC to the role it carries."""

LOGGER_SIGNALS: Final[dict[str, dict[str, str]]] = {
    f"Thermocouples{part}_{corner}": {
        f"Temp{signal}_{corner}": f"temp_{corner.lower()}_{node}"
        for signal, node in nodes
    }
    for corner in INSTRUMENTED
    for part, nodes in (
        (
            "A",
            (
                ("Disc", "disc"),
                ("Disc2", "disc_2"),
                ("PadFront", "pad_front"),
                ("PadBack", "pad_back"),
            ),
        ),
        ("B", (("Fluid", "fluid"), ("Caliper", "caliper"))),
    )
}
"""Layout of the measuring system's messages."""


class SentFrame(NamedTuple):
    """One frame on the simulated bus."""

    stamp_s: float
    frame_id: int
    data: bytes


class Stream(NamedTuple):
    """All frames of one message: send times and payloads."""

    frame_id: int
    length: int
    stamp_us: npt.NDArray[np.int64]
    payload: npt.NDArray[np.uint64]


class Encoder:
    """Packs roles into the frames of a DBC, column by column."""

    def __init__(self, database: Path) -> None:
        """Load *database*, the example car's DBC.

        Raises :class:`~bstm_daemon.errors.ConfigError`, which lists the
        messages and signals that are missing.
        """
        loaded = load_dbc(database, strict=True, encoding="cp1252")
        by_name = {message.name: message for message in loaded.messages}
        self._messages: list[tuple[Message, dict[str, str], bool]] = []
        problems = []
        for table, car in ((VEHICLE_SIGNALS, True), (LOGGER_SIGNALS, False)):
            for name, signals in table.items():
                message = by_name.get(name)
                if message is None:
                    problems.append(f"{database}: no message {name!r}")
                    continue
                problems += _unfit(message, signals, str(database))
                self._messages.append((message, signals, car))
        if problems:
            raise ConfigError(problems)

    def streams(self, drive: SimulatedDrive) -> list[Stream]:
        """Return every frame of *drive*, one stream a message."""
        return [
            _stream(drive, message, signals, car=car, order=order)
            for order, (message, signals, car) in enumerate(self._messages)
        ]


def _unfit(
    message: Message, signals: dict[str, str], database: str
) -> list[str]:
    where = f"{database}: message {message.name!r}"
    known = {signal.name: signal for signal in message.signals}
    problems = [
        f"{where}: no signal {name!r}" for name in signals if name not in known
    ]
    problems += [
        f"{where}: signal {name!r} is not Intel byte order"
        for name in signals
        if name in known and known[name].byte_order != "little_endian"
    ]
    if not message.cycle_time:
        problems.append(f"{where}: no GenMsgCycleTime")
    return problems


def _stream(
    drive: SimulatedDrive,
    message: Message,
    signals: dict[str, str],
    *,
    car: bool,
    order: int,
) -> Stream:
    cycle_us = (message.cycle_time or 0) * 1000
    total_us = round(len(drive.time_s) * SAMPLE_S * 1e6)
    sent_us = np.arange(
        order * _STAGGER_US % cycle_us, total_us, cycle_us, dtype=np.int64
    )
    sample = sent_us // round(SAMPLE_S * 1e6)
    on = (drive.bus_on if car else drive.logger_on)[sample]
    sent_us, sample = sent_us[on], sample[on]
    payload = np.zeros(len(sample), dtype=np.uint64)
    for name, role in signals.items():
        signal = message.get_signal_by_name(name)
        if car:
            values = drive.roles[role][sample]
        else:
            row = np.searchsorted(drive.slow_time_s, sent_us * 1e-6, "right")
            values = drive.temperatures[role][np.maximum(row - 1, 0)]
        payload |= _raw_bits(signal, values)
    return Stream(message.frame_id, message.length, sent_us, payload)


def _raw_bits(signal: Signal, si: Array) -> npt.NDArray[np.uint64]:
    """Return *si* as this signal's bits in place, limited to its range."""
    unit = UNITS[signal.unit or "1"]
    values = (si - unit.offset) / unit.factor
    low = -(1 << (signal.length - 1)) if signal.is_signed else 0
    high = low + (1 << signal.length) - 1
    raw = np.rint((values - signal.offset) / signal.scale)
    limit = signal.minimum, signal.maximum
    if limit[0] is not None and limit[1] is not None:
        ends = (np.array(limit) - signal.offset) / signal.scale
        low, high = max(low, int(ends.min())), min(high, int(ends.max()))
    bits = np.clip(raw, low, high).astype(np.int64).astype(np.uint64)
    mask = np.uint64((1 << signal.length) - 1)
    placed: npt.NDArray[np.uint64] = (bits & mask) << np.uint64(signal.start)
    return placed


def frames(
    drive: SimulatedDrive,
    encoder: Encoder,
    start_stamp_s: float = START_STAMP_S,
) -> Iterator[SentFrame]:
    """Yield the frames of *drive* in the order of their stamps."""
    streams = encoder.streams(drive)
    for which, stamp_us, data in in_order(streams):
        stream = streams[which]
        yield SentFrame(
            start_stamp_s + stamp_us * 1e-6,
            stream.frame_id,
            data[: stream.length],
        )


def in_order(streams: list[Stream]) -> Iterator[tuple[int, int, bytes]]:
    """Yield (stream, stamp in us, eight bytes) by stamp, then by stream."""
    stamps = np.concatenate([s.stamp_us for s in streams])
    payloads = np.concatenate([s.payload for s in streams])
    which = np.repeat(
        np.arange(len(streams)), [len(s.stamp_us) for s in streams]
    )
    order = np.argsort(stamps, kind="stable")
    octets = payloads[order].astype("<u8").tobytes()
    for row, (stream, stamp) in enumerate(
        zip(which[order].tolist(), stamps[order].tolist(), strict=True)
    ):
        yield stream, stamp, octets[8 * row : 8 * row + 8]


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

"""A simulated car whose DBC is written in the style of a large maker's.

Several signals of each kind, of which one plays the role: requests beside
measurements, another clutch, a lamp request that stays 0, accelerations with
an offset or without gravity. Launches spin the rear wheels, and the released
master cylinder reads 0.4 to 0.7 bar.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.profile import SAMPLE_S
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    Series = npt.NDArray[np.float64]

RADIUS_M: Final = 0.342
EVERY: Final = 2
"""A frame every 20 ms."""

DRIVE: Final = """
[drive]
name = "launches"
description = "launches with wheelspin, bends, hills and stops"
propulsion = "engine"
[[segment]]
parked = true
duration_s = 5.0
[[segment]]
repeat = 3
[[segment.segment]]
speed_kmh = 55.0
rate_ms2 = 3.5
gear = 1
[[segment.segment]]
until_speed_kmh = 54.0
gear = 0
[[segment.segment]]
speed_kmh = 90.0
rate_ms2 = 2.0
gear = 2
duration_s = 12.0
[[segment.segment]]
until_speed_kmh = 89.0
gear = 0
[[segment.segment]]
speed_kmh = 100.0
rate_ms2 = 1.2
gear = 4
duration_s = 14.0
grade_percent = 4.0
[[segment.segment]]
speed_kmh = 60.0
rate_ms2 = 3.0
gear = 4
[[segment.segment]]
speed_kmh = 45.0
rate_ms2 = 1.0
gear = 3
duration_s = 12.0
bend_radius_m = 40.0
[[segment.segment]]
speed_kmh = 80.0
rate_ms2 = 1.5
gear = 3
duration_s = 10.0
grade_percent = -4.0
[[segment.segment]]
until_speed_kmh = 78.0
gear = 0
[[segment.segment]]
speed_kmh = 20.0
rate_ms2 = 5.0
gear = 3
[[segment.segment]]
speed_kmh = 20.0
gear = 2
duration_s = 8.0
bend_radius_m = -15.0
[[segment.segment]]
speed_kmh = 0.0
rate_ms2 = 2.0
gear = 0
[[segment.segment]]
parked = true
duration_s = 6.0
brake_pressure_bar = 12.0
[[segment]]
parked = true
duration_s = 6.0
"""

ROLES: Final = {
    **{
        f"wheel_speed_{corner}": f"Whl{corner.title()}_W_Meas"
        for corner in ("fl", "fr", "rl", "rr")
    },
    "vehicle_speed": "Veh_V_ActlBrk",
    "primary_pressure": "MstrCylPress",
    "acceleration_longitudinal": "VehLongAccel_A_Actl",
    "acceleration_lateral": "VehLatAccel_A_Actl",
    "yaw_rate": "VehYaw_W_Actl",
    "powertrain_torque": "WhlTqTot_Actl",
    "engine_speed": "EngAout_N_Actl",
    "gear": "GearEngd",
    "clutch_open": "ClutchOpen_B_Actl",
    "brake_torque": "BrkTqMeas",
    "ambient_temperature": "AirAmb_Te_Actl",
    "brake_switch": "BrkPedalPressed_B",
    "park_brake": "PrkBrkActv_B_Actl",
}
"""The signal of each role that the drive shows."""

Table = dict[str, dict[str, tuple[str, float, "Series"]]]


@cache
def table() -> tuple[Series, Table]:
    """Return the time, and by message and signal unit, scale and values."""
    drive = simulate(parse_drive(DRIVE, "launches"), sensors="n2", seed=5)
    read = {
        role: np.asarray(values)[::EVERY]
        for role, values in drive.roles.items()
    }
    time_s = np.asarray(drive.time_s)[::EVERY]
    step_s = EVERY * SAMPLE_S
    rng = np.random.default_rng(11)

    def noise(size: float) -> Series:
        return rng.normal(0.0, size, len(time_s))

    speed = read["vehicle_speed"]
    over_ground = np.gradient(_smooth(speed, 0.3, step_s), step_s)
    measured = read["acceleration_longitudinal"]
    braking = read["primary_pressure"] > 0.3e5
    torque = read["brake_torque"] / 0.6
    # the released pedal returns to another place each time
    rest = 0.55e5 + 0.15e5 * np.sin(0.05 * time_s)
    gear = read["gear"]
    parked = np.zeros_like(speed)
    parked[time_s < 4.0] = 1.0
    parked[time_s > time_s[-1] - 4.0] = 1.0
    ac_clutch = (time_s % 37.0 < 16.0).astype(np.float64)
    # the driven wheels spin in the launches, the others turn on circles
    spin = np.clip((over_ground - 2.5) / 1.0, 0.0, 1.0) * 0.35
    spin *= np.clip((22.0 - speed) / 12.0, 0.0, 1.0)
    turned = {
        corner: read[f"wheel_speed_{corner}"] * (1 + spin * (corner[0] == "r"))
        + (0.8 if corner[1] == "r" else -0.8) * read["yaw_rate"]
        for corner in ("fl", "fr", "rl", "rr")
    }
    wheels = {
        f"Whl{corner.title()}_W_Meas": (
            "radians/second",
            0.01,
            value / RADIUS_M,
        )
        for corner, value in turned.items()
    }
    wheel_torque = read["powertrain_torque"]
    ratio = np.array([1.0, 13.0, 7.5, 5.0, 3.8, 3.1, 2.6])[gear.astype(int)]
    values: Table = {
        "WheelSpeed_CG1": wheels,
        "EngVehicleSpThrottle": {
            "EngAout_N_Actl": ("rpm", 0.5, 30 / np.pi * read["engine_speed"]),
            "Veh_V_ActlBrk": ("kph", 0.01, 3.6 * speed),
            "ClutchAC_B_Stat": ("SED", 1.0, ac_clutch),
            "ClutchOpen_B_Actl": ("SED", 1.0, read["clutch_open"]),
        },
        "Accel_Data": {
            "VehLongAccel_A_Actl": ("m/s^2", 0.002, measured + noise(0.1)),
            "VehLongAccelGnd_A_Est": ("m/s^2", 0.002, over_ground),
            "VehLongAccel2_A_Actl": ("m/s^2", 0.002, measured + 1.4),
            "VehLatAccel_A_Actl": (
                "meters per second squared",
                0.002,
                read["acceleration_lateral"] + noise(0.05),
            ),
        },
        "Brake_Data": {
            "BrkTqRqDrv": (
                "N-m",
                1.0,
                1.3 * np.roll(torque, -5) * (noise(0.02) + 1),
            ),
            "BrkTqMeas": ("Nm", 1.0, torque * (1 + noise(0.01))),
            "MstrCylPress": (
                "bar",
                0.02,
                (np.maximum(read["primary_pressure"], 0) + rest) / 1e5,
            ),
        },
        "Body_Data": {
            "BrkLampRq_B": ("", 1.0, np.zeros_like(speed)),
            "BrkLamp_B_Stat": ("", 1.0, np.zeros_like(speed)),
            "BrkPedalPressed_B": ("", 1.0, braking.astype(np.float64)),
            "PrkBrkDecel_B_Actv": ("", 1.0, (over_ground < -2.0) * 1.0),
            "PrkBrkActv_B_Actl": ("", 1.0, parked),
            "AbsActv_B": ("", 1.0, np.zeros_like(speed)),
        },
        "Powertrain_Data": {
            "WhlTqRq": ("N*m", 2.0, np.roll(1.1 * wheel_torque, -6)),
            "WhlTqTot_Actl": ("N*m", 2.0, wheel_torque * (1 + noise(0.02))),
            "EngTq_Actl": (
                "Nm",
                0.1,
                np.where(gear > 0, wheel_torque / ratio, 0.0),
            ),
            "GearEngd": ("SED", 1.0, gear),
        },
        "Yaw_Data": {
            "VehYaw_W_Actl": ("degrees/second", 0.01, read["yaw_rate"]),
            "AirAmb_Te_Actl": (
                "deg C",
                0.5,
                read["ambient_temperature"] - KELVIN_OFFSET,
            ),
        },
    }
    yaw = values["Yaw_Data"]["VehYaw_W_Actl"]
    values["Yaw_Data"]["VehYaw_W_Actl"] = (
        *yaw[:2],
        -180 / np.pi * yaw[2] + noise(0.05),
    )
    return time_s, values


def _smooth(values: Series, over_s: float, step_s: float) -> Series:
    count = max(1, round(over_s / step_s))
    padded = np.pad(values, (count // 2, count - 1 - count // 2), "edge")
    return np.convolve(padded, np.full(count, 1 / count), "valid")


def write_dbc(path: Path) -> Path:
    """Write the DBC to *path* and return it."""
    text = 'VERSION ""\nBU_: X\n'
    for number, (message, signals) in enumerate(table()[1].items()):
        text += f"BO_ {0x100 + 16 * number} {message}: 8 X\n"
        start = 0
        for name, (unit, scale, _) in signals.items():
            bits = _bits(name)
            sign = "-" if bits > 1 else "+"
            text += (
                f" SG_ {name} : {start}|{bits}@1{sign} ({scale:g},0) [0|0] "
                f'"{unit}" X\n'
            )
            start += bits
    path.write_text(text, encoding="ascii")
    return path


def _bits(name: str) -> int:
    return 1 if "_B" in name else 16


def write_log(path: Path) -> Path:
    """Write the drive to *path* as a candump log and return it."""
    time_s, messages = table()
    lines = []
    for number, signals in enumerate(messages.values()):
        payload = np.zeros(len(time_s), np.uint64)
        start = 0
        for name, (_, scale, value) in signals.items():
            bits = _bits(name)
            raw = np.rint(np.asarray(value) / scale).astype(np.int64)
            mask = np.uint64((1 << bits) - 1)
            payload |= (raw.view(np.uint64) & mask) << np.uint64(start)
            start += bits
        texts = payload.astype("<u8").tobytes().hex().upper()
        lines += [
            (
                at + 1e-4 * number,
                f"{0x100 + 16 * number:03X}",
                texts[i : i + 16],
            )
            for at, i in zip(
                time_s.tolist(), range(0, len(texts), 16), strict=True
            )
        ]
    path.write_text(
        "".join(
            f"({1e9 + at:.6f}) can0 {can_id}#{data}\n"
            for at, can_id, data in sorted(lines)
        ),
        encoding="ascii",
    )
    return path

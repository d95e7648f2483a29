"""A candump log of a busy bus: the example car among other traffic.

2000 frames a second, 600 of them of the example car; the same arguments give
the same bytes.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import cantools
import numpy as np
from cantools.database.can import Database

from bstm_daemon.files import shipped_file

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt
    from cantools.database.can import Message, Signal

    from bstm_daemon.config.sections import Config

    Floats = npt.NDArray[np.float64]
    Payloads = npt.NDArray[np.uint64]

FRAMES_PER_S: Final = 2000
START_US: Final = 1_700_000_000_000_000
BLOCK_S: Final = 60
"""Seconds written at a time; a log's length is a multiple of it."""

RATES_HZ: Final = {
    "Powertrain": 125,
    "WheelSpeeds": 125,
    "BrakePressure": 125,
    "Inertial": 125,
    "BrakeTorque": 30,
    "Body": 40,
    "ExternalForce": 10,
    "Satellites": 10,
    "Ambient": 2,
    "ThermocouplesA_FL": 2,
    "ThermocouplesB_FL": 2,
    "ThermocouplesA_FR": 2,
    "ThermocouplesB_FR": 2,
}
"""The wanted frames; a measuring bus is faster than the car's own."""

OTHER_IDS: Final = tuple(range(0x200, 0x200 + 70 * 3, 3))

_CYCLE_S = np.array([0.0, 25.0, 65.0, 75.0, 90.0])
_CYCLE_MS = np.array([0.0, 27.0, 27.0, 0.0, 0.0])


@cache
def example_database() -> Database:
    """Return the example car's DBC as cantools reads it."""
    path = shipped_file("dbc/example_vehicle.dbc")
    database = cantools.database.load_file(path)
    assert isinstance(database, Database)
    return database


def write_traffic(
    path: Path,
    seconds: int,
    config: Config,
    frames_per_s: int = FRAMES_PER_S,
) -> int:
    """Write *seconds* of traffic to *path*; returns the lines written.

    Values stay within the limits of *config*; speed, pressure and
    acceleration are those of stop-and-go, the rest is noise.
    """
    messages = {m.name: m for m in example_database().messages}
    limits = _limits(config)
    lines = 0
    with path.open("w", encoding="ascii") as file:
        for start_s in range(0, seconds, BLOCK_S):
            rng = np.random.default_rng((20_260_101, start_s))
            stamps, heads, texts = [], [], []
            for name, rate in RATES_HZ.items():
                message = messages[name]
                at_s = _times(start_s, rate, rng)
                stamps.append(at_s)
                heads += [f"{message.frame_id:03X}#"] * len(at_s)
                payloads = _payloads(message, at_s, limits, rng)
                texts += _hex(payloads, message.length)
            others = frames_per_s - sum(RATES_HZ.values())
            at_s = _times(start_s, others, rng)
            stamps.append(at_s)
            ids = rng.choice(OTHER_IDS, len(at_s)).tolist()
            noise = rng.integers(0, 1 << 64, len(at_s), np.uint64)
            heads += [f"{can_id:03X}#" for can_id in ids]
            texts += [
                text[: 2 * (8 if can_id % 5 else 3 + can_id % 4)]
                for can_id, text in zip(ids, _hex(noise, 8), strict=True)
            ]
            times_us = START_US + np.rint(np.concatenate(stamps) * 1e6).astype(
                np.int64
            )
            order = np.argsort(times_us, kind="stable")
            file.writelines(
                f"({us // 1_000_000}.{us % 1_000_000:06d}) can0 "
                f"{heads[i]}{texts[i]}\n"
                for us, i in zip(
                    times_us[order].tolist(), order.tolist(), strict=True
                )
            )
            lines += len(order)
    return lines


def _times(start_s: int, rate: int, rng: np.random.Generator) -> Floats:
    """Return *rate* stamps a second of one block, with jitter."""
    count = BLOCK_S * rate
    grid = (np.arange(count) + rng.uniform(0.05, 0.95, count)) / rate
    times: Floats = start_s + grid
    return times


def _limits(config: Config) -> dict[str, tuple[float, float]]:
    return {
        source.signal: (
            -np.inf if source.min is None else source.min,
            np.inf if source.max is None else source.max,
        )
        for source in config.signals.values()
        if source.signal is not None
    }


def _payloads(
    message: Message,
    at_s: Floats,
    limits: dict[str, tuple[float, float]],
    rng: np.random.Generator,
) -> Payloads:
    payload = np.zeros(len(at_s), np.uint64)
    for signal in message.signals:
        scale, offset = float(signal.scale), float(signal.offset)
        low, high = _range(signal, limits.get(signal.name))
        value = np.clip(_values(signal.name, at_s, low, high, rng), low, high)
        raw = np.rint((value - offset) / scale).astype(np.int64)
        bits = raw.view(np.uint64) & np.uint64((1 << signal.length) - 1)
        payload |= bits << np.uint64(signal.start)
    return payload


def _range(
    signal: Signal, limit: tuple[float, float] | None
) -> tuple[float, float]:
    lowest = 0 if not signal.is_signed else -(1 << (signal.length - 1))
    highest = lowest + (1 << signal.length) - 1
    scale, offset = float(signal.scale), float(signal.offset)
    low = max(lowest * scale + offset, signal.minimum or -np.inf)
    high = min(highest * scale + offset, signal.maximum or np.inf)
    if limit is not None:
        low, high = max(low, limit[0]), min(high, limit[1])
    return low + scale, high - scale if high - low > 2 * scale else high


def _values(
    name: str, at_s: Floats, low: float, high: float, rng: np.random.Generator
) -> Floats:
    phase = at_s % 90.0
    speed_ms: Floats = np.interp(phase, _CYCLE_S, _CYCLE_MS)
    stopping = (phase > 65.0) & (phase < 75.0)
    if name.startswith("WheelSpeed") or name in {"VehicleSpeed", "GnssSpeed"}:
        return speed_ms * 3.6
    if name.startswith("Pressure"):
        return np.where(stopping, 28.0, 0.0)
    if name == "AccelLongitudinal":
        slope = np.where(phase < 25.0, 27.0 / 25.0, 0.0)
        return np.where(stopping, -2.7, slope)
    if name == "AmbientTemperature":
        return np.full(len(at_s), 10.0)
    return rng.uniform(low, high, len(at_s))


def _hex(payloads: Payloads, length: int) -> list[str]:
    whole = payloads.astype("<u8").tobytes().hex().upper()
    return [whole[16 * i : 16 * i + 2 * length] for i in range(len(payloads))]

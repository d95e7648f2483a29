"""Real recordings in mode fused, with the figures of docs/heat.md.

Each is turned from the mode that its configuration has. What a set lacks for
it is told here: a pressure that rests, or a torque out of the battery's power.
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.channels import FLAGS
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.roles import CORNERS, ROLE_INDEX
from tests.replayed import replay_log

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    Series = npt.NDArray[np.float64]

REAL = os.environ.get("BSTM_REAL_DATA")
ROOT = Path(__file__).parents[2]
FUSED = 'mode = "fused"'
PUBLISHED_S = 0.1

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        not REAL, reason="BSTM_REAL_DATA names no folder of recordings"
    ),
]


@dataclass(frozen=True)
class Fused:
    """What a replay in mode fused has given."""

    columns: dict[str, Series]
    mass_kg: float

    def energy_j(self, way: str = "") -> float:
        """Return the brake heat of all corners."""
        return PUBLISHED_S * sum(
            float(self.columns[f"{name}.brake_power{way}_w"].sum())
            for name in CORNERS
        )

    def flagged_s(self, name: str) -> Series:
        """Return the times of a flag from the start [s]."""
        set_ = (self.columns["flags"].astype(np.int64) & FLAGS[name]) != 0
        at: Series = (self.columns["time_s"] - self.columns["time_s"][0])[set_]
        return at

    def lost_j(self) -> float:
        """Return all drops of the kinetic energy."""
        half_v2 = 0.5 * self.columns["speed_ms"] ** 2
        return self.mass_kg * float(np.maximum(-np.diff(half_v2), 0.0).sum())

    def taught(self) -> bool:
        """Whether the mass or the friction is another than configured."""
        return bool(
            np.any(self.columns["mass_kg"] != self.mass_kg)
            or np.any(self.columns["friction_scale"] != 1.0)
        )


@pytest.fixture
def fused(tmp_path: Path) -> Callable[..., Fused]:
    """Return what replays: configuration, log, (old, new) edits of it."""

    def replay(
        config: str,
        log: Path | str,
        *edits: tuple[str, str],
        without: str = "",
    ) -> Fused:
        path = edited(tmp_path, config, *edits)
        loaded, signal_map = load_vehicle(path)
        if isinstance(log, str):
            log = next(Path(str(REAL)).glob(log))
        overrides = {without: ""} if without else {}
        found = replay_log(loaded, signal_map, log, overrides, forecast=False)
        return Fused(found.results.columns, loaded.vehicle.mass_kg)

    return replay


def edited(folder: Path, config: str, *edits: tuple[str, str]) -> Path:
    """Return the configuration with *edits*, written into *folder*."""
    source = ROOT / config
    text = source.read_text(encoding="utf-8")
    text = text.replace("@DATA@", Path(str(REAL)).as_posix()).replace(
        'dbc = "../', f'dbc = "{source.parent.as_posix()}/../'
    )
    for old, new in edits:
        assert old in text
        text = text.replace(old, new)
    path = folder / source.name
    path.write_text(text, encoding="utf-8")
    return path


# Toyota: cruise control brakes, the driver's pressure rests

TOYOTA = "config/toyota_rav4.toml"
TOYOTA_LOG = "toyota-rav4-comma2k19/*.log"
RESTING = """[signals.primary_pressure]
message = "BRAKE_MODULE"
expression = "0 * BRAKE_PRESSED"
unit = "bar"

[signals.brake_switch]"""


def test_toyota_motion_finds_what_pressure_misses(
    fused: Callable[..., Fused],
) -> None:
    car = fused(
        TOYOTA,
        TOYOTA_LOG,
        ('mode = "auto" ', f"{FUSED} "),
        ("[signals.brake_switch]", RESTING),
        without="can1",
    )
    alone = fused(TOYOTA, TOYOTA_LOG, without="can1")

    assert alone.energy_j("_ff") == car.energy_j("_ff") == 0.0
    assert alone.energy_j() == pytest.approx(143e3, rel=0.05)
    # without a torque a bias of the accelerometer is never learned: only what
    # is surely felt is booked, and said to be vague
    found, doubt = car.energy_j(), car.energy_j("_std")
    assert 0.3 * alone.energy_j() < found < 1.2 * alone.energy_j()
    assert abs(found - alone.energy_j()) < 2.5 * doubt
    assert len(car.flagged_s("braking_unpressed"))
    assert not car.taught()


# Subaru: the DBC has the accelerometer wrong in sign and scale

SUBARU = "config/subaru_wrx_sti.toml"
SUBARU_LOG = "subaru-wrx-sti-candump/*.log"
COASTING = ('mode = "auto" ', f"{FUSED}\nassume_powertrain_torque_nm = 0.0 ")
AS_PUBLISHED = ("scale = 0.6667\nsign = -1\n", "")


def test_subaru_accelerometer_is_named_and_not_learned_away(
    fused: Callable[..., Fused],
) -> None:
    wrong = fused(SUBARU, SUBARU_LOG, COASTING, AS_PUBLISHED)
    right = fused(SUBARU, SUBARU_LOG, COASTING)

    named = wrong.flagged_s("acceleration_scale")
    assert 40.0 < named[0] < 60.0  # it accelerates hard for the first time
    assert not wrong.taught()
    assert len(right.flagged_s("acceleration_scale")) == 0
    # one stop from a walk is all that the brakes did
    assert right.energy_j() < 0.02 * right.lost_j()


# GT86 on a stand


def test_gt86_on_a_stand_teaches_nothing(
    fused: Callable[..., Fused],
) -> None:
    car = fused(
        "tests/real/gt86_stand.toml",
        "gt86-on-stand-candump/*.log",
        ('mode = "ff"', FUSED),
    )

    assert len(car.flagged_s("external_force_suspected"))
    assert not car.taught()
    assert car.energy_j() == pytest.approx(car.energy_j("_ff"), rel=1e-6)


# CANedge: the road's height by satellites

NEVER_SENT = """[signals.primary_pressure]
message = "gnss_geofence"
signal = "Fence1"
unit = "bar"

[signals.altitude]"""
STRETCH_M = 200.0


def test_canedge_grade_against_satellite_height(
    fused: Callable[..., Fused], tmp_path: Path
) -> None:
    """Over stretches of 200 m; the receiver's own height errs by metres."""
    pytest.importorskip("asammdf")
    edits = (('mode = "fb"', FUSED), ("[signals.altitude]", NEVER_SENT))
    config = "tests/real/canedge_gnss.toml"
    car = fused(config, "canedge-obd-gnss-mf4/*.MF4", *edits, without="can1")
    height, speed = heights(edited(tmp_path, config, *edits))
    time_s = car.columns["time_s"]
    v = np.interp(time_s, *speed)
    h = np.interp(time_s, *height)
    way = np.cumsum(v) * PUBLISHED_S
    grade = np.nan_to_num(car.columns["grade"])
    climbed = np.cumsum(grade * v) * PUBLISHED_S
    ends = np.searchsorted(way, np.arange(0.0, way[-1], STRETCH_M))
    length = np.diff(way[ends])
    told = np.diff(h[ends]) / length
    found = np.diff(climbed[ends]) / length
    # how the module is mounted is learned from the height by then
    late = slice(len(told) // 3, None)
    apart = (found - told)[late]

    assert np.corrcoef(found[late], told[late])[0, 1] > 0.8
    assert np.sqrt(np.mean(apart**2)) < 0.013
    assert abs(np.mean(apart)) < 0.006


def heights(config: Path) -> tuple[tuple[Series, Series], ...]:
    """Return times [s] and values of height [m] and speed [m/s]."""
    _, signal_map = load_vehicle(config)
    log = next(Path(str(REAL)).glob("canedge-obd-gnss-mf4/*.MF4"))
    events = list(EventLog(log, signal_map, {"can1": ""}).events())
    role, time_us, value = (
        np.concatenate([np.asarray(getattr(e, name)) for e in events])
        for name in ("role", "time_us", "value")
    )
    return tuple(
        (time_us[role == number] * 1e-6, value[role == number])
        for number in (ROLE_INDEX["altitude"], ROLE_INDEX["vehicle_speed"])
    )


# Tesla: the motors take most of it

TORQUE = """[signals.powertrain_torque]
column = "Torque (Nm)"
unit = "Nm"

[[corner]]
name = "FL\""""
RADIUS_M = 0.335
EFFICIENCY = 0.9


def with_torque(log: Path, folder: Path) -> Path:
    """Return *log* with the wheels' torque out of the battery's power."""
    path = folder / log.name
    with log.open(encoding="utf-8", newline="") as rows:
        head, *table = csv.reader(rows)
    speed = head.index("Speed (MPH)")
    power = head.index("Power Level (KW)")
    with path.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file)
        out.writerow([*head, "Torque (Nm)"])
        for row in table:
            v = max(float(row[speed]) * 0.44704, 3.0)
            watt = 1e3 * float(row[power])
            watt *= EFFICIENCY if watt > 0.0 else 1.0 / EFFICIENCY
            out.writerow([*row, f"{watt * RADIUS_M / v:.1f}"])
    return path


@pytest.mark.parametrize("day", ["03-05", "03-10"])
def test_tesla_recovery_is_not_counted(
    fused: Callable[..., Fused], tmp_path: Path, day: str
) -> None:
    """Given the motors' torque; a part of it remains, the rest is not told.

    The torque is of the battery's power and of a speed in whole miles an hour.
    """
    log = next(Path(str(REAL)).glob(f"tesla-model3-trackmode/*{day}*.csv"))
    config = "tests/real/tesla_model3.toml"
    mode = ('mode = "ff"', FUSED)
    blind = fused(config, log, mode)
    told = fused(
        config,
        with_torque(log, tmp_path),
        mode,
        ('[[corner]]\nname = "FL"', TORQUE),
    )

    assert told.lost_j() > 1e6
    assert 0.5 * told.energy_j("_ff") < told.energy_j() < 0.2 * told.lost_j()
    assert blind.energy_j() > 0.5 * blind.lost_j()

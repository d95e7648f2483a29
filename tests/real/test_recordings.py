"""Every real recording through check and replay, as docs/real-data.md says.

The configurations beside this file hold no data of the recordings. Where a
DBC is not shipped, ``@DATA@`` in its path stands for the folder it is in.
"""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.matching.baseline import baselines
from bstm_daemon.analysis.matching.drives import read_drive
from bstm_daemon.analysis.quality.judge import judge
from bstm_daemon.analysis.quality.recording import read_recording
from bstm_daemon.channels import FLAGS, WHEEL_SUSPECT
from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle
from tests.replayed import Replay, replay_log

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    from bstm_daemon.analysis.quality.finding import Comparison, Quality
    from bstm_daemon.config.sections import Config

    Series = npt.NDArray[np.float64]

REAL = os.environ.get("BSTM_REAL_DATA")
HERE = Path(__file__).parent
ROOT = HERE.parents[1]

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        not REAL, reason="BSTM_REAL_DATA names no folder of recordings"
    ),
]

ACCELERATION = "acceleration_longitudinal"
FRONT = ("FL", "FR")
FRONT_SUSPECT = WHEEL_SUSPECT * 3
REAR = ("RL", "RR")


@dataclass(frozen=True)
class Set:
    """A configuration, the log it is for, and a bus that is left out."""

    config: str
    log: str
    without: str = ""


SETS = {
    "canedge": Set(
        "tests/real/canedge_gnss.toml", "canedge-obd-gnss-mf4/*.MF4", "can1"
    ),
    "f1-spain": Set(
        "tests/real/f1.toml", "f1-five-channel/Spain.converted.csv"
    ),
    "f1-hungary": Set(
        "tests/real/f1.toml", "f1-five-channel/Hungary.converted.csv"
    ),
    "gr86": Set("tests/real/gr86_cup.toml", "gr86-cup-barber/*.csv"),
    "gt86": Set("tests/real/gt86_stand.toml", "gt86-on-stand-candump/*.log"),
    "subaru": Set(
        "config/subaru_wrx_sti.toml", "subaru-wrx-sti-candump/*.log"
    ),
    "tesla-03-05": Set(
        "tests/real/tesla_model3.toml", "tesla-model3-trackmode/*03-05*.csv"
    ),
    "tesla-03-10": Set(
        "tests/real/tesla_model3.toml", "tesla-model3-trackmode/*03-10*.csv"
    ),
    "toyota": Set(
        "config/toyota_rav4.toml", "toyota-rav4-comma2k19/*.log", "can1"
    ),
    "uwfe-91": Set(
        "tests/real/uwfe_fsae.toml", "uwfe-fsae-ev-can/NewMotor*.log"
    ),
    "uwfe-30": Set(
        "tests/real/uwfe_fsae.toml", "uwfe-fsae-ev-can/PostMichigan*.log"
    ),
}

USABLE = {
    "canedge": {"fb"},
    "f1-spain": {"fb"},
    "f1-hungary": {"fb"},
    "gr86": set(),
    "gt86": {"ff"},
    "subaru": {"ff"},
    "tesla-03-05": {"ff", "fb", "fused", "measured"},
    "tesla-03-10": {"ff", "fb", "fused", "measured"},
    "toyota": {"fb"},
    "uwfe-91": set(),
    "uwfe-30": set(),
}
"""The heat modes that check allows."""

SHORT = {"canedge", "gt86", "subaru", "tesla-03-05", "tesla-03-10", "toyota"}
"""Sets over which the forecast, most of the work, takes seconds."""


@dataclass(frozen=True)
class Car:
    """One configuration of a set, and what check and replay make of it."""

    path: Path
    log: Path
    overrides: dict[str, str]

    @functools.cached_property
    def config(self) -> Config:
        return load_vehicle(self.path)[0]

    @functools.cached_property
    def quality(self) -> Quality:
        config, plan = load_vehicle(self.path)
        recording = read_recording([self.log], plan, self.overrides)
        return judge(recording, config, plan)

    @functools.cached_property
    def replay(self) -> Replay:
        return replay_log(
            *load_vehicle(self.path), self.log, self.overrides, forecast=False
        )

    @property
    def columns(self) -> dict[str, Series]:
        return self.replay.results.columns

    @property
    def usable(self) -> set[str]:
        return {one.mode for one in self.quality.modes if one.usable}

    @property
    def faults(self) -> set[tuple[str, str]]:
        return {
            (finding.fault, role)
            for finding in self.quality.findings
            if finding.wrong
            for role in finding.roles
        }

    def comparison(self, title: str) -> Comparison:
        (found,) = [c for c in self.quality.comparisons if c.title == title]
        return found

    def energy_j(self, way: str = "", corners: tuple[str, ...] = ()) -> float:
        """Return the brake heat of *corners*, else of all."""
        names = corners or tuple(one.name for one in self.config.corner)
        return 0.1 * sum(
            float(self.columns[f"{name}.brake_power{way}_w"].sum())
            for name in names
        )

    def kinetic_j(self, speed_ms: float) -> float:
        return 0.5 * self.config.vehicle.mass_kg * speed_ms**2

    def lost_j(self) -> float:
        """Return all drops of the kinetic energy."""
        half_v2 = 0.5 * self.columns["speed_ms"] ** 2
        drops = np.maximum(-np.diff(half_v2), 0.0).sum()
        return self.config.vehicle.mass_kg * float(drops)

    def rise_k(self, corner: str) -> float:
        return float(np.ptp(self.columns[f"{corner}.disc_c"]))


@pytest.fixture(scope="module")
def cars(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Car]:
    """Return a maker of cars: set, then (old, new) edits of its file."""
    mended = tmp_path_factory.mktemp("mended")
    mended_dbc(mended)

    @functools.cache
    def made(name: str, *edits: tuple[str, str]) -> Car:
        one = SETS[name]
        source = ROOT / one.config
        text = source.read_text(encoding="utf-8")
        folder = mended if name.startswith("uwfe") else Path(str(REAL))
        text = text.replace("@DATA@", folder.as_posix()).replace(
            'dbc = "../', f'dbc = "{source.parent.as_posix()}/../'
        )
        for old, new in edits:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path_factory.mktemp(name) / source.name
        path.write_text(text, encoding="utf-8")
        log = next(Path(str(REAL)).glob(one.log))
        if log.suffix == ".MF4":
            pytest.importorskip("asammdf")
        return Car(path, log, {one.without: ""} if one.without else {})

    return made


def mended_dbc(folder: Path) -> None:
    """Write the formula car's DBC with the lengths that its frames have."""
    dbc = Path(str(REAL)) / "uwfe-fsae-ev-can" / "2024CAR.dbc"
    text = dbc.read_text(encoding="cp1252", errors="replace")
    for old, new in (
        ("VCU_Data: 6", "VCU_Data: 8"),
        ("WSBFL_BrakeTemp: 5", "WSBFL_BrakeTemp: 8"),
    ):
        assert old in text
        text = text.replace(old, new)
    (folder / "uwfe.dbc").write_text(text, encoding="cp1252")


@pytest.mark.parametrize("name", SETS)
def test_check_and_replay_take_every_recording(
    cars: Callable[..., Car], name: str
) -> None:
    """Check allows what the table of the document says, replay always runs.

    A replay of a log that check rejects gives finite figures all the same.
    """
    car = cars(name)
    without = [f"--map={bus}=" for bus in car.overrides]

    code = main(["check", str(car.path), "--log", str(car.log), *without])

    assert code == (0 if car.config.heat.mode in USABLE[name] else 1)
    assert car.usable == USABLE[name]
    if name not in SHORT:
        without.append("--no-forecast")
    assert main(["replay", str(car.log), "-c", str(car.path), *without]) == 0
    for column in car.columns:
        if column.endswith(("disc_c", "power_w", "speed_ms")):
            assert np.isfinite(car.columns[column]).all(), column


@pytest.mark.slow
@pytest.mark.full
@pytest.mark.parametrize("name", sorted(SETS.keys() - SHORT))
def test_the_forecast_takes_every_recording(
    cars: Callable[..., Car], name: str
) -> None:
    car = cars(name)

    assert main(["replay", str(car.log), "-c", str(car.path)]) == 0


# CANedge

TRAVEL = 'signal = "AccelerationY"\nunit = "m/s2"\nsign = -1'
GRAVITY = 'signal = "AccelerationX"\nunit = "m/s2"'
ACROSS = 'signal = "AccelerationZ"\nunit = "m/s2"'


@pytest.mark.parametrize("axis", [GRAVITY, ACROSS])
def test_canedge_a_wrong_axis_is_named(
    cars: Callable[..., Car], axis: str
) -> None:
    """Gravity for a motion hides all of the braking: check must tell."""
    wrong = cars("canedge", (TRAVEL, axis))

    assert wrong.faults == {("unrelated", ACCELERATION)}
    assert wrong.usable == set()
    if axis == GRAVITY:
        assert wrong.energy_j() == 0.0


def test_canedge_along_the_right_axis(cars: Callable[..., Car]) -> None:
    """The direction of travel is -Y; the discs gain some tens of kelvin."""
    right = cars("canedge")
    turned = cars("canedge", ("sign = -1", "sign = 1"))

    assert turned.faults == {("sign", ACCELERATION)}
    assert right.faults == set()
    fit = right.comparison("accelerometer against dv/dt").fit
    assert fit is not None
    assert fit.scale == pytest.approx(1.0, abs=0.2)
    assert fit.correlation > 0.85
    # drag, rolling, grade and lifts of the pedal take most of it
    assert 0.02 * right.lost_j() < right.energy_j() < 0.5 * right.lost_j()
    assert 5.0 < right.rise_k("RL") < right.rise_k("FL") < 60.0


# Formula 1


@pytest.mark.parametrize("name", ["f1-spain", "f1-hungary"])
def test_f1_carbon_is_beyond_the_limits_of_iron(
    cars: Callable[..., Car], name: str
) -> None:
    """Over 1127 degC and 400 K in a second: measured is not allowed."""
    car = cars(name)

    assert car.faults == {
        ("implausible", "temp_fl_disc"),
        ("implausible", "temp_fr_disc"),
    }
    lost_j = car.lost_j()
    # the front has 60 %, and drag takes its part before the brakes
    assert 0.3 * lost_j < car.energy_j() < 0.6 * lost_j


def test_f1_base_model_is_too_hot(cars: Callable[..., Car]) -> None:
    """A road car's cooling on ducted carbon; the recorded peak is 1257."""
    car = cars("f1-spain")
    measured = cars("f1-spain", ('mode = "fb"', 'mode = "measured"'))

    assert np.max(measured.columns["FL.disc_c"]) == pytest.approx(1257, abs=1)
    assert np.max(car.columns["FL.disc_c"]) > 1600.0


def test_f1_discs_of_one_node(cars: Callable[..., Car]) -> None:
    """27 K and 29 K are known of others for their own session."""
    spain, hungary = (
        read_drive(car.log, *load_vehicle(car.path))
        for car in map(cars, ("f1-spain", "f1-hungary"))
    )
    of_spain, of_hungary = (baselines([drive]) for drive in (spain, hungary))

    for corner in ("FL", "FR"):
        one, other = of_spain[corner][0], of_hungary[corner][0]
        assert one.rms_k == pytest.approx(22.0, abs=3.0)
        assert other.rms_k == pytest.approx(28.0, abs=5.0)
        assert one.rms_on([hungary]) == pytest.approx(42.0, abs=4.0)
        assert other.rms_on([spain]) == pytest.approx(28.0, abs=4.0)


# GR86 Cup

SHORT_TIMEOUT = 'column = "speed"\nunit = "km/h"\ntimeout_s = 2.0'
LONG_TIMEOUT = SHORT_TIMEOUT.replace("2.0", "60.0")


def test_gr86_speed_is_absent_most_of_the_time(
    cars: Callable[..., Car],
) -> None:
    """One row in five has it: no mode; what is read agrees."""
    car = cars("gr86")

    assert ("dropouts", "vehicle_speed") in car.faults
    assert {role for _, role in car.faults} == {
        "vehicle_speed",
        "engine_speed",
    }
    both = car.comparison("secondary_pressure against primary_pressure").fit
    assert both is not None
    assert both.scale == pytest.approx(1.0, abs=0.02)
    force = car.comparison(
        "Feed-Forward by primary_pressure against Feed-Back"
    )
    assert force.agrees


def test_gr86_without_speed_there_is_no_heat(
    cars: Callable[..., Car],
) -> None:
    """Speed is absent 68 % of the time; held on, several times the heat."""
    short = cars("gr86")
    held = cars("gr86", (SHORT_TIMEOUT, LONG_TIMEOUT))

    absent = np.mean(short.columns["speed_ms"] == 0.0)
    assert absent == pytest.approx(0.68, abs=0.03)
    assert ("dropouts", "vehicle_speed") not in held.faults
    assert 2.0 * short.energy_j() < held.energy_j()
    # pad friction, mass and drag are typical values: a factor of 2
    assert 0.5 < held.energy_j("_ff") / held.energy_j("_fb") < 2.0
    disc_c = held.columns["FL.disc_c"]
    fifths = [float(part.max()) for part in np.array_split(disc_c, 5)[1:]]
    # a cycle, no drift
    assert max(fifths) - min(fifths) < 200.0
    assert max(fifths) < 1100.0


# GT86 on a stand


def test_gt86_no_kinetic_energy_of_the_vehicle(
    cars: Callable[..., Car],
) -> None:
    """Only what turns is braked: little at the rear, nothing at the front.

    The front wheels stand while three other speeds agree, and the
    accelerometer shows that the car does not move.
    """
    car = cars("gt86")
    flat = cars("gt86", ('mode = "ff"', 'mode = "fb"\nslope = "flat"'))

    assert [
        finding.fault
        for finding in car.quality.findings
        if finding.fault != "missing"
    ] == ["axles-disagree"]
    # braked from 74 km/h: both rear wheels and their discs, 2 to 4 kg m2
    # with the driveline, against 279 kJ of a car that moves
    turning_j = 0.5 * 4.0 * (74 / 3.6 / 0.315) ** 2
    assert 1e3 < car.energy_j(corners=REAR) < 2.0 * turning_j
    assert car.rise_k("RL") < 5.0
    moving_j = car.kinetic_j(74 / 3.6)
    dead = car.columns["flags"].astype(np.int64) & FRONT_SUSPECT
    assert dead[-1] == FRONT_SUSPECT
    assert int(car.columns["flags"][-1]) & FLAGS["speed_suspect"]
    # the accelerometer feels no motion, so Feed-Back books none either
    assert car.energy_j("_fb") < 0.05 * moving_j
    # a road taken as flat has the wheels alone: check forbids fb for it
    assert flat.energy_j("_fb") > 0.5 * moving_j
    for one in (car, flat):
        assert one.energy_j(corners=FRONT) == 0.0
        assert one.rise_k("FL") < 0.1


# Subaru


def test_subaru_accelerometer_of_the_dbc(cars: Callable[..., Car]) -> None:
    """Sign and scale are wrong in the DBC, put right in the configuration."""
    raw = cars("subaru", ("scale = 0.6667\nsign = -1\n", ""))

    assert raw.faults == {("sign", ACCELERATION), ("scale", ACCELERATION)}
    fit = raw.comparison("accelerometer against dv/dt").fit
    assert fit is not None
    assert fit.scale == pytest.approx(-1.5, abs=0.1)
    assert cars("subaru").faults == set()


def test_subaru_yaw_rate_is_positive_to_the_left(
    cars: Callable[..., Car],
) -> None:
    """It seems the other way round where the car reverses out of its place."""
    car = cars("subaru")

    for axle in ("front", "rear"):
        pair = car.comparison(
            f"{axle} wheels, right minus left, against yaw rate"
        )
        assert pair.verdict.startswith("agrees")
        assert pair.fit is not None
        assert pair.fit.scale == pytest.approx(1.3, abs=0.1)  # the track, m


def test_subaru_130_km_h_without_braking(cars: Callable[..., Car]) -> None:
    """A pull and a cruise are no heat: one stop from a walk is all."""
    car = cars("subaru")

    assert car.columns["speed_ms"].max() > 35.0
    assert car.energy_j() < car.kinetic_j(2.5)
    assert max(car.rise_k(c) for c in FRONT + REAR) < 0.5


# Tesla

PEDAL = """[signals.primary_pressure]
column = "Brake Pressure (bar)"
unit = "bar"
min = -2.0
"""
BY_MOTION = ('mode = "ff"', 'mode = "fb"')


@pytest.mark.parametrize(
    ("name", "front_k", "rear_k"),
    [("tesla-03-05", 4, 3), ("tesla-03-10", 2, 2)],
)
def test_tesla_rise_is_that_of_its_maker_s_estimate(
    cars: Callable[..., Car], name: str, front_k: float, rear_k: float
) -> None:
    """A light drive: some kelvin, as the car itself estimates."""
    car = cars(name)
    theirs = {
        role.role: role.statistics.maximum - role.statistics.minimum
        for role in car.quality.roles
        if role.role.startswith("temp") and role.statistics
    }

    assert car.faults == set()
    assert theirs["temp_fl_disc"] == pytest.approx(front_k, abs=0.01)
    assert theirs["temp_rl_disc"] == pytest.approx(rear_k, abs=0.01)
    for corner, rise_k in (("FL", front_k), ("RL", rear_k)):
        assert car.rise_k(corner) == pytest.approx(rise_k, abs=1.5)


@pytest.mark.parametrize("name", ["tesla-03-05", "tesla-03-10"])
def test_tesla_recovery_is_no_brake_heat(
    cars: Callable[..., Car], name: str
) -> None:
    """By pressure a few per cent of the speed's energy reach the brakes.

    Without pressure and the motor's torque Feed-Back books all of it.
    """
    car = cars(name)
    blind = cars(name, (PEDAL, ""), BY_MOTION)

    assert car.energy_j() < 0.05 * car.lost_j()
    assert blind.energy_j() > 10.0 * car.energy_j()
    assert 50.0 < blind.rise_k("FL") < 250.0
    # a pressure that tells when leaves only what the motors take meanwhile
    assert car.energy_j() < car.energy_j("_fb") < 0.2 * blind.energy_j()


# Toyota


def test_toyota_brakes_without_the_driver(cars: Callable[..., Car]) -> None:
    """The pedal switch never moves, the motion tells of the braking."""
    car = cars("toyota")
    (switch,) = [r for r in car.quality.roles if r.role == "brake_switch"]

    assert switch.statistics is not None
    assert switch.statistics.maximum == 0.0
    assert car.energy_j("_ff") == 0.0
    assert 0.15 * car.lost_j() < car.energy_j() < car.lost_j()
    assert 2.0 < car.rise_k("RL") < car.rise_k("FL") < 30.0


# Formula SAE


def test_uwfe_mis_wired_channel_and_dead_wheels(
    cars: Callable[..., Car],
) -> None:
    """A temperature that follows the pedal, wheels that stand or freeze."""
    car = cars("uwfe-91")

    assert car.faults == {
        ("dead", "wheel_speed_fl"),
        ("dead", "wheel_speed_fr"),
        ("frozen", "wheel_speed_rl"),
        ("frozen", "wheel_speed_rr"),
        ("offset", "primary_pressure"),
        ("mis-wired", "temp_fl_disc"),
    }
    assert cars("uwfe-30").faults == {
        ("dead", "wheel_speed_fl"),
        ("dead", "wheel_speed_fr"),
    }


def test_uwfe_lengths_of_the_dbc_are_told(cars: Callable[..., Car]) -> None:
    """As published, the DBC refuses the pressure's frames: check says so."""
    dbc = Path(str(REAL)) / "uwfe-fsae-ev-can" / "2024CAR.dbc"
    mended = cars("uwfe-91").config.bus[0].dbc
    car = cars("uwfe-91", (mended, dbc.as_posix()))
    roles = {one.role: one for one in car.quality.roles}

    for role in ("primary_pressure", "temp_fl_disc"):
        assert roles[role].statistics is None
        assert "wrong length" in roles[role].why_missing


def test_uwfe_a_frozen_speed_would_be_heat(cars: Callable[..., Car]) -> None:
    """What replay books is more than the motion ever had to give.

    The dead front wheels are told and left out, so their brakes are heated
    too; that the rear ones are frozen alike nothing contradicts.
    """
    car = cars("uwfe-91")

    dead = car.columns["flags"].astype(np.int64) & FRONT_SUSPECT
    assert dead[-1] == FRONT_SUSPECT
    assert car.energy_j(corners=FRONT) > 2.0 * car.lost_j()
    assert car.energy_j(corners=REAR) > 0.1 * car.lost_j()

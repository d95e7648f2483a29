"""One car of the population: what it learns, and the heat it gets right.

The car drives in the independent reality; the estimator has the example
car's configuration, wrong for it in every way. Three ordinary drives, then a
descent, hard stops and a city drive, each a morning later: what was learned is
carried over as the service does. Samples reach the estimator as columns, at
the 50 Hz of the example bus.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from heat_roads import TESTS, Road, learning

from bstm_daemon.channels import CHANNELS, VEHICLE_CHANNELS
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.estimator import STEP_US, Estimator
from bstm_daemon.estimator.input_history import InputHistory
from bstm_daemon.estimator.state import export_state, resume_state
from bstm_daemon.files import shipped_file
from bstm_daemon.roles import ROLE_INDEX, ROLES
from bstm_daemon.simulation import NOMINAL, SENSOR_PRESETS, simulate
from bstm_daemon.simulation.profile import SAMPLE_S
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation import CarParameters, SimulatedDrive
    from bstm_daemon.simulation.drives import Drive
    from bstm_daemon.simulation.materials import Array

NIGHT_US: Final = 8 * 3_600_000_000
DAY_US: Final = 24 * 3_600_000_000
EVERY: Final = 2
"""Samples of the reality (100 Hz) to one of the bus."""

BUS: Final = (
    *(f"wheel_speed_{corner}" for corner in ("fl", "fr", "rl", "rr")),
    *("vehicle_speed", "primary_pressure", "secondary_pressure"),
    *("acceleration_longitudinal", "acceleration_lateral", "yaw_rate"),
    *("powertrain_torque", "motor_torque", "gear", "clutch_open"),
    *("ambient_temperature", "brake_switch"),
    *("abs_active", "esc_active", "tc_active"),
)
"""Signals of a usual bus: no wheel pressures, no external force."""

HEIGHT_DRIFT_M: Final = 2.0
HEIGHT_DRIFT_S: Final = 60.0
HEIGHT_NOISE_M: Final = 0.3
GNSS_SPEED_NOISE_MS: Final = 0.1

DIMENSIONS: Final = {
    "mass_kg": (1600.0, 2900.0),
    "bias_ms2": (-0.3, 0.3),
    "grade_percent": (-12.0, 12.0),
    "friction": (0.7, 1.3),
    "drag": (1.0, 1.4),
    "wind_ms": (0.0, 8.0),
    "torque": (0.97, 1.03),
    "rolling": (0.012, 0.016),
    "sensors": (0.0, 3.0),
}
"""What the hypercube spans."""


@dataclass(frozen=True)
class Case:
    """A car, its sensors and its roads.

    ``friction``, ``drag`` and ``torque`` are shares of what the configuration
    (or the truth, for the torque signal) has. Even cases have a satellite
    receiver: height and speed once a second.
    """

    number: int
    seed: int
    mass_kg: float
    bias_ms2: float
    grade_percent: float
    friction: float
    drag: float
    wind_ms: float
    torque: float
    rolling: float
    sensors: str
    preset: str
    satellites: bool

    def car(self) -> CarParameters:
        """Return the car that really drives."""
        mu = NOMINAL.front.friction_coefficient * self.friction
        return replace(
            NOMINAL,
            mass_kg=self.mass_kg,
            drag_area_m2=NOMINAL.drag_area_m2 * self.drag,
            rolling_resistance=self.rolling,
            front=replace(NOMINAL.front, friction_coefficient=mu),
            rear=replace(NOMINAL.rear, friction_coefficient=mu),
        )


def hypercube(count: int, seed: int) -> list[Case]:
    """Return *count* cases: each dimension once in each of its strata."""
    rng = np.random.default_rng(seed)
    drawn = {
        name: low
        + (high - low) * (rng.permutation(count) + rng.random(count)) / count
        for name, (low, high) in DIMENSIONS.items()
    }
    sensors = drawn.pop("sensors")
    return [
        Case(
            number=i,
            seed=seed * 10_000 + i,
            sensors=("n1", "n2", "n3")[int(sensors[i])],
            preset=("plain", "road")[i // 2 % 2],
            satellites=i % 2 == 0,
            **{name: float(values[i]) for name, values in drawn.items()},
        )
        for i in range(count)
    ]


@dataclass
class Heat:
    """What fusion says of one drive [J], corners together; front axle."""

    energy_j: float = 0.0
    spread_j: float = 0.0
    front_j: float = 0.0


class StepHeat(InputHistory):
    """Takes every step's power and standard deviation.

    An error of one step is taken to be that of all: the friction's, the
    mass's. So standard deviations add up.
    """

    def __init__(self, corners: int) -> None:
        """Take rows of this many corners."""
        super().__init__(corners * len(CHANNELS), 1)
        self.heat = Heat()

    def add(self, rows: memoryview, steps: int) -> None:
        """Add *steps* rows up."""
        table = np.frombuffer(rows, np.float64).reshape(
            steps, -1, len(CHANNELS)
        )
        step_s = STEP_US * 1e-6
        power = table[:, :, CHANNELS.index("brake_power_w")]
        spread = table[:, :, CHANNELS.index("brake_power_std_w")]
        self.heat.energy_j += step_s * float(power.sum())
        self.heat.front_j += step_s * float(power[:, :2].sum())
        self.heat.spread_j += step_s * float(spread.sum())


@dataclass
class Run:
    """The estimator's side of a drive."""

    heat: Heat
    document: dict[str, Any]
    times_s: Array
    vehicle: Array
    ff_j: float
    fb_j: float

    def of_car(self, name: str) -> Array:
        """Return one of the vehicle's channels at the publications."""
        column: Array = self.vehicle[:, VEHICLE_CHANNELS.index(name)]
        return column

    def last(self, name: str) -> float:
        """Return the channel's value at the end."""
        return float(self.of_car(name)[-1])


@cache
def configured(mode: str) -> Config:
    """Return the example car's configuration with this heat mode."""
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    heat = config.heat.model_copy(update={"mode": mode})
    return config.model_copy(update={"heat": heat})


def simulated(case: Case, drive: Drive) -> SimulatedDrive:
    """Return the drive with the case's sensors instead of the preset's.

    The preset's bias of the accelerometer is a new one every drive; a car's
    stays.
    """
    driven = simulate(
        drive,
        case.car(),
        preset=case.preset,
        sensors=case.sensors,
        seed=case.seed,
    )
    roles = dict(driven.roles)
    preset = SENSOR_PRESETS[case.sensors]
    assert preset is not None
    course = driven.course
    pitch = preset.pitch_rad_per_g * course.acceleration_ms2 / GRAVITY_MS2
    felt = course.acceleration_ms2 + GRAVITY_MS2 * np.sin(
        course.slope_rad + pitch
    )
    role = "acceleration_longitudinal"
    drawn = float((roles[role] - felt).mean())
    roles[role] = roles[role] + (case.bias_ms2 - drawn)
    roles["powertrain_torque"] = roles["powertrain_torque"] * case.torque
    if case.satellites:
        roles |= satellites(driven, np.random.default_rng([case.seed, 1]))
    return replace(driven, roles=roles)


def satellites(
    driven: SimulatedDrive, rng: np.random.Generator
) -> dict[str, Array]:
    """Return height [m] and speed [m/s], held between their seconds."""
    course = driven.course
    every = round(1.0 / SAMPLE_S)
    height = np.cumsum(course.speed_ms * np.sin(course.slope_rad)) * SAMPLE_S
    count = len(height[::every])
    keep = float(np.exp(-1.0 / HEIGHT_DRIFT_S))
    drift = np.empty(count)
    last = rng.normal()
    for i, step in enumerate(rng.normal(0, np.sqrt(1 - keep**2), count)):
        last = keep * last + step
        drift[i] = last
    error = HEIGHT_DRIFT_M * drift + rng.normal(0, HEIGHT_NOISE_M, count)
    speed = course.speed_ms[::every]
    speed = np.maximum(speed + rng.normal(0, GNSS_SPEED_NOISE_MS, count), 0.0)
    return {
        "altitude": np.repeat(height[::every] + error, every)[: len(height)],
        "gnss_speed": np.repeat(speed, every)[: len(height)],
    }


def columns(
    driven: SimulatedDrive, start_us: int
) -> tuple[Array, Array, Array, dict[int, int]]:
    """Return stamps, roles and values of the bus, and time-outs."""
    names = [*BUS, *(n for n in ("altitude", "gnss_speed"))]
    names = [name for name in names if name in driven.roles]
    numbers = np.array([ROLE_INDEX[name] for name in names], np.int32)
    stamps = np.rint(driven.time_s[::EVERY] * 1e6).astype(np.int64) + start_us
    values = np.column_stack([driven.roles[name][::EVERY] for name in names])
    return (
        np.repeat(stamps, len(names)),
        np.tile(numbers, len(stamps)),
        values.astype(np.float64).ravel(),
        {int(n): round(ROLES[n].timeout_s * 1e6) for n in numbers},
    )


def estimate(
    config: Config,
    driven: SimulatedDrive,
    day: int,
    document: dict[str, Any] | None = None,
) -> Run:
    """Let the estimator see *driven*, parked since *document*."""
    start_us = day * DAY_US
    *samples, present = columns(driven, start_us)
    estimator = Estimator(config, present)
    assert estimator.compiled
    if document is not None:
        resume_state(estimator, document, NIGHT_US, start_us)
    steps = StepHeat(len(config.corner))
    estimator.input_history = steps
    blocks = estimator.advance(*samples)
    wide, channels = len(VEHICLE_CHANNELS), len(CHANNELS)
    rows = np.concatenate([np.frombuffer(b.rows) for b in blocks])
    last = rows.reshape(-1, len(config.corner), channels)[-1]
    times = np.concatenate([np.frombuffer(b.times_us, "q") for b in blocks])
    vehicle = np.concatenate([np.frombuffer(b.vehicle) for b in blocks])
    return Run(
        steps.heat,
        json.loads(json.dumps(export_state(estimator))),
        (times - start_us) * 1e-6,
        vehicle.reshape(-1, wide),
        float(last[:, CHANNELS.index("brake_energy_ff_j")].sum()),
        float(last[:, CHANNELS.index("brake_energy_fb_j")].sum()),
    )


def examine(case: Case) -> dict[str, Any]:
    """Return the figures of one case, as JSON has them."""
    document = None
    fused, alone = configured("fused"), configured("ff")
    found: dict[str, Any] = {"case": vars(case), "heat": {}, "learned": []}
    steep = abs(case.grade_percent)
    for number in range(3):
        rng = np.random.default_rng([case.seed, 10 + number])
        road = Road(rng, case.wind_ms, steep)
        road.mean = 0.4 * case.grade_percent
        learning(road, number)
        driven = simulated(case, road.drive(f"learning {number + 1}"))
        run = estimate(fused, driven, number, document)
        document = run.document
        found["learned"].append(learned(case, run))
        found["heat"][driven.drive.name] = judged(case, driven, run)
    for number, (name, kind) in enumerate(TESTS.items()):
        rng = np.random.default_rng([case.seed, 20 + number])
        road = Road(rng, case.wind_ms, steep)
        kind(road)
        driven = simulated(case, road.drive(name))
        run = estimate(fused, driven, 3, document)
        base = estimate(alone, driven, 3)
        found["heat"][name] = judged(case, driven, run, base)
        if name == "descent":
            first = estimate(fused, driven, 3)
            found["heat"]["first descent"] = judged(case, driven, first, base)
    return found


def learned(case: Case, run: Run) -> dict[str, float]:
    """Return errors of what is learned, with its standard deviations.

    A torque signal that reads s times the torque makes everything that is
    weighed with it s times as heavy and as braked: the errors are relative to
    that, but for those that say ``true``.
    """
    mass_kg = run.last("mass_kg")
    friction = run.last("friction_scale")
    numbers = (run.document["learned"] or {"numbers": {}})["numbers"]
    true_bias = case.bias_ms2 - GRAVITY_MS2 * case.rolling
    return {
        "bias": numbers.get("bias", np.nan) - true_bias,
        "bias_sd": numbers.get("bias_bias", np.nan) ** 0.5,
        "mass": mass_kg / (case.mass_kg * case.torque) - 1.0,
        "mass_sd": run.last("mass_std_kg") / mass_kg,
        "mass_true": mass_kg / case.mass_kg - 1.0,
        "friction": (friction / mass_kg) / (case.friction / case.mass_kg)
        - 1.0,
        "friction_sd": run.last("friction_scale_std") / friction,
        "friction_alone": friction / (case.friction * case.torque) - 1.0,
        "friction_true": friction / case.friction - 1.0,
        "drag": run.last("drag_scale") / case.drag - 1.0,
    }


def judged(
    case: Case, driven: SimulatedDrive, run: Run, alone: Run | None = None
) -> dict[str, float]:
    """Return the heat's errors, those of FF and FB *alone*, and the grade's.

    ``relative`` takes the torque signal's scale as right.
    """
    real_j = float(driven.brake_power_w.sum()) * SAMPLE_S
    front_j = float(driven.brake_power_w[:, :2].sum()) * SAMPLE_S
    course = driven.course
    slope = np.interp(run.times_s, course.time_s, np.tan(course.slope_rad))
    grade, moving = run.of_car("grade"), run.of_car("speed_ms") > 2.0
    apart = (grade - slope)[moving]
    found = {
        "real_j": real_j,
        "fused": run.heat.energy_j / real_j - 1.0,
        "relative": run.heat.energy_j / (real_j * case.torque) - 1.0,
        "front": run.heat.front_j / front_j - 1.0,
        "sd": run.heat.spread_j / real_j,
        "grade_rms": float(np.sqrt(np.nanmean(apart**2))),
        "grade_mean": float(np.nanmean(apart)),
        "grade_sd": float(np.nanmean(run.of_car("grade_std")[moving])),
        "flags": int(np.bitwise_or.reduce(run.of_car("flags").astype("q"))),
    }
    if alone is not None:
        found["ff"] = alone.ff_j / real_j - 1.0
        found["fb"] = alone.fb_j / real_j - 1.0
    return found

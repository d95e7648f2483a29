"""A simulated drive: car, four brakes and sensors together."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from bstm_daemon.roles import CORNERS
from bstm_daemon.simulation import vehicle
from bstm_daemon.simulation.car import Motion, line_pressure, move
from bstm_daemon.simulation.drives import Drive
from bstm_daemon.simulation.materials import Array
from bstm_daemon.simulation.parameters import (
    DEFAULT_MESH,
    Effects,
    Mesh,
    preset_effects,
)
from bstm_daemon.simulation.profile import SAMPLE_S, Course, plan_course
from bstm_daemon.simulation.reality import LaneInputs, LaneResult, march_lanes
from bstm_daemon.simulation.sensors import (
    measured_roles,
    measured_temperatures,
    sensor_suite,
)
from bstm_daemon.units import KELVIN_OFFSET

TRUTH_S: Final = 1.0
"""Time between rows of the truth and of the thermocouples."""

SETTLED_S: Final = 60.0
"""Standing time after which the soak step is long enough."""

_BLOCK_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class Resolution:
    """Cells and steps of the reality.

    ``step_s`` while anything happens, ``soak_step_s`` once the car has stood
    for :data:`SETTLED_S`; both divide 2 s into whole steps.
    """

    mesh: Mesh = DEFAULT_MESH
    step_s: float = 0.5
    soak_step_s: float = 2.0


DEFAULT_RESOLUTION: Final = Resolution()
"""On ``simalp`` fluid within 0.04 K, disc 0.4 K of twice the resolution."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedDrive:
    """What happened and what the car's sensors said of it; all SI.

    ``car`` is the one that really drove. ``roles`` maps vehicle roles to (n,)
    arrays at ``time_s`` (100 Hz). ``temperatures`` maps
    ``temp_<corner>_<node>`` roles to (m,) arrays [K] at ``slow_time_s`` (1
    Hz). ``truth`` maps ``<corner>.<node>`` to the real temperatures [K],
    (m,). ``brake_power_w`` (n, 4) is the real friction power of FL, FR, RL,
    RR, ``brake_energy_j`` (m, 4) its integral. ``bus_on`` and ``logger_on``
    (n,) mark which frames are sent.
    """

    drive: Drive
    car: vehicle.CarParameters
    course: Course
    motion: Motion
    time_s: Array
    roles: Mapping[str, Array]
    slow_time_s: Array
    temperatures: Mapping[str, Array]
    truth: Mapping[str, Array]
    brake_power_w: Array
    brake_energy_j: Array
    bus_on: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    logger_on: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    balance_residual: Array


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A drive up to the brakes: what acts on the four corners of ``car``."""

    car: vehicle.CarParameters
    course: Course
    motion: Motion
    inputs: LaneInputs
    ambient_k: Array
    start_k: float


def prepare(
    drive: Drive,
    car: vehicle.CarParameters | None,
    effects: Effects,
    resolution: Resolution = DEFAULT_RESOLUTION,
) -> Prepared:
    """Return *drive* of *car* (None: the drive's own) up to the brakes.

    Raises :class:`~bstm_daemon.errors.ConfigError` for a drive that cannot be
    driven.
    """
    head = drive.drive
    if car is None:
        car = vehicle.load_vehicle(head.vehicle)
    car = vehicle.scaled_car(car, head.scale, drive.name)
    if head.mass_kg is not None:
        car = replace(car, mass_kg=head.mass_kg)
    actual = vehicle.real_car(car, effects)
    course = plan_course(drive, actual)
    motion = move(course, actual, effects, pushed=head.propulsion == "push")
    ambient_k = KELVIN_OFFSET + course.level(
        [
            head.ambient_c if s.ambient_c is None else s.ambient_c
            for s in course.segments
        ]
    )
    start_c = head.ambient_c if head.start_c is None else head.start_c
    return Prepared(
        actual,
        course,
        motion,
        step_inputs(course, motion, ambient_k, resolution),
        ambient_k,
        KELVIN_OFFSET + start_c,
    )


def simulate(
    drive: Drive,
    car: vehicle.CarParameters | None = None,
    *,
    preset: str | Effects = "plain",
    sensors: str = "none",
    seed: int = 0,
    resolution: Resolution = DEFAULT_RESOLUTION,
) -> SimulatedDrive:
    """Drive *car* along *drive* and return what happened.

    Without *car* the drive's own vehicle drives. *preset* names the effects
    or gives them, *sensors* names the sensors' errors, which *seed* feeds;
    the same arguments give the same arrays.
    Raises :class:`~bstm_daemon.errors.UsageError` for an unknown name and
    :class:`~bstm_daemon.errors.ConfigError` for a drive that cannot be driven.
    """
    effects = preset_effects(preset) if isinstance(preset, str) else preset
    suite = sensor_suite(sensors, effects, seed)
    ready = prepare(drive, car, effects, resolution)
    course, motion = ready.course, ready.motion
    result = march_lanes(
        ready.car.corners,
        [effects] * len(CORNERS),
        ready.inputs,
        start_k=np.full(len(CORNERS), ready.start_k),
        mesh=resolution.mesh,
    )
    slow_s = np.arange(TRUTH_S, course.time_s[-1] + SAMPLE_S, TRUTH_S)
    truth = real_temperatures(result, slow_s, ready.start_k)
    scale, power = _at_samples(result, ready)
    roles = measured_roles(
        course,
        line_pa=line_pressure(motion.pressure_pa * scale, effects),
        wheel_pa=motion.corner_pressure_pa * scale[:, None],
        motion=motion,
        ambient_k=ready.ambient_k,
        suite=suite,
    )
    energy = np.cumsum(power, axis=0) * SAMPLE_S
    ignition = course.level([float(s.ignition) for s in course.segments]) > 0
    return SimulatedDrive(
        drive=drive,
        car=ready.car,
        course=course,
        motion=motion,
        time_s=course.time_s,
        roles=roles,
        slow_time_s=slow_s,
        temperatures=measured_temperatures(truth, suite),
        truth=truth,
        brake_power_w=power,
        brake_energy_j=energy[np.rint(slow_s / SAMPLE_S).astype(int) - 1],
        bus_on=ignition,
        logger_on=ignition | drive.drive.thermocouple_logger,
        balance_residual=result.balance_residual,
    )


def real_temperatures(
    result: LaneResult, slow_s: Array, start_k: float
) -> dict[str, Array]:
    """Return ``<corner>.<node>`` [K] at *slow_s* (m,) of a car's march."""
    time_s = np.concatenate(([0.0], result.time_s))
    return {
        f"{corner}.{node}": np.interp(
            slow_s, time_s, np.concatenate(([start_k], series[:, lane]))
        )
        for lane, corner in enumerate(CORNERS)
        for node, series in result.nodes.items()
    }


def _at_samples(result: LaneResult, ready: Prepared) -> tuple[Array, Array]:
    """Return the pressure over its nominal value (n,) and the power (n, 4).

    Friction is known a step; both are continuous in it to within its drift.
    """
    step_s = ready.inputs.step_s
    middles = np.cumsum(step_s) - step_s / 2
    time_s = ready.course.time_s
    gains = ready.car.gains
    total = result.friction @ (gains / gains.sum())
    scale = np.interp(time_s, middles, 1.0 / total)
    nominal = nominal_power(ready.course, ready.motion)
    power = nominal * np.column_stack(
        [
            np.interp(time_s, middles, result.friction[:, lane])
            for lane in range(len(CORNERS))
        ]
    )
    reached = power.sum(axis=1)
    power *= np.divide(
        nominal.sum(axis=1),
        reached,
        out=np.ones_like(reached),
        where=reached > 0,
    )[:, None]
    return scale, power


def nominal_power(course: Course, motion: Motion) -> Array:
    """Return the friction power [W] of each corner at nominal mu, (n, 4).

    A wheel that slips turns slower and leaves its part to the tyre.
    """
    power: Array = (
        motion.corner_force_n * course.speed_ms[:, None] * (1.0 - motion.slip)
    )
    return power


def step_inputs(
    course: Course, motion: Motion, ambient_k: Array, resolution: Resolution
) -> LaneInputs:
    """Return the reality's inputs: means of the samples over its steps.

    Power is averaged, so no brake energy is lost to the step.
    """
    block = round(_BLOCK_S / SAMPLE_S)
    moving = round(resolution.step_s / SAMPLE_S)
    soaking = round(resolution.soak_step_s / SAMPLE_S)
    pressures = motion.corner_pressure_pa
    active = (course.speed_ms > 0) | pressures.any(axis=1)
    settled = _settled(np.logical_or.reduce(active.reshape(-1, block), axis=1))
    starts = np.concatenate(
        [
            index * block + np.arange(0, block, soaking if calm else moving)
            for index, calm in enumerate(settled.tolist())
        ]
    )
    lengths = np.diff(np.append(starts, motion.size))

    def mean(samples: Array) -> Array:
        sums = np.add.reduceat(samples, starts, axis=0)
        return sums.reshape(len(starts), -1) / lengths[:, None]

    pumping = np.abs(np.gradient(pressures, SAMPLE_S, axis=0))
    rain = course.level([s.rain for s in course.segments])
    ends_s = (starts + lengths) * SAMPLE_S
    return LaneInputs(
        step_s=lengths * SAMPLE_S,
        keep=np.abs(ends_s - np.round(ends_s)) < SAMPLE_S / 2,
        speed_ms=mean(course.speed_ms),
        power_w=mean(nominal_power(course, motion)),
        pressure_pa=mean(pressures),
        contact=mean((pressures > 0).astype(np.float64)),
        ambient_k=mean(ambient_k),
        wetness=mean(rain),
        pumping_pa_s=mean(pumping),
        corners_per_car=len(CORNERS),
    )


def _settled(
    active: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return which 2 s blocks lie :data:`SETTLED_S` after the last active."""
    busy = np.flatnonzero(active)
    if not len(busy):
        return np.ones_like(active)
    blocks = np.arange(len(active))
    last = np.searchsorted(busy, blocks, side="right") - 1
    since_s = (blocks - busy[np.maximum(last, 0)]) * _BLOCK_S
    return (last < 0) | (since_s > SETTLED_S)

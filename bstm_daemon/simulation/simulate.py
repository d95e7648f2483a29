"""A simulated drive: car, four brakes and sensors together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.roles import CORNERS
from bstm_daemon.simulation.batch import march_lanes
from bstm_daemon.simulation.car import Motion, line_pressure, move
from bstm_daemon.simulation.march import LaneInputs, LaneResult
from bstm_daemon.simulation.parameters import (
    DEFAULT_MESH,
    Mesh,
    preset_effects,
)
from bstm_daemon.simulation.profile import SAMPLE_S, Course, plan_course
from bstm_daemon.simulation.sensors import (
    SensorSuite,
    measured_roles,
    measured_temperatures,
)
from bstm_daemon.simulation.vehicle import NOMINAL, CarParameters, real_car
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.simulation.drives import Drive
    from bstm_daemon.simulation.materials import Array

SETTLED_S: Final = 60.0
"""Standing time after which the soak step is long enough."""

_BLOCK_S: Final = 2.0

TRUTH_S: Final = 1.0
"""Time between rows of the truth and of the thermocouples."""


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
"""Fluid and disc within 0.1 K of the doubled resolution on ``simalp``."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedDrive:
    """What happened and what the car's sensors said of it; all SI.

    ``roles`` maps vehicle roles to (n,) arrays at ``time_s`` (100 Hz).
    ``temperatures`` maps ``temp_<corner>_<node>`` roles to (m,) arrays [K] at
    ``slow_time_s`` (1 Hz). ``truth`` maps ``<corner>.<node>`` to the real
    temperatures [K], (m,). ``brake_power_w`` (n, 4) is the real friction
    power of FL, FR, RL, RR, ``brake_energy_j`` (m, 4) its integral.
    ``bus_on`` and ``logger_on`` (n,) tell which frames are sent.
    """

    drive: Drive
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


def simulate(
    drive: Drive,
    car: CarParameters = NOMINAL,
    *,
    preset: str = "plain",
    seed: int = 0,
    resolution: Resolution = DEFAULT_RESOLUTION,
) -> SimulatedDrive:
    """Drive *car* along *drive* and return what happened.

    *seed* feeds the sensors' noise; the same arguments give the same arrays.
    Raises :class:`~bstm_daemon.errors.UsageError` for an unknown preset and
    :class:`~bstm_daemon.errors.ConfigError` for a drive that cannot be driven.
    """
    effects = preset_effects(preset)
    if drive.drive.mass_kg is not None:
        car = car.with_mass(drive.drive.mass_kg)
    actual = real_car(car, effects)
    course = plan_course(drive, actual)
    motion = move(course, actual, pushed=drive.drive.propulsion == "push")
    head = drive.drive
    ambient_k = KELVIN_OFFSET + course.level(
        [
            head.ambient_c if s.ambient_c is None else s.ambient_c
            for s in course.segments
        ]
    )
    start_k = KELVIN_OFFSET + (
        head.ambient_c if head.start_c is None else head.start_c
    )
    inputs = step_inputs(course, motion, actual, ambient_k, resolution)
    result = march_lanes(
        actual.corners,
        [effects] * len(CORNERS),
        inputs,
        start_k=np.full(len(CORNERS), start_k),
        mesh=resolution.mesh,
    )
    slow_s = np.arange(TRUTH_S, course.time_s[-1] + SAMPLE_S, TRUTH_S)
    truth = _truth(result, slow_s, start_k)
    scale, power = _at_samples(result, inputs, course, motion, actual)
    clamp_pa = motion.pressure_pa * scale
    suite = SensorSuite(effects, seed)
    line_pa = line_pressure(clamp_pa, effects, SAMPLE_S)
    roles = measured_roles(course, motion, line_pa, ambient_k, suite)
    energy = np.cumsum(power, axis=0) * SAMPLE_S
    ignition = course.level([float(s.ignition) for s in course.segments]) > 0
    return SimulatedDrive(
        drive=drive,
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
        logger_on=ignition | head.thermocouple_logger,
        balance_residual=result.balance_residual,
    )


def step_inputs(
    course: Course,
    motion: Motion,
    car: CarParameters,
    ambient_k: Array,
    resolution: Resolution,
) -> LaneInputs:
    """Return the reality's inputs: means of the samples over its steps.

    Power is averaged, so no brake energy is lost to the step.
    """
    block = round(_BLOCK_S / SAMPLE_S)
    moving = round(resolution.step_s / SAMPLE_S)
    soaking = round(resolution.soak_step_s / SAMPLE_S)
    active = (course.speed_ms > 0) | (motion.pressure_pa > 0)
    settled = _settled(np.logical_or.reduce(active.reshape(-1, block), axis=1))
    starts = np.concatenate(
        [
            index * block + np.arange(0, block, soaking if calm else moving)
            for index, calm in enumerate(settled.tolist())
        ]
    )
    lengths = np.diff(np.append(starts, motion.size))

    def mean(samples: Array) -> Array:
        return np.add.reduceat(samples, starts) / lengths

    power = mean(motion.brake_force_n * course.speed_ms)
    share = car.gains / car.gains.sum()
    pumping = np.abs(np.gradient(motion.pressure_pa, SAMPLE_S))
    rain = course.level([s.rain for s in course.segments])
    ends_s = (starts + lengths) * SAMPLE_S
    return LaneInputs(
        step_s=lengths * SAMPLE_S,
        keep=np.abs(ends_s - np.round(ends_s)) < SAMPLE_S / 2,
        speed_ms=mean(course.speed_ms)[:, None],
        power_w=power[:, None] * share,
        pressure_pa=mean(motion.pressure_pa)[:, None],
        contact=mean(motion.contact)[:, None],
        ambient_k=mean(ambient_k)[:, None],
        wetness=mean(rain)[:, None],
        pumping_pa_s=mean(pumping)[:, None],
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


def _truth(
    result: LaneResult, slow_s: Array, start_k: float
) -> dict[str, Array]:
    time_s = np.concatenate(([0.0], result.time_s))
    return {
        f"{corner}.{node}": np.interp(
            slow_s, time_s, np.concatenate(([start_k], series[:, lane]))
        )
        for lane, corner in enumerate(CORNERS)
        for node, series in result.nodes.items()
    }


def _at_samples(
    result: LaneResult,
    inputs: LaneInputs,
    course: Course,
    motion: Motion,
    car: CarParameters,
) -> tuple[Array, Array]:
    """Return the pressure over its nominal value (n,) and the power (n, 4).

    Friction is known a step; both are continuous in it to within its drift.
    """
    middles = np.cumsum(inputs.step_s) - inputs.step_s / 2
    share = car.gains / car.gains.sum() * result.friction
    total = share.sum(axis=1, keepdims=True)
    share = share / total
    scale = np.interp(course.time_s, middles, 1.0 / total[:, 0])
    force_power = motion.brake_force_n * course.speed_ms
    power = np.column_stack(
        [
            force_power * np.interp(course.time_s, middles, share[:, lane])
            for lane in range(len(CORNERS))
        ]
    )
    return scale, power

"""A simulated drive: car, four brakes and sensors together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.roles import CORNERS
from bstm_daemon.simulation.car import Motion, move
from bstm_daemon.simulation.hydraulics import line_pressure
from bstm_daemon.simulation.parameters import Effects, preset_effects
from bstm_daemon.simulation.profile import SAMPLE_S, Course, plan_course
from bstm_daemon.simulation.reality import march_lanes
from bstm_daemon.simulation.sensor_presets import sensor_suite
from bstm_daemon.simulation.sensors import (
    measured_roles,
    measured_temperatures,
)
from bstm_daemon.simulation.steps import (
    DEFAULT_RESOLUTION,
    Resolution,
    nominal_power,
    step_inputs,
)
from bstm_daemon.simulation.vehicle import CarParameters, real_car
from bstm_daemon.simulation.vehicles import load_vehicle, scaled_car
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.simulation.drives import Drive
    from bstm_daemon.simulation.march import LaneInputs, LaneResult
    from bstm_daemon.simulation.materials import Array

TRUTH_S: Final = 1.0
"""Time between rows of the truth and of the thermocouples."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedDrive:
    """What happened and what the car's sensors said of it; all SI.

    ``car`` is the one that really drove. ``roles`` maps vehicle roles to (n,)
    arrays at ``time_s`` (100 Hz). ``temperatures`` maps
    ``temp_<corner>_<node>`` roles to (m,) arrays [K] at ``slow_time_s`` (1
    Hz). ``truth`` maps ``<corner>.<node>`` to the real temperatures [K],
    (m,). ``brake_power_w`` (n, 4) is the real friction power of FL, FR, RL,
    RR, ``brake_energy_j`` (m, 4) its integral. ``bus_on`` and ``logger_on``
    (n,) tell which frames are sent.
    """

    drive: Drive
    car: CarParameters
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

    car: CarParameters
    course: Course
    motion: Motion
    inputs: LaneInputs
    ambient_k: Array
    start_k: float


def prepare(
    drive: Drive,
    car: CarParameters | None,
    effects: Effects,
    resolution: Resolution = DEFAULT_RESOLUTION,
) -> Prepared:
    """Return *drive* of *car* (None: the drive's own) up to the brakes.

    Raises :class:`~bstm_daemon.errors.ConfigError` for a drive that cannot be
    driven.
    """
    head = drive.drive
    if car is None:
        car = load_vehicle(head.vehicle)
    car = scaled_car(car, head.scale, drive.name)
    if head.mass_kg is not None:
        car = car.with_mass(head.mass_kg)
    actual = real_car(car, effects)
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
    car: CarParameters | None = None,
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

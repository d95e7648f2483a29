"""The reality's steps: how a course's samples become inputs of the march."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.roles import CORNERS
from bstm_daemon.simulation.march import LaneInputs
from bstm_daemon.simulation.parameters import DEFAULT_MESH, Mesh
from bstm_daemon.simulation.profile import SAMPLE_S

if TYPE_CHECKING:
    from bstm_daemon.simulation.car import Motion
    from bstm_daemon.simulation.materials import Array
    from bstm_daemon.simulation.profile import Course

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


def nominal_power(course: Course, motion: Motion) -> Array:
    """Return the friction power [W] of each corner at nominal mu, (n, 4).

    A wheel that slips turns slower and leaves its part to the tyre.
    """
    power: Array = (
        motion.corner_force_n * course.speed_ms[:, None] * (1.0 - motion.slip)
    )
    return power


def step_inputs(
    course: Course,
    motion: Motion,
    ambient_k: Array,
    resolution: Resolution,
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

"""From a drive to its course: speed, grade and settings at 100 Hz.

Driven segments give the speed as straight pieces; free segments are
integrated with the car's forces. Corners of the speed are rounded over half a
second, as a driver and the chassis do, so that acceleration is finite.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.errors import ConfigError
from bstm_daemon.simulation.drives import Drive, Segment
from bstm_daemon.simulation.materials import Array
from bstm_daemon.simulation.vehicle import CarParameters

SAMPLE_S: Final = 0.01
"""Time between samples of a course."""

_BLOCK_S = 2.0
_ROUNDING_SAMPLES = 51
_GRADE_SAMPLES = 301
_FREE_STEP_S = 0.05
_FREE_LIMIT_S = 1800.0


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A drive sampled at 100 Hz; arrays (n,), SI.

    ``segment`` is the index into ``segments``, the unrolled list; per-segment
    settings are looked up with :meth:`level`.
    """

    time_s: Array
    speed_ms: Array
    acceleration_ms2: Array
    slope_rad: Array
    headwind_ms: Array
    segment: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    segments: list[Segment]
    starts_s: list[float]

    def level(self, values: list[float]) -> Array:
        """Return *values*, one a segment, as samples."""
        return np.array(values, dtype=np.float64)[self.segment]


def plan_course(drive: Drive, car: CarParameters) -> Course:
    """Return the course of *drive* for *car*.

    Raises :class:`~bstm_daemon.errors.ConfigError` naming the segment that
    cannot be driven.
    """
    times, speeds, ends, segments = [0.0], [0.0], [0.0], []
    for place, segment in drive.flat():
        t, v = _run(segment, speeds[-1], car, f"{drive.name}: {place}")
        times.extend((times[-1] + t).tolist())
        speeds.extend(v.tolist())
        ends.append(times[-1])
        segments.append(segment)
    total_s = np.ceil(times[-1] / _BLOCK_S) * _BLOCK_S
    count = round(total_s / SAMPLE_S)
    time_s = np.arange(count) * SAMPLE_S
    speed = rounded(np.interp(time_s, times, speeds))
    speed[speed < 1e-9] = 0.0
    index = np.minimum(
        np.searchsorted(ends[1:], time_s, side="right"), len(segments) - 1
    )
    grades = np.array([segment.grade_percent / 100 for segment in segments])
    slope = rounded(np.arctan(grades)[index], _GRADE_SAMPLES)
    winds = np.array([segment.headwind_ms for segment in segments])
    return Course(
        time_s,
        speed,
        np.gradient(speed, SAMPLE_S),
        slope,
        rounded(winds[index], _GRADE_SAMPLES),
        index,
        segments,
        ends[:-1],
    )


def rounded(values: Array, samples: int = _ROUNDING_SAMPLES) -> Array:
    """Return the centred moving average of *values*, ends extended.

    Without *samples* over as long as the corners of the speed are rounded.
    """
    half = samples // 2
    padded = np.concatenate(
        (np.full(half, values[0]), values, np.full(half, values[-1]))
    )
    sums = np.concatenate(([0.0], np.cumsum(padded)))
    mean: Array = (sums[samples:] - sums[:-samples]) / samples
    return mean


def _run(
    segment: Segment, v0: float, car: CarParameters, place: str
) -> tuple[Array, Array]:
    """Return the segment's knots: times from its start and speeds."""
    if segment.parked:
        if v0 > 0:
            raise ConfigError(
                [f"{place}: parked at {v0 * 3.6:.0f} km/h: stop first"]
            )
        return np.array([segment.duration_s]), np.zeros(1)
    if segment.until_speed_kmh is not None:
        return _free(segment, v0, car, place)
    v1 = (segment.speed_kmh or 0.0) / 3.6
    ramp_s = abs(v1 - v0) / segment.rate_ms2
    hold_s = _hold(segment, ramp_s, (v0 + v1) / 2 * ramp_s, v1, place)
    return np.array([ramp_s, ramp_s + hold_s]), np.array([v1, v1])


def _hold(
    segment: Segment, ramp_s: float, ramp_m: float, v1: float, place: str
) -> float:
    if segment.duration_s is not None:
        if segment.duration_s < ramp_s:
            problem = (
                f"{place}: duration_s: {segment.speed_kmh:g} km/h takes "
                f"{ramp_s:.1f} s at rate_ms2 = {segment.rate_ms2:g}"
            )
            raise ConfigError([problem])
        return segment.duration_s - ramp_s
    if segment.distance_m is None:
        return 0.0
    if segment.distance_m < ramp_m or v1 == 0:
        problem = (
            f"{place}: distance_m: {segment.speed_kmh:g} km/h takes "
            f"{ramp_m:.0f} m, the rest needs a speed above 0"
        )
        raise ConfigError([problem])
    return (segment.distance_m - ramp_m) / v1


def prescribed_force(
    segment: Segment, elapsed_s: Array, car: CarParameters
) -> Array:
    """Return the brake force [N] that *segment* prescribes, else 0.

    *elapsed_s* counts from the segment's start.
    """
    if segment.brake_pressure_bar is None:
        return np.full(len(elapsed_s), segment.brake_force_n or 0.0)
    bar = segment.brake_pressure_bar + segment.pressure_rise_bar_s * elapsed_s
    return car.brake_force(1e5) * np.maximum(bar, 0.0)


def _free(
    segment: Segment, v0: float, car: CarParameters, place: str
) -> tuple[Array, Array]:
    v1 = (segment.until_speed_kmh or 0.0) / 3.6
    limit_s = segment.duration_s or _FREE_LIMIT_S
    slope = np.arctan(np.array([segment.grade_percent / 100]))
    t, v = 0.0, v0
    times, speeds = [], []
    falling = v1 < v0
    while (v > v1) if falling else (v < v1):
        at = np.array([v])
        braking = prescribed_force(segment, np.array([t]), car)
        drag = car.engine_drag(at, np.array([segment.gear]))
        resistance = car.resistance(at, slope, segment.headwind_ms)
        force = (
            segment.external_force_n
            - float(braking[0])
            + float((drag / car.wheel_radius_m - resistance)[0])
        )
        v = max(v + force / car.effective_mass_kg * _FREE_STEP_S, 0.0)
        t += _FREE_STEP_S
        times.append(t)
        speeds.append(v)
        if t > limit_s:
            if segment.duration_s is not None:
                break
            problem = (
                f"{place}: until_speed_kmh: not reached within "
                f"{_FREE_LIMIT_S:.0f} s; still at {v * 3.6:.1f} km/h"
            )
            raise ConfigError([problem])
    return np.array(times), np.array(speeds)

"""Discs of any drive in windows: brake work from motion, cooling by speed.

Steps of a quarter of a second: a race car's stop lasts two. Brake work is
what the kinetic energy loses and neither resistances, climb nor drive line
account for (Eq 4.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.identify.disc_loss import (
    HIGHEST_K,
    LOWEST_K,
    HeatCapacities,
)
from bstm_daemon.analysis.quality.limits import GRID_S, RELEASED_PA
from bstm_daemon.analysis.statistics.series import Column, Matrix, block_means

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.analysis.identify.cool_downs import Slow
    from bstm_daemon.analysis.identify.disc_loss import DiscLoss
    from bstm_daemon.analysis.identify.driving import Driving

STEP_S: Final = 0.25
WINDOW_S: Final = 90.0
"""Long against a stop and short against the drive: about a lap."""

_POINTS: Final = round(STEP_S / GRID_S)
_STEPS: Final = round(WINDOW_S / STEP_S)


@dataclass(frozen=True, slots=True)
class Window:
    """One thermocouple over :data:`WINDOW_S`, (n,) each, SI.

    ``lost_j`` is the kinetic energy lost in each step less climb and plus
    the drive line's work, ``resisted_j`` the work of the resistances;
    ``pressed`` is 0 where the brake is known to be released.
    """

    log: str
    role: str
    corner: str
    start_s: float
    disc_k: Column
    ambient_k: Column
    speed_ms: Column
    lost_j: Column
    resisted_j: Column
    pressed: Column

    @property
    def time_s(self) -> Column:
        """Time since the start of the log, (n,)."""
        steps = np.arange(len(self.disc_k), dtype=np.float64)
        return self.start_s + STEP_S * steps


def windows_of(driving: Driving, slow: Slow) -> list[Window]:
    """Return the windows of *driving* in which everything is known.

    Only those in which the disc is above ambient at some time by 40 K.
    """
    car = driving.vehicle
    speed = driving.speed_ms
    count = (len(speed) - 1) // _POINTS
    ends = np.arange(count + 1) * _POINTS
    resistance = (car.quadratic * speed + car.linear) * speed
    resistance = np.where(speed > 0.0, resistance + car.constant, 0.0)
    pull = np.nan_to_num(driving.torque_nm) / car.wheel_radius_m
    pull = pull + driving.external_n
    if driving.has_accelerometer:
        pull = pull - car.mass_kg * np.nan_to_num(driving.slope_ms2)
    kinetic = 0.5 * car.effective_mass_kg * speed[ends] ** 2
    lost = -np.diff(kinetic) + _per_step(pull * speed, count) * STEP_S
    resisted = _per_step(resistance * speed, count) * STEP_S
    pressed = np.ones(len(speed))
    if driving.pressures:
        pressed = np.where(driving.highest_pressure_pa() < RELEASED_PA, 0, 1)
    on = _per_step(pressed.astype(float), count)
    mean_speed = _per_step(speed, count)
    ambient = np.interp(driving.time_s[ends[:-1]], slow.time_s, slow.ambient_k)
    found = []
    for role in slow.discs:
        disc = driving.value(role)[ends[:-1]]
        known = np.isfinite(disc + lost + resisted + mean_speed)
        for first in range(0, count - _STEPS + 1, _STEPS):
            part = slice(first, first + _STEPS)
            if not known[part].all():
                continue
            if (disc[part] - ambient[part]).max() < 40.0:
                continue
            found.append(
                Window(
                    driving.name,
                    role,
                    role.split("_")[1].upper(),
                    float(driving.time_s[ends[first]]),
                    disc[part],
                    ambient[part],
                    mean_speed[part],
                    lost[part],
                    resisted[part],
                    on[part],
                )
            )
    return found


def _per_step(value: Column, count: int) -> Column:
    """Return the mean of *value* over each step."""
    return block_means(value, _POINTS)[:count]


class BrakedLanes:
    """Windows marched side by side with brake heat (Eq 2.6, 4.12)."""

    def __init__(
        self,
        windows: Sequence[Window],
        losses: Sequence[DiscLoss],
        knots_ms: Sequence[float],
        shares: Sequence[float],
    ) -> None:
        """Take *windows* with the disc and the share of the work of each."""
        self.count = len(windows)
        self.measured_k = _columns([w.disc_k for w in windows])
        self._ambient_k = _columns([w.ambient_k for w in windows])
        self._lost_j = _columns([w.lost_j for w in windows])
        self._resisted_j = _columns([w.resisted_j for w in windows])
        share = np.array(shares)
        self._share = _columns([w.pressed for w in windows]) * share
        speed = _columns([w.speed_ms for w in windows])
        knots = np.array(knots_ms)
        place = np.clip(
            np.searchsorted(knots, speed, "right") - 1, 0, len(knots) - 2
        )
        into = (speed - knots[place]) / np.diff(knots)[place]
        self._place, self._into = place, np.clip(into, 0.0, 1.0)
        still = np.array([loss.still for loss in losses])
        end = np.array([loss.blend_end_ms for loss in losses])
        rising = np.clip(speed / end, 0.0, 1.0)
        self._blend = STEP_S * (still + (1.0 - still) * rising)
        self._radiation = (
            STEP_S
            * (1.0 - rising)
            * np.array([loss.radiation_w_k4 for loss in losses])
        )
        self._capacities = HeatCapacities(
            losses, [loss.rate_form for loss in losses]
        )

    def march(self, values: Matrix) -> Matrix:
        """Return the discs [K], (steps, windows, m), of m sets of *values*.

        *values* (m, k + 2): S at each knot [1/s], the factor on the heat,
        and that on the resistances.
        """
        s, heat, resist = values[:, :-2], values[:, -2], values[:, -1]
        rows = np.arange(self.count)[:, None]
        now = np.repeat(self.measured_k[0][:, None], len(values), axis=1)
        out = np.empty((len(self.measured_k), *now.shape))
        for step in range(len(out)):
            out[step] = now
            place, into = self._place[step], self._into[step][:, None]
            rate = s[:, place].T * (1.0 - into) + s[:, place + 1].T * into
            work = self._lost_j[step][:, None] - (
                resist * self._resisted_j[step][:, None]
            )
            work = np.maximum(work, 0.0) * heat * self._share[step][:, None]
            per_capacity = self._capacities.inverse(rows, now)
            strength = self._capacities.factor(rows, per_capacity)
            ambient = self._ambient_k[step][:, None]
            beside = self._radiation[step][:, None] * (now**4 - ambient**4)
            now = (
                now
                + (work - beside) * per_capacity
                - rate
                * strength
                * self._blend[step][:, None]
                * (now - ambient)
            )
            now = np.clip(now, LOWEST_K, HIGHEST_K)
        return out


def _columns(values: Sequence[Column]) -> Matrix:
    """Return *values* side by side, (n, windows)."""
    return np.asarray(np.stack(values, axis=1), np.float64)

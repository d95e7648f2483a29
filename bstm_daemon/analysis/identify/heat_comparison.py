"""The brake heat of a drive by every source, side by side (thesis 4.2, 6.1).

Sources are Feed-Forward and Feed-Back as the estimator integrates them, the
fused power where that heat mode exists, and the bus's own brake torque. Each
stop is compared with its energy balance, Eq 4.5.

Within a stop the car's motion shows one friction for all brakes (Fig 4.7). An
axle's share of a stop's energy follows from its discs: mass times the integral
of c_p over the measured rise, over the disc's share of the heat. The axle
without thermocouples gets the rest of the energy balance.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import nan
from typing import Final

import numpy as np

from bstm_daemon.analysis.identify.brake_samples import (
    applications,
    brake_samples,
)
from bstm_daemon.analysis.identify.disc_loss import disc_part
from bstm_daemon.analysis.identify.driving import (
    Balance,
    Driving,
    Span,
    balance_of,
)
from bstm_daemon.analysis.statistics.series import Column, Mask, Matrix
from bstm_daemon.config.sections import Config, CornerConfig
from bstm_daemon.model.heat.feed_forward import PressureTorque
from bstm_daemon.model.thermal.brake_corner import corner_spec
from bstm_daemon.model.thermal.properties import disc_heat_capacity
from bstm_daemon.replay.results import Results

SOURCES: Final = {
    "ff": "Feed-Forward",
    "fb": "Feed-Back",
    "fused": "fused",
    "can": "bus's brake torque",
}
"""Key of a source to its name, in the order of figures and tables."""

BEFORE_S: Final = 0.3
AFTER_S: Final = 1.5
"""Time before and after a stop over which its energies are integrated, to
include the transients of body and filter."""

LEAST_KNOWN: Final = 0.9
"""Share of a stop in which the speed has to be known."""

LEAST_POWER_W: Final = 1000.0
LEAST_FORCE_N: Final = 300.0
LEAST_ENERGY_J: Final = 2000.0
"""Least energy for a ratio; below it noise dominates."""


@dataclass(frozen=True, slots=True)
class HeatStop:
    """A brake application.

    ``first`` and ``last`` are rows, both included, of the application,
    ``begin_s`` and ``end_s`` the times between which energies [J] are
    integrated: by source in ``energy_j``, the others in ``balance``.
    ``initial_c`` are the discs' temperatures at the press, measured if
    possible, else estimated.
    """

    first: int
    last: int
    begin_s: float
    end_s: float
    pressure_pa: float
    energy_j: dict[str, float]
    balance: Balance
    initial_c: dict[str, float]


@dataclass(frozen=True, slots=True)
class HeatComparison:
    """The drive: rows at the publications, (n,) each, SI.

    ``time_s`` since the log's start; ``power_w`` and ``energy_j`` (running)
    by source; ``force_n`` is Feed-Back's brake force. ``pressure_pa`` is the
    highest of the corners'. ``absent`` says why a source is not there.
    """

    time_s: Column
    speed_ms: Column
    pressure_pa: Column
    braking: Mask
    force_n: Column
    power_w: dict[str, Column]
    energy_j: dict[str, Column]
    stops: tuple[HeatStop, ...]
    absent: dict[str, str]
    remarks: tuple[str, ...]

    def total_j(self, source: str) -> float:
        """Return the energy of *source* over the drive."""
        return float(self.energy_j[source][-1])

    def momentary_ratio(self) -> Column:
        """Return Feed-Forward over Feed-Back while braking (Fig 6.2), (n,).

        NaN where either is too weak or absent.
        """
        return self._ratio(self.power_w, LEAST_POWER_W, self.braking)

    def integrated_ratio(self) -> Column:
        """Return the ratio of the running energies (Fig 6.3), (n,)."""
        return self._ratio(
            self.energy_j, LEAST_ENERGY_J, np.ones(len(self.time_s), bool)
        )

    def pressure_per_force(self) -> Column:
        """Return pressure over Feed-Back's force (Fig 4.9), (n,) [Pa/N]."""
        used = self.braking & (self.force_n > LEAST_FORCE_N)
        used &= self.pressure_pa > 0.0
        result = np.full(len(self.time_s), np.nan)
        result[used] = self.pressure_pa[used] / self.force_n[used]
        return result

    def _ratio(
        self, values: Mapping[str, Column], least: float, used: Mask
    ) -> Column:
        result = np.full(len(self.time_s), np.nan)
        if {"ff", "fb"} <= set(values):
            forward, back = values["ff"], values["fb"]
            used = used & (forward > least) & (back > least)
            result[used] = forward[used] / back[used]
        return result


def compare_heat(
    results: Results,
    driving: Driving,
    config: Config,
    fused: Results | None = None,
) -> HeatComparison:
    """Compare the sources over the rows of *results*.

    Args:
        results: the replay of the log.
        driving: the same log's motion.
        config: the vehicle.
        fused: the replay in the heat mode ``fused``, rows as *results*.
    """
    columns = results.columns
    time_s = columns["time_s"] - driving.channels.recording.start_s
    usual_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.1
    steps_s = np.diff(time_s, prepend=time_s[0] - usual_s)
    steps_s = np.where((steps_s > 0.0) & (steps_s < 1.0), steps_s, 0.0)
    power, absent = _powers(results, driving, config, fused, time_s)
    energy = {
        name: np.cumsum(np.nan_to_num(value) * steps_s)
        for name, value in power.items()
    }
    speed = np.nan_to_num(columns["speed_ms"])
    pressure = _by_corner(results, "pressure_pa").max(axis=0, initial=0.0)
    if driving.pressures:
        braking = pressure > config.heat.brake_on_pressure_pa
    else:
        braking = np.nan_to_num(power.get("fb", np.zeros(len(time_s)))) > 0.0
    braking &= speed > 0.0
    stops = [
        stop
        for span in applications(time_s, speed, braking)
        if (stop := _stop(span, time_s, pressure, energy, driving, results))
        and any(abs(one) > LEAST_ENERGY_J for one in stop.energy_j.values())
    ]
    return HeatComparison(
        time_s,
        speed,
        pressure,
        braking,
        columns["brake_force_fb_n"],
        power,
        energy,
        tuple(stops),
        absent,
        driving.remarks,
    )


def _by_corner(results: Results, column: str) -> Matrix:
    """Return *column* of each corner, (corners, n), 0 where unknown."""
    return np.nan_to_num(
        [results.columns[f"{name}.{column}"] for name in results.corners]
    )


def _powers(
    results: Results,
    driving: Driving,
    config: Config,
    fused: Results | None,
    time_s: Column,
) -> tuple[dict[str, Column], dict[str, str]]:
    """Return the power of each source [W], and why others are absent."""
    power, absent = {}, {}
    if driving.pressures:
        power["ff"] = _by_corner(results, "brake_power_ff_w").sum(axis=0)
    else:
        absent["ff"] = "no brake pressure in this log"
    torque_known = bool(driving.channels.alive(["powertrain_torque"]))
    if torque_known or config.heat.assume_powertrain_torque_nm is not None:
        power["fb"] = _by_corner(results, "brake_power_fb_w").sum(axis=0)
    else:
        absent["fb"] = "no torque at the wheels in this log"
    if fused is not None:
        power["fused"] = _by_corner(fused, "brake_power_w").sum(axis=0)
    else:
        absent["fused"] = "no heat mode 'fused' for this car and version"
    if driving.channels.alive(["brake_torque"]):
        force = np.abs(driving.value("brake_torque"))
        force /= driving.vehicle.wheel_radius_m
        at = np.interp(time_s, driving.time_s, force * driving.speed_ms)
        power["can"] = np.nan_to_num(at)
    else:
        absent["can"] = "no role brake_torque in this log"
    return power, absent


def _stop(
    span: Span,
    time_s: Column,
    pressure_pa: Column,
    energy_j: Mapping[str, Column],
    driving: Driving,
    results: Results,
) -> HeatStop:
    begin_s = float(time_s[span.first]) - BEFORE_S
    end_s = float(time_s[span.last]) + AFTER_S
    rows = np.searchsorted(time_s, (begin_s, end_s))
    first, last = max(int(rows[0]) - 1, 0), min(int(rows[1]), len(time_s) - 1)
    begin_s, end_s = float(time_s[first]), float(time_s[last])
    return HeatStop(
        span.first,
        span.last,
        begin_s,
        end_s,
        float(np.mean(pressure_pa[span.points])),
        {n: float(e[last] - e[first]) for n, e in energy_j.items()},
        _balance(driving, begin_s, end_s),
        _initial_c(results, span.first),
    )


def _balance(driving: Driving, begin_s: float, end_s: float) -> Balance:
    """Return Eq 4.5 from *begin_s* to *end_s*, nan where the speed is not."""
    ends = np.searchsorted(driving.time_s, (begin_s, end_s))
    part = slice(int(ends[0]), int(ends[1]))
    known = np.isfinite(driving.speed_ms[part])
    if not len(known) or known.mean() < LEAST_KNOWN:
        return Balance(*[nan] * 6)
    time_s = driving.time_s[part]
    speed = np.interp(time_s, time_s[known], driving.speed_ms[part][known])
    car = driving.vehicle
    slope = np.zeros(len(speed))
    if driving.has_accelerometer:
        slope = np.nan_to_num(driving.slope_ms2[part])
    drive = np.nan_to_num(driving.torque_nm[part]) / car.wheel_radius_m
    return balance_of(car, speed, slope, drive + driving.external_n[part])


def _initial_c(results: Results, row: int) -> dict[str, float]:
    """Return each disc's temperature at *row*: measured, else estimated."""
    found = {}
    for name in results.corners:
        for key in (f"{name}.disc_measured_c", f"{name}.disc_c"):
            column = results.columns.get(key)
            if column is not None and np.isfinite(column[row]):
                found[name] = float(column[row])
                break
    return found


LONGEST_STOP_S: Final = 15.0
"""Longest stop; in a longer one the disc loses heat before its peak."""

SETTLING_S: Final = 4.0
"""Time for the disc's heat to spread before its peak is read."""

LEAST_RISE_K: Final = 10.0
"""Least rise, above a thermocouple's noise."""

LEAST_BRAKED_J: Final = 50e3
PARTS: Final = {"front": "F", "rear": "R"}


@dataclass(frozen=True, slots=True)
class WithinStop:
    """Friction coefficient over the time since the press, (n,) each."""

    start_s: float
    since_s: Column
    friction: Column
    initial_c: dict[str, float]


@dataclass(frozen=True, slots=True)
class AxleFriction:
    """Mean friction of an axle in a stop, by the heat in its discs."""

    axle: str
    start_s: float
    initial_c: float
    friction: float
    by_discs: bool


@dataclass(frozen=True, slots=True)
class StopFriction:
    """Friction within and between stops, and why the axles' may be missing."""

    within: tuple[WithinStop, ...]
    axles: tuple[AxleFriction, ...]
    why_no_axles: str


def stop_friction(
    driving: Driving, config: Config, heat: HeatComparison
) -> StopFriction:
    """Return the friction coefficients that *driving* shows."""
    within = []
    if driving.pressures:
        nominal = _nominal(config, "F")
        pushout = max(c.pushout_pressure_pa for c in config.corner)
        stops, *_ = brake_samples(driving, config, every_stop=True)
        for stop in stops:
            pushing = stop.gain * (stop.pressure_pa - pushout)
            within.append(
                WithinStop(
                    stop.start_s,
                    stop.since_s,
                    nominal * stop.force_n / pushing,
                    _initial_of(heat, stop.start_s),
                )
            )
    corners = [
        corner
        for corner in config.disc_corners()
        if driving.channels.alive([f"temp_{corner.name.lower()}_disc"])
    ]
    axles: list[AxleFriction] = []
    if corners and driving.pressures:
        why = (
            f"no stop of at most {LONGEST_STOP_S:g} s that warms a measured "
            f"disc by {LEAST_RISE_K:g} K"
        )
        for one in heat.stops:
            axles += _axles(one, driving, config, corners)
    else:
        what = "disc temperature" if driving.pressures else "brake pressure"
        why = (
            f"no measured {what}: the motion only shows the sum of front and "
            "rear"
        )
    return StopFriction(tuple(within), tuple(axles), "" if axles else why)


def _initial_of(heat: HeatComparison, start_s: float) -> dict[str, float]:
    """Return the discs' temperatures of the stop nearest to *start_s*."""
    nearest = min(
        heat.stops, key=lambda s: abs(s.begin_s - start_s), default=None
    )
    return {} if nearest is None else nearest.initial_c


def _nominal(config: Config, axle: str) -> float:
    of_axle = [
        corner.friction_coefficient
        for corner in config.corner
        if corner.name[0] == axle
    ]
    return float(np.mean(of_axle or [np.nan]))


def _axles(
    stop: HeatStop,
    driving: Driving,
    config: Config,
    corners: list[CornerConfig],
) -> list[AxleFriction]:
    """Return the friction of the axles in *stop*, none where it shows none."""
    if (
        stop.end_s - stop.begin_s > LONGEST_STOP_S
        or not stop.balance.brake_j > LEAST_BRAKED_J
        or "ff" not in stop.energy_j
    ):
        return []
    heats = {c.name: _disc_heat_j(c, stop, driving, config) for c in corners}
    taken: dict[str, float] = {}
    for axle, letter in PARTS.items():
        own = [c for c in config.corner if c.name[0] == letter]
        known = [heats[c.name] for c in own if c.name in heats]
        if own and known and np.isfinite(known).all():
            # both sides of an axle are alike
            taken[axle] = float(np.mean(known)) * len(own)
    measured = set(taken)
    if len(taken) == 1:
        (axle,) = taken
        other = "rear" if axle == "front" else "front"
        taken[other] = stop.balance.brake_j - taken[axle]
    found = []
    for axle, energy_j in taken.items():
        letter = PARTS[axle]
        forward_j = stop.energy_j["ff"] * _gain_share(config, letter)
        if forward_j <= 0.0:
            continue
        initial = [c for n, c in stop.initial_c.items() if n[0] == letter]
        found.append(
            AxleFriction(
                axle,
                stop.begin_s,
                float(np.mean(initial or [np.nan])),
                _nominal(config, letter) * energy_j / forward_j,
                axle in measured,
            )
        )
    return found


def _gain_share(config: Config, letter: str) -> float:
    gains = {
        c.name: PressureTorque.of_corner(c).torque_per_pressure_nm_pa
        for c in config.corner
    }
    own = sum(gain for name, gain in gains.items() if name[0] == letter)
    return own / sum(gains.values())


def _disc_heat_j(
    corner: CornerConfig, stop: HeatStop, driving: Driving, config: Config
) -> float:
    """Return the brake energy that the rise of *corner*'s disc shows [J]."""
    if corner.disc is None:  # the caller asks for disc corners only
        return float("nan")
    value = driving.value(f"temp_{corner.name.lower()}_disc")
    time_s = driving.time_s
    before = value[(time_s > stop.begin_s - 2.0) & (time_s < stop.begin_s)]
    after = value[(time_s > stop.end_s) & (time_s < stop.end_s + SETTLING_S)]
    before, after = before[np.isfinite(before)], after[np.isfinite(after)]
    if not len(before) or not len(after):
        return float("nan")
    start_k, end_k = float(np.median(before)), float(np.median(after))
    if end_k - start_k < LEAST_RISE_K:
        return float("nan")
    spec = corner_spec(config, corner)
    capacity = disc_heat_capacity(corner.disc)
    stored_j = spec.disc_mass_kg * (
        capacity.integral(end_k) - capacity.integral(start_k)
    )
    return stored_j / disc_part(spec)

"""The daemon's judgement of a descent when the car stops to park."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from risk_cases import HORIZON_S, Case, Truth
from risk_fleet import JUDGED

from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.forecast.monitor import RiskMonitor
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    import numpy.typing as npt

    from bstm_daemon.model.risk.vaporisation import Boiling

    Column = npt.NDArray[np.float64]

START_US: Final = 1_700_000_000_000_000
SAMPLES_S: Final = 10
"""Samples a second of every role."""

ROLES: Final = ("vehicle_speed", "primary_pressure", "ambient_temperature")
BEFORE_STOP_S: Final = 1
TIMEOUT_US: Final = 500_000


@dataclass(frozen=True, slots=True)
class Judgement:
    """What the daemon says at the stop, and what came; K and s.

    ``members_k`` [member, corner] are the ensemble's peaks, ``peaks_k`` and
    ``peaks_in_s`` the ones told, ``now_k`` and ``deviation_k`` the fluid's
    [corner]; ``true_*`` what came.
    """

    members_k: Column
    peaks_k: Column
    peaks_in_s: Column
    now_k: Column
    deviation_k: Column
    true_peaks_k: Column
    true_peaks_in_s: Column
    true_now_k: Column
    truth: Truth

    def probability(self, boiling: Boiling) -> float:
        """Return the daemon's probability of vapour with such a fluid."""
        worst = self.members_k.max(axis=1).tolist()
        return sum(map(boiling.probability, worst)) / len(worst)


def estimating(case: Case) -> tuple[Estimator, RiskMonitor]:
    """Return estimator and risk of its car, cold in the air of *case*."""
    config = case.one.config
    estimator = Estimator(
        config,
        {ROLE_INDEX[role]: TIMEOUT_US for role in ROLES},
        history_known=True,
        initial_k=case.sensed_ambient_k,
    )
    return estimator, RiskMonitor(config, estimator)


def judged(case: Case, truth: Truth) -> Judgement:
    """Run the daemon's estimator and risk over *case* up to the stop."""
    estimator, monitor = estimating(case)
    times_us, numbers, values = samples(case, truth)
    drive_s = len(case.drive.speed_ms)
    stop_us = START_US + (drive_s - BEFORE_STOP_S) * 1_000_000
    cut = int(np.searchsorted(times_us, stop_us))
    estimator.advance(times_us[:cut], numbers[:cut], values[:cut])
    risk = None
    for block in estimator.advance(
        times_us[cut:], numbers[cut:], values[cut:]
    ):
        risk = monitor.add(block)[-1]
    assert risk is not None
    assert risk.forecast_us is not None
    peaks = monitor.peaks_k()
    told = [risk.corners[name] for name in JUDGED]
    fluid = truth.fluid_k
    return Judgement(
        np.array([peaks[name] for name in JUDGED]).T,
        np.array([c.peak_k for c in told]),
        np.array([c.peak_in_s for c in told]),
        np.array([estimator.state(name)["fluid"] for name in JUDGED]),
        np.array([c.fluid_deviation_k for c in told]),
        fluid.max(axis=0),
        truth.time_s[fluid.argmax(axis=0)],
        truth.stop_k,
        truth,
    )


def boiled_at_s(truth: Truth, boiling_k: float) -> float:
    """Return when the fluid of any corner boils after the stop; inf: never."""
    reached = (truth.fluid_k >= boiling_k).any(axis=1)
    reached &= truth.time_s <= HORIZON_S
    return float(truth.time_s[reached.argmax()]) if reached.any() else np.inf


def samples(
    case: Case, truth: Truth
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32], Column]:
    """Return times [us], role numbers and values of what *case* senses."""
    drive_s = len(case.drive.speed_ms)
    count = (drive_s + 1) * SAMPLES_S
    at_s = np.arange(count) / SAMPLES_S
    seconds = np.arange(drive_s) + 0.5
    speed = np.interp(at_s, seconds, case.sensed_speed_ms())
    place = np.minimum(at_s.astype(int), drive_s - 1)
    pressure = case.sensed_pressure_pa(truth.pressure_pa)[place]
    ambient = np.full(count, case.sensed_ambient_k)
    values = np.stack([speed, pressure, ambient], axis=1).ravel()
    numbers = np.tile([ROLE_INDEX[role] for role in ROLES], count)
    times = START_US + np.repeat(at_s, len(ROLES)) * 1e6
    return times.astype(np.int64), numbers.astype(np.int32), values

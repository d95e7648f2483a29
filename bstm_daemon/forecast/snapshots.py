"""From the record of the risk to what is published of it."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING

from bstm_daemon.bus.output_layout import RiskLevel
from bstm_daemon.bus.publication import CarRiskSnapshot, RiskSnapshot

if TYPE_CHECKING:
    from bstm_daemon.forecast.records import CarRisk


def car_snapshot(risk: CarRisk) -> CarRiskSnapshot:
    """Return what is published of the car."""
    return CarRiskSnapshot(
        probability=risk.probability,
        probability_now=risk.probability_now,
        level=RiskLevel(risk.level),
        boiling_k=risk.boiling_k,
        boiling_low_k=risk.boiling_low_k,
        water_percent=risk.water_percent,
    )


def corner_snapshot(risk: CarRisk, name: str, time_us: int) -> RiskSnapshot:
    """Return what is published of corner *name* at *time_us* [us]."""
    corner = risk.corners[name]
    begun = risk.forecast_us
    return RiskSnapshot(
        probability=corner.probability,
        level=RiskLevel(corner.level),
        fade=RiskLevel(corner.fade),
        fluid_deviation_k=corner.deviation_k,
        peak_k=corner.peak_k,
        peak_in_s=corner.peak_in_s,
        safe_in_s=corner.safe_in_s,
        duty_peak_k=corner.duty_peak_k,
        age_s=nan if begun is None else (time_us - begun) * 1e-6,
    )

"""What is told of the risk at a publication."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import nan
from typing import TYPE_CHECKING

from bstm_daemon.risk.levels import Level

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, slots=True)
class CornerRisk:
    """One corner; kelvin, seconds, probabilities; NaN is not known yet.

    ``deviation_k`` is the fluid's standard deviation now. ``probability`` is
    that of vapour now or within the horizon if the car parks now,
    ``probability_now`` that of now. ``peak_k`` and ``peak_in_s`` are the
    fluid's if the car parks, ``safe_in_s`` the time until vapour is unlikely
    and stays so, infinite where that is out of sight. ``duty_peak_k`` is the
    highest if the present duty goes on to the horizon and ``duty_in_s`` the
    time until vapour is likely then, infinite for never. Times count from
    :attr:`CarRisk.forecast_us`. ``fade`` is the level of disc and pads.
    """

    deviation_k: float = nan
    probability_now: float = nan
    probability: float = nan
    level: Level = Level.UNKNOWN
    fade: Level = Level.UNKNOWN
    peak_k: float = nan
    peak_in_s: float = nan
    safe_in_s: float = nan
    duty_peak_k: float = nan
    duty_in_s: float = nan


@dataclass(frozen=True, slots=True)
class CarRisk:
    """The car: the worst that can happen at any of its corners.

    ``boiling_low_k`` and ``boiling_k`` are the 1 % quantile and the median of
    the boiling point; ``forecast_us`` is the data time of the forecast that
    all this rests on, None before the first.
    """

    probability_now: float = nan
    probability: float = nan
    level: Level = Level.UNKNOWN
    boiling_low_k: float = nan
    boiling_k: float = nan
    water_percent: float = nan
    forecast_us: int | None = None
    members: int = 0
    corners: Mapping[str, CornerRisk] = field(default_factory=dict)

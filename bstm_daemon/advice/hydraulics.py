"""A3 and A5: pedal feel, and isolation of the front wheels' hydraulics."""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import TYPE_CHECKING, ClassVar, Final

from bstm_daemon.estimate import Isolation
from bstm_daemon.estimator.memory import Flag, Int64, Machine, Share

if TYPE_CHECKING:
    from bstm_daemon.advice.conditions import Conditions
    from bstm_daemon.config.estimates import AdviceConfig

FEEL_RATE_1_S: Final = 0.02
"""Fastest change of the feel, slow so that nobody takes it for a fault
(thesis, 7.2.3)."""

REAR_SPARE_K: Final = 20.0
"""Least excess of the rear margin over the front one to brake at the rear."""


class PedalFeel(Machine):
    """Factor of pedal feel; it falls as the fluid nears worst-case boiling."""

    MEMORY: ClassVar = {"_feel": Share, "_last_us": Int64 | None}

    def __init__(self, config: AdviceConfig) -> None:
        """Begin with the usual feel."""
        self._config = config
        self._feel = 1.0
        self._last_us: int | None = None

    def update(self, now: Conditions) -> float:
        """Return the factor, 1 = usual; NaN where the margin is unknown."""
        last_us, self._last_us = self._last_us, now.time_us
        margin_k = now.least_k
        if margin_k == inf:
            return nan
        least, from_k = (
            self._config.pedal_feel_least,
            self._config.pedal_feel_from_k,
        )
        if margin_k > from_k and self._feel == 1.0:
            # nearly always
            return self._feel
        hot = 1.0 if margin_k <= 0.0 else 0.0
        if from_k > 0.0:
            hot = min(max(1.0 - margin_k / from_k, 0.0), 1.0)
        wanted = 1.0 - (1.0 - least) * hot
        dt_s = 0.0 if last_us is None else max(now.time_us - last_us, 0) * 1e-6
        step = FEEL_RATE_1_S * dt_s
        self._feel += min(max(wanted - self._feel, -step), step)
        return self._feel


class FrontIsolation(Machine):
    """Braking by the rear wheels alone, so that the front ones cool.

    Needs only the worst-case boiling point: the fluid is kept below it
    whatever its age (thesis, 7.2.5). Only at moderate speed, with no
    intervention of the stability systems, and while the rear brakes are
    known to have more margin.
    """

    MEMORY: ClassVar = {"_requested": Flag}

    def __init__(self, config: AdviceConfig) -> None:
        """Begin without a request."""
        self._config = config
        self._requested = False

    def update(self, now: Conditions) -> Isolation:
        """Return the request."""
        limit_k = self._config.isolation_margin_k
        if self._requested:
            limit_k += self._config.isolation_hysteresis_k
        self._requested = (
            now.least_k <= limit_k
            and now.is_known("R")
            and (front_k := now.margin_k("F")) <= limit_k
            and now.margin_k("R") >= front_k + REAR_SPARE_K
            and isfinite(now.speed_ms)
            and now.speed_ms <= self._config.isolation_speed_ms
            and not now.flag("abs_active")
            and not now.flag("esc_active")
        )
        return Isolation.REQUESTED if self._requested else Isolation.NONE

"""Sections on top of temperatures: accuracy, fluid, forecast, advice, wear."""

from __future__ import annotations

import itertools
from datetime import date  # noqa: TC003  (pydantic resolves it at run time)
from math import sqrt
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from bstm_daemon.config.section import (
    Fraction,
    NotNegative,
    Positive,
    Section,
    require,
)

BoilingPoint = Annotated[float, Field(ge=100, le=400)]
Limit = Annotated[float, Field(ge=100, le=1200)]
Margin = Annotated[float, Field(ge=0, le=150)]
Speed = Annotated[float, Field(ge=0, le=40)]
Spread = Annotated[float, Field(gt=0, le=2)]
Depth = Annotated[float, Field(gt=0, le=0.02)]

WEAR_LIMIT_M3_J: Final = 2e-11
"""Largest volume worn per friction energy. GB 5763-1998, after JIS D
4411-1993, allows a lining 0.5e-13 at 100 degC and 3.5e-13 at 350 degC; the
limit is fifty times that, for poor linings and drives that stand for many."""

USUAL_DRIFT_K: Final = 1.0
"""Drift of a thermocouple that the accuracy of models includes already."""


class AccuracyConfig(Section):
    """``[accuracy]``: residuals of a matched model, from ``bstm match``.

    Standard deviation of a node's estimate: ``_k`` and ``_share`` of its rise
    above the air, in quadrature. The last two describe the thermocouples, by
    their data sheet: a constant offset, and a drift over minutes.
    """

    disc_k: Positive | None = None
    disc_share: NotNegative = 0.0
    pad_front_k: Positive | None = None
    pad_front_share: NotNegative = 0.0
    pad_back_k: Positive | None = None
    pad_back_share: NotNegative = 0.0
    fluid_k: Positive | None = None
    fluid_share: NotNegative = 0.0
    thermocouple_offset_k: NotNegative = 0.0
    thermocouple_drift_k: NotNegative = 0.0

    def drift_beyond_usual_k(self) -> float:
        """Return the drift beyond that of a usual thermocouple, sd [K]."""
        return sqrt(max(self.thermocouple_drift_k**2 - USUAL_DRIFT_K**2, 0.0))


class FluidConfig(Section):
    """``[fluid]``: the brake fluid's grade and age."""

    grade: Literal["DOT3", "DOT4", "DOT5.1", "CLASS6"] = "DOT4"
    changed: date | None = None
    climate: Literal["dry", "temperate", "humid"] = "temperate"
    water_percent: Annotated[float, Field(ge=0, le=10)] | None = None
    water_measured: date | None = None
    water_accuracy: Annotated[float, Field(gt=0, le=1)] = 0.1
    dry_boiling_point_c: BoilingPoint | None = None
    wet_boiling_point_c: BoilingPoint | None = None

    @model_validator(mode="after")
    def _points_fit(self) -> Self:
        dry, wet = self.dry_boiling_point_c, self.wet_boiling_point_c
        if dry is not None and wet is not None:
            require(
                wet < dry,
                "'wet_boiling_point_c' must be below 'dry_boiling_point_c'",
            )
        require(
            self.water_measured is None or self.water_percent is not None,
            "'water_measured' is the date of 'water_percent'",
        )
        return self


class ForecastConfig(Section):
    """``[forecast]``: the ensemble, and the limits of disc and pads.

    ``uncertainty`` scales the model uncertainty of the ensemble; the limits
    are where elevated, high and critical begin.
    """

    members: Annotated[int, Field(ge=8, le=256)] = 64
    uncertainty: Positive = 1.0
    disc_limits_c: list[Limit] = [500.0, 600.0, 700.0]
    pad_limits_c: list[Limit] = [400.0, 500.0, 600.0]

    @model_validator(mode="after")
    def _limits_rise(self) -> Self:
        for name in ("disc_limits_c", "pad_limits_c"):
            limits = getattr(self, name)
            require(
                len(limits) == 3
                and all(a < b for a, b in itertools.pairwise(limits)),
                f"{name!r} needs three limits that rise: elevated, high, "
                "critical",
            )
        return self


class AdviceConfig(Section):
    """``[advice]``: the driver interface (thesis, chapter 7).

    Nothing of it is sent without ``[publish] requests``, and nothing of it
    acts on the car: it is a value in a frame. Margins are those of the fluid
    with one standard deviation to the wet boiling point, the worst case.
    """

    while_driving: bool = False
    sound: bool = True
    parked_after_s: Annotated[float, Field(ge=1, le=3600)] = 60.0
    gearbox: Literal["none", "manual", "automatic"] = "none"
    descent_power_w: Positive = 5000.0
    descent_window_s: Annotated[float, Field(ge=5, le=600)] = 40.0
    shift_below_rpm: Positive = 3500.0
    pedal_feel_from_k: Margin = 60.0
    pedal_feel_least: Fraction = 0.5
    isolation_margin_k: Margin = 10.0
    isolation_hysteresis_k: Margin = 10.0
    isolation_speed_ms: Speed = 14.0
    brake_split: Literal["front-rear", "diagonal"] = "diagonal"
    park_brake_speed_ms: Speed = 6.0
    detector_pressure_pa: Positive = 2.0e6
    detector_pedal_rate_1_s: Positive = 1.0
    detector_score: Annotated[float, Field(ge=0.1, le=1)] = 0.6
    detector_hold_s: Annotated[float, Field(ge=0.1, le=5)] = 0.5


class WearConfig(Section):
    """``[wear]``: lining and disc volume worn per joule of friction.

    ``law``: ``energy`` (Eq 4.20, 4.21) counts the friction heat that the
    model is given, ``archard`` (Eq 2.13) contact pressure times sliding
    speed. Both count more above ``hot_from_c`` (Fig 2.7), up to ``hot_limit``
    times, by default at 590 degC: measurements of linings of organic matrix
    end about there (EuroBrake 2012, EB2012-FM-12: the rate rises, radically
    from about 500 degC on), and hotter faces wear at that rate. The indicators
    report of the axle that ``indicators`` names. The thermal model is that of
    the configured linings and discs, unless ``model_follows``.
    """

    law: Literal["energy", "archard"] = "energy"
    pad_wear_m3_j: Annotated[float, Field(gt=0, le=WEAR_LIMIT_M3_J)] = 3.0e-13
    disc_wear_m3_j: Annotated[float, Field(ge=0, le=WEAR_LIMIT_M3_J)] = 1.0e-13
    rate_spread: Spread = 0.5
    learned_spread: Spread = 0.15
    hot_from_c: Annotated[float, Field(ge=100, le=700)] = 320.0
    hot_doubling_k: Annotated[float, Field(ge=10, le=1000)] = 90.0
    hot_limit: Annotated[float, Field(ge=1, le=10)] = 8.0
    indicators: Literal["front", "rear", "all"] = "front"
    first_indicator_worn_m: Depth = 0.001
    second_indicator_left_m: Depth = 0.002
    indicator_std_m: Positive = 1.0e-4
    configured_std_m: Positive = 5.0e-4
    limit_m: Depth = 0.002
    model_follows: bool = False

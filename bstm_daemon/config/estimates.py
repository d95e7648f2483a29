"""Sections on top of temperatures: accuracy, fluid, forecast, advice, wear."""

import itertools
from datetime import date
from math import sqrt
from typing import Annotated, Any, Final, Literal

from pydantic import Field

from bstm_daemon.config.section import (
    Fraction,
    NotNegative,
    Positive,
    Section,
    Text,
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

AT_FLUID: Final = frozenset({"fluid", "caliper"})
"""A match that compared one of these nodes knows the way of the heat there."""

ALIKE: Final = 3.0
"""Factor on what is unknown of a matched model, whose fluid has 3.6 % of its
rise: brakes that are alike on paper differ by a tenth in friction and air."""

UNMATCHED: Final = 6.0
"""The same of a drawing alone; its estimate is degraded besides, which
doubles it (docs/risk.md)."""

USUAL_DRIFT_K: Final = 1.0
"""Drift of a thermocouple that the accuracy of models includes already."""


class AccuracyConfig(Section):
    """``[accuracy]``: residuals of a matched model, from ``bstm match``.

    Standard deviation of a node's estimate: ``_k`` and ``_share`` of its rise
    above the air, in quadrature. The last two describe the thermocouples, by
    their data sheet: a constant offset, and a drift over minutes.
    """

    disc_k: Positive | None = None
    """floor of the disc; without it no interval"""
    disc_share: NotNegative = 0.0
    """share of the disc"""
    pad_front_k: Positive | None = None
    """floor of the pad's face"""
    pad_front_share: NotNegative = 0.0
    """share of the pad's face"""
    pad_back_k: Positive | None = None
    """floor of the pad's back"""
    pad_back_share: NotNegative = 0.0
    """share of the pad's back"""
    fluid_k: Positive | None = None
    """floor of the fluid"""
    fluid_share: NotNegative = 0.0
    """share of the fluid"""
    thermocouple_offset_k: NotNegative = 0.0
    """constant error of a thermocouple, from its data sheet (type K of class
    2, IEC 60584-1: at most 2.5 K, so 1.4); needed by `bstm gap` and the live
    comparison where above some K"""
    thermocouple_drift_k: NotNegative = 0.0
    """its drift over minutes; `bstm gap` and the live comparison expect 1 K
    anyway"""

    def drift_beyond_usual_k(self) -> float:
        """Return the drift beyond that of a usual thermocouple, sd [K]."""
        return sqrt(max(self.thermocouple_drift_k**2 - USUAL_DRIFT_K**2, 0.0))


class MatchedConfig(Section):
    """``[[matched]]``: what ``bstm match`` learned of corners that are alike.

    `bstm gap` takes it as prior and noise. A value that was edited since
    counts as never matched.
    """

    corners: list[Text]
    """corners matched together"""
    alike: list[Text] = []
    """corners without a thermocouple, configured alike, that got the same
    values"""
    names: list[Text]
    """the fitted values, as dotted keys"""
    values: list[Positive]
    """their values then; of the cooling table S at that speed"""
    factor: list[list[float]]
    """lower Cholesky factor of the covariance of their logarithms; row n has n
    numbers"""
    form_k: dict[str, NotNegative] = {}
    """error that the fit left, by node: the form of the model"""
    form_share: dict[str, NotNegative] = {}
    """likewise, share of the rise above the air"""
    form: dict[str, float] = {}
    """the same as errors of values and of strengths of effects and heats"""
    forces: dict[str, float] = {}
    """strengths by which the forces of pressure and motion differed"""
    forces_sd: dict[str, Positive] = {}
    """their standard deviations"""
    drives: Annotated[int, Field(ge=1)] = 1
    """fitted drives"""
    left_out: str = ""
    """drives left out in turn, to judge the fit"""

    @property
    def knows_fluid(self) -> bool:
        """Whether the way of the heat to the fluid was compared."""
        return not AT_FLUID.isdisjoint(self.form_k)

    def _check(self) -> None:
        count = len(self.names)
        require(
            len(self.values) == count == len(self.factor)
            and all(len(row) == i + 1 for i, row in enumerate(self.factor)),
            "'names', 'values' and 'factor' need the same length, row i of "
            "'factor' i numbers",
        )
        require(
            all(row[-1] > 0.0 for row in self.factor),
            "the last number of each row of 'factor' must be above 0",
        )
        require(
            self.forces.keys() == self.forces_sd.keys(),
            "'forces' and 'forces_sd' need the same keys",
        )


class PriorsConfig(Section):
    """``[[priors]]``: what matched cars of the type say of a further one.

    `bstm match` takes it in the place of its own priors, for each value that
    is still the type's. Written by `bstm fleet gap -o`.
    """

    corners: list[Text]
    """corners matched together"""
    names: list[Text]
    """dotted keys"""
    values: list[Positive]
    """those of the type, as in `[[matched]]`"""
    deviations: list[Positive]
    """standard deviations of their logarithms from car to car"""
    cars: Annotated[int, Field(ge=2)]
    """matched cars"""

    def _check(self) -> None:
        require(
            len(self.names) == len(self.values) == len(self.deviations),
            "'names', 'values' and 'deviations' need the same length",
        )


class ChangeConfig(Section):
    """``[[change]]``: a value of this car that changed since its match.

    The values themselves stand where they always do; this says which of them
    moved, when and why.
    """

    name: Text
    """what changed"""
    corner: Literal["FL", "FR", "RL", "RR", "all"] = "all"
    """one corner, or all"""
    factor: Positive
    """the value over that of the match"""
    provenance: dict[str, Any] = {}
    """source; kept, not used"""


class FluidConfig(Section):
    """``[fluid]``: the brake fluid's grade and age."""

    grade: Literal["DOT3", "DOT4", "DOT5.1", "CLASS6"] = "DOT4"
    """decides the boiling point"""
    changed: date | None = None
    """last change; the role `fluid_changed` tells a later one"""
    climate: Literal["dry", "temperate", "humid"] = "temperate"
    """how fast the fluid takes up water"""
    water_percent: Annotated[float, Field(ge=0, le=10)] | None = None
    """measured water; the role `fluid_water_percent` tells a later one"""
    water_measured: date | None = None
    """day of that measurement; the uptake since is added"""
    water_accuracy: Annotated[float, Field(gt=0, le=1)] = 0.1
    """standard deviation of a measurement over its value"""
    dry_boiling_point_c: BoilingPoint | None = None
    """from the fluid's data sheet; without it the grade's minimum and what
    fluids usually have above it"""
    wet_boiling_point_c: BoilingPoint | None = None
    """likewise, at 3.7 % water; below the dry one"""

    def _check(self) -> None:
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


class ForecastConfig(Section):
    """``[forecast]``: the ensemble, and the limits of disc and pads."""

    members: Annotated[int, Field(ge=8, le=256)] = 64
    """members of the ensemble; 8 without the compiled kernel"""
    uncertainty: Positive | None = None
    """factor on what is unknown of a matched model; without it 1 for matched
    corners, 3 for those alike, 6 for others ([risk.md](risk.md))"""
    disc_limits_c: list[Limit] = [500.0, 600.0, 700.0]
    """where elevated, high and critical begin"""
    pad_limits_c: list[Limit] = [400.0, 500.0, 600.0]
    """likewise, friction face of the pads"""

    def _check(self) -> None:
        for name in ("disc_limits_c", "pad_limits_c"):
            limits = getattr(self, name)
            require(
                len(limits) == 3
                and all(a < b for a, b in itertools.pairwise(limits)),
                f"{name!r} needs three limits that rise: elevated, high, "
                "critical",
            )


class AdviceConfig(Section):
    """``[advice]``: the driver interface (thesis, chapter 7).

    Nothing of it is sent without ``[publish] requests``, and nothing of it
    acts on the car: it is a value in a frame. Margins are those of the fluid
    with one standard deviation to the wet boiling point, the worst case.
    """

    while_driving: bool = False
    """also a message while driving, at level critical"""
    sound: bool = True
    """a chime with the message before departure"""
    parked_after_s: Annotated[float, Field(ge=1, le=3600)] = 60.0
    """a car that stands longer is parked; ignition off parks it at once"""
    gearbox: Literal["none", "manual", "automatic"] = "none"
    """who is asked for a lower gear: nobody, driver (P3), gearbox (A4)"""
    descent_power_w: Positive = 5000.0
    """brake power by the slope from which braking is excessive"""
    descent_window_s: Annotated[float, Field(ge=5, le=600)] = 40.0
    """time constant of that brake power"""
    shift_below_rpm: Positive = 3500.0
    """no lower gear at a higher engine speed"""
    pedal_feel_from_k: Margin = 60.0
    """margin below which the pedal becomes softer (A3)"""
    pedal_feel_least: Fraction = 0.5
    """factor at the boiling point"""
    isolation_margin_k: Margin = 10.0
    """margin of a front brake below which its isolation is requested (A5)"""
    isolation_hysteresis_k: Margin = 10.0
    """further margin until the request ends"""
    isolation_speed_ms: Speed = 14.0
    """no isolation is requested above it"""
    brake_split: Literal["front-rear", "diagonal"] = "diagonal"
    """which brakes share a circuit (A6)"""
    park_brake_speed_ms: Speed = 6.0
    """the parking brake is requested below only"""
    detector_pressure_pa: Positive = 2.0e6
    """certainly large pressure"""
    detector_pedal_rate_1_s: Positive = 1.0
    """certainly fast pedal, travels a second"""
    detector_score: Annotated[float, Field(ge=0.1, le=1)] = 0.6
    """score from which the brakes count as not responding"""
    detector_hold_s: Annotated[float, Field(ge=0.1, le=5)] = 0.5
    """time for which the score has to last"""


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
    """by the estimate's friction heat (Eq 4.20, 4.21), or contact pressure
    times sliding speed (Eq 2.13)"""
    pad_wear_m3_j: Annotated[float, Field(gt=0, le=WEAR_LIMIT_M3_J)] = 3.0e-13
    """expected lining wear per joule, both pads"""
    disc_wear_m3_j: Annotated[float, Field(ge=0, le=WEAR_LIMIT_M3_J)] = 1.0e-13
    """the disc's, both faces"""
    rate_spread: Spread = 0.5
    """relative standard deviation of the expected rate"""
    learned_spread: Spread = 0.15
    """of a rate that indicators taught"""
    hot_from_c: Annotated[float, Field(ge=100, le=700)] = 320.0
    """friction face above which a joule wears more (Fig 2.7)"""
    hot_doubling_k: Annotated[float, Field(ge=10, le=1000)] = 90.0
    """rise of temperature that doubles the wear"""
    hot_limit: Annotated[float, Field(ge=1, le=10)] = 8.0
    """most that a joule counts"""
    indicators: Literal["front", "rear", "all"] = "front"
    """axle of `pads_new`, `pad_worn_1mm` and `pad_2mm_left`"""
    first_indicator_worn_m: Depth = 0.001
    """worn when `pad_worn_1mm` comes"""
    second_indicator_left_m: Depth = 0.002
    """left when `pad_2mm_left` comes"""
    indicator_std_m: Positive = 1.0e-4
    """standard deviation of an indicator, and of new pads"""
    configured_std_m: Positive = 5.0e-4
    """standard deviation of `pad.thickness_m`"""
    limit_m: Depth = 0.002
    """thickness at which pads are worn"""
    model_follows: bool = False
    """slabs and disc mass of the thermal model follow, in every command that
    replays or runs"""

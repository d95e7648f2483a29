"""Estimates: the codes and records of one publication.

Model, estimator, forecast and advice fill these records; frames, tables,
metrics and screens show them. All SI, temperatures in kelvin,
probabilities 0 to 1; NaN is unknown.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from math import isfinite, nan
from types import MappingProxyType
from typing import Final, NamedTuple


class Validity(IntEnum):
    """How far an estimate may be relied on; a larger code is worse."""

    VALID = 0
    DEGRADED = 1
    INVALID = 2
    NOT_AVAILABLE = 15

    @property
    def is_usable(self) -> bool:
        """Whether anything may be concluded from the estimate."""
        return self <= Validity.DEGRADED


class Reason(IntFlag):
    """Why an estimate is not valid; it is valid exactly where there is none.

    The bits are those of frames and result columns.
    """

    START_UNKNOWN = 1
    """The temperatures at the start still have an effect."""
    INPUT_MISSING = 2
    INPUT_SUSPECT = 4
    """Something speaks against an input now, or did against the heat that the
    brake still has."""
    HEAT_UNKNOWN = 8
    """The brake was, or may have been, heated by what nobody knows."""
    UNVERIFIED = 16
    """Nothing checks an input that the heat mode goes by, or the model."""
    MODEL_DISAGREES = 32
    """Measurements are, or were, far from the estimate."""
    IMPOSSIBLE = 64
    """The estimate is no temperature that a brake has."""
    AMBIENT = 128
    """The car sleeps for so long that the air may have become warmer."""

    @property
    def words(self) -> tuple[str, ...]:
        """The reasons in plain words, in the order of their bits."""
        return tuple(REASON_WORDS[one] for one in self)


REASON_WORDS: Final = {
    Reason.START_UNKNOWN: "start unknown",
    Reason.INPUT_MISSING: "input missing",
    Reason.INPUT_SUSPECT: "input suspect",
    Reason.HEAT_UNKNOWN: "heat unknown",
    Reason.UNVERIFIED: "unverified",
    Reason.MODEL_DISAGREES: "model disagrees",
    Reason.IMPOSSIBLE: "impossible",
    Reason.AMBIENT: "ambient",
}
"""Each reason in words, wherever one is shown."""

NO_REASON: Final = Reason(0)


class Input(IntFlag):
    """What an estimate goes by; the bits are the frames'.

    Inputs of a heat mode, and the fluid's part of a model that was matched.
    """

    SPEED = 1
    PRESSURE = 2
    ACCELERATION = 4
    TORQUE = 8
    TEMPERATURE = 16
    FLUID = 32

    @property
    def words(self) -> tuple[str, ...]:
        """The inputs in plain words, in the order of their bits."""
        return tuple(str(one.name).lower() for one in self)


NO_INPUT: Final = Input(0)


class State(IntEnum):
    """What the daemon is doing; without input: no wanted sample for 1 s."""

    STARTING = 0
    RUNNING = 1
    DEGRADED = 2
    NO_INPUT = 3
    STOPPING = 4
    NOT_AVAILABLE = 15


class HeatMode(IntEnum):
    """Where the brake power comes from; names as in ``[heat] mode``."""

    FF = 0
    FB = 1
    FUSED = 2
    MEASURED = 3
    NOT_AVAILABLE = 7


class RiskLevel(IntEnum):
    """How close the fluid is to boiling, or a part to its limit."""

    NORMAL = 0
    ELEVATED = 1
    HIGH = 2
    CRITICAL = 3
    UNKNOWN = 15

    @property
    def severity(self) -> int:
        """The code, below all others where the level is unknown."""
        return -1 if self is RiskLevel.UNKNOWN else int(self)


class WearSource(IntEnum):
    """Basis of the lining thickness."""

    CONFIGURED = 0
    """The configured thickness, worn on at the expected rate."""
    NEW_PADS = 1
    """``pads_new`` was seen; the rate is expected, or of the previous set."""
    FIRST_INDICATOR = 2
    """The rate is that of the first millimetre (Eq 4.20)."""
    SECOND_INDICATOR = 3
    """The rate is that between the indicators (Eq 4.21)."""
    NOT_AVAILABLE = 15


class WearLevel(IntEnum):
    """Action that the lining thickness requires."""

    OK = 0
    CHECK = 1
    """The limit lies within two standard deviations: have them looked at."""
    WORN = 2
    NOT_AVAILABLE = 15


class Message(IntEnum):
    """Text for the driver's display (P1)."""

    NONE = 0
    WAIT_BEFORE_DEPARTURE = 1
    BRAKES_HOT = 2
    NOT_AVAILABLE = 15


class Sound(IntEnum):
    """Sound for the driver (P2)."""

    NONE = 0
    CHIME = 1
    NOT_AVAILABLE = 3


class Downshift(IntEnum):
    """Engine braking, asked of the driver (P3) or the gearbox (A4)."""

    NONE = 0
    SHIFT_DOWN = 1
    NOT_AVAILABLE = 3


class Isolation(IntEnum):
    """Front wheels off the hydraulics while driving (A5)."""

    NONE = 0
    REQUESTED = 1
    NOT_AVAILABLE = 3


class Assist(IntEnum):
    """State of the emergency assist (A6)."""

    OFF = 0
    STANDBY = 1
    DETECTED = 2
    NOT_AVAILABLE = 7


class Intervention(IntEnum):
    """What the emergency assist asks for (A6)."""

    NONE = 0
    MAXIMUM_PRESSURE = 1
    PARK_BRAKE = 2
    ISOLATE_FRONT = 3
    NOT_AVAILABLE = 7


@dataclass(frozen=True, slots=True)
class WearEstimate:
    """Linings and disc of one corner."""

    thickness_m: float = nan
    std_m: float = nan
    disc_loss_m: float = nan
    remaining_distance_m: float = nan
    source: WearSource = WearSource.NOT_AVAILABLE
    level: WearLevel = WearLevel.NOT_AVAILABLE

    @property
    def validity(self) -> Validity:
        """Degraded while it is based on the configuration alone."""
        if self.source is WearSource.NOT_AVAILABLE:
            return Validity.NOT_AVAILABLE
        if self.source is WearSource.CONFIGURED:
            return Validity.DEGRADED
        return Validity.VALID


class CornerRisk(NamedTuple):
    """Risk and forecast of one corner.

    ``probability`` is that of vapour now or within the horizon if the car
    parks now, ``probability_now`` that of now; ``fluid_deviation_k`` the
    standard deviation of the fluid's temperature now. ``fade`` is the level
    of disc and pads. ``peak_k`` and ``peak_in_s`` are the fluid's if the car
    parks, ``safe_in_s`` the time until vapour is unlikely and stays so,
    infinite beyond the forecast. ``duty_peak_k`` is the highest if the
    present duty goes on to the horizon and ``duty_in_s`` the time until
    vapour is likely then, infinite for never. Times count from
    :attr:`CarRisk.forecast_us`.

    As long as the start is unknown all of it but the deviation is of the hot
    bound, so at most as given. ``sure_level`` is then unknown unless the
    estimate, which began cold, is raised too or the bound is normal.
    """

    probability: float = nan
    probability_now: float = nan
    level: RiskLevel = RiskLevel.UNKNOWN
    sure_level: RiskLevel = RiskLevel.UNKNOWN
    fade: RiskLevel = RiskLevel.UNKNOWN
    fluid_deviation_k: float = nan
    peak_k: float = nan
    peak_in_s: float = nan
    safe_in_s: float = nan
    duty_peak_k: float = nan
    duty_in_s: float = nan


class CarRisk(NamedTuple):
    """Risk of the car: the worst that can happen at any of its corners.

    ``boiling_low_k`` is the point that 1 % of such fluids boil below,
    ``boiling_k`` their median; ``water_percent`` the median of the water.
    ``forecast_us`` is the data time of the underlying forecast,
    None before the first; ``members`` is the size of its ensemble.
    """

    probability: float = nan
    probability_now: float = nan
    level: RiskLevel = RiskLevel.UNKNOWN
    boiling_k: float = nan
    boiling_low_k: float = nan
    water_percent: float = nan
    forecast_us: int | None = None
    members: int = 0
    corners: Mapping[str, CornerRisk] = MappingProxyType({})

    def age_s(self, time_us: int) -> float:
        """Return the age [s] of the forecast at *time_us* [us]."""
        if self.forecast_us is None:
            return nan
        return (time_us - self.forecast_us) * 1e-6


NO_WEAR: Final = WearEstimate()
NO_RISK: Final = CornerRisk()


class CornerEstimate(NamedTuple):
    """One corner with a thermal model.

    ``boiling_k`` is the boiling point of a wet fluid of the grade. ``level``
    is that of the risk, without a forecast that of the margin; without one
    ``risk`` is None. As long as the start is unknown it is of the hot bound,
    and what alarms anybody goes by ``sure_level``, see :class:`CornerRisk`.
    ``forecast_age_s`` is the age of the forecast; ``reasons`` are those why
    the estimate is not valid.
    """

    disc_k: float = nan
    pad_front_k: float = nan
    pad_back_k: float = nan
    fluid_k: float = nan
    boiling_k: float = nan
    validity: Validity = Validity.NOT_AVAILABLE
    reasons: Reason = NO_REASON
    level: RiskLevel = RiskLevel.UNKNOWN
    sure_level: RiskLevel = RiskLevel.UNKNOWN
    risk: CornerRisk | None = None
    forecast_age_s: float = nan
    wear: WearEstimate = NO_WEAR

    @property
    def margin_k(self) -> float:
        """Wet boiling point less the fluid's temperature [K]."""
        return self.boiling_k - self.fluid_k

    @property
    def cautious_margin_k(self) -> float:
        """The margin less the fluid's deviation [K], where that is known."""
        risk, kelvin = self.risk, self.fluid_k
        if risk is not None and isfinite(risk.fluid_deviation_k):
            kelvin += risk.fluid_deviation_k
        return self.boiling_k - kelvin

    @property
    def waiting_s(self) -> float:
        """How long the car must stand from now until the corner is safe [s].

        NaN where the forecast does not know.
        """
        # max keeps a nan that comes first
        return max(
            (NO_RISK if self.risk is None else self.risk).safe_in_s
            - self.forecast_age_s,
            0.0,
        )

    def is_at_least(self, level: RiskLevel) -> bool:
        """Return whether the level is known to be *level* or worse."""
        return self.validity.is_usable and self.sure_level.severity >= (
            level.severity
        )


@dataclass(frozen=True, slots=True)
class Status:
    """The daemon itself. Counts are totals since the start.

    A ``*_stale`` flag says that an input of that kind, which the heat mode
    uses, is older than its time-out; ``input_suspect`` that an input is
    suspect, used or not; ``heat_substituted`` that the heat of a corner is
    from the other source than the heat mode's, or unknown;
    ``model_disagrees`` that residuals against measurements exceed the
    tolerance of a sound model. ``unverified`` are the inputs of any corner
    that no mapped role can check.
    """

    state: State = State.NOT_AVAILABLE
    heat_mode: HeatMode = HeatMode.NOT_AVAILABLE
    history_known: bool = False
    compiled_kernel: bool = False
    oldest_input_age_s: float = nan
    rejected_frames: int = 0
    dropped_frames: int = 0
    speed_stale: bool = False
    pressure_stale: bool = False
    acceleration_stale: bool = False
    torque_stale: bool = False
    ambient_stale: bool = False
    clock_jump: bool = False
    input_suspect: bool = False
    heat_substituted: bool = False
    model_disagrees: bool = False
    unverified: Input = NO_INPUT


class Advice(NamedTuple):
    """Advice and requests to others; never an actuation.

    ``pedal_feel`` 1 is the usual feel of the pedal and less is softer;
    ``detector_score`` goes from 0 to 1.
    """

    message: Message = Message.NOT_AVAILABLE
    sound: Sound = Sound.NOT_AVAILABLE
    waiting_s: float = nan
    shift_advice: Downshift = Downshift.NOT_AVAILABLE
    gearbox_request: Downshift = Downshift.NOT_AVAILABLE
    front_isolation: Isolation = Isolation.NOT_AVAILABLE
    emergency_assist: Assist = Assist.NOT_AVAILABLE
    intervention: Intervention = Intervention.NOT_AVAILABLE
    pedal_feel: float = nan
    detector_score: float = nan
    validity: Validity = Validity.NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class Estimate:
    """Everything known at the grid time ``time_us`` (microseconds).

    ``corners`` are those with a thermal model; ``risk`` is None without a
    forecast.
    """

    time_us: int
    corners: Mapping[str, CornerEstimate]
    status: Status = field(default_factory=Status)
    advice: Advice = field(default_factory=Advice)
    risk: CarRisk | None = None

    @property
    def validity(self) -> Validity:
        """The worst validity of the corners."""
        found = [corner.validity for corner in self.corners.values()]
        return max(found, default=Validity.NOT_AVAILABLE)

"""The frames that the daemon publishes, as a table.

``dbc/bstm.dbc`` says the same for other tools and ``docs/frames.md`` for
people; tests hold the three together signal by signal. Encoding needs only
this table, so an installed daemon depends on no DBC file for its own output.

All signals are unsigned and little endian (Intel). A quantity of n bits uses
the raw values 0..2^n - 3; all ones means not available, all ones minus one an
error of the value itself.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from math import isinf, isnan
from operator import attrgetter
from typing import Any, Final

from bstm_daemon.bus.output.e2e import COUNTER_COUNT
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimate import (
    NO_RISK,
    REASON_WORDS,
    Assist,
    CarRisk,
    CornerEstimate,
    Downshift,
    Estimate,
    HeatMode,
    Input,
    Intervention,
    Isolation,
    Message,
    RiskLevel,
    Sound,
    State,
    Validity,
    WearLevel,
    WearSource,
)
from bstm_daemon.units import to_celsius

LAYOUT_VERSION: Final = 3
"""Raised whenever a signal of an existing frame moves or changes meaning."""

FRAME_BYTES: Final = 8
CORNERS: Final = ("FL", "FR", "RL", "RR")

ADVICE_OFFSET: Final = 0x02
BLOCK_IDS: Final = 0x14
"""Ids from the base on that belong to us, those in reserve included."""

MAX_STANDARD_ID: Final = 0x7FF

TEN_HERTZ_US: Final = 100_000
ONE_HERTZ_US: Final = 1_000_000
TENTH_HERTZ_US: Final = 10_000_000

UNKNOWN_REASONS: Final = 0xFF
"""Reasons of a corner without an estimate."""

LATER_S: Final = 1e9
"""A time beyond the range of any signal."""

_OF_SI: Final[Mapping[str, Callable[[float], float]]] = {
    "mm": lambda length_m: length_m * 1e3,
    "km": lambda length_m: length_m * 1e-3,
    "degC": to_celsius,
}
"""Quantities in SI as units that are not."""

# DataIDList[counter] = key xor the masks of the bits set in the counter. The
# list is linear, so a flipped counter bit changes the CRC in a known way;
# these masks were searched so that every error of up to three bits, counter
# included, is detected. Different keys never share an id at any counter.
_COUNTER_BIT_MASKS: Final = (0x36, 0x09, 0xAA, 0xD7)


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal: raw = (physical - offset) / scale at bit *start*.

    ``value`` gets it from the :class:`~bstm_daemon.estimate.Estimate`, for a
    frame of a corner from its :class:`~bstm_daemon.estimate.CornerEstimate`:
    a quantity in ``unit``, anything else as its raw code.
    """

    name: str
    start: int
    length: int
    value: Callable[[Any], float]
    choices: Mapping[int, str] = field(default_factory=dict)
    scale: float = 1.0
    offset: float = 0.0
    maximum: float | None = None
    unit: str = ""
    is_quantity: bool = False

    @property
    def not_available(self) -> int:
        """The raw value of a quantity that is not available."""
        return (1 << self.length) - 1

    @property
    def error(self) -> int:
        """The raw value of a quantity that is in error."""
        return self.not_available - 1

    def raw_of(self, source: Estimate | CornerEstimate) -> int:
        """Return the raw value in a frame of *source*; never raises."""
        value = self.value(source)
        return self.raw(value) if self.is_quantity else int(value)

    def raw(self, value: float) -> int:
        """Return the raw value of the quantity *value*; never raises.

        NaN is not available and an infinity an error; anything else outside
        the range is sent as the end of the range.
        """
        if isnan(value):
            return self.not_available
        if isinf(value):
            return self.error
        top = self.maximum
        if top is None:
            top = self.offset + self.scale * (self.error - 1)
        clipped = min(max(value, self.offset), top)
        return round((clipped - self.offset) / self.scale)


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame: where its id lies, when it is due, what it carries."""

    name: str
    id_offset: int
    cycle_us: int
    phase_us: int
    signals: tuple[Signal, ...]
    corner: str | None = None

    @property
    def data_ids(self) -> tuple[int, ...]:
        """The 16 data ids of the end-to-end protection."""
        return data_id_list(self.id_offset)

    def is_due(self, time_us: int) -> bool:
        """Return whether the frame goes out at grid time *time_us*."""
        return (time_us - self.phase_us) % self.cycle_us == 0

    def pack(self, estimate: Estimate) -> bytes:
        """Return 8 bytes with every signal of *estimate*, yet unprotected.

        A corner that *estimate* does not hold is sent as not available.
        """
        source: Estimate | CornerEstimate = estimate
        if self.corner is not None:
            source = estimate.corners.get(self.corner, _NO_CORNER)
        bits = 0
        for signal in self.signals[len(E2E_SIGNALS) :]:
            bits |= signal.raw_of(source) << signal.start
        return bits.to_bytes(FRAME_BYTES, "little")


_NO_CORNER: Final = CornerEstimate()


def _getter(path: str) -> Callable[[Any], Any]:
    """Return what gives the attribute *path*, such as ``risk.peak_k``.

    Without a forecast there is no ``risk``: then it gives that of none.
    """
    inner = path.removeprefix("risk.")
    if inner == path:
        return attrgetter(path)
    get = attrgetter(inner)

    def of_risk(source: Estimate | CornerEstimate) -> Any:
        if source.risk is not None:
            return get(source.risk)
        is_corner = isinstance(source, CornerEstimate)
        return get(NO_RISK if is_corner else _NO_CAR_RISK)

    return of_risk


def _code(
    name: str, start: int, length: int, path: str, codes: type[IntEnum]
) -> Signal:
    choices = {int(code): code.name.lower() for code in codes}
    return Signal(name, start, length, _getter(path), choices)


def _quantity(  # noqa: PLR0913  (the columns of the table)
    name: str,
    start: int,
    length: int,
    value: str | Callable[[Any], float],
    scale: float = 1.0,
    unit: str = "",
    *,
    offset: float = 0.0,
    maximum: float | None = None,
) -> Signal:
    """Return a quantity whose *value*, or its path, is in SI."""
    get = _getter(value) if isinstance(value, str) else value
    if unit in _OF_SI:
        in_si, convert = get, _OF_SI[unit]
        get = lambda source: convert(in_si(source))  # noqa: E731
    top = (1 << length) - 1
    choices = {top: "not_available", top - 1: "error"}
    return Signal(
        *(name, start, length, get, choices, scale, offset, maximum, unit),
        is_quantity=True,
    )


def _flag(name: str, start: int, when_0: str, when_1: str) -> Signal:
    """Return the flag of the status *name*, there in snake case."""
    words = re.findall("[A-Z][a-z]+", name)
    get = attrgetter(f"status.{'_'.join(words).lower()}")
    return Signal(name, start, 1, get, {0: when_0, 1: when_1})


def _celsius(
    name: str, start: int, length: int, path: str, scale: float = 1.0
) -> Signal:
    """Return a temperature, whose value is in kelvin."""
    return _quantity(name, start, length, path, scale, "degC", offset=-60.0)


def _percent(
    name: str, start: int, length: int, path: str, scale: float
) -> Signal:
    """Return a share, whose value is from 0 to 1."""
    share = _getter(path)
    return _quantity(
        *(name, start, length, lambda source: 100.0 * share(source)),
        *(scale, "%"),
        maximum=100.0,
    )


def _safe_in_s(corner: CornerEstimate) -> float:
    """A time beyond the forecast is the end of the range, not an error."""
    return min((corner.risk or NO_RISK).safe_in_s, LATER_S)


def _reasons(corner: str, start: int) -> Signal:
    """Return the bits why the estimate of *corner* is not valid."""

    def bits(estimate: Estimate) -> int:
        found = estimate.corners.get(corner, _NO_CORNER)
        absent = found.validity is Validity.NOT_AVAILABLE
        return UNKNOWN_REASONS if absent else found.reasons

    choices = {
        int(one): text.replace(" ", "_") for one, text in REASON_WORDS.items()
    }
    choices |= {0: "none", UNKNOWN_REASONS: "not_available"}
    return Signal(f"Reasons{corner}", start, 8, bits, choices)


_NO_CAR_RISK: Final = CarRisk()

E2E_SIGNALS: Final = (
    Signal("CRC", 0, 8, lambda _: 0),
    Signal("Counter", 8, 4, lambda _: 0),
)


def _header(path: str = "validity") -> tuple[Signal, ...]:
    return (*E2E_SIGNALS, _code("Validity", 12, 4, path, Validity))


TEMPERATURES_SIGNALS: Final = (
    *_header(),
    _celsius("Disc", 16, 12, "disc_k", 0.5),
    _celsius("PadFront", 28, 12, "pad_front_k", 0.5),
    _celsius("PadBack", 40, 12, "pad_back_k", 0.5),
    _celsius("Fluid", 52, 12, "fluid_k", 0.1),
)

RISK_SIGNALS: Final = (
    *_header(),
    _quantity("Margin", 16, 12, "margin_k", 0.2, "K", offset=-400.0),
    _celsius("WetBoilingPoint", 28, 12, "boiling_k", 0.1),
    _percent("Probability", 40, 16, "risk.probability", 0.002),
    _code("Level", 56, 4, "level", RiskLevel),
    _code("FadeLevel", 60, 4, "risk.fade", RiskLevel),
)

FORECAST_SIGNALS: Final = (
    *_header(),
    _celsius("Peak", 16, 12, "risk.peak_k", 0.1),
    _quantity("PeakIn", 28, 6, "risk.peak_in_s", 30.0, "s"),
    _quantity("SafeIn", 34, 7, _safe_in_s, 60.0, "s"),
    _quantity("FluidDeviation", 41, 7, "risk.fluid_deviation_k", 0.5, "K"),
    _celsius("DutyPeak", 48, 9, "risk.duty_peak_k"),
    _quantity("Age", 57, 7, "forecast_age_s", 1.0, "s"),
)

CAR_RISK_SIGNALS: Final = (
    *_header(),
    _percent("Probability", 16, 10, "risk.probability", 0.1),
    _percent("ProbabilityNow", 26, 10, "risk.probability_now", 0.1),
    _code("Level", 36, 4, "risk.level", RiskLevel),
    _celsius("BoilingPoint", 40, 9, "risk.boiling_k"),
    _celsius("BoilingPointLow", 49, 9, "risk.boiling_low_k"),
    _quantity("Water", 58, 6, "risk.water_percent", 0.2, "%"),
)

ADVICE_SIGNALS: Final = (
    *_header("advice.validity"),
    _code("Message", 16, 4, "advice.message", Message),
    _code("Sound", 20, 2, "advice.sound", Sound),
    _code("ShiftAdvice", 22, 2, "advice.shift_advice", Downshift),
    _code("GearboxRequest", 24, 2, "advice.gearbox_request", Downshift),
    _code("FrontIsolation", 26, 2, "advice.front_isolation", Isolation),
    _code("EmergencyAssist", 28, 3, "advice.emergency_assist", Assist),
    _code("Intervention", 31, 3, "advice.intervention", Intervention),
    _quantity("WaitingTime", 34, 12, "advice.waiting_s", 1.0, "s"),
    _percent("PedalFeel", 46, 8, "advice.pedal_feel", 0.5),
    _percent("DetectorScore", 54, 8, "advice.detector_score", 0.5),
)

WEAR_SIGNALS: Final = (
    *_header("wear.validity"),
    _quantity("PadThickness", 16, 12, "wear.thickness_m", 0.01, "mm"),
    _quantity("PadThicknessStd", 28, 8, "wear.std_m", 0.02, "mm"),
    _quantity("DiscLoss", 36, 8, "wear.disc_loss_m", 0.02, "mm"),
    _quantity(
        "RemainingDistance", 44, 12, "wear.remaining_distance_m", 50.0, "km"
    ),
    _code("Source", 56, 4, "wear.source", WearSource),
    _code("Level", 60, 4, "wear.level", WearLevel),
)

STATUS_SIGNALS: Final = (
    *_header(),
    Signal("LayoutVersion", 16, 4, lambda _: LAYOUT_VERSION),
    _code("State", 20, 4, "status.state", State),
    _code("HeatMode", 24, 3, "status.heat_mode", HeatMode),
    Signal("CornersModelled", 27, 3, lambda e: len(e.corners)),
    _flag("HistoryKnown", 30, "unknown", "known"),
    _flag("CompiledKernel", 31, "python", "compiled"),
    _quantity("OldestInputAge", 32, 8, "status.oldest_input_age_s", 0.1, "s"),
    _flag("SpeedStale", 40, "fresh", "stale"),
    _flag("PressureStale", 41, "fresh", "stale"),
    _flag("AccelerationStale", 42, "fresh", "stale"),
    _flag("TorqueStale", 43, "fresh", "stale"),
    _flag("AmbientStale", 44, "fresh", "stale"),
    _flag("ClockJump", 45, "none", "jumped"),
    _flag("InputSuspect", 46, "none", "suspect"),
    _flag("HeatSubstituted", 47, "own", "substituted"),
    _quantity("RejectedFrames", 48, 8, "status.rejected_frames"),
    _quantity("DroppedFrames", 56, 7, "status.dropped_frames"),
    _flag("ModelDisagrees", 63, "none", "disagrees"),
)

REASONS_SIGNALS: Final = (
    *_header(),
    *(_reasons(corner, 16 + 8 * i) for i, corner in enumerate(CORNERS)),
    Signal(
        *("Unverified", 48, 8, attrgetter("status.unverified")),
        {0: "none"} | {int(one): one.words[0] for one in Input},
    ),
)


# name, id offset, cycle, phase, signals
_CAR_FRAMES: Final = (
    ("Status", 0x00, TEN_HERTZ_US, 0, STATUS_SIGNALS),
    ("Reasons", 0x01, TEN_HERTZ_US, 0, REASONS_SIGNALS),
    ("Advice", ADVICE_OFFSET, ONE_HERTZ_US, 0, ADVICE_SIGNALS),
    ("Risk", 0x03, ONE_HERTZ_US, 900_000, CAR_RISK_SIGNALS),
)

# name, id offset, cycle, phase of the first corner, from one to the next
_CORNER_FRAMES: Final = (
    ("Temperatures", 0x04, TEN_HERTZ_US, 0, 0, TEMPERATURES_SIGNALS),
    ("Risk", 0x08, ONE_HERTZ_US, 100_000, TEN_HERTZ_US, RISK_SIGNALS),
    ("Forecast", 0x0C, ONE_HERTZ_US, 500_000, TEN_HERTZ_US, FORECAST_SIGNALS),
    ("Wear", 0x10, TENTH_HERTZ_US, 0, ONE_HERTZ_US, WEAR_SIGNALS),
)


@cache
def data_id_list(key: int) -> tuple[int, ...]:
    """Return the 16 data ids (0..255) of the frame with *key*.

    The key of a frame is its id offset, so the protection does not depend on
    the base the user chooses.
    """
    ids = []
    for counter in range(COUNTER_COUNT):
        data_id = key
        for bit, mask in enumerate(_COUNTER_BIT_MASKS):
            if counter >> bit & 1:
                data_id ^= mask
        ids.append(data_id)
    return tuple(ids)


def published_frames(corners: Iterable[str]) -> tuple[Frame, ...]:
    """Return the frames of a car with *corners*, in the order of their ids.

    The slow frames go out on different 100 ms ticks: the transmit queue of a
    CAN interface holds ten frames by default, and a burst would keep the bus
    for longer than needed. Raises :class:`ValueError` for
    a corner that is not FL, FR, RL or RR.
    """
    frames = [
        Frame(f"BSTM_{name}", offset, cycle_us, phase_us, signals)
        for name, offset, cycle_us, phase_us, signals in _CAR_FRAMES
    ]
    for corner in set(corners):
        if corner not in CORNERS:
            msg = f"a corner is one of {', '.join(CORNERS)}, got {corner!r}"
            raise ValueError(msg)
        place = CORNERS.index(corner)
        frames += [
            Frame(
                f"BSTM_{corner}_{name}",
                offset + place,
                cycle_us,
                phase_us + place * apart_us,
                signals,
                corner,
            )
            for name, offset, cycle_us, phase_us, apart_us, signals in (
                _CORNER_FRAMES
            )
        ]
    return tuple(sorted(frames, key=lambda frame: frame.id_offset))


def own_ids(id_base: int, corners: Iterable[str]) -> tuple[int, ...]:
    """Return the standard (11-bit) ids that a car with *corners* sends.

    Raises :class:`~bstm_daemon.errors.ConfigError` where the block of ids
    that starts at *id_base* does not fit into 11 bits.
    """
    last_base = MAX_STANDARD_ID - BLOCK_IDS + 1
    if not 0 <= id_base <= last_base:
        problem = (
            f"[publish] id_base = 0x{id_base:X}: {BLOCK_IDS} ids from it on "
            f"must fit into 11 bits, use 0x0 to 0x{last_base:X}"
        )
        raise ConfigError([problem])
    return tuple(
        id_base + frame.id_offset for frame in published_frames(corners)
    )

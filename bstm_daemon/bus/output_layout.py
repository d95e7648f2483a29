"""The frames that the daemon publishes, as a table.

``dbc/bstm.dbc`` says the same for other tools and ``docs/frames.md`` for
people; tests hold the three together signal by signal. Encoding needs only
this table, so an installed daemon depends on no DBC file for its own output.

All signals are unsigned and little endian (Intel). A quantity of n bits uses
the raw values 0..2^n - 3; all ones means not available, all ones minus one an
error of the value itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from math import isinf, isnan
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.e2e import COUNTER_COUNT
from bstm_daemon.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

LAYOUT_VERSION: Final = 3
"""Raised whenever a signal of an existing frame moves or changes meaning."""

FRAME_BYTES: Final = 8
CORNERS: Final = ("FL", "FR", "RL", "RR")

STATUS_OFFSET: Final = 0x00
ADVICE_OFFSET: Final = 0x02
CAR_RISK_OFFSET: Final = 0x03
TEMPERATURES_OFFSET: Final = 0x04
RISK_OFFSET: Final = 0x08
FORECAST_OFFSET: Final = 0x0C
WEAR_OFFSET: Final = 0x10
BLOCK_IDS: Final = 0x14
"""Ids from the base on that belong to us, those in reserve included."""

MAX_STANDARD_ID: Final = 0x7FF

CAR_RISK_PHASE_US: Final = 900_000
ADVICE_PHASE_US: Final = 0
WEAR_PHASE_US: Final = 0
"""Ticks within the second, beside those of the corners' 1 Hz frames. Advice,
where it is sent at all, shares one with a frame of wear in four of ten."""

TEN_HERTZ_US: Final = 100_000
ONE_HERTZ_US: Final = 1_000_000
TENTH_HERTZ_US: Final = 10_000_000

# DataIDList[counter] = key xor the masks of the bits set in the counter. The
# list is linear, so a flipped counter bit changes the CRC in a known way;
# these masks were searched so that every error of up to three bits, counter
# included, is detected. Different keys never share an id at any counter.
_COUNTER_BIT_MASKS: Final = (0x36, 0x09, 0xAA, 0xD7)


class Validity(IntEnum):
    """High nibble of byte 1 of every frame."""

    VALID = 0
    DEGRADED = 1
    INVALID = 2
    NOT_AVAILABLE = 15


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


class WearSource(IntEnum):
    """What the lining thickness rests on."""

    CONFIGURED = 0
    NEW_PADS = 1
    FIRST_INDICATOR = 2
    SECOND_INDICATOR = 3
    NOT_AVAILABLE = 15


class WearLevel(IntEnum):
    """What the lining thickness asks for."""

    OK = 0
    CHECK = 1
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
class Signal:
    """One signal: raw = (physical - offset) / scale at bit *start*."""

    name: str
    start: int
    length: int
    choices: Mapping[int, str] = field(default_factory=dict)
    scale: float = 1.0
    offset: float = 0.0
    maximum: float | None = None
    unit: str = ""

    @property
    def not_available(self) -> int:
        """The raw value of a quantity that there is none."""
        return (1 << self.length) - 1

    @property
    def error(self) -> int:
        """The raw value of a quantity whose value is no number."""
        return self.not_available - 1

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

    def pack(self, raw: Mapping[str, int]) -> bytes:
        """Return 8 unprotected bytes with every signal of *raw* in place.

        *raw* has exactly the signals after CRC and counter; a missing one is
        a :class:`KeyError`, so that no signal is ever left to chance.
        """
        bits = 0
        for signal in self.signals[len(E2E_SIGNALS) :]:
            bits |= raw[signal.name] << signal.start
        return bits.to_bytes(FRAME_BYTES, "little")


def _names(values: type[IntEnum]) -> dict[int, str]:
    return {int(value): value.name.lower() for value in values}


def _quantity(  # noqa: PLR0913  (the columns of the table)
    name: str,
    start: int,
    length: int,
    *,
    scale: float = 1.0,
    offset: float = 0.0,
    maximum: float | None = None,
    unit: str = "",
) -> Signal:
    top = (1 << length) - 1
    choices = {top: "not_available", top - 1: "error"}
    return Signal(name, start, length, choices, scale, offset, maximum, unit)


def _flag(name: str, start: int, when_0: str, when_1: str) -> Signal:
    return Signal(name, start, 1, {0: when_0, 1: when_1})


def _solid_temperature(name: str, start: int) -> Signal:
    return _quantity(name, start, 12, scale=0.5, offset=-60.0, unit="degC")


def _fluid_temperature(name: str, start: int) -> Signal:
    return _quantity(name, start, 12, scale=0.1, offset=-60.0, unit="degC")


E2E_SIGNALS: Final = (Signal("CRC", 0, 8), Signal("Counter", 8, 4))
_HEADER: Final = (*E2E_SIGNALS, Signal("Validity", 12, 4, _names(Validity)))

TEMPERATURES_SIGNALS: Final = (
    *_HEADER,
    _solid_temperature("Disc", 16),
    _solid_temperature("PadFront", 28),
    _solid_temperature("PadBack", 40),
    _fluid_temperature("Fluid", 52),
)

RISK_SIGNALS: Final = (
    *_HEADER,
    _quantity("Margin", 16, 12, scale=0.2, offset=-400.0, unit="K"),
    _fluid_temperature("WetBoilingPoint", 28),
    _quantity("Probability", 40, 16, scale=0.002, maximum=100.0, unit="%"),
    Signal("Level", 56, 4, _names(RiskLevel)),
    Signal("FadeLevel", 60, 4, _names(RiskLevel)),
)

FORECAST_SIGNALS: Final = (
    *_HEADER,
    _fluid_temperature("Peak", 16),
    _quantity("PeakIn", 28, 6, scale=30.0, unit="s"),
    _quantity("SafeIn", 34, 7, scale=60.0, unit="s"),
    _quantity("FluidDeviation", 41, 7, scale=0.5, unit="K"),
    _quantity("DutyPeak", 48, 9, offset=-60.0, unit="degC"),
    _quantity("Age", 57, 7, unit="s"),
)

CAR_RISK_SIGNALS: Final = (
    *_HEADER,
    _quantity("Probability", 16, 10, scale=0.1, maximum=100.0, unit="%"),
    _quantity("ProbabilityNow", 26, 10, scale=0.1, maximum=100.0, unit="%"),
    Signal("Level", 36, 4, _names(RiskLevel)),
    _quantity("BoilingPoint", 40, 9, offset=-60.0, unit="degC"),
    _quantity("BoilingPointLow", 49, 9, offset=-60.0, unit="degC"),
    _quantity("Water", 58, 6, scale=0.2, unit="%"),
)

ADVICE_SIGNALS: Final = (
    *_HEADER,
    Signal("Message", 16, 4, _names(Message)),
    Signal("Sound", 20, 2, _names(Sound)),
    Signal("ShiftAdvice", 22, 2, _names(Downshift)),
    Signal("GearboxRequest", 24, 2, _names(Downshift)),
    Signal("FrontIsolation", 26, 2, _names(Isolation)),
    Signal("EmergencyAssist", 28, 3, _names(Assist)),
    Signal("Intervention", 31, 3, _names(Intervention)),
    _quantity("WaitingTime", 34, 12, unit="s"),
    _quantity("PedalFeel", 46, 8, scale=0.5, maximum=100.0, unit="%"),
    _quantity("DetectorScore", 54, 8, scale=0.5, maximum=100.0, unit="%"),
)

WEAR_SIGNALS: Final = (
    *_HEADER,
    _quantity("PadThickness", 16, 12, scale=0.01, unit="mm"),
    _quantity("PadThicknessStd", 28, 8, scale=0.02, unit="mm"),
    _quantity("DiscLoss", 36, 8, scale=0.02, unit="mm"),
    _quantity("RemainingDistance", 44, 12, scale=50.0, unit="km"),
    Signal("Source", 56, 4, _names(WearSource)),
    Signal("Level", 60, 4, _names(WearLevel)),
)

STATUS_SIGNALS: Final = (
    *_HEADER,
    Signal("LayoutVersion", 16, 4),
    Signal("State", 20, 4, _names(State)),
    Signal("HeatMode", 24, 3, _names(HeatMode)),
    Signal("CornersModelled", 27, 3),
    _flag("HistoryKnown", 30, "unknown", "known"),
    _flag("CompiledKernel", 31, "python", "compiled"),
    _quantity("OldestInputAge", 32, 8, scale=0.1, unit="s"),
    _flag("SpeedStale", 40, "fresh", "stale"),
    _flag("PressureStale", 41, "fresh", "stale"),
    _flag("AccelerationStale", 42, "fresh", "stale"),
    _flag("TorqueStale", 43, "fresh", "stale"),
    _flag("AmbientStale", 44, "fresh", "stale"),
    _flag("ClockJump", 45, "none", "jumped"),
    _flag("InputSuspect", 46, "none", "suspect"),
    _flag("HeatSubstituted", 47, "own", "substituted"),
    _quantity("RejectedFrames", 48, 8),
    _quantity("DroppedFrames", 56, 7),
    _flag("ModelDisagrees", 63, "none", "disagrees"),
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
        Frame("BSTM_Status", STATUS_OFFSET, TEN_HERTZ_US, 0, STATUS_SIGNALS),
        Frame(
            "BSTM_Advice",
            ADVICE_OFFSET,
            ONE_HERTZ_US,
            ADVICE_PHASE_US,
            ADVICE_SIGNALS,
        ),
        Frame(
            "BSTM_Risk",
            CAR_RISK_OFFSET,
            ONE_HERTZ_US,
            CAR_RISK_PHASE_US,
            CAR_RISK_SIGNALS,
        ),
    ]
    for corner in set(corners):
        if corner not in CORNERS:
            msg = f"a corner is one of {', '.join(CORNERS)}, got {corner!r}"
            raise ValueError(msg)
        place = CORNERS.index(corner)
        frames += [
            Frame(
                f"BSTM_{corner}_Temperatures",
                TEMPERATURES_OFFSET + place,
                TEN_HERTZ_US,
                0,
                TEMPERATURES_SIGNALS,
                corner,
            ),
            Frame(
                f"BSTM_{corner}_Risk",
                RISK_OFFSET + place,
                ONE_HERTZ_US,
                (1 + place) * TEN_HERTZ_US,
                RISK_SIGNALS,
                corner,
            ),
            Frame(
                f"BSTM_{corner}_Forecast",
                FORECAST_OFFSET + place,
                ONE_HERTZ_US,
                (5 + place) * TEN_HERTZ_US,
                FORECAST_SIGNALS,
                corner,
            ),
            Frame(
                f"BSTM_{corner}_Wear",
                WEAR_OFFSET + place,
                TENTH_HERTZ_US,
                WEAR_PHASE_US + place * ONE_HERTZ_US,
                WEAR_SIGNALS,
                corner,
            ),
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

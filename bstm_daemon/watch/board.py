"""The latest published values of a car, and the last minutes of each."""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from enum import IntEnum
from math import isfinite, isnan, nan
from typing import Final, NamedTuple, TypeVar

from bstm_daemon import estimate
from bstm_daemon.bus.output.e2e import CheckStatus
from bstm_daemon.bus.output.layout import (
    CORNERS,
    LAYOUT_VERSION,
    UNKNOWN_REASONS,
    Frame,
)
from bstm_daemon.bus.output.published import PublishedDecoder

HISTORY_S: Final = 300
"""Five minutes, about the time constant of a cooling disc."""

SECOND_US: Final = 1_000_000

BARS: Final = "▁▂▃▄▅▆▇█"
ASCII_BARS: Final = "_.-~=+*#"
"""For terminals without block elements."""

LEAST_SPAN: Final = 20.0
"""Values within 20 K are drawn as a flat line: no noise is magnified."""


class History:
    """The largest finite value of each of the last seconds.

    A time [us] before the last one empties the history, since the older
    values belong to another time axis.
    """

    def __init__(self) -> None:
        """Begin empty."""
        self._bins: deque[tuple[int, float]] = deque(maxlen=HISTORY_S)

    def add(self, time_us: int, value: float) -> None:
        """Take *value* at *time_us*; one that is not finite leaves a gap."""
        second = time_us // SECOND_US
        if self._bins and second < self._bins[-1][0]:
            self._bins.clear()
        if not isfinite(value):
            return
        if self._bins and second == self._bins[-1][0]:
            value = max(value, self._bins.pop()[1])
        self._bins.append((second, value))

    def columns(self, now_us: int, count: int) -> list[float]:
        """Return the largest value in each of *count* spans up to *now_us*.

        The last span ends now; NaN where nothing was received.
        """
        columns = [nan] * count
        now = now_us // SECOND_US
        for second, value in self._bins:
            age = now - second
            if 0 <= age < HISTORY_S:
                place = count - 1 - age * count // HISTORY_S
                if not value <= columns[place]:
                    columns[place] = value
        return columns


def sparkline(values: Sequence[float], bars: str = BARS) -> str:
    """Return one character of *bars* per value, blank for NaN.

    The scale runs from the least value to the largest, at least
    :data:`LEAST_SPAN` wide.
    """
    known = [value for value in values if isfinite(value)]
    if not known:
        return " " * len(values)
    bottom = min(known)
    span = max(max(known) - bottom, LEAST_SPAN)
    top = len(bars) - 1
    return "".join(
        bars[round((value - bottom) / span * top)] if isfinite(value) else " "
        for value in values
    )


STATUS: Final = "BSTM_Status"
REASONS: Final = "BSTM_Reasons"

NODES: Final = ("Disc", "PadFront", "PadBack", "Fluid")
"""Signals of ``BSTM_<corner>_Temperatures``, hottest first."""

INPUTS: Final = ("Speed", "Pressure", "Acceleration", "Torque", "Ambient")
"""Inputs with a flag ``<input>Stale`` in ``BSTM_Status``."""

SILENT_CYCLES: Final = 3.5
"""Cycles without a frame after which it counts as stopped: three missed ones
and half a cycle of jitter."""


E = TypeVar("E", bound="IntEnum")


class Received(NamedTuple):
    """A valid frame and when it was received [us]."""

    layout: Frame
    time_us: int
    values: Mapping[str, float]


class Board:
    """The last valid frame of every name, and histories of temperatures.

    Frames are taken in the order of reception; their times [us] may have any
    origin.
    """

    def __init__(
        self, id_base: int, corners: Collection[str] | None = None
    ) -> None:
        """Expect the frames from *id_base* on.

        Args:
            id_base: id of ``BSTM_Status``.
            corners: those of the car; None takes those that are received.

        Raises:
            ConfigError: the ids do not fit.
        """
        self._decoder = PublishedDecoder(id_base)
        self.ids = self._decoder.ids
        self._expected = frozenset(corners or ())
        self._received: dict[str, Received] = {}
        self._histories: dict[tuple[str, str], History] = {}
        self.rejected = 0
        """Frames with a wrong CRC or out of sequence."""

    def frame(
        self,
        can_id: int,
        data: bytes | bytearray,
        time_us: int,
        *,
        extended: bool = False,
    ) -> None:
        """Take a frame received at *time_us*; foreign frames are ignored."""
        frame = self._decoder.decode(can_id, data, extended=extended)
        if frame is None:
            return
        if not frame.usable:
            self.rejected += frame.verdict is not CheckStatus.REPEATED
            return
        layout = frame.layout
        self._received[layout.name] = Received(layout, time_us, frame.values)
        for node in NODES:
            if layout.corner is not None and node in frame.values:
                place = layout.corner, node
                history = self._histories.setdefault(place, History())
                history.add(time_us, frame.values[node])

    @property
    def corners(self) -> tuple[str, ...]:
        """The corners of the car, front left first."""
        received = {one.layout.corner for one in self._received.values()}
        return tuple(
            name for name in CORNERS if name in self._expected | received
        )

    @property
    def has_frames(self) -> bool:
        """Whether a valid frame was received."""
        return bool(self._received)

    @property
    def wrong_layout(self) -> int | None:
        """The sender's layout version where it is not ours, else None."""
        version = self.value(STATUS, "LayoutVersion")
        if isnan(version) or version == LAYOUT_VERSION:
            return None
        return int(version)

    def value(self, frame: str, signal: str) -> float:
        """Return the last valid value; NaN where there is none."""
        last = self._received.get(frame)
        return nan if last is None else last.values.get(signal, nan)

    def silence_s(self, frame: str, now_us: int) -> float | None:
        """Return how long ago a frame stopped, None while it is received.

        One that was never received is not silent but unknown: None as well.
        """
        last = self._received.get(frame)
        if last is None:
            return None
        age_us = now_us - last.time_us
        if age_us <= SILENT_CYCLES * last.layout.cycle_us:
            return None
        return age_us / SECOND_US

    def history(self, corner: str, node: str) -> History:
        """Return the history of a temperature [degC]."""
        return self._histories.get((corner, node), _EMPTY)

    def validity(self, frame: str) -> estimate.Validity:
        """Return the validity of a frame; an undefined code is invalid."""
        unset = estimate.Validity.NOT_AVAILABLE
        return self._choice(
            frame, "Validity", unset, estimate.Validity.INVALID
        )

    def reasons(self, corner: str) -> estimate.Reason:
        """Return why *corner* is not valid, as far as it was received."""
        raw = self.value(REASONS, f"Reasons{corner}")
        unknown = isnan(raw) or raw == UNKNOWN_REASONS
        return estimate.NO_REASON if unknown else estimate.Reason(int(raw))

    @property
    def unverified(self) -> estimate.Input:
        """Inputs that no mapped role can check."""
        raw = self.value(REASONS, "Unverified")
        return estimate.NO_INPUT if isnan(raw) else estimate.Input(int(raw))

    def risk(self, corner: str) -> estimate.RiskLevel:
        """Return the risk level of *corner*."""
        return self._choice(
            f"BSTM_{corner}_Risk", "Level", estimate.RiskLevel.UNKNOWN
        )

    @property
    def state(self) -> estimate.State:
        """State of the daemon."""
        return self._choice(STATUS, "State", estimate.State.NOT_AVAILABLE)

    @property
    def heat_mode(self) -> estimate.HeatMode:
        """Source of the brake power."""
        return self._choice(
            STATUS, "HeatMode", estimate.HeatMode.NOT_AVAILABLE
        )

    def is_set(self, flag: str) -> bool:
        """Return whether *flag* of ``BSTM_Status`` is set."""
        return self.value(STATUS, flag) == 1

    @property
    def stale_inputs(self) -> list[str]:
        """Inputs older than their timeout, in lower case."""
        return [one.lower() for one in INPUTS if self.is_set(f"{one}Stale")]

    def _choice(
        self, frame: str, signal: str, missing: E, unknown: E | None = None
    ) -> E:
        """Return a code as its name; *unknown*, or *missing*, has none."""
        raw = self.value(frame, signal)
        if isnan(raw):
            return missing
        other = missing if unknown is None else unknown
        return next((one for one in type(missing) if one == raw), other)


_EMPTY: Final = History()

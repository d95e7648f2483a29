"""What is known of a car from the frames it has published so far."""

from __future__ import annotations

from math import isnan, nan
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

from bstm_daemon.bus.e2e import CheckStatus
from bstm_daemon.bus.output_layout import (
    CORNERS,
    LAYOUT_VERSION,
    HeatMode,
    RiskLevel,
    State,
    Validity,
)
from bstm_daemon.bus.published import PublishedDecoder
from bstm_daemon.watch.history import SECOND_US, History

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping
    from enum import IntEnum

    from bstm_daemon.bus.output_layout import Frame

NODES: Final = ("Disc", "PadFront", "PadBack", "Fluid")
"""Signals of ``BSTM_<corner>_Temperatures``, hottest first."""

INPUTS: Final = ("Speed", "Pressure", "Acceleration", "Torque", "Ambient")
"""Inputs with a flag ``<input>Stale`` in ``BSTM_Status``."""

SILENT_CYCLES: Final = 3.5
"""Three missing cycles and half a one of grace: the frame has stopped."""


class Seen(NamedTuple):
    """The last good frame of a name and when it came [us]."""

    layout: Frame
    time_us: int
    values: Mapping[str, float]


class Board:
    """The last good frame of every name, and histories of temperatures.

    Feed frames in the order they come; times [us] are on any axis that runs
    forward. A frame that the table gains later is held like the others.
    """

    def __init__(
        self, id_base: int, corners: Collection[str] | None = None
    ) -> None:
        """Expect the frames from *id_base* on.

        *corners* are those of the car where they are known; otherwise a
        corner exists once it is heard of. Raises
        :class:`~bstm_daemon.errors.ConfigError` where the ids do not fit.
        """
        self._decoder = PublishedDecoder(id_base)
        self.ids = self._decoder.ids
        self._expected = frozenset(corners or ())
        self._seen: dict[str, Seen] = {}
        self._histories: dict[tuple[str, str], History] = {}
        self.refused = 0
        """Frames with a wrong CRC or out of sequence."""

    def frame(
        self,
        can_id: int,
        data: bytes | bytearray,
        time_us: int,
        *,
        extended: bool = False,
    ) -> None:
        """Take a frame received at *time_us*; foreign ones do nothing."""
        frame = self._decoder.decode(can_id, data, extended=extended)
        if frame is None:
            return
        if not frame.usable:
            self.refused += frame.verdict is not CheckStatus.REPEATED
            return
        layout = frame.layout
        self._seen[layout.name] = Seen(layout, time_us, frame.values)
        if layout.corner is not None:
            for node in NODES:
                if node in frame.values:
                    history = self._histories.setdefault(
                        (layout.corner, node), History()
                    )
                    history.add(time_us, frame.values[node])

    @property
    def corners(self) -> tuple[str, ...]:
        """The corners of the car, front left first."""
        heard = {seen.layout.corner for seen in self._seen.values()}
        return tuple(
            name for name in CORNERS if name in self._expected | heard
        )

    @property
    def has_frames(self) -> bool:
        """Whether any frame was good."""
        return bool(self._seen)

    @property
    def wrong_layout(self) -> int | None:
        """The version of a layout that is not ours, if the sender has one."""
        version = self.value("BSTM_Status", "LayoutVersion")
        if isnan(version) or version == LAYOUT_VERSION:
            return None
        return int(version)

    def value(self, frame: str, signal: str) -> float:
        """Return the last good value; NaN where there is none."""
        seen = self._seen.get(frame)
        return nan if seen is None else seen.values.get(signal, nan)

    def silence_s(self, frame: str, now_us: int) -> float | None:
        """Return for how long a frame has stopped, None while it comes.

        One that never came is not silent but unknown: None as well.
        """
        seen = self._seen.get(frame)
        if seen is None:
            return None
        age_us = now_us - seen.time_us
        if age_us <= SILENT_CYCLES * seen.layout.cycle_us:
            return None
        return age_us / SECOND_US

    def history(self, corner: str, node: str) -> History:
        """Return the history of a temperature [degC]."""
        return self._histories.get((corner, node), _EMPTY)

    def validity(self, frame: str) -> Validity:
        """Return the validity of a frame; one of no meaning is invalid."""
        return _choice(
            Validity,
            self.value(frame, "Validity"),
            Validity.NOT_AVAILABLE,
            Validity.INVALID,
        )

    def risk(self, corner: str) -> RiskLevel:
        """Return the risk level of *corner*."""
        level = self.value(f"BSTM_{corner}_Risk", "Level")
        return _choice(RiskLevel, level, RiskLevel.UNKNOWN, RiskLevel.UNKNOWN)

    @property
    def state(self) -> State:
        """What the daemon says it does."""
        state = self.value("BSTM_Status", "State")
        return _choice(State, state, State.NOT_AVAILABLE, State.NOT_AVAILABLE)

    @property
    def heat_mode(self) -> HeatMode:
        """Where the daemon says that brake power comes from."""
        mode = self.value("BSTM_Status", "HeatMode")
        return _choice(
            HeatMode, mode, HeatMode.NOT_AVAILABLE, HeatMode.NOT_AVAILABLE
        )

    @property
    def has_suspect_input(self) -> bool:
        """Whether something speaks against an input."""
        return self.value("BSTM_Status", "InputSuspect") == 1

    @property
    def has_substituted_heat(self) -> bool:
        """Whether heat is from the other source, or unknown."""
        return self.value("BSTM_Status", "HeatSubstituted") == 1

    @property
    def stale_inputs(self) -> list[str]:
        """Inputs that are older than their time-out, in lower case."""
        return [
            name.lower()
            for name in INPUTS
            if self.value("BSTM_Status", f"{name}Stale") == 1
        ]


_EMPTY: Final = History()
E = TypeVar("E", bound="IntEnum")


def _choice(values: type[E], raw: float, missing: E, unknown: E) -> E:
    if isnan(raw):
        return missing
    return next((value for value in values if value == raw), unknown)

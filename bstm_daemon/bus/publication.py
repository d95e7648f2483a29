"""From one snapshot of the estimate to the frames that are due.

Nothing here sends, reads a clock or knows a socket: :class:`Publication`
turns a :class:`Snapshot` with its grid time into bytes. Its only state are
the counters of the end-to-end protection, which a restart takes over.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, isinf, nan
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.bus.e2e import COUNTER_COUNT, protect
from bstm_daemon.bus.output_layout import (
    ADVICE_SIGNALS,
    CAR_RISK_SIGNALS,
    FORECAST_SIGNALS,
    LAYOUT_VERSION,
    RISK_SIGNALS,
    STATUS_SIGNALS,
    TEMPERATURES_SIGNALS,
    WEAR_SIGNALS,
    Frame,
    HeatMode,
    RiskLevel,
    State,
    Validity,
    own_ids,
    published_frames,
)
from bstm_daemon.bus.publication_slow import (
    AdviceSnapshot,
    WearSnapshot,
    advice_raw,
    wear_raw,
)
from bstm_daemon.units import to_celsius

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from bstm_daemon.bus.output_layout import Signal

ELEVATED_MARGIN_K: Final = 40.0
"""The fluid estimate may be off by 30 K over a whole descent (thesis, section
1.3, reached in section 6) and vapour lock begins some K below the equilibrium
boiling point: from 40 K on, boiling is no longer excluded."""

HIGH_MARGIN_K: Final = 20.0
"""Two thermocouples in the same disc differ by up to 20 K (thesis, section
3.2): nearer than this, even a measurement would not rule boiling out."""

CRITICAL_MARGIN_K: Final = 0.0
"""The fluid has the temperature at which a wet fluid of its grade boils."""

LATER_S: Final = 1e9
"""What is later than a forecast reaches is sent as the end of the range."""

_STATUS: Final = {signal.name: signal for signal in STATUS_SIGNALS}
_TEMPERATURES: Final = {signal.name: signal for signal in TEMPERATURES_SIGNALS}
_RISK: Final = {signal.name: signal for signal in RISK_SIGNALS}
_FORECAST: Final = {signal.name: signal for signal in FORECAST_SIGNALS}
_CAR_RISK: Final = {signal.name: signal for signal in CAR_RISK_SIGNALS}


class OutputFrame(NamedTuple):
    """A frame ready to send."""

    can_id: int
    extended: bool
    data: bytes
    name: str


@dataclass(frozen=True, slots=True)
class RiskSnapshot:
    """Risk and forecast of a corner, probabilities 0 to 1, NaN if unknown.

    ``peak_in_s`` and ``safe_in_s`` count from the forecast, which is
    ``age_s`` old; infinite is later than the forecast reaches.
    """

    probability: float = nan
    level: RiskLevel = RiskLevel.UNKNOWN
    fade: RiskLevel = RiskLevel.UNKNOWN
    fluid_deviation_k: float = nan
    peak_k: float = nan
    peak_in_s: float = nan
    safe_in_s: float = nan
    duty_peak_k: float = nan
    age_s: float = nan


@dataclass(frozen=True, slots=True)
class CarRiskSnapshot:
    """Risk of the car, probabilities 0 to 1, NaN if unknown.

    ``boiling_low_k`` is the point that 1 % of such fluids boil below,
    ``boiling_k`` their median; ``water_percent`` the median of the water.
    """

    probability: float = nan
    probability_now: float = nan
    level: RiskLevel = RiskLevel.UNKNOWN
    boiling_k: float = nan
    boiling_low_k: float = nan
    water_percent: float = nan


@dataclass(frozen=True, slots=True)
class CornerSnapshot:
    """One corner: temperatures and boiling point in kelvin, NaN if unknown.

    ``margin_k`` is the wet boiling point minus the fluid temperature.
    Without ``risk`` the level is that of the margin.
    """

    disc_k: float = nan
    pad_front_k: float = nan
    pad_back_k: float = nan
    fluid_k: float = nan
    margin_k: float = nan
    wet_boiling_k: float = nan
    validity: Validity = Validity.NOT_AVAILABLE
    wear: WearSnapshot = field(default_factory=WearSnapshot)
    risk: RiskSnapshot | None = None


_NO_CORNER: Final = CornerSnapshot()


@dataclass(frozen=True, slots=True)
class StatusSnapshot:
    """The daemon itself. Counts are totals since the start.

    A ``*_stale`` flag says that an input of that kind, which the heat mode
    uses, is older than its time-out; ``input_suspect`` that something speaks
    against an input, used or not; ``heat_substituted`` that the heat of a
    corner is from the source that the heat mode does not name, or unknown;
    ``model_disagrees`` that estimates and measurements are further apart than
    a sound model's.
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


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Everything published at the grid time ``time_us`` (microseconds)."""

    time_us: int
    corners: Mapping[str, CornerSnapshot]
    status: StatusSnapshot = field(default_factory=StatusSnapshot)
    advice: AdviceSnapshot = field(default_factory=AdviceSnapshot)
    risk: CarRiskSnapshot | None = None


def corner_level(corner: CornerSnapshot, *, history_known: bool) -> RiskLevel:
    """Return the level of *corner*: of its risk, else of its margin."""
    if corner.risk is not None:
        return corner.risk.level
    return risk_level(
        corner.margin_k, corner.validity, history_known=history_known
    )


def risk_level(
    margin_k: float, validity: Validity, *, history_known: bool
) -> RiskLevel:
    """Return the level that belongs to *margin_k*.

    Unknown where the margin is no number and where the estimate is not valid
    or degraded. With an unknown history it is never normal: a car parked hot
    would be reported cold and safe, while a level that is raised all the same
    still holds, because an assumed cold start only underestimates.
    """
    usable = validity in (Validity.VALID, Validity.DEGRADED)
    if not usable or not isfinite(margin_k):
        return RiskLevel.UNKNOWN
    if margin_k <= CRITICAL_MARGIN_K:
        return RiskLevel.CRITICAL
    if margin_k <= HIGH_MARGIN_K:
        return RiskLevel.HIGH
    if margin_k <= ELEVATED_MARGIN_K:
        return RiskLevel.ELEVATED
    return RiskLevel.NORMAL if history_known else RiskLevel.UNKNOWN


class Publication:
    """The frames of one car; see ``docs/frames.md``."""

    def __init__(
        self,
        corner_names: Iterable[str],
        id_base: int,
        counters: Mapping[str, int] | None = None,
        modelled: Iterable[str] | None = None,
        *,
        requests: bool = False,
    ) -> None:
        """Publish *corner_names* from *id_base* on, continuing *counters*.

        *modelled* are those with a thermal model, by default all; a corner
        without one is sent as not available and says nothing of the status.
        ``BSTM_Advice`` is ours, but sent with *requests* only.
        *counters* holds the counter of the last frame sent by frame name, as
        :attr:`counters` gives it; frames it does not name start anew and
        frames it names that are not ours are forgotten. Raises
        :class:`~bstm_daemon.errors.ConfigError` where the ids do not fit
        into 11 bits and :class:`ValueError` for an unknown corner.
        """
        self._corners = frozenset(corner_names)
        self._modelled = self._corners & frozenset(
            self._corners if modelled is None else modelled
        )
        self._id_base = id_base
        self._frames = tuple(
            frame
            for frame in published_frames(self._corners)
            if requests or frame.signals is not ADVICE_SIGNALS
        )
        self.ids = own_ids(id_base, self._corners)
        self._counters: dict[str, int] = {}
        self.continue_from(counters or {})

    def continue_from(self, counters: Mapping[str, int]) -> None:
        """Go on behind *counters*, as :attr:`counters` gave them."""
        self._counters = {
            frame.name: counters.get(frame.name, -1) % COUNTER_COUNT
            for frame in self._frames
        }

    def stopping(
        self, heat_mode: HeatMode, *, compiled: bool
    ) -> list[OutputFrame]:
        """Return one last frame of each name: stopping, not available."""
        snapshot = Snapshot(
            0,
            {},
            StatusSnapshot(
                state=State.STOPPING,
                heat_mode=heat_mode,
                history_known=False,
                compiled_kernel=compiled,
                oldest_input_age_s=nan,
            ),
        )
        return [
            self._output(frame, self._raw(frame, snapshot))
            for frame in self._frames
        ]

    @property
    def counters(self) -> dict[str, int]:
        """The counter (0..15) last sent by frame name, for the state file."""
        return dict(self._counters)

    def due(self, time_us: int) -> tuple[str, ...]:
        """Return the names of the frames due at grid time *time_us*."""
        return tuple(
            frame.name for frame in self._frames if frame.is_due(time_us)
        )

    def encode(self, snapshot: Snapshot) -> list[OutputFrame]:
        """Return the frames due at the time of *snapshot*, lowest id first.

        Never raises for a value: NaN is sent as not available, an infinity
        as an error, what is out of range as the end of the range. A corner
        the snapshot does not hold is sent as not available.
        """
        return [
            self._output(frame, self._raw(frame, snapshot))
            for frame in self._frames
            if frame.is_due(snapshot.time_us)
        ]

    def _output(self, frame: Frame, raw: dict[str, int]) -> OutputFrame:
        counter = (self._counters[frame.name] + 1) % COUNTER_COUNT
        self._counters[frame.name] = counter
        return OutputFrame(
            can_id=self._id_base + frame.id_offset,
            extended=False,
            data=protect(frame.pack(raw), counter, frame.data_ids),
            name=frame.name,
        )

    def _raw(self, frame: Frame, snapshot: Snapshot) -> dict[str, int]:
        if frame.corner is not None:
            return _of_corner(
                frame.signals,
                snapshot.corners.get(frame.corner, _NO_CORNER),
                history_known=snapshot.status.history_known,
            )
        if frame.signals is ADVICE_SIGNALS:
            return advice_raw(snapshot.advice)
        if frame.signals is CAR_RISK_SIGNALS:
            return self._car_risk(snapshot)
        return self._status(snapshot)

    def _worst(self, snapshot: Snapshot) -> Validity:
        return max(
            (
                snapshot.corners.get(name, _NO_CORNER).validity
                for name in self._modelled
            ),
            default=Validity.NOT_AVAILABLE,
        )

    def _car_risk(self, snapshot: Snapshot) -> dict[str, int]:
        risk = snapshot.risk or CarRiskSnapshot()
        shown = {
            "Probability": 100.0 * risk.probability,
            "ProbabilityNow": 100.0 * risk.probability_now,
            "BoilingPoint": to_celsius(risk.boiling_k),
            "BoilingPointLow": to_celsius(risk.boiling_low_k),
            "Water": risk.water_percent,
        }
        return {
            "Validity": self._worst(snapshot),
            "Level": risk.level,
            **{name: _CAR_RISK[name].raw(v) for name, v in shown.items()},
        }

    def _status(self, snapshot: Snapshot) -> dict[str, int]:
        status = snapshot.status
        return {
            "Validity": self._worst(snapshot),
            "LayoutVersion": LAYOUT_VERSION,
            "State": status.state,
            "HeatMode": status.heat_mode,
            "CornersModelled": len(self._modelled),
            "HistoryKnown": status.history_known,
            "CompiledKernel": status.compiled_kernel,
            "OldestInputAge": _STATUS["OldestInputAge"].raw(
                status.oldest_input_age_s
            ),
            "SpeedStale": status.speed_stale,
            "PressureStale": status.pressure_stale,
            "AccelerationStale": status.acceleration_stale,
            "TorqueStale": status.torque_stale,
            "AmbientStale": status.ambient_stale,
            "ClockJump": status.clock_jump,
            "InputSuspect": status.input_suspect,
            "HeatSubstituted": status.heat_substituted,
            "RejectedFrames": _STATUS["RejectedFrames"].raw(
                status.rejected_frames
            ),
            "DroppedFrames": _STATUS["DroppedFrames"].raw(
                status.dropped_frames
            ),
            "ModelDisagrees": status.model_disagrees,
        }


def _of_corner(
    signals: tuple[Signal, ...], corner: CornerSnapshot, *, history_known: bool
) -> dict[str, int]:
    if signals is TEMPERATURES_SIGNALS:
        return _temperatures(corner)
    if signals is WEAR_SIGNALS:
        return wear_raw(corner.wear)
    if signals is FORECAST_SIGNALS:
        return _forecast(corner)
    return _risk(corner, history_known=history_known)


def _temperatures(corner: CornerSnapshot) -> dict[str, int]:
    return {
        "Validity": corner.validity,
        "Disc": _celsius("Disc", corner.disc_k),
        "PadFront": _celsius("PadFront", corner.pad_front_k),
        "PadBack": _celsius("PadBack", corner.pad_back_k),
        "Fluid": _celsius("Fluid", corner.fluid_k),
    }


def _celsius(name: str, temperature_k: float) -> int:
    return _TEMPERATURES[name].raw(to_celsius(temperature_k))


def _risk(corner: CornerSnapshot, *, history_known: bool) -> dict[str, int]:
    risk = corner.risk or RiskSnapshot()
    return {
        "Validity": corner.validity,
        "Margin": _RISK["Margin"].raw(corner.margin_k),
        "WetBoilingPoint": _RISK["WetBoilingPoint"].raw(
            to_celsius(corner.wet_boiling_k)
        ),
        "Probability": _RISK["Probability"].raw(100.0 * risk.probability),
        "Level": corner_level(corner, history_known=history_known),
        "FadeLevel": risk.fade,
    }


def _forecast(corner: CornerSnapshot) -> dict[str, int]:
    risk = corner.risk or RiskSnapshot()
    shown = {
        "Peak": to_celsius(risk.peak_k),
        "PeakIn": risk.peak_in_s,
        "SafeIn": _largest(risk.safe_in_s),
        "FluidDeviation": risk.fluid_deviation_k,
        "DutyPeak": to_celsius(risk.duty_peak_k),
        "Age": risk.age_s,
    }
    return {
        "Validity": corner.validity,
        **{name: _FORECAST[name].raw(value) for name, value in shown.items()},
    }


def _largest(seconds: float) -> float:
    """Return *seconds*; later than the forecast reaches is no error."""
    return LATER_S if isinf(seconds) else seconds

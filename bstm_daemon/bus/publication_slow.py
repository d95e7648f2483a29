"""The frames of wear and advice: snapshots and their raw values."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import Final

from bstm_daemon.bus.output_layout import (
    ADVICE_SIGNALS,
    WEAR_SIGNALS,
    Assist,
    Downshift,
    Intervention,
    Isolation,
    Message,
    Sound,
    Validity,
    WearLevel,
    WearSource,
)

_ADVICE: Final = {signal.name: signal for signal in ADVICE_SIGNALS}
_WEAR: Final = {signal.name: signal for signal in WEAR_SIGNALS}

_MM: Final = 1e3
_PER_KM: Final = 1e-3


@dataclass(frozen=True, slots=True)
class WearSnapshot:
    """Linings and disc of one corner; SI, NaN where unknown."""

    thickness_m: float = nan
    std_m: float = nan
    disc_loss_m: float = nan
    remaining_distance_m: float = nan
    source: WearSource = WearSource.NOT_AVAILABLE
    level: WearLevel = WearLevel.NOT_AVAILABLE
    validity: Validity = Validity.NOT_AVAILABLE


@dataclass(frozen=True, slots=True)
class AdviceSnapshot:
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


def wear_raw(wear: WearSnapshot) -> dict[str, int]:
    """Return the raw values of ``BSTM_<corner>_Wear``; never raises."""
    return {
        "Validity": wear.validity,
        "PadThickness": _WEAR["PadThickness"].raw(wear.thickness_m * _MM),
        "PadThicknessStd": _WEAR["PadThicknessStd"].raw(wear.std_m * _MM),
        "DiscLoss": _WEAR["DiscLoss"].raw(wear.disc_loss_m * _MM),
        "RemainingDistance": _WEAR["RemainingDistance"].raw(
            wear.remaining_distance_m * _PER_KM
        ),
        "Source": wear.source,
        "Level": wear.level,
    }


def advice_raw(advice: AdviceSnapshot) -> dict[str, int]:
    """Return the raw values of ``BSTM_Advice``; never raises."""
    return {
        "Validity": advice.validity,
        "Message": advice.message,
        "Sound": advice.sound,
        "ShiftAdvice": advice.shift_advice,
        "GearboxRequest": advice.gearbox_request,
        "FrontIsolation": advice.front_isolation,
        "EmergencyAssist": advice.emergency_assist,
        "Intervention": advice.intervention,
        "WaitingTime": _ADVICE["WaitingTime"].raw(advice.waiting_s),
        "PedalFeel": _ADVICE["PedalFeel"].raw(100.0 * advice.pedal_feel),
        "DetectorScore": _ADVICE["DetectorScore"].raw(
            100.0 * advice.detector_score
        ),
    }

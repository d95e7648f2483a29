"""One publication as a line of JSON; ``docs/connected.md`` has its fields.

Formed ten times a second on the thread of the live service: written, not
serialised. ``null`` is unknown, ``"beyond"`` a time beyond the forecast.
"""

from __future__ import annotations

import json
import re
from functools import cache, lru_cache
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.estimate import (
    NO_RISK,
    CarRisk,
    CornerEstimate,
    Estimate,
    Reason,
)
from bstm_daemon.units import to_celsius

if TYPE_CHECKING:
    from enum import IntEnum

    from bstm_daemon.config.sections import Config

SCHEMA: Final = "bstm.feed"
VERSION: Final = 1
"""Raised where a field changes its meaning or goes."""

_NO_NUMBER: Final = re.compile(r":-?(?:nan|inf)\b")
_NO_CAR_RISK: Final = CarRisk()


class RecordWriter:
    """Writes the estimates of one car as lines."""

    def __init__(self, config: Config) -> None:
        """Take the car's name and the linings' limits from *config*."""
        self._new_m: dict[str, float] = {
            corner.name: corner.pad.new_thickness_m or corner.pad.thickness_m
            for corner in config.corner
            if corner.pad is not None
        }
        self._limit_m = config.wear.limit_m
        self._head = (
            f'{{"schema":"{SCHEMA}","version":{VERSION},'
            f'"vehicle":{json.dumps(config.vehicle.id)},"seq":'
        )

    def line(self, estimate: Estimate, seq: int = 0) -> bytes:
        """Return *estimate* as a line with the number *seq*."""
        corners = ",".join(
            f'"{name}":{{{self._corner(name, corner)}}}'
            for name, corner in estimate.corners.items()
        )
        body = f'{_car(estimate)},"corners":{{{corners}}}}}\n'
        body = _NO_NUMBER.sub(":null", body.replace('_s":inf', '_s":"beyond"'))
        return f"{self._head}{seq},{body}".encode()

    def _corner(self, name: str, corner: CornerEstimate) -> str:
        risk, wear = corner.risk or NO_RISK, corner.wear
        worn = wear_percent(
            wear.thickness_m, self._new_m.get(name, nan), self._limit_m
        )
        peak_in_s = max(risk.peak_in_s - corner.forecast_age_s, 0.0)
        return (
            f'"validity":"{word(corner.validity)}",'
            f'"reasons":{_reasons(corner.reasons)},'
            f'"level":"{word(corner.level)}",'
            f'"sure_level":"{word(corner.sure_level)}",'
            f'"disc_c":{to_celsius(corner.disc_k):.1f},'
            f'"pad_front_c":{to_celsius(corner.pad_front_k):.1f},'
            f'"pad_back_c":{to_celsius(corner.pad_back_k):.1f},'
            f'"fluid_c":{to_celsius(corner.fluid_k):.1f},'
            f'"boiling_c":{to_celsius(corner.boiling_k):.1f},'
            f'"margin_k":{corner.margin_k:.1f},'
            f'"probability":{risk.probability:.4g},'
            f'"peak_c":{to_celsius(risk.peak_k):.1f},'
            f'"peak_in_s":{peak_in_s:.0f},'
            f'"waiting_s":{corner.waiting_s:.0f},'
            f'"fade":"{word(risk.fade)}",'
            f'"pad_mm":{1e3 * wear.thickness_m:.2f},'
            f'"pad_wear_percent":{worn:.1f},'
            f'"wear_level":"{word(wear.level)}",'
            f'"wear_validity":"{word(wear.validity)}"'
        )


def wear_percent(thickness_m: float, new_m: float, limit_m: float) -> float:
    """Return the wear [%] of a lining, 0 is new and 100 worn (COVESA VSS).

    Args:
        thickness_m: of the lining now [m].
        new_m: of a new one [m].
        limit_m: at which it is worn [m].

    Returns:
        NaN where one of them is unknown, or new pads are at the limit.
    """
    span_m = new_m - limit_m
    if not (isfinite(thickness_m) and span_m > 0.0):
        return nan
    return min(max(100.0 * (new_m - thickness_m) / span_m, 0.0), 100.0)


# typed: codes of two enumerations are equal numbers
@lru_cache(maxsize=None, typed=True)
def word(code: IntEnum) -> str:
    """Return the name of *code* as every line has it."""
    return code.name.lower()


@cache
def _reasons(reasons: Reason) -> str:
    return json.dumps(reasons.words)


def _car(estimate: Estimate) -> str:
    status, advice = estimate.status, estimate.advice
    risk = estimate.risk or _NO_CAR_RISK
    return (
        f'"time_s":{estimate.time_us * 1e-6:.1f},'
        f'"validity":"{word(estimate.validity)}",'
        f'"state":"{word(status.state)}",'
        f'"heat_mode":"{word(status.heat_mode)}",'
        f'"history_known":{json.dumps(status.history_known)},'
        f'"level":"{word(risk.level)}",'
        f'"probability":{risk.probability:.4g},'
        f'"boiling_low_c":{to_celsius(risk.boiling_low_k):.1f},'
        f'"advice":{{"validity":"{word(advice.validity)}",'
        f'"message":"{word(advice.message)}",'
        f'"sound":"{word(advice.sound)}",'
        f'"shift_advice":"{word(advice.shift_advice)}",'
        f'"emergency_assist":"{word(advice.emergency_assist)}",'
        f'"waiting_s":{advice.waiting_s:.0f}}}'
    )

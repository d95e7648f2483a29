"""One publication as a line of JSON; ``docs/connected.md`` has its fields.

Formed ten times a second on the thread of the live service: the numbers of a
corner are written by one format. ``null`` is unknown, ``"beyond"`` a time
beyond the forecast.
"""

from __future__ import annotations

import json
import re
from functools import cache, lru_cache
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.estimate import NO_RISK, CarRisk
from bstm_daemon.units import to_celsius

if TYPE_CHECKING:
    from enum import IntEnum

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimate import CornerEstimate, Estimate, Reason

SCHEMA: Final = "bstm.feed"
VERSION: Final = 1
"""Raised where a field changes its meaning or goes."""

_CORNER: Final = (
    '"%s":{"validity":"%s","reasons":%s,"level":"%s","sure_level":"%s",'
    '"disc_c":%.1f,"pad_front_c":%.1f,"pad_back_c":%.1f,"fluid_c":%.1f,'
    '"boiling_c":%.1f,"margin_k":%.1f,"probability":%.4g,'
    '"peak_c":%.1f,"peak_in_s":%.0f,"waiting_s":%.0f,"fade":"%s",'
    '"pad_mm":%.2f,"pad_wear_percent":%.1f,"wear_level":"%s",'
    '"wear_validity":"%s"}'
)
_CAR: Final = (
    '"time_s":%.1f,"validity":"%s","state":"%s","heat_mode":"%s",'
    '"history_known":%s,"level":"%s","probability":%.4g,"boiling_low_c":%.1f,'
    '"advice":{"validity":"%s","message":"%s","sound":"%s",'
    '"shift_advice":"%s","emergency_assist":"%s","waiting_s":%.0f}'
)
_NO_NUMBER: Final = re.compile(r":-?(?:nan|inf)\b")
_NO_CAR_RISK: Final = CarRisk()


class RecordWriter:
    """Writes the estimates of one car as lines."""

    def __init__(self, config: Config) -> None:
        """Take the car's name and the linings' limits from *config*."""
        self._linings: dict[str, tuple[float, float]] = {
            corner.name: (
                corner.pad.new_thickness_m or corner.pad.thickness_m,
                config.wear.limit_m,
            )
            for corner in config.corner
            if corner.pad is not None
        }
        self._head = (
            f'{{"schema":"{SCHEMA}","version":{VERSION},'
            f'"vehicle":{json.dumps(config.vehicle.id)},"seq":'
        )

    def line(self, estimate: Estimate, seq: int = 0) -> bytes:
        """Return *estimate* as a line with the number *seq*."""
        corners = ",".join(
            self._corner(name, corner)
            for name, corner in estimate.corners.items()
        )
        body = f'{_car(estimate)},"corners":{{{corners}}}}}\n'
        body = _NO_NUMBER.sub(":null", body.replace('_s":inf', '_s":"beyond"'))
        return f"{self._head}{seq},{body}".encode()

    def _corner(self, name: str, corner: CornerEstimate) -> str:
        risk = corner.risk or NO_RISK
        wear = corner.wear
        return _CORNER % (
            name,
            word(corner.validity),
            _reasons(corner.reasons),
            word(corner.level),
            word(corner.sure_level),
            to_celsius(corner.disc_k),
            to_celsius(corner.pad_front_k),
            to_celsius(corner.pad_back_k),
            to_celsius(corner.fluid_k),
            to_celsius(corner.boiling_k),
            corner.margin_k,
            risk.probability,
            to_celsius(risk.peak_k),
            max(risk.peak_in_s - corner.forecast_age_s, 0.0),
            corner.waiting_s,
            word(risk.fade),
            1e3 * wear.thickness_m,
            wear_percent(wear.thickness_m, *self._linings.get(name, _NONE)),
            word(wear.level),
            word(wear.validity),
        )


_NONE: Final = (nan, nan)


def wear_percent(thickness_m: float, new_m: float, limit_m: float) -> float:
    """Return the wear of a lining [%]: 0 is new, 100 worn (COVESA VSS).

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
    return _CAR % (
        estimate.time_us * 1e-6,
        word(estimate.validity),
        word(status.state),
        word(status.heat_mode),
        "true" if status.history_known else "false",
        word(risk.level),
        risk.probability,
        to_celsius(risk.boiling_low_k),
        word(advice.validity),
        word(advice.message),
        word(advice.sound),
        word(advice.shift_advice),
        word(advice.emergency_assist),
        advice.waiting_s,
    )

"""From a publication of the estimator to what wear and advice are told by.

The level of risk is that of the risk frame: of the forecast, and without one
of the margin.
"""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.advice.conditions import Conditions, CornerCondition
from bstm_daemon.bus.output_layout import Validity, WearLevel, WearSource
from bstm_daemon.bus.publication import RiskSnapshot, corner_level
from bstm_daemon.bus.publication_slow import WearSnapshot
from bstm_daemon.heat.sample_plan import (
    CHANNELS,
    CORNER_PRESSURE,
    FLAGS,
    VEHICLE_CHANNELS,
)
from bstm_daemon.wear.dose import DISTANCE, DOSE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.bus.publication import CornerSnapshot
    from bstm_daemon.estimator import Block
    from bstm_daemon.wear.car import CarWear

_POWER: Final = CHANNELS.index("brake_power_w")
_PRESSURE: Final = CHANNELS.index("pressure_pa")
_SPEED: Final = VEHICLE_CHANNELS.index("speed_ms")


def wear_of(
    wear: CarWear,
    name: str,
    block: Block,
    i: int,
    state: Mapping[str, float],
) -> WearSnapshot:
    """Return the linings and disc of *name* at publication *i* of *block*.

    Degraded while they rest on the configuration alone.
    """
    law = next(law for begin, law in reversed(block.wear[name]) if begin <= i)
    found = wear.estimate(name, law, state[DOSE], state[DISTANCE])
    source = WearSource(found.source)
    known = source is not WearSource.CONFIGURED
    return WearSnapshot(
        found.thickness_m,
        found.std_m,
        found.disc_loss_m,
        found.remaining_distance_m,
        source,
        WearLevel(found.level),
        Validity.VALID if known else Validity.DEGRADED,
    )


def conditions_of(
    block: Block,
    i: int,
    corners: Mapping[str, CornerSnapshot],
    names: Sequence[str],
    driver: Mapping[str, float],
    *,
    history_known: bool,
) -> Conditions:
    """Return what advice is given by at publication *i* of *block*.

    Args:
        block: contiguous publications.
        i: one of them.
        corners: the corners with a thermal model then.
        names: all corners in the order of the block's rows.
        driver: fresh values of the driver's roles.
        history_known: whether the start no longer matters.
    """
    rows = {
        name: (i * len(names) + place) * len(CHANNELS)
        for place, name in enumerate(names)
    }
    missing = bool(block.flags[i] & FLAGS["speed_missing"])
    speed_ms = block.vehicle[i * len(VEHICLE_CHANNELS) + _SPEED]
    return Conditions(
        block.times_us[i],
        {
            name: _condition(corner, history_known=history_known)
            for name, corner in corners.items()
        },
        nan if missing else speed_ms,
        sum(block.rows[first + _POWER] for first in rows.values()),
        {
            # the model takes one that is missing as 0; advice must not
            name: nan
            if block.flags[i] & CORNER_PRESSURE << place
            else block.rows[first + _PRESSURE]
            for place, (name, first) in enumerate(rows.items())
        },
        driver,
    )


def _condition(
    corner: CornerSnapshot, *, history_known: bool
) -> CornerCondition:
    """Return how *corner* stands; the wait counts from now."""
    risk = corner.risk or RiskSnapshot()
    return CornerCondition(
        level=corner_level(corner, history_known=history_known),
        probability=risk.probability,
        # nan stays nan
        time_until_safe_s=max(risk.safe_in_s - risk.age_s, 0.0),
        fluid_k=corner.fluid_k,
        fluid_std_k=risk.fluid_deviation_k,
        worst_boiling_k=corner.wet_boiling_k,
        validity=corner.validity,
    )

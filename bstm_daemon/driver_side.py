"""From a publication of the estimator to what wear and advice are told by.

The level of risk is that of the margin, as the risk frame has it.
"""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.advice.conditions import Conditions, CornerCondition
from bstm_daemon.bus.output_layout import Validity, WearLevel, WearSource
from bstm_daemon.bus.publication import risk_level
from bstm_daemon.bus.publication_slow import WearSnapshot
from bstm_daemon.heat.sample_plan import CHANNELS, FLAGS, VEHICLE_CHANNELS
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
            name: CornerCondition(
                level=risk_level(
                    corner.margin_k,
                    corner.validity,
                    history_known=history_known,
                ),
                fluid_k=corner.fluid_k,
                worst_boiling_k=corner.wet_boiling_k,
                validity=corner.validity,
            )
            for name, corner in corners.items()
        },
        nan if missing else speed_ms,
        sum(block.rows[first + _POWER] for first in rows.values()),
        {name: block.rows[first + _PRESSURE] for name, first in rows.items()},
        driver,
    )

"""Estimates of the corners at one publication of a block."""

from math import nan

from bstm_daemon.estimate import NO_WEAR, CarRisk, CornerEstimate, WearEstimate
from bstm_daemon.estimator.blocks import Instant, reasons_of, validity_of
from bstm_daemon.model.risk.levels import (
    level_of_margin,
    published_level,
    sure_level,
)
from bstm_daemon.model.wear.car import CarWear
from bstm_daemon.model.wear.dose import DISTANCE, DOSE


def corner_estimates(
    instant: Instant,
    boiling_k: float,
    risk: CarRisk | None,
    wear: CarWear | None = None,
) -> dict[str, CornerEstimate]:
    """Return the estimates of the corners with a thermal model.

    Args:
        instant: the publication.
        boiling_k: boiling point [K] of a wet fluid of the grade.
        risk: of the car then; None without a forecast.
        wear: what holds the wear of the car; None leaves wear out.
    """
    age_s = nan if risk is None else risk.age_s(instant.time_us)
    found = {}
    block, i = instant
    # the indices of blocks.Instant: a replay makes 144 000 an hour
    for name, (number, stride, places) in block.layout.looked_up.items():
        output, first = block.outputs[number], i * stride
        disc, front, back, fluid = places
        fluid_k = output[first + fluid]
        validity = validity_of(block.validity[name][i])
        corner_risk = None if risk is None else risk.corners[name]
        if corner_risk is not None:
            level, sure = corner_risk.level, corner_risk.sure_level
        else:
            least, level = (
                published_level(level_of_margin(boiling_k - kelvin), validity)
                for kelvin in (
                    fluid_k,
                    instant.state(name, hottest=True)["fluid"],
                )
            )
            sure = sure_level(least, level)
        found[name] = CornerEstimate(
            output[first + disc],
            output[first + front],
            output[first + back],
            fluid_k,
            boiling_k,
            validity,
            reasons_of(block.reasons[name][i]),
            level,
            sure,
            corner_risk,
            age_s,
            NO_WEAR if wear is None else _wear(wear, instant, name),
        )
    return found


def _wear(wear: CarWear, instant: Instant, name: str) -> WearEstimate:
    laws, state = instant.block.wear[name], instant.state(name)
    law = next(law for begin, law in reversed(laws) if begin <= instant.i)
    return wear.estimate(name, law, state[DOSE], state[DISTANCE])

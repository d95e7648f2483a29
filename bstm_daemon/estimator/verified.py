"""Which inputs of a heat mode are checked, and by which mapped roles.

An input is *verified* where a check of its own finds it reading zero, half or
frozen: :mod:`bstm_daemon.model.heat.checks` and the observer compare it with
other inputs, :class:`~bstm_daemon.estimator.trust.Trust` and
:class:`~bstm_daemon.estimator.model_check.ModelCheck` the heat and the
temperatures that follow. What no mapped role can contradict is *unverified*,
and with it every corner that goes by it. So is the fluid of a corner that was
not matched, or without its temperature: what leads to it has typical values.
"""

from collections.abc import Collection
from functools import reduce
from operator import or_
from typing import Final, NamedTuple

from bstm_daemon.channels import FLAGS
from bstm_daemon.config.sections import Config
from bstm_daemon.estimate import NO_INPUT, Input
from bstm_daemon.roles import CORNERS, MEASURED_NODES, ROLES

_SPEEDS: Final = (
    "vehicle_speed",
    *(f"wheel_speed_{name.lower()}" for name in CORNERS),
)
_PRESSURES: Final = (
    *("primary_pressure", "secondary_pressure"),
    *(f"wheel_pressure_{name.lower()}" for name in CORNERS),
)
_ACCELERATION: Final = "acceleration_longitudinal"
_TORQUE: Final = "powertrain_torque"
_COMPARED: Final = tuple(node for node in MEASURED_NODES if node != "caliper")
"""Thermocouples whose node every thermal structure has."""

_USED: Final = {
    "ff": ("speed", "pressure", "ambient"),
    "fb": ("speed", "pressure", "acceleration", "torque", "ambient"),
    "fused": ("speed", "pressure", "acceleration", "torque", "ambient"),
    "measured": ("speed", "ambient"),
}
"""Inputs by heat mode: only these are reported stale."""

_OPTIONAL: Final = {
    "pressure": _PRESSURES,
    "acceleration": (_ACCELERATION,),
    "torque": (_TORQUE,),
    "ambient": ("ambient_temperature",),
}
"""One without a mapped role is not stale."""


class Check(NamedTuple):
    """What verifies an input.

    ``modes`` are the heat modes in which it is made; it needs so many of each
    group of roles. ``words`` say what the input is compared with.
    """

    of: Input
    words: str
    modes: tuple[str, ...]
    needs: tuple[tuple[int, tuple[str, ...]], ...] = ()


CHECKS: Final = (
    # one sensor by the others, a fault of all of them by the acceleration
    Check(
        Input.SPEED,
        "other speeds and acceleration",
        ("ff", "fb", "fused"),
        ((2, _SPEEDS), (1, (_ACCELERATION,))),
    ),
    # in ff and fb a pressure that reads zero ends Feed-Back too
    Check(Input.PRESSURE, "motion and torque", ("fused",), ((1, (_TORQUE,)),)),
    Check(Input.ACCELERATION, "changes of speed", ("fused",)),
    Check(
        Input.ACCELERATION,
        "pressure",
        ("fb",),
        ((1, _PRESSURES), (1, (_TORQUE,))),
    ),
    Check(Input.TORQUE, "pressure and motion", ("fused",)),
    Check(
        Input.TORQUE,
        "pressure",
        ("fb",),
        ((1, _PRESSURES), (1, (_ACCELERATION,))),
    ),
)
"""All checks that verify an input of a heat mode. A thermocouple does not:
what a sound model may be off by hides a tenth of the heat."""

NOTHING: Final = "nothing: unverified, its corners are degraded"
THERMOCOUPLES: Final = "measured temperatures"
MATCH: Final = "its match"
MATCH_ALIKE: Final = "the match of a corner like it"
STATED: Final = "[forecast] uncertainty"


def inputs_of(config: Config, roles: Collection[str]) -> tuple[Input, ...]:
    """Return the inputs that the heat mode of *config* goes by.

    Args:
        config: the vehicle.
        roles: names of the mapped roles.
    """
    mode = config.heat.mode
    if mode == "measured":
        return (Input.TEMPERATURE,)
    found = [Input.SPEED]
    if mode != "fb" or any(role in roles for role in _PRESSURES):
        found.append(Input.PRESSURE)
    if mode in {"fb", "fused"}:
        if config.heat.slope == "accelerometer" and _ACCELERATION in roles:
            found.append(Input.ACCELERATION)
        if _TORQUE in roles:
            found.append(Input.TORQUE)
    return tuple(found)


def verified_by(
    config: Config, roles: Collection[str], corner: str
) -> dict[Input, tuple[str, ...]]:
    """Return what verifies each input of the heat mode at *corner*, in words.

    And what verifies its fluid: the values that lead to it are its own.

    Args:
        config: the vehicle.
        roles: names of the mapped roles.
        corner: its name.
    """
    mode = config.heat.mode
    # without the slope, fusion forms nothing from the motion
    blind = mode == "fused" and config.heat.slope != "accelerometer"
    found = {
        one: tuple(
            check.words
            for check in CHECKS
            if check.of is one
            and mode in check.modes
            and not blind
            and all(
                sum(role in roles for role in group) >= least
                for least, group in check.needs
            )
        )
        for one in inputs_of(config, roles)
    }
    if mode == "measured" and _is_compared(roles, corner):
        found[Input.TEMPERATURE] = (THERMOCOUPLES,)
    seen = f"temp_{corner.lower()}_fluid" in roles
    found[Input.FLUID] = _known_by(config, corner) + (THERMOCOUPLES,) * seen
    return found


def _known_by(config: Config, corner: str) -> tuple[str, ...]:
    """Return what knows the way of the heat to the fluid of *corner*."""
    one = config.source_of(corner)
    if one is None:
        return (STATED,) * (config.forecast.uncertainty is not None)
    match = MATCH if corner in one.corners else MATCH_ALIKE
    return (match,) * one.knows_fluid


def _is_compared(roles: Collection[str], corner: str) -> bool:
    """Return whether the model of *corner* is compared below its disc."""
    # it is held at the first of the disc
    return any(
        f"temp_{corner.lower()}_{node}" in roles
        for node in _COMPARED
        if node != "disc"
    )


def unverified_inputs(
    config: Config, present: Collection[int]
) -> dict[str, Input]:
    """Return the inputs that nothing verifies, by the corner they heat.

    Args:
        config: the vehicle.
        present: numbers of the mapped roles.
    """
    roles = {ROLES[number].name for number in present}
    found: dict[str, Input] = {}
    for corner in config.corner:
        found[corner.name] = NO_INPUT
        for one, by in verified_by(config, roles, corner.name).items():
            if not by:
                found[corner.name] |= one
    return found


def unverified_of_car(config: Config, present: Collection[int]) -> Input:
    """Return the inputs that nothing verifies at any corner with a model.

    Args:
        config: the vehicle.
        present: numbers of the mapped roles.
    """
    by_corner = unverified_inputs(config, present)
    modelled = (by_corner[one.name] for one in config.disc_corners())
    return reduce(or_, modelled, NO_INPUT)


def verification_table(
    config: Config, roles: Collection[str]
) -> list[tuple[str, str, str]]:
    """Return rows of input, corners, and what verifies it there.

    Args:
        config: the vehicle.
        roles: names of the mapped roles.
    """
    alike: dict[tuple[Input, tuple[str, ...]], list[str]] = {}
    for corner in config.disc_corners():
        for item in verified_by(config, roles, corner.name).items():
            alike.setdefault(item, []).append(corner.name)
    return [
        (one.words[0], " ".join(names), "; ".join(by) or NOTHING)
        for (one, by), names in sorted(
            alike.items(), key=lambda item: item[0][0]
        )
    ]


def stale_flags_of_car(
    config: Config, present: Collection[int]
) -> dict[str, int]:
    """Return the bit of each input that is stale when it is missing.

    Args:
        config: the vehicle.
        present: numbers of the mapped roles.
    """
    roles = {ROLES[number].name for number in present}
    return {
        name: FLAGS[f"{name}_missing"]
        for name in _USED[config.heat.mode]
        if name not in _OPTIONAL or not roles.isdisjoint(_OPTIONAL[name])
    }

"""What an estimate needs, corner by corner, to be valid.

An estimate is *valid* where no :class:`~bstm_daemon.estimate.Reason` speaks
against it; *invalid* where its heat has been unknown for too long, or it is
no temperature of a brake; else *degraded*. ``docs/validity.md`` has the
reasons in a table.
"""

from array import array
from collections.abc import Mapping, MutableSequence, Sequence
from functools import reduce
from math import inf, isfinite, isnan
from operator import or_
from typing import Final, NamedTuple

from bstm_daemon.channels import (
    CORNER_PRESSURE,
    CORNER_PRESSURE_SUSPECT,
    FLAGS,
    HEAT_LOST,
    HEAT_UNCERTAIN,
    WHEEL_SUSPECT,
)
from bstm_daemon.config.sections import Config
from bstm_daemon.estimate import Reason, Validity
from bstm_daemon.estimator.blocks import Block, Instant
from bstm_daemon.estimator.model_check import ModelCheck
from bstm_daemon.estimator.trust import Trust
from bstm_daemon.estimator.verified import unverified_inputs
from bstm_daemon.model.thermal.properties import DISC_LIMIT_C
from bstm_daemon.roles import ROLE_INDEX, ROLES
from bstm_daemon.units import KELVIN_OFFSET

LOWEST_K: Final = 200.0
HIGHEST_K: Final = 1800.0
"""An estimate outside can not be true: below any ambient, above iron's
melting point."""

AMBIENT_S: Final = 3 * 3600.0
"""Air whose temperature nobody measures may be 10 K warmer after that long:
a clear morning warms it by 3 K/h. The fluid follows later."""


_MOTION: Final = (
    ("acceleration_longitudinal", "acceleration"),
    ("powertrain_torque", "torque"),
)
_OBSERVED: Final = ("acceleration_scale", "wheel_radius", "pressure_dead")
"""What the observer of the car finds against an input."""


_SURE: Final = FLAGS["pressure_contradicts"] | FLAGS["ambient_suspect"]
"""Whatever the heat mode: pressure also says when the motion brakes, and all
temperatures are above the ambient's."""


_UNPROVEN: Final = FLAGS["speed_unproven"] | FLAGS["forces_unproven"]
"""Checks of the motion that had no occasion yet."""

_UNCHECKED_K: Final = DISC_LIMIT_C + KELVIN_OFFSET


class Needs(NamedTuple):
    """What a corner needs.

    Bits of a step's flags: those of an input that is missing, those that
    speak against one now, and those among them that speak against the heat,
    which the brake remembers; whether its heat was unknown, and for too
    long; whether nothing proved it. Whether its disc must be measured, whether
    an input that it goes by is unverified, and from which temperature of the
    disc [K] on the model is.
    """

    missing: int
    suspect: int
    remembered: int
    uncertain: int
    lost: int
    unproven: int
    measured: bool
    unverified: bool
    unchecked_k: float

    @property
    def any_flag(self) -> int:
        """All the bits."""
        return self.missing | self.suspect | self.uncertain | self.lost


def needs_of_corners(
    config: Config, present: Mapping[int, int]
) -> dict[str, Needs]:
    """Return what each corner of *config* needs, by its name.

    Args:
        config: the vehicle.
        present: role number to timeout [us] of each mapped role; an input
            that nothing is mapped to is not waited for.
    """
    found: dict[str, Needs] = {}
    unverified = unverified_inputs(config, present)
    for place, corner in enumerate(config.corner):
        remembered = _remembered(config, present, place)
        measured = config.heat.mode == "measured"
        found[corner.name] = Needs(
            missing=_missing(config, present, place),
            suspect=_pressure(config, place) | remembered,
            remembered=remembered,
            uncertain=HEAT_UNCERTAIN << place | FLAGS["driven_unseen"],
            lost=HEAT_LOST << place,
            unproven=_UNPROVEN if config.heat.mode == "fused" else 0,
            measured=measured,
            unverified=bool(unverified[corner.name]),
            unchecked_k=inf if measured else _UNCHECKED_K,
        )
    return found


# the value of a flag is looked up slowly
_UNVERIFIED: Final = Reason.UNVERIFIED.value
_START_UNKNOWN: Final = Reason.START_UNKNOWN.value
_INPUT_MISSING: Final = Reason.INPUT_MISSING.value
_INPUT_SUSPECT: Final = Reason.INPUT_SUSPECT.value
_AMBIENT: Final = Reason.AMBIENT.value
_HEAT_UNKNOWN: Final = Reason.HEAT_UNKNOWN.value
_MODEL_DISAGREES: Final = Reason.MODEL_DISAGREES.value
_IMPOSSIBLE: Final = Reason.IMPOSSIBLE.value


def judge(
    block: Block,
    needs: Mapping[str, Needs],
    checks: tuple[Trust, Trust, ModelCheck],
    step_s: float,
) -> None:
    """Fill in validity and reasons of *block*.

    Args:
        block: of the next publications.
        needs: what each corner needs, by its name.
        checks: what remembers findings against the heat, heat that nothing
            proved, and findings against the estimates.
        step_s: time between two publications [s].
    """
    trust, unproven, model_check = checks
    of_car = trust.findings(block, step_s)
    strong = model_check.findings(block)
    anything = any(of_car) or any(strong) or model_check.remembers
    all_flags = reduce(or_, block.flags, 0)
    for name, (number, place, stride, group) in block.layout.modelled.items():
        output = block.outputs[number]
        need = needs[name]
        heeded = need.any_flag
        # a column of each node: one look at each instead of one a publication
        columns = [output[place + k :: stride] for k in range(group.nodes)]
        all_possible = bool(block.flags) and all(map(_is_possible, columns))
        discs = columns[group.state_names.index("disc")]
        is_hot = max(discs, default=0.0) > need.unchecked_k
        unknown = min(block.known_from[name], len(block.flags))
        always = _UNVERIFIED if need.unverified else 0
        reasons = array("B", [always | _START_UNKNOWN] * unknown)
        reasons.extend([always] * (len(block.flags) - unknown))
        if (
            anything
            or not all_possible
            or is_hot
            or all_flags & (heeded | need.unproven)
            or need.measured
            or trust.remembers(name)
            or unproven.remembers(name)
        ):
            for i, flags in enumerate(block.flags):
                if trust.holds(
                    name,
                    step_s,
                    found=of_car[i] or flags & need.remembered != 0,
                ):
                    reasons[i] |= _INPUT_SUSPECT
                unchecked = is_hot and discs[i] > need.unchecked_k
                if unproven.holds(
                    name, step_s, found=unchecked or flags & need.unproven != 0
                ):
                    reasons[i] |= _UNVERIFIED
                if model_check.holds(name, step_s, found=name in strong[i]):
                    reasons[i] |= _MODEL_DISAGREES
                if not all_possible and not _is_possible(
                    [column[i] for column in columns]
                ):
                    reasons[i] |= _IMPOSSIBLE
                if flags & heeded or need.measured:
                    reasons[i] |= _of_inputs(block.at(i), name, need)
        block.reasons[name] = reasons
        codes = array("b", reasons.tobytes().translate(_BY_REASONS))
        if all_flags & need.lost:
            _invalidate(codes, need.lost, block.flags)
        block.validity[name] = codes


def _invalidate(
    codes: MutableSequence[int], lost: int, all_flags: Sequence[int]
) -> None:
    for i, flags in enumerate(all_flags):
        if flags & lost:
            codes[i] = Validity.INVALID


def _validity(why: int) -> Validity:
    """Return the validity by reasons alone."""
    if why & _IMPOSSIBLE:
        return Validity.INVALID
    return Validity.DEGRADED if why else Validity.VALID


_BY_REASONS: Final = bytes(map(_validity, range(256)))


def _is_possible(kelvins: Sequence[float]) -> bool:
    """Whether all *kelvins* are temperatures that a brake has."""
    # a nan would be sorted anywhere; the first and the last of a sorted list
    # are found quicker than by min and max
    if not isfinite(sum(kelvins)):
        return False
    ordered = sorted(kelvins)
    return ordered[0] > LOWEST_K and ordered[-1] < HIGHEST_K


def _of_inputs(now: Instant, corner: str, need: Needs) -> int:
    """Return the reasons of inputs that are missing or suspect now."""
    flags = now.flags
    why = _INPUT_SUSPECT if flags & need.suspect else 0
    if flags & (need.uncertain | need.lost):
        why |= _HEAT_UNKNOWN
    sleeps = flags & FLAGS["asleep"]
    if (flags & need.missing and not sleeps) or (
        need.measured and isnan(now.channel(corner, "measured_disc_k"))
    ):
        return why | _INPUT_MISSING
    if flags & need.missing or need.measured:
        is_old = sleeps and now.vehicle("input_age_s") > AMBIENT_S
        return why | _AMBIENT if is_old else why
    return why


def _missing(config: Config, present: Mapping[int, int], place: int) -> int:
    flags = FLAGS["speed_missing"]
    if config.heat.mode != "fb":
        return flags | CORNER_PRESSURE << place
    for role, name in _MOTION:
        if ROLE_INDEX[role] in present:
            flags |= FLAGS[f"{name}_missing"]
    return flags


def _pressure(config: Config, place: int) -> int:
    """Return the bit of a suspect pressure, where the heat comes from it."""
    return 0 if config.heat.mode == "fb" else CORNER_PRESSURE_SUSPECT << place


def _remembered(config: Config, present: Mapping[int, int], place: int) -> int:
    flags, mode = FLAGS["speed_suspect"] | _SURE, config.heat.mode
    if mode in {"fb", "fused"}:
        for role, name in _MOTION:
            if ROLE_INDEX[role] in present:
                flags |= FLAGS[f"{name}_suspect"]
    if mode == "fb":
        # where a pressure says when the brakes are on, no switch does
        pressed = any("pressure" in ROLES[n].quantities for n in present)
        return flags if pressed else flags | FLAGS["switch_contradicts"]
    flags |= WHEEL_SUSPECT << place
    if mode == "measured":
        flags |= FLAGS["temperature_suspect"]
    if mode == "fused":
        # whether the pressure was wrong is known by the work it explains
        for name in _OBSERVED:
            flags |= FLAGS[name]
    else:
        flags |= _pressure(config, place)
    return flags

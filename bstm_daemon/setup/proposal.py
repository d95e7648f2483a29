"""Clues and a recording put together: which signal plays which role.

A sure role has one signal whose name and unit fit and whose behaviour, where
a recording is there, does not speak against it. Everything else that was
suspected is kept as unsure, with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.setup.behaviour import (
    Motion,
    Verdict,
    spread,
    to_ms,
    to_si,
)
from bstm_daemon.setup.clues import clues_of
from bstm_daemon.setup.pressure_unit import assumed_unit
from bstm_daemon.units import UNITS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cantools.database.can import Database

    from bstm_daemon.setup.clues import Clue
    from bstm_daemon.setup.recording import Recording, Samples

TYPICAL_RADIUS_M: Final = 0.32
"""Rolling radius of a passenger car's wheel; enters comparisons only."""

_SPEEDS: Final = ("wheel_speed_", "vehicle_speed")
_PRESSURES: Final = ("primary_pressure", "secondary_pressure", "wheel_pres")
_GUESSED_UNIT: Final = {"primary_pressure": "bar", "secondary_pressure": "bar"}
_PROVABLE: Final = ("primary_pressure", "wheel_pressure_")
"""A secondary pressure needs corners that use it, which no log shows."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A signal for a role: unit, correction, and why (not).

    ``unread`` says why the daemon refuses the frames although the role is
    right, "" where it does not.
    """

    clue: Clue
    unit: str
    sure: bool
    reason: str
    sign: int = 1
    scale: float = 1.0
    rate_hz: float = 0.0
    unread: str = ""

    @property
    def role(self) -> str:
        """The role's name."""
        return self.clue.role


@dataclass(frozen=True, slots=True)
class Proposal:
    """The outcome: at most one sure candidate a role, and the others."""

    sure: tuple[Candidate, ...]
    unsure: tuple[Candidate, ...]

    def roles(self) -> frozenset[str]:
        """Return the names of the sure roles."""
        return frozenset(one.role for one in self.sure)

    def ready(self, role: str) -> bool:
        """Whether *role* is sure and the daemon reads its frames."""
        return any(one.role == role and not one.unread for one in self.sure)


def propose(database: Database, recording: Recording | None) -> Proposal:
    """Propose a signal of *database* for each role that one fits."""
    clues = clues_of(database)
    motion = _motion(clues, recording) if recording else None
    judged = [_judged(clue, recording, motion) for clue in clues]
    best: dict[str, Candidate] = {}
    owners: dict[tuple[int, bool], str] = {}
    for one in sorted(judged, key=_rank):
        message = one.clue.message
        key = message.frame_id, message.is_extended_frame
        # an id that two messages have can be read as one of them only
        if (
            one.role not in best
            and owners.get(key, message.name) == message.name
        ):
            best[one.role] = _beside(one, judged)
            if one.sure:
                owners[key] = message.name
    sure = [one for one in best.values() if one.sure]
    taken = {_source(one) for one in sure}
    unsure = [
        one
        for one in judged
        if _source(one) not in taken
        and (one.role not in best or not best[one.role].sure)
    ]
    return Proposal(
        tuple(sorted(sure, key=_place)), tuple(sorted(unsure, key=_place))
    )


def _beside(best: Candidate, judged: Iterable[Candidate]) -> Candidate:
    """Say in the reason which other signals fit as well."""
    others = [
        ".".join(_source(one))
        for one in judged
        if one.role == best.role and one.sure and _source(one) != _source(best)
    ]
    if not others or not best.sure:
        return best
    return replace(best, reason=f"{best.reason}; also {', '.join(others)}")


def _motion(clues: Iterable[Clue], recording: Recording) -> Motion:
    """Return the car's motion from all wheel and vehicle speeds.

    Angular speeds have a say only where there is no other.
    """
    speeds: dict[str, Samples] = {}
    angular: dict[str, Samples] = {}
    for clue in clues:
        found = recording.samples.get(_name(clue))
        if found is None or not clue.unit or not _is_speed(clue):
            continue
        is_angular = UNITS[clue.unit].quantity == "angular_speed"
        target = angular if is_angular else speeds
        name = ".".join(_name(clue))
        target[name] = to_ms(found, clue.unit, TYPICAL_RADIUS_M)
    moved = [one for one in speeds.values() if one.value.max(initial=0.0) > 0]
    return Motion(speeds if moved else {**speeds, **angular})


def _judged(
    clue: Clue, recording: Recording | None, motion: Motion | None
) -> Candidate:
    guessed = _GUESSED_UNIT.get(clue.role, "")
    unit = clue.unit or guessed
    if recording is None or motion is None:
        reason = clue.doubt or "by name and unit only, no log was given"
        sure = not clue.doubt and bool(clue.unit)
        return Candidate(clue, unit, sure, reason)
    found = recording.samples.get(_name(clue))
    if found is None:
        reasons = [clue.doubt, "its frame is not in the log"]
        return Candidate(clue, unit, sure=False, reason=_joined(reasons))
    verdict = _verdict(clue, found, motion)
    unread = ""
    if clue.message.name in recording.lengths:
        unread = (
            f"its frames have {recording.lengths[clue.message.name]} bytes, "
            f"the DBC says {clue.message.length}: refused until the DBC says "
            "the same"
        )
    sure = not clue.doubt and bool(clue.unit)
    reasons = [clue.doubt, verdict.reason]
    if not clue.unit and clue.role.startswith(_PROVABLE):
        assumed = assumed_unit(motion, found)
        if assumed is not None:
            unit, sure = assumed.unit, True
            reasons.append(assumed.reason)
    return Candidate(
        clue,
        unit,
        sure=verdict.fits and sure,
        reason=_joined(reasons),
        sign=verdict.sign,
        scale=verdict.scale,
        rate_hz=found.rate_hz,
        unread=unread,
    )


def _verdict(clue: Clue, samples: Samples, motion: Motion) -> Verdict:
    if clue.role.startswith(_PRESSURES):
        return motion.pressure_verdict(samples)
    if clue.unit and _is_speed(clue):
        speed = to_ms(samples, clue.unit, TYPICAL_RADIUS_M)
        verdict = motion.speed_verdict(speed)
        if UNITS[clue.unit].quantity == "angular_speed" and not verdict.fits:
            reason = f"{verdict.reason}, with a radius of {TYPICAL_RADIUS_M} m"
            return Verdict(fits=False, reason=reason)
        return verdict
    if clue.role == "acceleration_longitudinal" and clue.unit:
        return motion.acceleration_verdict(to_si(samples, clue.unit))
    return spread(samples)


def _rank(one: Candidate) -> tuple[bool, bool, bool, bool, bool, float]:
    """Sure ones first; then unit, readable, not multiplexed, linear, fast."""
    is_angular = one.role.startswith(_SPEEDS) and (
        one.unit in UNITS and UNITS[one.unit].quantity == "angular_speed"
    )
    is_multiplexed = one.clue.signal.multiplexer_signal is not None
    return (
        not one.sure,
        not one.clue.unit,
        bool(one.unread),
        is_multiplexed,
        is_angular,
        -one.rate_hz - 0.01 * len(one.clue.message.signals),
    )


def _is_speed(clue: Clue) -> bool:
    return clue.role.startswith(_SPEEDS)


def _name(clue: Clue) -> tuple[str, str]:
    return clue.message.name, clue.signal.name


def _source(one: Candidate) -> tuple[str, str]:
    return _name(one.clue)


def _place(one: Candidate) -> int:
    return ROLE_INDEX[one.role]


def _joined(reasons: list[str]) -> str:
    return "; ".join(reason for reason in reasons if reason)

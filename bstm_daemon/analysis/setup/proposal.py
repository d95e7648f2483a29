"""Which signal plays which role, by names and by a recording.

A sure role has one signal whose name and unit fit and whose behaviour in the
recording, if any, does not contradict them. All other matches are kept as
unsure, with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from bstm_daemon.analysis.setup.behaviour import (
    Motion,
    Verdict,
    spread,
    to_ms,
    to_si,
)
from bstm_daemon.analysis.setup.name_rules import name_matches
from bstm_daemon.analysis.setup.pressure_unit import assumed_unit
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.units import UNITS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cantools.database.can import Database

    from bstm_daemon.analysis.setup.name_rules import NameMatch
    from bstm_daemon.analysis.setup.recording import Recording, Samples

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

    ``unread`` is why the daemon rejects the frames although the role is right,
    "" where it does not.
    """

    match: NameMatch
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
        return self.match.role


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
    matches = name_matches(database)
    motion = _motion(matches, recording) if recording else None
    judged = [_judged(match, recording, motion) for match in matches]
    best: dict[str, Candidate] = {}
    owners: dict[tuple[int, bool], str] = {}
    for one in sorted(judged, key=_rank):
        message = one.match.message
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
    """Add to the reason which other signals fit as well."""
    others = [
        ".".join(_source(one))
        for one in judged
        if one.role == best.role and one.sure and _source(one) != _source(best)
    ]
    if not others or not best.sure:
        return best
    return replace(best, reason=f"{best.reason}; also {', '.join(others)}")


def _motion(matches: Iterable[NameMatch], recording: Recording) -> Motion:
    """Return the car's motion from all wheel and vehicle speeds.

    Angular speeds count only where there is no other.
    """
    speeds: dict[str, Samples] = {}
    angular: dict[str, Samples] = {}
    for match in matches:
        found = recording.samples.get(_name(match))
        if found is None or not match.unit or not _is_speed(match):
            continue
        is_angular = UNITS[match.unit].quantity == "angular_speed"
        target = angular if is_angular else speeds
        name = ".".join(_name(match))
        target[name] = to_ms(found, match.unit, TYPICAL_RADIUS_M)
    moved = [one for one in speeds.values() if one.value.max(initial=0.0) > 0]
    return Motion(speeds if moved else {**speeds, **angular})


def _judged(
    match: NameMatch, recording: Recording | None, motion: Motion | None
) -> Candidate:
    guessed = _GUESSED_UNIT.get(match.role, "")
    unit = match.unit or guessed
    if recording is None or motion is None:
        reason = match.caveat or "by name and unit only, no log was given"
        sure = not match.caveat and bool(match.unit)
        return Candidate(match, unit, sure, reason)
    found = recording.samples.get(_name(match))
    if found is None:
        reasons = [match.caveat, "its frame is not in the log"]
        return Candidate(match, unit, sure=False, reason=_joined(reasons))
    verdict = _verdict(match, found, motion)
    unread = ""
    if match.message.name in recording.lengths:
        unread = (
            f"its frames have {recording.lengths[match.message.name]} bytes, "
            f"the DBC has {match.message.length}: rejected until they agree"
        )
    sure = not match.caveat and bool(match.unit)
    reasons = [match.caveat, verdict.reason]
    if not match.unit and match.role.startswith(_PROVABLE):
        assumed = assumed_unit(motion, found)
        if assumed is not None:
            unit, sure = assumed.unit, True
            reasons.append(assumed.reason)
    return Candidate(
        match,
        unit,
        sure=verdict.fits and sure,
        reason=_joined(reasons),
        sign=verdict.sign,
        scale=verdict.scale,
        rate_hz=found.rate_hz,
        unread=unread,
    )


def _verdict(match: NameMatch, samples: Samples, motion: Motion) -> Verdict:
    if match.role.startswith(_PRESSURES):
        return motion.pressure_verdict(samples)
    if match.unit and _is_speed(match):
        speed = to_ms(samples, match.unit, TYPICAL_RADIUS_M)
        verdict = motion.speed_verdict(speed)
        if UNITS[match.unit].quantity == "angular_speed" and not verdict.fits:
            reason = f"{verdict.reason}, with a radius of {TYPICAL_RADIUS_M} m"
            return Verdict(fits=False, reason=reason)
        return verdict
    if match.role == "acceleration_longitudinal" and match.unit:
        return motion.acceleration_verdict(to_si(samples, match.unit))
    return spread(samples)


def _rank(one: Candidate) -> tuple[bool, bool, bool, bool, bool, float]:
    """Sure ones first; then unit, readable, not multiplexed, linear, fast."""
    is_angular = one.role.startswith(_SPEEDS) and (
        one.unit in UNITS and UNITS[one.unit].quantity == "angular_speed"
    )
    is_multiplexed = one.match.signal.multiplexer_signal is not None
    return (
        not one.sure,
        not one.match.unit,
        bool(one.unread),
        is_multiplexed,
        is_angular,
        -one.rate_hz - 0.01 * len(one.match.message.signals),
    )


def _is_speed(match: NameMatch) -> bool:
    return match.role.startswith(_SPEEDS)


def _name(match: NameMatch) -> tuple[str, str]:
    return match.message.name, match.signal.name


def _source(one: Candidate) -> tuple[str, str]:
    return _name(one.match)


def _place(one: Candidate) -> int:
    return ROLE_INDEX[one.role]


def _joined(reasons: list[str]) -> str:
    return "; ".join(reason for reason in reasons if reason)

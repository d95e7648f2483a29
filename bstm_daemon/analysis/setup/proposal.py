"""Which signal plays which role, by names and by a recording.

A sure role has one signal whose name and unit fit and whose behaviour in the
recording, if any, does not contradict them. All other matches are kept as
unsure, with the reason.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from cantools.database.can import Database

from bstm_daemon.analysis.quality.frozen import feels_nothing
from bstm_daemon.analysis.setup.behaviour import Motion, to_ms
from bstm_daemon.analysis.setup.judging import SPEEDS, Judge, stage_of
from bstm_daemon.analysis.setup.name_rules import (
    REQUEST,
    UNNAMED,
    NameMatch,
    name_matches,
    unit_matches,
)
from bstm_daemon.analysis.setup.pressure_unit import assumed_unit
from bstm_daemon.analysis.setup.recording import Recording, Samples
from bstm_daemon.roles import GROUND_LAG_S, ROLE_INDEX
from bstm_daemon.units import UNITS

TYPICAL_RADIUS_M: Final = 0.32
"""Rolling radius of a passenger car's wheel; enters comparisons only."""

MOST_UNSURE: Final = 4
"""Unsure signals of a role that are shown."""

_RADIUS_M: Final = (0.15, 0.6)
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
    flaws: int = 0

    @property
    def role(self) -> str:
        """The role's name."""
        return self.match.role


@dataclass(frozen=True, slots=True)
class Proposal:
    """The outcome: at most one sure candidate a role, and the others.

    ``more`` counts the unsure ones of a role that are left out;
    ``radius_m`` is that of the wheels where the log shows it.
    """

    sure: tuple[Candidate, ...]
    unsure: tuple[Candidate, ...]
    more: dict[str, int] = field(default_factory=dict)
    radius_m: float | None = None

    def roles(self) -> frozenset[str]:
        """Return the names of the sure roles."""
        return frozenset(one.role for one in self.sure)

    def ready(self, role: str) -> bool:
        """Whether *role* is sure and the daemon reads its frames."""
        return any(one.role == role and not one.unread for one in self.sure)


def propose(database: Database, recording: Recording | None) -> Proposal:
    """Propose a signal of *database* for each role that one fits."""
    matches = name_matches(database)
    radius_m = None
    if recording is None:
        judged = [_by_name(match) for match in matches]
    else:
        named = {(_name(one), one.role) for one in matches}
        matches += [
            one
            for one in unit_matches(database)
            if (_name(one), one.role) not in named
        ]
        motion, radius_m = _motion(matches, recording)
        motion.on_stand = _on_stand(matches, recording, motion)
        judged = _by_log(
            matches, recording, Judge(motion, radius_m or TYPICAL_RADIUS_M)
        )
    best: dict[str, Candidate] = {}
    owners: dict[tuple[int, bool], str] = {}
    taken: set[tuple[str, str]] = set()
    for one in sorted(judged, key=_rank):
        message = one.match.message
        key = message.frame_id, message.is_extended_frame
        # an id that two messages have can be read as one of them only, and a
        # signal is one quantity
        if (
            one.role not in best
            and owners.get(key, message.name) == message.name
            and _source(one) not in taken
        ):
            best[one.role] = _beside(one, judged)
            if one.sure:
                owners[key] = message.name
                taken.add(_source(one))
    sure = [one for one in best.values() if one.sure]
    unsure: dict[str, list[Candidate]] = {}
    for one in sorted(judged, key=_rank):
        if _source(one) not in taken and (
            one.role not in best or not best[one.role].sure
        ):
            unsure.setdefault(one.role, []).append(one)
    return Proposal(
        tuple(sorted(sure, key=_place)),
        tuple(
            one
            for role in sorted(unsure, key=ROLE_INDEX.__getitem__)
            for one in unsure[role][:MOST_UNSURE]
        ),
        {
            role: len(found) - MOST_UNSURE
            for role, found in unsure.items()
            if len(found) > MOST_UNSURE
        },
        radius_m,
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


def _motion(
    matches: Iterable[NameMatch], recording: Recording
) -> tuple[Motion, float | None]:
    """Return the car's motion from all wheel and vehicle speeds.

    Without one from those over ground, which lag.

    The radius that makes angular speeds agree with the others comes with it,
    None where there are not both; a typical one is taken where all are
    angular.
    """
    speeds: dict[str, Samples] = {}
    angular: dict[str, Samples] = {}
    over_ground: dict[str, Samples] = {}
    for match in matches:
        found = recording.samples.get(_name(match))
        if (
            found is None
            or not match.unit
            or not match.role.startswith((*SPEEDS, *GROUND_LAG_S))
            or match.level == REQUEST
        ):
            continue
        if match.role in GROUND_LAG_S:
            over_ground[".".join(_name(match))] = to_ms(found, match.unit, 1.0)
            continue
        is_angular = UNITS[match.unit].quantity == "angular_speed"
        target = angular if is_angular else speeds
        target[".".join(_name(match))] = to_ms(found, match.unit, 1.0)
    motion = Motion(speeds)
    if not speeds and not angular:
        return Motion(over_ground), None
    if not motion.moving.any():
        radius_m = TYPICAL_RADIUS_M
        turning = {
            name: replace(one, value=one.value * radius_m)
            for name, one in angular.items()
        }
        return Motion({**speeds, **turning}), None
    ratios = [
        float(np.median(motion.speed_ms[moving] / column[moving]))
        for one in angular.values()
        for column in (motion.on_grid(one),)
        for moving in (motion.moving & (column > 1.0),)
        if moving.any()
    ]
    low, high = _RADIUS_M
    radii = [ratio for ratio in ratios if low < ratio < high]
    return motion, round(float(np.median(radii)), 4) if radii else None


def _on_stand(
    matches: Iterable[NameMatch], recording: Recording, motion: Motion
) -> bool:
    """Whether an axle stands while the others turn and the car stays.

    Its wheels would be taken for dead sensors, and its brakes heated. Only a
    named accelerometer shows it.
    """
    values: dict[str, list[Samples]] = {}
    for one in matches:
        found = recording.samples.get(_name(one))
        if found is not None and one.unit and not one.caveat:
            values.setdefault(one.role, []).append(found)

    def rests(role: str) -> bool:
        own = values.get(role, [])
        return bool(own) and all(np.ptp(one.value) == 0.0 for one in own)

    felt = values.get("acceleration_longitudinal", [])
    return (
        motion.known
        and any(
            rests(f"wheel_speed_{axle}l") and rests(f"wheel_speed_{axle}r")
            for axle in "fr"
        )
        and any(np.ptp(one.value) > 0.0 for one in felt)
        and all(
            feels_nothing(
                motion.change_ms2, motion.smooth(motion.on_grid(one))
            )
            for one in felt
        )
    )


def _by_name(match: NameMatch) -> Candidate:
    return Candidate(
        match,
        match.unit or _GUESSED_UNIT.get(match.role, ""),
        sure=not match.caveat and bool(match.unit),
        reason=match.caveat or "by name and unit only, no log was given",
    )


def _by_log(
    matches: Iterable[NameMatch], recording: Recording, judge: Judge
) -> list[Candidate]:
    """Judge *matches*, the sure ones of a stage known to the next."""
    stages: list[list[NameMatch]] = [[], [], []]
    for match in matches:
        stages[stage_of(match.role)].append(match)
    judged: list[Candidate] = []
    for stage in stages:
        found = [_judged(match, recording, judge) for match in stage]
        judged += [
            one for one in found if one.sure or one.match.level < UNNAMED
        ]
        for one in sorted(found, key=_rank, reverse=True):
            if one.sure:
                samples = recording.samples[_source(one)]
                value = samples.value * one.sign * one.scale
                corrected = replace(samples, value=value)
                si = judge.si(one.role, one.unit, corrected)
                judge.known[one.role] = judge.motion.on_grid(si)
    return judged


def _judged(match: NameMatch, recording: Recording, judge: Judge) -> Candidate:
    unit = match.unit or _GUESSED_UNIT.get(match.role, "")
    found = recording.samples.get(_name(match))
    if found is None:
        reasons = [match.caveat, "its frame is not in the log"]
        return Candidate(match, unit, sure=False, reason=_joined(reasons))
    verdict = judge.verdict(match.role, match.unit, found)
    unread = ""
    if match.message.name in recording.lengths:
        unread = (
            f"its frames have {recording.lengths[match.message.name]} bytes, "
            f"the DBC has {match.message.length}: rejected until they agree"
        )
    proven = verdict.proven and match.level != REQUEST
    sure = bool(match.unit) and (proven or not match.caveat)
    reasons = [match.caveat, verdict.reason]
    if not match.unit and match.role.startswith(_PROVABLE):
        assumed = assumed_unit(judge.motion, found)
        if assumed is not None:
            unit, sure = assumed[0], match.level != REQUEST
            reasons.append(assumed[1])
    return Candidate(
        match,
        unit,
        sure=verdict.fits and sure,
        reason=_joined(reasons),
        sign=verdict.sign,
        scale=verdict.scale,
        rate_hz=found.rate_hz,
        unread=unread,
        flaws=verdict.flaws,
    )


def _rank(one: Candidate) -> tuple[float, ...]:
    """Sure ones first; then unit, measured, readable, flawless and fast."""
    is_angular = one.role.startswith(SPEEDS) and (
        one.unit in UNITS and UNITS[one.unit].quantity == "angular_speed"
    )
    is_multiplexed = one.match.signal.multiplexer_signal is not None
    return (
        not one.sure,
        not one.match.unit,
        one.match.level,
        bool(one.unread),
        is_multiplexed,
        is_angular,
        one.flaws,
        -one.rate_hz - 0.01 * len(one.match.message.signals),
    )


def _name(match: NameMatch) -> tuple[str, str]:
    return match.message.name, match.signal.name


def _source(one: Candidate) -> tuple[str, str]:
    return _name(one.match)


def _place(one: Candidate) -> int:
    return ROLE_INDEX[one.role]


def _joined(reasons: list[str]) -> str:
    return "; ".join(reason for reason in reasons if reason)

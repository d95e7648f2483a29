"""``bstm match``: stages, then the joint refinement, corner by corner.

And what comes of it: changes of the configuration file, curves.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import log, nan
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from bstm_daemon.analysis.matching.baseline import baselines
from bstm_daemon.analysis.matching.coarse import (
    CAPACITY,
    FILTER,
    FINE_POINTS,
    FINE_S,
    OF_DISC,
    Found,
    Reading,
    driven_keys,
    exponent_of,
    search,
)
from bstm_daemon.analysis.matching.doubts import doubts
from bstm_daemon.analysis.matching.learned import settings_of
from bstm_daemon.analysis.matching.phases import HARD_MS2, hard_stops
from bstm_daemon.analysis.matching.refine import (
    ROUNDS,
    Accuracy,
    NodeAccuracy,
    Refinement,
    errors_of,
    fitted,
    folds_of,
    peaks_of,
    refine,
    rms_of,
    white_k,
)
from bstm_daemon.analysis.matching.stages import StageResult, run_stages
from bstm_daemon.analysis.matching.structure import (
    KEPT,
    share_left,
    with_contact,
)
from bstm_daemon.analysis.matching.targets import (
    measured_targets,
    over_targets,
)
from bstm_daemon.analysis.matching.tunables import (
    CONTACT,
    COOLING,
    DRAG,
    NODES_MS,
    SIDES,
    TABLE_4_1,
    Target,
    refined_keys,
    usable,
)
from bstm_daemon.analysis.statistics.series import rms
from bstm_daemon.config.estimates import AT_FLUID

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bstm_daemon.analysis.matching.baseline import Baseline
    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.refine import Errors
    from bstm_daemon.analysis.statistics.whitening import SensorNoise
    from bstm_daemon.config.sections import Config

MUCH_LESS: Final = 0.8
"""A form is worth a word where it leaves so much less of the error."""

NO_FLUID: Final = (
    "no thermocouple in fluid or caliper: such a corner stays unverified"
)

CHOSEN: Final[dict[str, Callable[[Target], float]]] = {
    CAPACITY: exponent_of,
    FILTER: lambda one: one.config.heat.derivative_filter_s,
}
"""What the coarse search chooses beside the values that are fitted."""


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """The match of corners that are alike.

    ``before`` and ``after`` are the configurations, ``start`` what the coarse
    search made of the first; ``table_4_1`` is the refinement of the thesis's
    own parameters alone, from the same start. ``drives`` have the heat as the
    search chose to form it. ``accuracy`` is what the fit leaves over on what
    it did not see, ``form`` what it leaves over itself, ``verdict`` why it is
    not to be trusted, empty where it is.
    """

    corners: tuple[str, ...]
    before: Target
    start: Target
    after: Target
    drives: Sequence[Drive]
    stages: tuple[StageResult, ...]
    joint: Refinement
    table_4_1: Refinement | None
    accuracy: Accuracy
    remarks: tuple[str, ...]
    verdict: tuple[str, ...]
    form: Mapping[str, NodeAccuracy] = field(default_factory=dict)

    def settings(self) -> dict[str, Any]:
        """Return the keys of the configuration and their matched values."""
        before, after = self.before, self.after
        found = settings_of(before, after, self.joint.values)
        for key, of in CHOSEN.items():
            if of(after) != of(before):
                found[key] = of(after)
        return found

    def deviation(self, key: str) -> float:
        """Return the standard deviation of a key of :meth:`settings`.

        That of the S-table is relative, its larger factor's; nan for what was
        chosen, not fitted.
        """
        if key == "cooling.s_per_s":
            return max(
                self.joint.standard_deviation(one) / self.joint.values[one]
                for one in NODES_MS
                if one in self.joint.values
            )
        if key not in self.joint.values:
            return nan
        return self.joint.standard_deviation(key)

    def in_place_of(self, other: Match) -> Match:
        """Return it as a match of what *other* began with."""
        before_k = other.accuracy.before_k
        return replace(
            self,
            before=other.before,
            table_4_1=other.table_4_1,
            accuracy=replace(self.accuracy, before_k=before_k),
        )


def match_drives(  # noqa: PLR0913
    config: Config,
    readings: Sequence[Reading],
    *,
    guessed: frozenset[str] = frozenset(),
    only: str = "",
    each: bool = False,
    beside: bool = True,
    progress: Callable[[float], None] | None = None,
) -> list[Match]:
    """Match *config* to *readings*, all corners with thermocouples.

    Those that are alike together; where only discs are measured, with values
    of each side's own, and a match for each corner.

    Args:
        config: the vehicle.
        readings: what was recorded, first as configured.
        guessed: tunables whose configured values nobody has measured.
        only: ``cooling`` for what another rim changes, else everything.
        each: match corners by themselves that are configured alike.
        beside: fit Table 4.1 alone, for comparison.
        progress: called with the share that is done.

    Raises:
        LogError: no corner has a thermocouple.
    """
    targets = measured_targets(
        config, readings[0].drives, each=each, guessed=guessed
    )
    found = over_targets(
        targets,
        lambda target, show: _with_additions(
            target, readings, only, show, beside=beside and not only
        ),
        progress,
    )
    return [match for of_target in found for match in of_target]


def _other_form(
    target: Target, drives: Sequence[Drive], joint: Refinement
) -> str:
    """Say where the other form of cooling leaves much less of the disc."""
    if "disc" not in joint.rms_k:
        return ""
    form = target.config.cooling_of(target.corner).form
    other = "conductance" if form == "rate" else "rate"
    fit = refine(
        target.with_cooling_form(other), drives, joint.keys,
        start=joint.values, noise=joint.noise, rounds=1,
    )  # fmt: skip
    before, after = joint.rms_k["disc"], fit.rms_k["disc"]
    if after > MUCH_LESS * before:
        return ""
    return (
        f'cooling.form = "{other}" would leave {after:.1f} K of the disc '
        f"instead of {before:.1f} K: set it and match again"
    )


def _no_hard_stop(target: Target, drives: Sequence[Drive]) -> str:
    """Say where the drives have no hard stop: drags alone fit wrongly."""
    if any(
        hard_stops(drive, corner)
        for drive in drives
        for corner in target.corners
        if corner in drive.corners
    ):
        return ""
    return (
        f"no hard stop ({HARD_MS2:g} m/s2) in these drives: the values fit "
        "drags and may be wrong in stops"
    )


def _with_additions(
    target: Target,
    readings: Sequence[Reading],
    only: str,
    show: Callable[[float], None],
    *,
    beside: bool,
) -> list[Match]:
    """Match *target*, and once more with what a doubtful match may lack."""
    found = _match(
        *(target, readings, only, lambda one: show(0.5 * one)), beside=beside
    )
    plain = found[0]
    trial = with_contact(target, plain.drives)
    if only or not plain.verdict or trial is None:
        return found
    (more,) = _match(
        *(trial, readings, only, lambda one: show(0.5 + 0.5 * one)),
        beside=False,
    )
    left = share_left(plain.accuracy.rms_k, more.accuracy.rms_k)
    what = (
        f"heat through the contact of disc and pads ({CONTACT}), with k and "
        f"cp of the lining, leaves {left:.2f} times the error on what was "
        "left out"
    )
    if left > KEPT:
        note = f"{what}: not added"
        return [replace(plain, remarks=(*plain.remarks, note))]
    note = f"{what}: added"
    return [replace(more.in_place_of(plain), remarks=(*more.remarks, note))]


def _match(
    target: Target,
    readings: Sequence[Reading],
    only: str,
    show: Callable[[float], None],
    *,
    beside: bool,
) -> list[Match]:
    found = search(target, readings)
    drives = found.reading.drives
    keys, remarks = _keys(found.target, drives, only)
    sides = {corner[-1] for corner in target.corners}
    if not only and _discs_only(keys) and len(sides) > 1:
        keys += SIDES
    start, stages = run_stages(
        found.target,
        drives,
        COOLING if only == "cooling" else None,
        lambda share: show(0.3 * share),
        without=OF_DISC if found.noise else frozenset(),
    )
    joint = _refined(found, keys, start, lambda one: show(0.3 + 0.3 * one))
    thesis = None
    if beside and not _discs_only(keys):
        thesis = refine(
            *(found.target, drives, usable(found.target, TABLE_4_1)[0]),
            lambda share: show(0.6 + 0.2 * share),
            start=start,
        )
    after = found.target.changed(joint.values)
    folds = _folds(
        *(target, readings, joint, only), lambda share: show(0.8 + 0.2 * share)
    )
    remarks += found.remarks
    if not only:
        if AT_FLUID.isdisjoint(joint.rms_k):
            remarks.append(NO_FLUID)
        of_form = _other_form(found.target, drives, joint)
        remarks += [of_form, _no_hard_stop(target, drives)]
    of_sides = [target.corners]
    if SIDES.keys() & set(keys):
        of_sides = [(corner,) for corner in target.corners]
    matches = []
    for corners in of_sides:
        own = replace(after, corners=corners)
        errors = _errors(own, drives)
        fit = joint
        if corners != target.corners:
            fit = joint.of_side(corners[0], rms_of(errors))
        before = replace(target, corners=corners)
        accuracy = _accuracy(before, own, fit, folds, errors)
        matches.append(
            Match(
                corners,
                before,
                replace(found.target, corners=corners),
                own,
                drives,
                tuple(stages),
                fit,
                thesis,
                accuracy,
                tuple(remark for remark in remarks if remark),
                tuple(doubts(joint, accuracy, errors)),
                {
                    node: fitted(
                        [(*part, white_k(joint, node)) for part in parts]
                    )
                    for node, parts in errors.items()
                },
            )
        )
    return matches


def _discs_only(keys: Sequence[str]) -> bool:
    return OF_DISC | {DRAG, *SIDES} >= set(keys)


def _refined(
    found: Found,
    keys: Sequence[str],
    start: Mapping[str, float],
    show: Callable[[float], None] | None = None,
    noise: Mapping[str, SensorNoise] | None = None,
) -> Refinement:
    """Return the refinement of *keys* from what the search found.

    Of discs alone with the search's plain noise: their errors are those of
    the heat, and the fit with least error is asked for. *noise* is known.
    """
    drives = found.reading.drives
    if found.noise and _discs_only(keys):
        return refine(
            *(found.target, drives, keys, show),
            noise=found.noise,
            rounds=1,
            point_s=FINE_S,
            most_points=FINE_POINTS,
        )
    return refine(
        *(found.target, drives, keys, show),
        start=start,
        noise=noise,
        rounds=1 if noise else ROUNDS,
    )


def _keys(
    target: Target, drives: Sequence[Drive], only: str
) -> tuple[list[str], list[str]]:
    """Return what is refined, and what is said of the rest."""
    wanted = COOLING if only == "cooling" else refined_keys(target)
    wanted, why = driven_keys(target, drives, wanted)
    keys, remarks = usable(target, wanted)
    return keys, [*remarks, *why]


def _errors(target: Target, drives: Sequence[Drive]) -> Errors:
    """Return errors and rises of *target* on all of *drives* by node."""
    found: Errors = {}
    for drive in drives:
        for node, parts in errors_of(target, drive).items():
            found.setdefault(node, []).extend(parts)
    return found


class _Fold(NamedTuple):
    """A fit without a drive or a part.

    ``left`` is what was left out as the fit reads it, ``plain`` as it was
    configured; ``simple`` are the simple discs fitted to the same.
    """

    fit: Target
    left: Drive
    plain: Drive
    simple: Mapping[str, list[Baseline]]


def _folds(
    target: Target,
    readings: Sequence[Reading],
    joint: Refinement,
    only: str,
    show: Callable[[float], None],
) -> list[_Fold]:
    """Return fits that leave out each drive, or a part, in turn."""
    found = []
    folds = folds_of(readings[0].drives)
    for number, (pieces, left) in enumerate(folds):
        start = search(target, [one.of(pieces) for one in readings])
        keys = _keys(start.target, start.reading.drives, only)[0]
        keys += [key for key in SIDES if key in joint.keys]
        first = {} if start.noise else joint.values
        fit = _refined(start, keys, first, None, joint.noise)
        unseen = next(
            one for one in readings if one.filter_s == start.reading.filter_s
        )
        found.append(
            _Fold(
                start.target.changed(fit.values),
                unseen.of([left]).drives[0],
                readings[0].of([left]).drives[0],
                baselines(readings[0].of(pieces).drives),
            )
        )
        show((number + 1) / len(folds))
    return found


def _accuracy(
    before: Target,
    whole: Target,
    fit: Refinement,
    folds: Sequence[_Fold],
    errors: Errors,
) -> Accuracy:
    """Return what is left on drives, or a part, that a fit has not seen.

    *before* and *whole* as configured and fitted to all, with *errors*.
    """
    corners = whole.corners
    plain: Errors = {}
    after: Errors = {}
    simple_k, shifts, each_k, peaks_k = [], [], [], []
    for fold in folds:
        without = replace(fold.fit, corners=corners)
        shifts.append(
            [log(without.setting(k) / whole.setting(k)) for k in fit.keys]
        )
        simple_k += [
            fold.simple[corner][0].rms_on([fold.plain])
            for corner in corners
            if corner in fold.simple
        ]
        own = _errors(without, [fold.left])
        each_k.append(rms_of(own))
        peaks_k.append(peaks_of(own))
        for all_of, these in (
            (plain, _errors(before, [fold.plain])),
            (after, own),
        ):
            for node, parts in these.items():
                all_of.setdefault(node, []).extend(parts)
    seen = {node: list(parts) for node, parts in after.items()}
    if len(folds) < 2:
        # a last third alone may hold a soak and no stop
        for node, parts in errors.items():
            seen.setdefault(node, []).extend(parts)
    return Accuracy(
        {
            node: fitted([(*part, white_k(fit, node)) for part in parts])
            for node, parts in seen.items()
        },
        len(folds) if len(folds) > 1 else 0,
        " and ".join(fold.plain.name for fold in folds),
        rms_of(plain),
        rms_of(after),
        rms(np.array(simple_k)) if simple_k else nan,
        np.array(shifts),
        tuple(each_k),
        tuple(peaks_k),
    )

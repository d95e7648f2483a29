"""``bstm gap run``: locate, gate, name, fit, show, corner by corner."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.adopting import written
from bstm_daemon.analysis.gap.advising import (
    MENU,
    Advice,
    Prospect,
    advise,
    candidate_drive,
    members_of,
    prospect,
)
from bstm_daemon.analysis.gap.changes import of_sensor
from bstm_daemon.analysis.gap.comparison import Comparison, heats
from bstm_daemon.analysis.gap.evidence import Candidate
from bstm_daemon.analysis.gap.fitting import (
    Fit,
    askable,
    directions,
    fit,
    prior_along,
)
from bstm_daemon.analysis.gap.heat_only import ForceGap, find_force_gap
from bstm_daemon.analysis.gap.holdout_comparison import (
    Shown,
    baseline_fits,
    confirmed,
    contradicted,
    fitted_and_shown,
    show,
)
from bstm_daemon.analysis.gap.naming import (
    SMALL,
    Naming,
    is_contradicted,
)
from bstm_daemon.analysis.gap.noise import noise_of
from bstm_daemon.analysis.gap.recording import Recording
from bstm_daemon.analysis.gap.residual_heat import Located, locate
from bstm_daemon.analysis.gap.searching import search, starts
from bstm_daemon.analysis.gap.signatures import Linearised, candidates, sensed
from bstm_daemon.analysis.identify.writing import NO_ENTRIES, Change, Entries
from bstm_daemon.analysis.matching.learned import known_keys
from bstm_daemon.analysis.matching.targets import (
    measured_targets,
    over_targets,
    targets_of,
)
from bstm_daemon.analysis.matching.tunables import Target
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError
from bstm_daemon.roles import MEASURED_NODES, ROLE_INDEX


@dataclass(frozen=True, slots=True)
class Question:
    """What to tell apart, and by which drives; empty: what is left.

    ``without`` are candidates that it is known not to be.
    """

    menu: tuple[str, ...] = MENU
    among: tuple[str, ...] = ()
    without: frozenset[str] = frozenset()


ANY = Question()

LIKELIEST: Final = 3
"""Members that are asked on held-out drives where it is not decided."""

STEPS = ("locate", "gate", "name", "adopt", "show", "advise")


@dataclass(frozen=True, slots=True, eq=False)
class Gap:
    """What was found on corners that are alike.

    ``before`` and ``after`` are the maps of the drives that ``shown`` is of,
    as configured and with the effect. ``silent`` are candidates that the
    drives do not excite. ``fit`` and ``shown`` are None where nothing was
    named, ``located`` and ``naming`` where they were not asked for.
    ``advice`` is which drive would tell ``members`` apart, the best first;
    ``values`` and ``entries`` are what a file gets; ``matched`` is whether
    the configuration says what its match learned.
    """

    corners: tuple[str, ...]
    recordings: tuple[str, ...]
    points: int
    located: Located | None = None
    naming: Naming | None = None
    silent: tuple[str, ...] = ()
    fit: Fit | None = None
    shown: Shown | None = None
    before: Located | None = None
    after: Located | None = None
    advice: tuple[Advice, ...] = ()
    members: tuple[str, ...] = ()
    values: tuple[Change, ...] = ()
    entries: Entries = NO_ENTRIES
    matched: bool = False

    @property
    def adopted(self) -> tuple[str, ...]:
        """Names of what can be written."""
        return () if self.fit is None else tuple(self.fit.strengths)

    @property
    def worse(self) -> bool:
        """Whether what can be written makes the gap not clearly smaller."""
        return self.shown is not None and not self.shown.better


def find_gap(
    config: Config,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    *,
    until: str = "show",
    question: Question = ANY,
    progress: Callable[[float], None] | None = None,
) -> list[Gap]:
    """Search *recordings* for what *config* lacks.

    Args:
        config: the vehicle, matched to it as well as may be.
        recordings: drives with thermocouples.
        held_out: drives to show before and after on.
        until: the last step taken: locate, gate, name, adopt, show or
            advise; advise leaves adopt and show out, show advises where
            candidates are left that the data can not tell apart.
        question: which drives of the menu would tell what apart.
        progress: called with the share that is done.

    Raises:
        LogError: no corner with a thermocouple.
    """
    targets = measured_targets(config, [one.drive for one in recordings])
    without = question.without
    by_forces = cache(lambda: _force_gap(config, recordings, without))
    return over_targets(
        targets,
        lambda target, report_share: _gap(
            target,
            recordings,
            held_out,
            until,
            question,
            report_share,
            by_forces=by_forces,
        ),
        progress,
    )


def _force_gap(
    config: Config, recordings: Sequence[Recording], without: Collection[str]
) -> ForceGap | None:
    """Return what forces show that is new since the match.

    None where the match knows no forces, or these drives show none.
    """
    if not any(one.forces for one in config.matched):
        return None
    try:
        return find_force_gap(config, recordings, without=without)
    except LogError:
        return None


def _of_one_day(naming: Naming) -> tuple[str, ...]:
    """Return the small error of a sensor that is best, if a drive has none.

    Predicted by the others, that drive is then less likely with it.
    """
    if not (naming.found and naming.candidates):
        return ()
    best = naming.candidates[0]
    small = of_sensor(best.name) and abs(best.strength) < SMALL
    against = is_contradicted(best, naming.cross_validated)
    return (best.name,) if small and against else ()


def _refuted(
    naming: Naming,
    comparison: Comparison,
    by_forces: Callable[[], ForceGap | None],
) -> tuple[str, ...]:
    """Return what temperatures suggest and forces would show, but do not.

    Or show with the other sign. Friction moves forces more plainly than
    temperatures, which motion heats.
    """
    suggested = [
        one
        for i, one in enumerate(naming.candidates)
        if (i == 0 or one.name in naming.names)
        and comparison.is_on_heat(one.name)
    ]
    if not (naming.found and suggested):
        return ()
    forces = by_forces()
    seen = () if forces is None else forces.naming.candidates
    own = {one.name: one for one in seen}

    def speaks_against(one: Candidate) -> bool:
        """Whether forces show less of *one*, or the other sign."""
        by = own.get(one.name)
        if by is None:
            return False
        if by.log_evidence < 0.0:
            return by.reach <= abs(one.strength)
        return by.strength * one.strength < 0.0

    return tuple(one.name for one in suggested if speaks_against(one))


def _named_by_forces(
    naming: Naming, by_forces: Callable[[], ForceGap | None]
) -> Naming | None:
    """Return what forces name where temperatures, with *naming*, do not.

    Motion heats whatever friction is: there is nothing to fit to temperatures.
    """
    if naming.answer in {"name", "class"}:
        return None
    forces = by_forces()
    wanted = {"name"} if naming.found else {"name", "unknown"}
    if forces is None or forces.naming.answer not in wanted:
        return None
    reason = f"by forces, pressure against motion: {forces.naming.reason}"
    return replace(forces.naming, reason=reason)


def _after_held_out(
    naming: Naming,
    comparison: Comparison,
    basis: Column,
    held_out: Sequence[Recording],
    noise: Mapping[str, SensorNoise],
    *,
    known_k: Column,
) -> Naming:
    """Return *naming* without a name if held-out drives contradict each.

    Of those that it does not decide between, the likeliest. *noise* is what
    the match handed on; *known_k* (n, p) is as for
    :func:`~bstm_daemon.analysis.gap.fitting.fit`.
    """
    baselines = baseline_fits(comparison, known_k)
    strengths = {one.name: one.strength for one in naming.candidates}
    members, by = naming.names[:LIKELIEST], None
    for name in members:
        own = fit(comparison, {name: strengths[name]}, basis, known_k=known_k)
        shown = show(comparison, own, held_out, baselines, known_k=known_k)
        by = shown.against(noise)
        if by is None:
            return naming
    return naming if by is None else contradicted(naming, members, by)


def is_unmatched(config: Config, recordings: Sequence[Recording]) -> bool:
    """Whether any corner with a thermocouple was not matched."""
    measured = {one for each in recordings for one in each.drive.measured}
    return any(
        config.matched_of(corner.name) is None
        for corner in config.disc_corners()
        if corner.name in measured
    )


def compare(target: Target, recordings: Sequence[Recording]) -> Comparison:
    """Return *target* against *recordings* with the noise of its nodes."""
    form = target.config.matched_of(target.corners[0])
    noise = {
        node: noise_of(target.config, node, form) for node in MEASURED_NODES
    }
    return Comparison(target, recordings, known_keys(target), noise)


def _gap(  # noqa: PLR0913
    target: Target,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    until: str,
    question: Question,
    report_share: Callable[[float], None],
    *,
    by_forces: Callable[[], ForceGap | None],
) -> Gap:
    located = locate(target.config, recordings, target.corners)
    report_share(0.1)
    names = tuple(one.name for one in recordings)
    comparison = compare(target, recordings)
    handed_on = comparison.noise
    points = int(comparison.edges[-1])
    if until == "locate":
        return Gap(target.corners, names, points, located)
    simulated = sensed(
        comparison,
        askable(target, candidates(target.config)),
        lambda share: report_share(0.1 + 0.6 * share),
    ).without(question.without)
    basis = directions(comparison)
    known, naming = search(comparison, simulated, basis)
    while refuted := (
        _of_one_day(naming) or _refuted(naming, comparison, by_forces)
    ):
        comparison = compare(target, recordings)
        simulated = simulated.without(refuted)
        known, naming = search(comparison, simulated, basis)
    plain = Gap(
        *(target.corners, names, points, located, naming, known.silent),
        matched=comparison.matched,
    )
    if until == "show" and held_out and naming.answer == "undecided":
        naming = _after_held_out(
            *(naming, comparison, basis, held_out, handed_on),
            known_k=simulated.jacobian_k,
        )
        plain = replace(plain, naming=naming)
    if found := _named_by_forces(naming, by_forces):
        return replace(plain, naming=found)
    if until == "advise" or (
        until == "show" and naming.answer in {"class", "undecided"}
    ):
        own = replace(known, jacobian=known.jacobian[:, : basis.shape[1]])
        plain = _advised(plain, comparison, own, question, report_share)
    if until in {"gate", "name", "advise"} or not naming.adoptable:
        return plain
    naming, extended, shown = fitted_and_shown(
        *(naming, starts(naming), comparison, basis, held_out),
        known_k=simulated.jacobian_k,
    )
    report_share(0.85)
    judged = confirmed(naming, shown, handed_on)
    if not judged.names:
        named = _named_by_forces(judged, by_forces)
        return replace(plain, naming=named or judged)
    values, entries = written(comparison, extended, naming)
    plain = replace(
        plain,
        naming=judged,
        fit=extended,
        values=tuple(values),
        entries=entries,
        shown=shown,
    )
    if until != "show":
        return plain
    before, after = located, _map(comparison, extended, held_out or recordings)
    if held_out:
        before = locate(target.config, held_out, target.corners)
    return replace(plain, before=before, after=after)


def _advised(
    gap: Gap,
    comparison: Comparison,
    known: Linearised,
    question: Question,
    report_share: Callable[[float], None],
) -> Gap:
    """Add which drive of the menu would tell what is left apart."""
    naming = gap.naming
    if naming is None:
        return gap
    settled = naming.answer in {"name", "composed", "unknown"}
    if settled and not question.among:
        return gap
    members = question.among or members_of(naming, known.silent)
    target = comparison.target
    recording = comparison.recordings[0]
    couples = {
        corner: tuple(recording.drive.measured.get(corner, {}))
        for corner in target.corners
    }
    prospects, prior = _prospects(
        target,
        recording.present,
        couples,
        Question(question.menu, members),
        lambda share: report_share(0.7 + 0.15 * share),
        comparison.noise,
    )
    found = advise(known, prior, members, prospects)
    return replace(gap, advice=found, members=members)


def advise_before(
    config: Config,
    present: Mapping[int, int],
    question: Question,
    progress: Callable[[float], None] | None = None,
) -> Gap:
    """Return which drive would tell candidates apart before any is driven.

    Args:
        config: the vehicle.
        present: role number to timeout [us] of what its bus has.
        question: candidates, each as likely as the other, and drives.
        progress: called with the share that is done.

    Raises:
        LogError: no role of a thermocouple is mapped.
    """
    couples: dict[str, tuple[str, ...]] = {}
    for corner in config.disc_corners():
        nodes = tuple(
            node
            for node in MEASURED_NODES
            if ROLE_INDEX[f"temp_{corner.name.lower()}_{node}"] in present
        )
        if nodes:
            couples[corner.name] = nodes
    targets = targets_of(config, sorted(couples))
    if not targets:
        msg = (
            "no role temp_<corner>_<node> is mapped: there is nothing to "
            "compare"
        )
        raise LogError(msg)
    target = targets[0]
    own = {name: couples[name] for name in target.corners}
    prospects, prior = _prospects(
        target, present, own, question, progress or (lambda _: None)
    )
    none = Linearised(np.zeros(0), np.zeros((0, len(prior))), (), (), ())
    found = advise(none, prior, question.among, prospects)
    return Gap(target.corners, (), 0, advice=found, members=question.among)


def _prospects(
    target: Target,
    present: Mapping[int, int],
    couples: Mapping[str, Sequence[str]],
    question: Question,
    report_share: Callable[[float], None],
    noise: Mapping[str, SensorNoise] | None = None,
) -> tuple[list[Prospect], Column]:
    """Return what each drive would show, and the tunables' priors."""
    found = []
    prior = np.zeros(0)
    for number, name in enumerate(question.menu):
        recording, description = candidate_drive(
            name, target.config, present, couples
        )
        comparison = compare(target, [recording])
        if noise is not None:
            comparison.set_noise({**comparison.noise, **noise})
        one = prospect(comparison, question.among, description)
        basis = directions(comparison)
        found.append(replace(one, jacobian=one.jacobian @ basis))
        prior = prior_along(comparison, basis)
        report_share((number + 1) / len(question.menu))
    return found, prior


def _map(
    comparison: Comparison, extended: Fit, recordings: Sequence[Recording]
) -> Located:
    """Return the map of *recordings* with what was found."""
    target = comparison.target
    x = extended.written_x
    after = comparison.config(x, extended.entries)
    heat = any(heats(effect, target.config) for effect in extended.entries)
    scale = float(np.exp(x[-1]))
    heated = []
    for one in recordings:
        drive = one.heated_by(after) if heat else one.drive
        heated.append(replace(one, drive=drive.with_power_times(scale)))
    return locate(after, heated, target.corners)

"""The gap without a thermocouple: Feed-Forward against Feed-Back.

Effects on the heat input leave their trace in forces before they do in
temperatures. The residual is the force of the pressure less that of the
motion; friction as a whole, the resistances and the body's pitch are
integrated out as tunables are, and the rest is the naming of
:mod:`bstm_daemon.analysis.gap.naming`.
"""

import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from math import exp, expm1, log
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import (
    LARGEST,
    STEP,
    either_sign,
    is_change,
    is_listed,
    largest,
)
from bstm_daemon.analysis.gap.evidence import Candidate, is_clearly_better
from bstm_daemon.analysis.gap.fitting import FORM_ERROR
from bstm_daemon.analysis.gap.force_balance import (
    CHANGE,
    SCALE,
    STEADY,
    ForceComparison,
)
from bstm_daemon.analysis.gap.forces import Forces
from bstm_daemon.analysis.gap.naming import (
    CLEARLY,
    Naming,
    name_effect,
)
from bstm_daemon.analysis.gap.recording import Recording
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
    candidates,
)
from bstm_daemon.analysis.gap.unnamed_forces import unnamed_forces
from bstm_daemon.analysis.identify.writing import Change, Entries
from bstm_daemon.analysis.matching.learned import short
from bstm_daemon.analysis.statistics.evidence import FREE, Projector, fit_terms
from bstm_daemon.config.sections import Config, EffectConfig
from bstm_daemon.errors import LogError
from bstm_daemon.model.effects.catalogue import effect_class

NOTHING_SEEN: Final = (
    "no effect on the heat input changes the forces of these drives by more "
    "than they are uncertain, friction and resistances re-fitted"
)

SILENT_MS2: Final = 1e-3
"""An effect that nowhere changes the car's acceleration by more is silent."""

LEARNED: Final = 1.0
"""Prior standard deviation of the strengths that describe a matched car."""

FOURFOLD: Final = 3.9
"""Largest strength of a change by forces, linear in it: four times as
much as matched. That is no stand-in: a match may find a fifth of what is
typical."""

BEYOND: Final = 15.0
"""By so much of the log-likelihood at least what has no name must explain more
for a name to be withheld."""

WEAK: Final = 2.0
"""From this strength on an effect counts as too weak for these drives."""


@dataclass(frozen=True, slots=True, eq=False)
class ForceGap:
    """What forces alone show.

    ``seen`` are strengths from which each effect shows, ``unseen`` why one
    does not. ``before`` and ``after`` are RMS errors of the acceleration
    [m/s2] on ``shown_on``, without and with ``strengths``; ``pressed_j`` and
    ``motion_j`` the work of pressure and motion while braking.
    """

    recordings: tuple[str, ...]
    windows: int
    naming: Naming
    strengths: dict[str, float]
    deviations: dict[str, float]
    seen: dict[str, float]
    unseen: dict[str, str]
    shown_on: tuple[str, ...]
    held_out: bool
    before_ms2: float
    after_ms2: float
    pressed_j: float
    motion_j: float
    curves: tuple[Forces, ...] = ()

    @property
    def worse(self) -> bool:
        """Whether what can be written does not make the gap smaller."""
        return bool(self.adopted) and self.after_ms2 >= self.before_ms2

    @property
    def values(self) -> tuple[Change, ...]:
        """Values to write beside: none."""
        return ()

    @property
    def adopted(self) -> tuple[str, ...]:
        """Names of what can be written: effects, no changed values."""
        return tuple(filter(is_listed, self.strengths))

    @property
    def entries(self) -> Entries:
        """What can be adopted, with its provenance."""
        effects = [
            EffectConfig(
                name=name,
                parameters={"strength": self.strengths[name]},
                provenance={
                    "source": "bstm gap, forces",
                    "data": list(self.recordings),
                    "date": time.strftime("%Y-%m-%d"),
                    "strength_sd": round(self.deviations[name], 3),
                    **self.naming.provenance(name),
                },
            )
            for name in self.adopted
        ]
        return Entries(effects)


def find_force_gap(
    config: Config,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    without: Collection[str] = (),
) -> ForceGap:
    """Search *recordings* for effects on the heat input, by forces alone.

    Args:
        config: the vehicle.
        recordings: drives, with or without thermocouples.
        held_out: drives to show before and after on.
        without: candidates that it is known not to be.

    Raises:
        LogError: the motion shows no force.
    """
    comparison = ForceComparison(config, recordings)
    known, unseen = linearised(comparison)
    asked = tuple(one for one in known.signatures if one.name not in without)
    known = replace(known, signatures=asked)
    naming = _with_unnamed(comparison, known)
    seen = {}
    for one in naming.candidates:
        if one.reach <= WEAK:
            seen[one.name] = one.reach
        else:
            unseen[one.name] = (
                f"too weak in these drives: from a strength of {one.reach:.1f}"
            )
    names = naming.adoptable
    strengths, deviations = _strengths(comparison, known, names)
    possible = tuple(n for n in names if not _at_bound(n, strengths[n]))
    if naming.answer == "name" and 0 < len(possible) < len(names):
        # beside the first, what no car has is a leftover of its form
        naming = replace(naming, names=possible)
        strengths, deviations = _strengths(comparison, known, possible)
    others = held_out or recordings
    before, after = _errors(config, others, strengths)
    pressed, motion = _work(comparison)
    naming = replace(
        naming, candidates=tuple(map(_in_logarithms, naming.candidates))
    )
    return ForceGap(
        tuple(one.name for one in recordings),
        len(comparison.base_n),
        naming,
        {name: _logarithm(name, a) for name, a in strengths.items()},
        {n: a * _slope(n, strengths[n]) for n, a in deviations.items()},
        dict(sorted(seen.items(), key=lambda item: item[1])),
        unseen,
        tuple(one.name for one in others),
        bool(held_out),
        before,
        after,
        pressed,
        motion,
        tuple(comparison.parts),
    )


def _with_unnamed(comparison: ForceComparison, known: Linearised) -> Naming:
    """Return what *known* says is missing, or that it has no name.

    The latter is told where nothing is named, and where what has no name
    explains clearly more than what is.
    """
    naming = name_effect(comparison.layout, known)
    if naming.answer == "nothing":
        naming = replace(naming, reason=NOTHING_SEEN)
    beyond = replace(known, unknown=unnamed_forces(comparison))
    unnamed = name_effect(comparison.layout, beyond)
    evidence = unnamed.unknown_evidence
    names = naming.adoptable
    if not names:
        tells = unnamed.answer == "unknown" and evidence > CLEARLY
        return unnamed if tells else naming
    project = Projector(known.jacobian, comparison.prior)
    columns = [s.linear for s in known.signatures if s.name in names]
    own = np.column_stack(columns)
    listed = fit_terms(project, known.residual, own, FREE).gain
    if not is_clearly_better(evidence, listed, BEYOND):
        return naming
    reason = f"{unnamed.unknown_place} explains more than {', '.join(names)}"
    return unnamed.answered("unknown", (), 1.0 - naming.odds[""], reason)


def learned_forces(
    config: Config, recordings: Sequence[Recording]
) -> dict[str, tuple[float, float]]:
    """Return by what pressure and motion differ on the drives of a match.

    All effects on the heat at once, none of them believed, and all of
    :data:`STEADY`: together they describe the friction of this car, its
    resistances and its sensors.

    Args:
        config: the vehicle as matched.
        recordings: the drives.

    Returns:
        Strength and standard deviation by name; none where a drive shows no
        force, or no pressure.
    """
    matched = [one.model_copy(update={"forces": {}}) for one in config.matched]
    config = config.model_copy(update={"matched": matched})
    try:
        comparison = ForceComparison(config, recordings)
    except LogError:
        return {}
    known, _ = linearised(comparison)
    named = [one for one in known.signatures if one.name not in SCALE]
    if not named:
        return {}
    columns = [one.linear for one in named]
    scales = dict.fromkeys((one.name for one in named), 1.0)
    for name, column_n in comparison.steady_n.items():
        scales[name], _ = STEADY[name]
        columns.append(comparison.layout.whiten(scales[name] * column_n))
    # what is alike on all drives is learned: the days and an engine are left
    apart = [one.name not in STEADY for one in comparison.tunables]
    project = Projector(known.jacobian[:, apart], comparison.prior[apart])
    terms = fit_terms(
        project, known.residual, np.column_stack(columns), LEARNED
    )
    deviations = np.sqrt(np.diag(terms.covariance))
    return {
        name: (short(scale * strength), short(scale * deviation))
        for (name, scale), strength, deviation in zip(
            scales.items(),
            terms.strengths.tolist(),
            deviations.tolist(),
            strict=True,
        )
    }


def linearised(
    comparison: ForceComparison,
) -> tuple[Linearised, dict[str, str]]:
    """Return the whitened residual and what effects change in it.

    And why an effect is not among them, by name.
    """
    layout, mass = comparison.layout, comparison.vehicle.mass_kg
    found, unseen = [], {}
    for name in (*candidates(comparison.config), *comparison.trials):
        if why := _unseen(comparison, name):
            unseen[name] = why
            continue
        change = comparison.changed_n(name)
        if float(np.abs(change).max()) < SILENT_MS2 * mass:
            unseen[name] = "changes no force of these drives"
            continue
        white = layout.whiten(change)
        most = FOURFOLD if is_change(name) else largest(name)
        found.append(
            Signature(
                *(name, white, 0.0 * white, change, either_sign(name)),
                most=most,
            )
        )
    residual = layout.whiten(comparison.base_n)
    jacobian = layout.whiten(comparison.jacobian_n)
    return Linearised(residual, jacobian, tuple(found), (), ()), unseen


def _unseen(comparison: ForceComparison, name: str) -> str:
    """Say why no force can show *name*, nothing where one can."""
    if is_change(name):
        return ""
    if effect_class(name).kind != "heat":
        return "moves temperatures only: needs a thermocouple"
    if name == "brake_share":
        return "leaves the force of the whole car as it is"
    if name == "brake_without_pressure" and not comparison.knows_released:
        return "neither pressure nor brake switch on the bus"
    return ""


def _strengths(
    comparison: ForceComparison, known: Linearised, names: Sequence[str]
) -> tuple[dict[str, float], dict[str, float]]:
    """Return strengths of *names* fitted together, and their deviations.

    What their forms are off by is in the deviations.
    """
    if not names:
        return {}, {}
    by_name = {one.name: one for one in known.signatures}
    columns = np.column_stack([by_name[name].linear for name in names])
    project = Projector(known.jacobian, comparison.prior)
    terms = fit_terms(project, known.residual, columns, FREE)
    strengths, deviations = {}, {}
    for i, name in enumerate(names):
        least, most = _bounds(name)
        a = float(np.clip(terms.strengths[i], least, most))
        noise = terms.covariance[i, i] ** 0.5
        strengths[name] = a
        deviations[name] = float(np.hypot(noise, FORM_ERROR * a))
    return strengths, deviations


GROWTH: Final = expm1(STEP * CHANGE) / CHANGE
"""Share by which forces have more of a change, for each unit of strength."""


def _logarithm(name: str, linear: float) -> float:
    """Return the strength of *name* whose factor is the *linear* one's."""
    if not is_change(name):
        return linear
    least = exp(-STEP * LARGEST)
    return log(max(1.0 + GROWTH * linear, least)) / STEP


def _slope(name: str, linear: float) -> float:
    """Return what :func:`_logarithm` makes of a small change of *linear*."""
    if not is_change(name):
        return 1.0
    return GROWTH / (STEP * exp(STEP * _logarithm(name, linear)))


def _in_logarithms(one: Candidate) -> Candidate:
    return replace(
        one,
        strength=_logarithm(one.name, one.strength),
        deviation=one.deviation * _slope(one.name, one.strength),
    )


def _bounds(name: str) -> tuple[float, float]:
    if is_change(name):
        return -LARGEST, LARGEST
    bounds = effect_class(name).parameters()[0]
    return bounds.lower, bounds.upper


def _at_bound(name: str, strength: float) -> bool:
    least, most = _bounds(name)
    return not least < strength < most


def _errors(
    config: Config,
    recordings: Sequence[Recording],
    strengths: dict[str, float],
) -> tuple[float, float]:
    """Return RMS errors of the acceleration [m/s2], without and with.

    The nuisances are fitted in both; white noise is taken off.
    """
    comparison = ForceComparison(config, recordings)
    mass = comparison.vehicle.mass_kg
    white = comparison.layout.noise["force"].white_k
    project = Projector(
        comparison.layout.whiten(comparison.jacobian_n), comparison.prior
    )
    found = []
    for effects in ({}, strengths):
        apart = comparison.base_n
        for name, strength in effects.items():
            apart = apart + strength * comparison.changed_n(name)
        tunables = project.nuisance(comparison.layout.whiten(apart))
        left = apart + comparison.jacobian_n @ tunables
        power = float(np.mean(left**2)) - white**2
        found.append(max(power, 0.0) ** 0.5 / mass)
    return found[0], found[1]


def _work(comparison: ForceComparison) -> tuple[float, float]:
    """Return the work of pressure and of motion while braking [J]."""
    pressed = comparison.column("whole_n")
    motion = comparison.column("motion_n")
    braked = (comparison.column("braked") > 0.0) | (
        motion > comparison.config.heat.brake_on_force_n
    )
    metres = comparison.column("metres")
    return (
        float(np.sum((pressed * metres)[braked])),
        float(np.sum((motion * metres)[braked])),
    )

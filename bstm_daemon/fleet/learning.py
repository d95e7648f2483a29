"""What cars of one type show together: effects, values, the odd car out.

The search of a car leaves, of the strength a of an effect, the log-likelihood
``score a - information a^2 / 2`` against none. Cars that have an effect of
their type differ from its strength m by a normal spread t m, over which each
car integrates in closed form; m and t are summed on a grid. Against that
stands that each car has nothing, or any one effect of its own. What matched
cars say of a further one is written as a configuration.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from bstm_daemon.analysis.gap import evidence, joint_effects
from bstm_daemon.analysis.gap.changes import either_sign, is_change, is_listed
from bstm_daemon.analysis.gap.naming import GATE_NOTHING, GATE_Z, SURE
from bstm_daemon.analysis.identify.writing import (
    Change,
    Entries,
    write_changed,
)
from bstm_daemon.analysis.matching.changes import value_changes
from bstm_daemon.analysis.matching.learned import settings_of, short
from bstm_daemon.analysis.matching.targets import targets_of
from bstm_daemon.analysis.matching.tunables import NODES_MS, TUNABLES, Target
from bstm_daemon.analysis.statistics.evidence import FREE
from bstm_daemon.analysis.statistics.series import Column, Matrix
from bstm_daemon.config.estimates import MatchedConfig, PriorsConfig
from bstm_daemon.config.reading import load_config
from bstm_daemon.model.effects.catalogue import effect_class

SPREADS: Final = np.array([0.03, 0.1, 0.3])
"""Standard deviation of the cars' strengths over that of the type. More would
be no strength of a type: cars without the effect would count as weak ones."""

CARRIES: Final = 3.0
"""Log Bayes factor from which a car carries the evidence: strong (Kass and
Raftery, 1995)."""

FORM_CORRELATION: Final = 0.25
"""Of the errors of two cars of a type: what the form of the model leaves is
alike in them, so that pooled scores are divided by the design effect."""

ODD: Final = 3.5
"""Standard deviations of the other cars from which one is the odd one out."""

LEAST_CARS: Final = 4
UNEXPLAINED: Final = frozenset({"unknown", "composed"})
"""Answers that no effect of the catalogue explains what a car shows."""

TINY: Final = 1e-12

SENSORS: Final = frozenset({"accelerometer_bias", "powertrain_torque_error"})
"""Effects on the heat that are errors of a sensor."""


class Searched(NamedTuple):
    """What the search of one car left: its answer, and the equations."""

    car: str
    answer: str
    equations: joint_effects.NormalEquations


@dataclass(frozen=True, slots=True)
class Finding:
    """What cars of a type lack or have changed.

    ``names`` are one effect, several that the cars can not separate, the
    likeliest first, or none where no effect explains it. ``scope`` is
    ``type``, ``car`` or ``sensor``; ``strengths`` with their deviations are
    of the cars that have it, of which ``carriers`` show it by themselves.
    ``strength``, ``deviation`` and ``spread`` are the type's.
    """

    names: tuple[str, ...]
    scope: str
    carriers: tuple[str, ...]
    probability: float
    strength: float
    deviation: float
    spread: float
    strengths: dict[str, tuple[float, float]]


class Pooled(NamedTuple):
    """One effect over n cars: log Bayes factors against none of it.

    ``common`` of one strength for all, ``own`` (n,) of each car by itself;
    mean and standard deviation of the common strength, mean spread.
    """

    common: float
    own: Column
    strength: float
    deviation: float
    spread: float


def pool(name: str, score: Column, information: Column) -> Pooled:
    """Return what cars, (n,) each, say of the effect *name*."""
    grid, weights = evidence.strength_prior(
        either_sign=either_sign(name), even=is_change(name)
    )
    m, t = (part.ravel() for part in np.meshgrid(grid, SPREADS))
    prior = np.log(np.tile(weights, len(SPREADS)) / len(SPREADS))
    s, g = score[:, None], information[:, None]
    variance = (t * m) ** 2
    free = 1.0 + g * variance
    logs = (s * m + 0.5 * s**2 * variance - 0.5 * g * m**2) / free
    logs = logs - 0.5 * np.log(free)
    together = prior + logs.sum(axis=0)
    common = float(np.logaddexp.reduce(together))
    share = np.exp(together - common)
    strength = float(share @ m)
    deviation = float(np.sqrt(max(share @ m**2 - strength**2, 0.0)))
    own = np.logaddexp.reduce(prior + logs, axis=1)
    return Pooled(common, own, strength, deviation, float(share @ t))


def learn(cars: Sequence[Searched]) -> list[Finding]:
    """Return what *cars* of one type show, the plainest first.

    What is found is integrated out before the next is looked for.
    """
    names = sorted({n for one in cars for n in one.equations.names})
    score = np.zeros((len(cars), len(names)))
    information = np.zeros((len(cars), len(names), len(names)))
    costs = np.zeros_like(score)
    for i, one in enumerate(cars):
        # what a car's drives do not excite stays 0
        at = [names.index(name) for name in one.equations.names]
        score[i, at] = one.equations.score
        information[i][np.ix_(at, at)] = one.equations.information
        costs[i, at] = one.equations.form_cost
    first = np.zeros(len(cars))
    found: dict[str, Finding] = {}
    while len(cars) > 1 and names:
        best = _best(cars, names, (score, information, costs), first)
        if best is None:
            break
        finding, which, members = best
        if known := found.get(names[which]):
            finding = replace(
                known,
                carriers=(*dict.fromkeys(known.carriers + finding.carriers),),
                strengths=known.strengths | finding.strengths,
            )
        found[names[which]] = finding
        for i in members:
            own = max(information[i, which, which], TINY)
            first[i] = max(first[i], 0.5 * score[i, which] ** 2 / own)
            column = information[i, :, which] / (own + FREE**-2)
            # where no effect explains it, none is looked for beside
            keep = 1.0 if finding.names else 0.0
            information[i] -= np.outer(column, information[i, which])
            information[i] *= keep
            score[i] = keep * (score[i] - column * score[i, which])
    return [_scoped(one, len(cars)) for one in found.values()]


def _best(
    cars: Sequence[Searched],
    names: Sequence[str],
    equations: tuple[Matrix, Matrix, Matrix],
    first: Column,
) -> tuple[Finding, int, list[int]] | None:
    """Return the plainest finding, its effect and the cars that have it."""
    score, information, costs = equations
    g = np.maximum(np.diagonal(information, axis1=1, axis2=2), TINY)
    gains = 0.5 * score**2 / g
    pooled = [pool(n, score[:, k], g[:, k]) for k, n in enumerate(names)]
    own = np.array([one.own for one in pooled]).T - costs
    together = np.array([one.common for one in pooled]) - costs.sum(axis=0)
    count = np.log(2.0 * len(names))
    # of each car, as likely before data: nothing, or any one effect
    of_any = np.logaddexp.reduce(own, axis=1)
    background = np.logaddexp(0.0, of_any - np.log(len(names)))
    # so is of the type: nothing, or any one
    common = together - np.log(len(names)) - background.sum()
    is_common = (
        (common > np.log(SURE / (1.0 - SURE)))
        & (together - count > -np.log(GATE_NOTHING))
        & (_pooled_z(score, g) >= GATE_Z)
        & (gains.sum(axis=0) >= joint_effects.NEXT_SHARE * first.sum())
    )
    least_z = np.where(first > 0.0, joint_effects.NEXT_Z, GATE_Z)[:, None]
    plain = (
        (own - count > -np.log(GATE_NOTHING))
        & (own - of_any[:, None] > np.log(1.0 - SURE))
        & (np.sqrt(2.0 * gains) >= least_z)
        & (gains >= joint_effects.NEXT_SHARE * first[:, None])
    )
    has_it = plain | is_common
    total = (gains * has_it).sum(axis=0)
    k = int(np.argmax(total))
    if total[k] == 0.0:
        return None
    members = np.flatnonzero(has_it[:, k]).tolist()
    carriers = [i for i in members if own[i, k] >= CARRIES]
    logs = together if is_common[k] else own[members].sum(axis=0)
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    order = np.argsort(-shares)
    alike = order[: int(np.searchsorted(np.cumsum(shares[order]), SURE)) + 1]
    probability = float(shares[alike].sum())
    if is_common[k]:
        probability /= 1.0 + float(np.exp(-common[k]))
    unexplained = sum(cars[i].answer in UNEXPLAINED for i in carriers)
    one = pooled[k]
    finding = Finding(
        ()
        if 2 * unexplained > len(carriers)
        else tuple(names[i] for i in alike),
        "type" if is_common[k] else "car",
        tuple(cars[i].car for i in carriers),
        min(probability, 1.0),
        *(one.strength, one.deviation, one.spread),
        {
            cars[i].car: (float(score[i, k] / g[i, k]), float(g[i, k] ** -0.5))
            for i in members
            if g[i, k] > TINY
        },
    )
    return finding, k, members


def _pooled_z(score: Matrix, information: Matrix) -> Column:
    """Return the scores (k,) of all cars in standard deviations.

    Divided by the design effect of errors that are alike.
    """
    whole = information.sum(axis=0)
    cars = np.sqrt(information).sum(axis=0) ** 2 / whole
    design = 1.0 + (cars - 1.0) * FORM_CORRELATION
    return np.asarray(np.abs(score.sum(axis=0)) / np.sqrt(whole * design))


def _scoped(one: Finding, count: int) -> Finding:
    """Return *one*: the type's where all its cars have it; or a sensor's."""
    if one.scope == "type" or len(one.strengths) == count:
        return replace(one, scope="type")
    name = next(iter(one.names), "")
    sensor = name in SENSORS or (
        name != ""
        and is_listed(name)
        and effect_class(name).kind == "measurement"
    )
    return replace(one, scope="sensor") if sensor else one


def type_prior(
    logs: Column, deviations: Column, usual: float
) -> tuple[float, float]:
    """Return the value of a type's next car and its standard deviation.

    Args:
        logs: of the value in each matched car, (n,).
        deviations: of these, by their matches.
        usual: deviation that cars of one design have without any match; it
            counts as two cars, so that few that agree do not promise too much.
    """
    tried = usual * np.geomspace(0.02, 3.0, 60)
    weights = 1.0 / (deviations**2 + tried[:, None] ** 2)
    total = weights.sum(axis=1)
    means = weights @ logs / total
    cost = 0.5 * (weights * (logs - means[:, None]) ** 2).sum(axis=1)
    cost += 0.5 * (np.log(total) - np.log(weights).sum(axis=1))
    # scaled inverse chi-square with two degrees of freedom
    cost += 2.0 * np.log(tried) + (usual / tried) ** 2
    best = int(np.argmin(cost))
    return float(means[best]), float(
        np.hypot(tried[best], total[best] ** -0.5)
    )


def odd_ones(values: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Return the cars whose value differs from the others', and by how much.

    Args:
        values: value and standard deviation by car.

    Returns:
        Standard deviations by car. Few others say little about their own
        spread: of these more are asked for.
    """
    found: dict[str, float] = {}
    if len(values) < LEAST_CARS:
        return found
    for car, (value, deviation) in values.items():
        others = np.array([v for name, v in values.items() if name != car])
        count = len(others)
        noise = max(
            float(np.std(others[:, 0], ddof=1)), float(np.mean(others[:, 1]))
        )
        scale = np.hypot(deviation, noise * np.sqrt(1.0 + 1.0 / count))
        z = float((value - np.mean(others[:, 0])) / max(scale, TINY))
        # as Student's t grows where few estimate a spread
        if abs(z) >= ODD * (1.0 + 8.0 / count):
            found[car] = z
    return found


LEARNED: Final = 0.7
"""A value that a match knows no better than this share of its usual prior is
what the file had before: it says nothing of the type."""

LEAST_MATCHED: Final = 2


def write_prior(kind: str, configs: Sequence[Path], out: Path) -> int:
    """Write what the matched *configs* of the type *kind* share as *out*.

    The rest is as in the first of them, whose own match is left out.

    Returns:
        The number of matched cars; with fewer than two nothing is written.

    Raises:
        ConfigError: of a configuration.
        FileAccessError: one is unreadable or *out* unwritable.
    """
    cars = [(path, load_config(path)) for path in configs]
    cars = [(path, config) for path, config in cars if config.matched]
    if len(cars) < LEAST_MATCHED:
        return 0
    source, first = cars[0]
    origin = f"type {kind}, {len(cars)} cars"
    changes: list[Change] = []
    priors = []
    corners = [name for one in first.matched for name in one.corners]
    for target in targets_of(first, corners):
        entries = [each.matched_of(target.corners[0]) for _, each in cars]
        found = _values(target, [one for one in entries if one is not None])
        if not found:
            continue
        # of the table as factors
        values = {
            key: value / (target.setting(key) if key in NODES_MS else 1.0)
            for key, (value, _) in found.items()
        }
        after = target.changed(values)
        settings = settings_of(target, after, values)
        changes += value_changes(
            settings, dict.fromkeys(settings, origin), first, target.corners
        )
        priors.append(
            PriorsConfig(
                corners=list(target.corners),
                names=list(found),
                values=[short(after.setting(key)) for key in found],
                deviations=[short(sd) for _, sd in found.values()],
                cars=len(cars),
            )
        )
    if priors:
        entries_of_type = Entries(priors=priors)
        write_changed(source, out, changes, origin, entries=entries_of_type)
    return len(cars) if priors else 0


def _values(
    target: Target, entries: Sequence[MatchedConfig]
) -> dict[str, tuple[float, float]]:
    """Return value and deviation of its logarithm by key, for a next car."""
    known: dict[str, list[tuple[float, float]]] = {}
    for one in entries:
        for i, key in enumerate(one.names):
            deviation = float(np.linalg.norm(one.factor[i]))
            if key in TUNABLES and deviation < LEARNED * TUNABLES[key].prior:
                log = float(np.log(one.values[i]))
                known.setdefault(key, []).append((log, deviation))
    found = {}
    for key, pairs in known.items():
        if len(pairs) >= LEAST_MATCHED and target.setting(key) > 0.0:
            logs, deviations = np.array(pairs).T
            prior = TUNABLES[key].prior
            mean, sd = type_prior(logs, deviations, prior)
            found[key] = float(np.exp(mean)), min(sd, prior)
    return found

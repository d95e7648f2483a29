"""What cars of one type show together: effects, values, the odd car out.

The search of a car leaves, of the strength a of an effect, the log-likelihood
``score a - information a^2 / 2`` against none. Cars that have an effect of
their type differ from its strength m by a normal spread t m, over which each
car integrates in closed form; m and t are summed on a grid. Against that
stands that each car has the effect with a rate that nobody knows, and
strengths of its own; and that each has nothing, or anything else of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.gap.changes import either_sign, is_change
from bstm_daemon.analysis.gap.evidence import (
    NEXT_EVIDENCE,
    NEXT_SHARE,
    NEXT_Z,
    strength_prior,
)
from bstm_daemon.analysis.gap.naming import GATE_NOTHING, GATE_Z, SURE
from bstm_daemon.analysis.statistics.evidence import FREE
from bstm_daemon.model.effects.catalogue import effect_class

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.analysis.gap.evidence import NormalEquations
    from bstm_daemon.analysis.statistics.series import Column, Matrix

SPREADS: Final = np.array([0.03, 0.1, 0.3])
"""Standard deviation of the cars' strengths over that of the type. More would
be no strength of a type: cars without the effect would count as weak ones."""

RATES: Final = (np.arange(50) + 0.5) / 50
CARRIES: Final = 3.0
"""Log Bayes factor from which a car carries the evidence: strong (Kass and
Raftery, 1995); its negative speaks against the effect in this car."""

FORM_CORRELATION: Final = 0.25
"""Of the errors of two cars of a type: what the form of the model leaves is
alike in them, so that pooled scores are divided by the design effect."""

MOST: Final = 8
TINY: Final = 1e-12
ODD: Final = 3.5
"""Standard deviations of the other cars from which one is the odd one out."""

LEAST_CARS: Final = 4

SENSORS: Final = frozenset({"accelerometer_bias", "powertrain_torque_error"})
"""Effects on the heat that are errors of a sensor."""


@dataclass(frozen=True, slots=True, eq=False)
class Searched:
    """What the search of one car left: its answer, and the equations."""

    car: str
    answer: str
    equations: NormalEquations


@dataclass(frozen=True, slots=True)
class Finding:
    """What cars of a type lack or have changed.

    ``names`` are one effect, several that the cars can not separate, the
    likeliest first, or none where no effect explains it. ``scope`` is
    ``type``, ``car`` or ``sensor``, ``cars`` those that have it, all of them
    where the type does. ``carriers`` show it by themselves, ``against`` do
    not have it by themselves. ``strength`` and ``deviation`` are the type's,
    ``spread`` how far its cars differ; of single cars ``strengths`` are.
    """

    names: tuple[str, ...]
    scope: str
    cars: tuple[str, ...]
    carriers: tuple[str, ...]
    against: tuple[str, ...]
    probability: float
    strength: float
    deviation: float
    spread: float
    strengths: dict[str, tuple[float, float]]


@dataclass(frozen=True, slots=True, eq=False)
class Pooled:
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
    grid, weights = strength_prior(
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
    common = _log_sum(together)
    share = np.exp(together - common)
    strength = float(share @ m)
    return Pooled(
        common,
        np.array([_log_sum(prior + own) for own in logs]),
        strength,
        float(np.sqrt(max(share @ m**2 - strength**2, 0.0))),
        float(share @ t),
    )


def membership(
    own: Column, background: Column, among: int
) -> tuple[float, Column]:
    """Return the log Bayes factor of *some cars have it*, and which (n,).

    Args:
        own: log Bayes factors of the effect in each car, (n,).
        background: likewise of nothing, or anything of *among* effects.
        among: number of effects.
    """
    ratio = np.exp(np.clip(own - background, -500.0, 500.0))
    mixed = (1.0 - RATES[:, None]) + RATES[:, None] * ratio
    logs = np.log(mixed).sum(axis=1)
    some = _log_sum(logs) - float(np.log(len(RATES)))
    weights = np.exp(logs - logs.max())
    shared = (weights / weights.sum()) @ (RATES[:, None] * ratio / mixed)
    # what a car has of its own may be the same
    return some, shared + (1.0 - shared) * np.minimum(ratio / 2 / among, 1.0)


def learn(cars: Sequence[Searched]) -> list[Finding]:
    """Return what *cars* of one type show, best first.

    What is found is integrated out before the next is looked for.
    """
    names = sorted({n for one in cars for n in one.equations.names})
    score, information = _aligned(cars, names)
    first = np.zeros(len(cars))
    found: dict[str, Finding] = {}
    while len(found) < MOST:
        best = _best(cars, names, score, information, first)
        if best is None:
            break
        finding, which, members = best
        known = found.get(names[which])
        found[names[which]] = _joined(known, finding) if known else finding
        for i in members:
            own = max(information[i, which, which], TINY)
            first[i] = max(first[i], 0.5 * score[i, which] ** 2 / own)
            if not finding.names:
                score[i], information[i] = 0.0, 0.0
                continue
            column = information[i, :, which].copy()
            own += FREE**-2
            score[i] -= column * (score[i, which] / own)
            information[i] -= np.outer(column, column) / own
    return [_scoped(one, len(cars)) for one in found.values()]


def _aligned(
    cars: Sequence[Searched], names: Sequence[str]
) -> tuple[Matrix, Matrix]:
    """Return scores (n, k) and information (n, k, k), 0 where not excited."""
    score = np.zeros((len(cars), len(names)))
    information = np.zeros((len(cars), len(names), len(names)))
    for i, one in enumerate(cars):
        at = [names.index(name) for name in one.equations.names]
        score[i, at] = one.equations.score
        information[i][np.ix_(at, at)] = one.equations.information
    return score, information


def _best(
    cars: Sequence[Searched],
    names: Sequence[str],
    score: Matrix,
    information: Matrix,
    first: Column,
) -> tuple[Finding, int, list[int]] | None:
    """Return the plainest finding, its effect and the cars that have it."""
    own_g = np.maximum(np.diagonal(information, axis1=1, axis2=2), TINY)
    pooled = [
        pool(name, score[:, k], own_g[:, k]) for k, name in enumerate(names)
    ]
    own = np.array([one.own for one in pooled]).reshape(len(names), len(cars))
    # half nothing, half anything
    background = np.logaddexp(
        0.0, [_log_sum(one) - np.log(max(len(names), 1)) for one in own.T]
    ) - np.log(2.0)
    best, most = None, 0.0
    for k, one in enumerate(pooled):
        gain = 0.5 * score[:, k] ** 2 / own_g[:, k]
        some, shares = membership(one.own, background, len(names))
        least_z = np.where(first > 0.0, NEXT_Z, GATE_Z)
        plain = (
            (shares >= SURE)
            & (np.sqrt(2.0 * gain) >= least_z)
            & (one.own >= NEXT_EVIDENCE)
            & (gain >= NEXT_SHARE * first)
        )
        common = one.common - background.sum()
        is_common = (
            common > some
            and one.common - np.log(2 * len(names)) > -np.log(GATE_NOTHING)
            and _pooled_z(score[:, k], own_g[:, k]) >= GATE_Z
            and gain.sum() >= NEXT_SHARE * first.sum()
        )
        members = np.flatnonzero(plain | is_common).tolist()
        if len(cars) < 2 or not members or gain[members].sum() <= most:
            continue
        most = float(gain[members].sum())
        carriers = [i for i in members if one.own[i] >= CARRIES]
        logs = (
            np.array([each.common for each in pooled])
            if is_common
            else own[:, members].sum(axis=1)
        )
        probability = float(np.mean(shares[members]))
        if is_common:
            probability = 1.0 / (1.0 + float(np.exp(some - common)))
        unexplained = sum(cars[i].answer == "unknown" for i in carriers)
        alike, sure = _class(names, logs)
        best = (
            Finding(
                () if 2 * unexplained > len(carriers) else alike,
                "type" if is_common else "car",
                tuple(cars[i].car for i in members),
                tuple(cars[i].car for i in carriers),
                tuple(
                    car.car
                    for car, log in zip(cars, one.own, strict=True)
                    if log <= -CARRIES
                ),
                probability * sure,
                *(one.strength, one.deviation, one.spread),
                {
                    cars[i].car: (
                        float(score[i, k] / own_g[i, k]),
                        float(own_g[i, k] ** -0.5),
                    )
                    for i in (carriers if is_common else members)
                },
            ),
            k,
            members,
        )
    return best


def _class(
    names: Sequence[str], logs: Column
) -> tuple[tuple[str, ...], float]:
    """Return which *names* together are sure, and their probability."""
    shares = np.exp(logs - _log_sum(logs))
    order = np.argsort(-shares)
    count = int(np.searchsorted(np.cumsum(shares[order]), SURE)) + 1
    chosen = order[:count]
    return tuple(names[i] for i in chosen), float(shares[chosen].sum())


def _pooled_z(score: Column, information: Column) -> float:
    """Return the score of all cars in standard deviations.

    Divided by the design effect of errors that are alike.
    """
    cars = np.sqrt(information).sum() ** 2 / information.sum()
    design = 1.0 + (cars - 1.0) * FORM_CORRELATION
    return float(abs(score.sum()) / np.sqrt(information.sum() * design))


def _joined(one: Finding, other: Finding) -> Finding:
    """Return one finding of the same effect in the cars of both."""
    return replace(
        one,
        cars=(*one.cars, *other.cars),
        carriers=(*one.carriers, *other.carriers),
        probability=min(one.probability, other.probability),
        strengths=one.strengths | other.strengths,
        against=tuple(c for c in one.against if c not in other.cars),
    )


def _scoped(one: Finding, count: int) -> Finding:
    """Return *one*: the type's where all its cars have it; or a sensor's."""
    if len(set(one.cars)) == count:
        return replace(one, scope="type")
    name = next(iter(one.names), "")
    sensor = name in SENSORS or (
        name != ""
        and not is_change(name)
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


def _log_sum(logs: Column) -> float:
    return float(np.logaddexp.reduce(logs))

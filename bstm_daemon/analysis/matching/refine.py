"""The joint refinement: all tunables over all drives on the whole model.

How far it lies off on drives that it was not matched to: each drive in turn is
left out, the others are fitted, and what is left on it is the discrepancy of
sensor, heat and form of the model together. A fit's own covariance knows of
the last only through drives it has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.matching.drives import GRID_S
from bstm_daemon.analysis.matching.problem import (
    FIRST,
    MOST_POINTS,
    OTHER,
    POINT_S,
    Problem,
    whole_drives,
)
from bstm_daemon.analysis.matching.tunables import SIDES, of_side
from bstm_daemon.analysis.statistics.levenberg_marquardt import minimise
from bstm_daemon.analysis.statistics.series import Column, rms, white_std
from bstm_daemon.analysis.statistics.whitening import DRIFT_S, SensorNoise

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.tunables import Target

    Errors = dict[str, list[tuple[Column, Column]]]
    """Error and rise above the air of each thermocouple by node."""

ROUNDS: Final = 3
"""Fits, each with the noise that the one before has shown."""

LEAST_K: Final = 0.5
"""No sensor, no model and no estimate is better."""

LARGEST: Final = 1.5
"""Drift is at most so many times the first guess: else a node that the model
misses would be believed less from round to round, and missed the more."""


WEIGHED: Final = 0.5
"""Share of the drift that residuals show by which a fit weighs them. With all
of it the priors keep what the values could take away, and so the drift: in a
car of another simulator disc and fluid then err half as much again on drives
left out. With less the fluid of the own reality errs more."""


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """The joint fit.

    ``values`` by key; ``covariance`` (p, p) is that of their logarithms,
    priors included, ``information`` (p, p) without them. ``at_bound`` lists
    keys that a bound holds. ``rms_k`` is by node and ``noise`` what
    residuals showed; ``misfit``, 1 or more, is their mean square over that of
    this noise.
    """

    keys: tuple[str, ...]
    start: dict[str, float]
    values: dict[str, float]
    prior: Column
    covariance: Column
    information: Column
    at_bound: tuple[str, ...]
    noise: Mapping[str, SensorNoise]
    rms_k: dict[str, float]
    points: int
    evaluations: int
    misfit: float = 1.0

    def of_side(self, corner: str, rms_k: dict[str, float]) -> Refinement:
        """Return it for *corner*, of sides that have values of their own."""
        keys = tuple(key for key in self.keys if key not in SIDES)
        kept = [self.keys.index(key) for key in keys]
        columns = [
            of_side(dict(zip(self.keys, one, strict=True)), corner)
            for one in np.exp(np.eye(len(self.keys))).tolist()
        ]
        rows = np.log([[one[key] for one in columns] for key in keys])
        covariance = rows @ self.covariance @ rows.T
        prior = np.sqrt(rows**2 @ self.prior**2)
        return replace(
            self,
            keys=keys,
            start={key: self.start[key] for key in keys},
            values=of_side(self.values, corner),
            prior=prior,
            covariance=covariance,
            information=self.information[np.ix_(kept, kept)],
            at_bound=tuple(key for key in self.at_bound if key in keys),
            rms_k=rms_k,
        )

    def standard_deviation(self, key: str) -> float:
        """Return the standard deviation of the value itself."""
        i = self.keys.index(key)
        return self.values[key] * float(np.sqrt(self.covariance[i, i]))


def refine(  # noqa: PLR0913
    target: Target,
    drives: Sequence[Drive],
    keys: Sequence[str],
    progress: Callable[[float], None] | None = None,
    *,
    start: Mapping[str, float] | None = None,
    noise: Mapping[str, SensorNoise] | None = None,
    rounds: int = ROUNDS,
    point_s: float = POINT_S,
    most_points: int = MOST_POINTS,
) -> Refinement:
    """Fit *keys* of *target* to all of *drives*.

    Args:
        target: the corners; priors lie around their values.
        drives: the drives.
        keys: the tunables.
        progress: called with the share that is done.
        start: values to begin from, by key; else those of *target*.
        noise: what is known of residuals, by node.
        rounds: fits, after each but the last the noise is learned.
        point_s: least time between two points that count.
        most_points: of a thermocouple over a drive, at most.
    """
    runs, terms = whole_drives(
        target, drives, point_s=point_s, most_points=most_points
    )
    problem = Problem(target, drives, keys, runs, terms, noise or {})
    shown = problem.noise
    if noise:
        problem.set_noise(_weighing(shown))
    x = problem.start.copy()
    for i, key in enumerate(keys):
        if start is not None and key in start:
            x[i] = np.log(start[key])
    evaluations = 0
    for number in range(rounds):

        def show(iteration: int, _: float, number: int = number) -> None:
            if progress is not None:
                progress((number + min(iteration / 6.0, 1.0)) / rounds)

        found = minimise(problem, x, problem.lower, problem.upper, show)
        x = found.x
        evaluations += found.evaluations
        if number < rounds - 1:
            apart = [one[:, 0] for one in problem.residuals_k(x[None])]
            shown = {
                node: learned(_first(shown[node], node), own)
                for node, own in _by_node(problem, apart).items()
            }
            problem.set_noise(_weighing(shown))
    apart = [one[:, 0] for one in problem.residuals_k(x[None])]
    # how well values are known is a matter of the whole noise
    white = np.column_stack((found.jacobian, found.residuals))
    white, priors = white[: -len(keys)], found.jacobian[-len(keys) :]
    white = problem.rewhitened(white, shown)
    data, left = white[:, :-1], white[:, -1]
    information = data.T @ data
    precision = information + priors.T @ priors
    return Refinement(
        tuple(keys),
        problem.values(problem.start),
        problem.values(x),
        np.asarray(problem.prior, np.float64),
        np.asarray(np.linalg.inv(precision), np.float64),
        information,
        tuple(
            key for key, held in zip(keys, found.at_bound, strict=True) if held
        ),
        shown,
        {
            node: rms(np.concatenate([one for one, _ in own]))
            for node, own in sorted(_by_node(problem, apart).items())
        },
        sum(len(term.steps) for term in terms),
        evaluations,
        max(float(np.mean(left**2)), 1.0),
    )


def _weighing(
    shown: Mapping[str, SensorNoise],
) -> dict[str, SensorNoise]:
    """Return the noise by node that a fit weighs residuals with."""
    return {node: one.scaled(WEIGHED, 1.0) for node, one in shown.items()}


def _first(noise: SensorNoise, node: str) -> SensorNoise:
    """Return what is believed of *node* before residuals, lag as known."""
    return replace(
        FIRST.get(node, OTHER), lag_s=noise.lag_s, quick_s=noise.quick_s
    )


def _by_node(
    problem: Problem, apart: Sequence[Column]
) -> dict[str, list[tuple[Column, Column]]]:
    """Return residuals and times of each series, by node."""
    found: dict[str, list[tuple[Column, Column]]] = {}
    for one, term in zip(apart, problem.terms, strict=True):
        found.setdefault(term.node, []).append((one, term.time_s))
    return found


def learned(
    noise: SensorNoise, series: Sequence[tuple[Column, Column]]
) -> SensorNoise:
    """Return *noise* with what a fit's residuals and times show, (n,) each."""
    total = np.concatenate([one for one, _ in series])
    steps = np.concatenate(
        [np.diff(one)[np.diff(at) < DRIFT_S / 10.0] for one, at in series]
    )
    # jumps at stops are drift of the model, not noise
    white = white_std(steps, 1) if len(steps) else 1.0
    drift_2 = float(np.mean(total**2)) - white**2
    return replace(
        noise,
        white_k=max(white, LEAST_K),
        drift_k=min(max(drift_2, LEAST_K**2) ** 0.5, LARGEST * noise.drift_k),
    )


@dataclass(frozen=True, slots=True)
class NodeAccuracy:
    """Standard deviation of an estimate.

    ``floor_k`` and ``share`` of the rise above the air, in quadrature.
    """

    floor_k: float
    share: float

    def deviation_k(self, rise_k: Column) -> Column:
        """Return the standard deviation at *rise_k* above the air, (n,)."""
        return np.asarray(np.hypot(self.floor_k, self.share * rise_k))


@dataclass(frozen=True, slots=True)
class Accuracy:
    """By node, from what was left out of the fit.

    ``drives`` were left out in turn, 0: a part of the only one, named in
    ``left_out``; where that is empty, nothing could be. ``before_k`` and
    ``rms_k`` are the RMS there, as configured and fitted without it, and
    ``baseline_k`` that of a disc of one node fitted to the same; ``each_k``
    is ``rms_k`` of each thing left out, ``peaks_k`` the largest error there
    in either direction. ``shifts`` (k, p) are how far the
    logarithms of the values lay off without it.
    """

    nodes: Mapping[str, NodeAccuracy]
    drives: int
    left_out: str
    before_k: Mapping[str, float]
    rms_k: Mapping[str, float]
    baseline_k: float = np.nan
    shifts: Column = field(default_factory=lambda: np.zeros((0, 0)))
    each_k: tuple[Mapping[str, float], ...] = ()
    peaks_k: tuple[Mapping[str, float], ...] = ()


LEAST_S: Final = 240.0
"""A shorter drive has no part to leave out."""

HELD_SHARE: Final = 1.0 / 3.0
"""Last part of a single drive that is left out."""

Piece = tuple[int, slice]
"""Number of a drive, and its steps."""


def folds_of(drives: Sequence[Drive]) -> list[tuple[list[Piece], Piece]]:
    """Return what is fitted and what is left out, once for each way.

    Each drive in turn; of a single one its last third, if it is long enough.
    """
    whole = slice(None)
    if len(drives) > 1:
        every = range(len(drives))
        return [
            ([(i, whole) for i in every if i != j], (j, whole)) for j in every
        ]
    steps = len(drives[0])
    if drives[0].duration_s < LEAST_S:
        return []
    cut = round((1.0 - HELD_SHARE) * steps)
    return [([(0, slice(0, cut))], (0, slice(cut, steps)))]


def errors_of(target: Target, drive: Drive) -> Errors:
    """Return error and rise above the air of each thermocouple by node."""
    runs, terms = whole_drives(
        target, [drive], point_s=GRID_S, most_points=len(drive)
    )
    problem = Problem(target, [drive], (), runs, terms, None)
    found: Errors = {}
    for term, apart in zip(
        terms, problem.residuals_k(np.zeros((1, 0))), strict=True
    ):
        found.setdefault(term.node, []).append((apart[:, 0], term.rise_k))
    return found


def white_k(fit: Refinement, node: str) -> float:
    """Return the thermocouple's own noise [K], none of the estimate's."""
    usual = FIRST.get(node, OTHER).white_k
    return min(fit.noise[node].white_k, usual) if node in fit.noise else usual


def rms_of(errors: Errors) -> dict[str, float]:
    """Return the RMS of errors as of :func:`errors_of`, by node."""
    return {
        node: rms(np.concatenate([error for error, *_ in parts]))
        for node, parts in sorted(errors.items())
    }


def peaks_of(errors: Errors) -> dict[str, float]:
    """Return the largest of errors as of :func:`errors_of`, by node."""
    return {
        node: max(float(np.abs(error).max()) for error, _ in parts)
        for node, parts in errors.items()
    }


def fitted(parts: Sequence[tuple[Column, Column, float]]) -> NodeAccuracy:
    """Fit floor and share to errors, rises and white noise, one a series.

    Errors squared are a straight line over the rise squared, neither part
    below 0; white noise of the thermocouple is not the estimate's.
    """
    error_2 = np.concatenate([e**2 - w**2 for e, _, w in parts])
    rise_2 = np.concatenate([rise**2 for _, rise, _ in parts])
    spread = float(np.mean((rise_2 - rise_2.mean()) ** 2))
    slope = 0.0
    if spread > 0.0:
        covariance = np.mean((rise_2 - rise_2.mean()) * error_2)
        slope = max(float(covariance) / spread, 0.0)
    floor = float(np.mean(error_2)) - slope * float(np.mean(rise_2))
    if floor < LEAST_K**2:
        floor = LEAST_K**2
        slope = max(float(np.mean(error_2)) - floor, 0.0) / max(
            float(np.mean(rise_2)), 1.0
        )
    return NodeAccuracy(floor**0.5, slope**0.5)

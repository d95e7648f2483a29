"""The joint refinement: all tunables over all drives on the whole model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.matching.least_squares import minimise
from bstm_daemon.matching.noise import FIRST, OTHER, learned
from bstm_daemon.matching.problem import Problem, whole_drives

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bstm_daemon.matching.drives import Column, Drive
    from bstm_daemon.matching.noise import Noise
    from bstm_daemon.matching.tunables import Target

ROUNDS: Final = 3
"""Fits, each with the noise that the one before has shown."""


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """The joint fit.

    ``values`` by key; ``covariance`` (p, p) is that of their logarithms,
    priors included, ``information`` (p, p) without them. ``at_bound`` lists
    keys that a bound holds. ``rms_k`` is by node and ``noise`` what
    residuals showed.
    """

    keys: tuple[str, ...]
    start: dict[str, float]
    values: dict[str, float]
    prior: Column
    covariance: Column
    information: Column
    at_bound: tuple[str, ...]
    noise: Mapping[str, Noise]
    rms_k: dict[str, float]
    points: int
    evaluations: int

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
    noise: Mapping[str, Noise] | None = None,
    rounds: int = ROUNDS,
) -> Refinement:
    """Fit *keys* of *target* to all of *drives*.

    Args:
        target: the corners; priors lie around their values.
        drives: the drives.
        keys: the tunables.
        progress: told the share that is done.
        start: values to begin from, by key; else those of *target*.
        noise: what is known of residuals, by node.
        rounds: fits, after each but the last the noise is learned.
    """
    runs, terms = whole_drives(target, drives)
    problem = Problem(target, drives, keys, runs, terms, noise or {})
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
        apart = [one[:, 0] for one in problem.apart_k(x[None])]
        if number < rounds - 1:
            problem.set_noise(_learned(problem, apart))
    nodes = sorted({term.node for term in terms})
    data = found.jacobian[: -len(keys)]
    information = data.T @ data
    precision = information + np.diag(problem.prior**-2.0)
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
        problem.noise,
        {
            node: float(
                np.sqrt(
                    np.mean(
                        np.concatenate(
                            [
                                one**2
                                for one, term in zip(apart, terms, strict=True)
                                if term.node == node
                            ]
                        )
                    )
                )
            )
            for node in nodes
        },
        sum(len(term.steps) for term in terms),
        evaluations,
    )


def _learned(problem: Problem, apart: Sequence[Column]) -> dict[str, Noise]:
    nodes = {term.node for term in problem.terms}
    found = {}
    for node in nodes:
        own = [
            (one, term.time_s)
            for one, term in zip(apart, problem.terms, strict=True)
            if term.node == node
        ]
        first = FIRST.get(node, OTHER)
        found[node] = learned(
            first, [r for r, _ in own], [time for _, time in own]
        )
    return found

"""How large the noise of these very recordings is, node by node.

What is usual for a matched model is a guess. Here a factor on the slow part
of each node's noise (drift, form of the model) and one on its fast part
(white, quick) are those of greatest marginal likelihood, with everything that
could explain the residuals integrated out: the tunables, all effects of the
catalogue and heat without a name. So what is missing does not count as noise,
and what is noise need not be missing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.gap.layout import Layout, Series
    from bstm_daemon.gap.noise import NodeNoise
    from bstm_daemon.gap.signatures import Sensed
    from bstm_daemon.matching.drives import Column

FACTORS: Final = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6)
"""None below 1: the usual noise also is how effects of other forms than the
model's may look."""

WIDTH: Final = 0.7
"""Prior of the logarithm of a factor, about 0."""

FREEDOM: Final = 0.7
"""Prior standard deviation of the strength of each effect and heat."""

SWEEPS: Final = 2
EVERY: Final = 2
"""Points are thinned by it: what is sought are variances."""


@dataclass(frozen=True, slots=True)
class _Part:
    """What one series adds to the likelihood."""

    log_size: float
    square: float
    score: Column
    gram: Column


def calibrated(layout: Layout, sensed: Sensed) -> dict[str, NodeNoise]:
    """Return the noise by node that suits *sensed* best."""
    columns = np.column_stack(
        [
            sensed.jacobian_k,
            *(terms.sum(axis=0) for terms in sensed.terms_k.values()),
            *(one.change for one in sensed.unknown_k),
        ]
    )
    free = columns.shape[1] - len(layout.prior)
    prior = np.concatenate((layout.prior, np.full(free, FREEDOM)))
    columns = columns * prior
    noise = {one.node: layout.noise[one.node] for one in layout.series}
    picked = dict.fromkeys(noise, (1.0, 1.0))

    def parts_of(node: str, factors: tuple[float, float]) -> list[_Part]:
        changed = scaled(noise[node], *factors)
        return [
            _part(one, changed, sensed.base_k[own], columns[own])
            for one, own in _places(layout)
            if one.node == node
        ]

    parts = {node: parts_of(node, one) for node, one in picked.items()}
    best = _likelihood(parts) + _log_prior(picked)
    for _ in range(SWEEPS):
        before = best
        for node in noise:
            for which in range(2):
                for factor in FACTORS:
                    trial = list(picked[node])
                    if trial[which] == factor:
                        continue
                    trial[which] = factor
                    pair = (trial[0], trial[1])
                    new = {**parts, node: parts_of(node, pair)}
                    value = _likelihood(new) + _log_prior(
                        {**picked, node: pair}
                    )
                    if value > best:
                        best, parts = value, new
                        picked = {**picked, node: pair}
        if best == before:
            break
    return {
        node: scaled(one, *picked[node]) if node in picked else one
        for node, one in layout.noise.items()
    }


def scaled(noise: NodeNoise, slow: float, fast: float) -> NodeNoise:
    """Return *noise* with its slow and its fast part larger by factors."""
    return replace(
        noise,
        white_k=noise.white_k * fast,
        quick_s=noise.quick_s * fast,
        floor_k=noise.floor_k * slow,
        share=noise.share * slow,
    )


def _places(layout: Layout) -> list[tuple[Series, slice]]:
    return [
        (one, slice(layout.edges[i], layout.edges[i + 1], EVERY))
        for i, one in enumerate(layout.series)
    ]


def _part(
    series: Series, noise: NodeNoise, residual: Column, columns: Column
) -> _Part:
    whole = noise.covariance(series.time_s, series.slope_k_s, series.rise_k)
    covariance = whole[::EVERY, ::EVERY]
    lower = np.linalg.cholesky(covariance)
    white = np.linalg.solve(lower, np.column_stack((residual, columns)))
    gram = white.T @ white
    return _Part(
        float(np.log(np.diag(lower)).sum()),
        float(gram[0, 0]),
        gram[1:, 0],
        gram[1:, 1:],
    )


def _likelihood(parts: Mapping[str, Sequence[_Part]]) -> float:
    flat = [one for own in parts.values() for one in own]
    gram = sum(one.gram for one in flat) + np.eye(len(flat[0].score))
    score = np.sum([one.score for one in flat], axis=0)
    explained = float(score @ np.linalg.solve(gram, score))
    square = sum(one.square for one in flat)
    return (
        -sum(one.log_size for one in flat)
        - 0.5 * float(np.linalg.slogdet(gram)[1])
        - 0.5 * (square - explained)
    )


def _log_prior(picked: Mapping[str, tuple[float, float]]) -> float:
    logs = np.log(list(picked.values())) / WIDTH
    return -0.5 * float(np.sum(logs**2))

"""Series of residuals, and how model and thermocouples err in them.

Apart from the model, so that residuals which were kept can be judged anew.

What is usual for a matched model is a guess. :func:`calibrated` finds a factor
on the slow part of each node's noise (drift, form of the model) and one on
its fast part (white, quick) from the recordings: those of greatest marginal
likelihood, with everything that could explain the residuals integrated out:
the tunables, all effects of the catalogue and heat without a name. So what is
missing does not count as noise, and what is noise need not be missing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product
from math import hypot
from typing import Final

import numpy as np

from bstm_daemon.analysis.matching.problem import Series
from bstm_daemon.analysis.matching.verification import accuracy_of
from bstm_daemon.analysis.statistics.series import Column, Matrix
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.config.estimates import MatchedConfig
from bstm_daemon.config.sections import Config


class Layout:
    """Series one after the other, their noise, and the tunables' priors.

    ``prior`` (p,) are standard deviations of logarithms, ``edges`` where the
    series begin and end, ``drive_names`` of the recordings.
    """

    def __init__(
        self,
        series: Sequence[Series],
        noise: Mapping[str, SensorNoise],
        prior: Column,
        drive_names: Sequence[str],
    ) -> None:
        """Take the series and what is known of them."""
        self.series = tuple(series)
        self.prior = prior
        self.drive_names = tuple(drive_names)
        self.set_noise(noise)
        sizes = [len(one.time_s) for one in self.series]
        self.edges = np.concatenate(([0], np.cumsum(sizes)))

    def set_noise(self, noise: Mapping[str, SensorNoise]) -> None:
        """Let residuals err by *noise*, by node."""
        self.noise = dict(noise)
        self._whiteners = [
            self.noise[one.node].whitener(
                one.time_s, one.slope_k_s, one.rise_k
            )
            for one in self.series
        ]

    def slices(self, drive: int) -> list[slice]:
        """Return where the points of *drive* are."""
        return [
            slice(self.edges[i], self.edges[i + 1])
            for i, one in enumerate(self.series)
            if one.drive == drive
        ]

    def whiten(self, apart_k: Column) -> Column:
        """Return *apart_k* (n, k) or (n,) with unit covariance."""
        parts = [
            whitener @ apart_k[self.edges[i] : self.edges[i + 1]]
            for i, whitener in enumerate(self._whiteners)
        ]
        return np.concatenate(parts)


USUAL: Final[dict[str, SensorNoise]] = {
    # a lumped disc has no surface: in stops it errs by seconds of its slope
    "disc": SensorNoise(1.5, 3.6, 0.024, 2.0, quick_s=3.4),
    "pad_front": SensorNoise(0.7, 2.4, 0.024, 3.0, quick_s=1.5),
    "pad_back": SensorNoise(0.7, 1.2, 0.016, 1.5, quick_s=1.5),
    "fluid": SensorNoise(1.0, 1.0, 0.01, 0.7),
}
"""Of a model matched to this car, by node, where ``[accuracy]`` is empty."""

OTHER: Final = SensorNoise(1.0, 4.0, 0.03, 3.0)
"""Of any other node."""

LEAST_K: Final = 0.5
LARGEST: Final = 2.0
"""Times the usual: ``[accuracy]`` of few drives is mostly what the tunables
do not know yet, and here they are fitted."""

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


def noise_of(
    config: Config, node: str, form: MatchedConfig | None = None
) -> SensorNoise:
    """Return the noise of *node*: what ``[accuracy]`` knows, else usual.

    With *form* drift is what the match itself left, at least the usual: a
    fit knows little of drives that it has not seen. What its values may be
    off by has their covariance.

    Offset and drift of the junctions add to what the model is off by.
    """
    known = config.accuracy
    found = USUAL.get(node, OTHER)
    if form is not None and node in form.form_k:
        found = replace(
            found,
            drift_k=max(form.form_k[node], found.drift_k),
            share=max(form.form_share.get(node, 0.0), found.share),
        )
    elif (own := accuracy_of(config, node)) is not None:
        found = replace(
            found,
            drift_k=min(max(own.floor_k, LEAST_K), LARGEST * found.drift_k),
            share=min(own.share, LARGEST * found.share),
        )
    return replace(
        found,
        offset_k=hypot(found.offset_k, known.thermocouple_offset_k),
        drift_k=hypot(found.drift_k, known.drift_beyond_usual_k()),
    )


@dataclass(frozen=True, slots=True)
class _Part:
    """What one series adds to the likelihood."""

    log_size: float
    square: float
    score: Column
    gram: Column


def calibrated(
    layout: Layout, residual_k: Column, columns_k: Matrix
) -> dict[str, SensorNoise]:
    """Return the noise by node that suits recordings best.

    Args:
        layout: where the residuals are, and the usual noise.
        residual_k: of the configured model, (n,).
        columns_k: what changes with each tunable, and with each effect and
            heat besides, (n, p + k).
    """
    free = columns_k.shape[1] - len(layout.prior)
    prior = np.concatenate((layout.prior, np.full(free, FREEDOM)))
    columns = columns_k * prior
    noise = {one.node: layout.noise[one.node] for one in layout.series}
    picked = dict.fromkeys(noise, (1.0, 1.0))
    places = [slice(*ends, EVERY) for ends in pairwise(layout.edges)]

    def parts_of(node: str, factors: tuple[float, float]) -> list[_Part]:
        changed = noise[node].scaled(*factors)
        return [
            _part(one, changed, residual_k[own], columns[own])
            for one, own in zip(layout.series, places, strict=True)
            if one.node == node
        ]

    parts = {node: parts_of(node, one) for node, one in picked.items()}
    best = _likelihood(parts) + _log_prior(picked)
    for _ in range(SWEEPS):
        before = best
        for node, slow, factor in product(noise, (True, False), FACTORS):
            was_slow, was_fast = picked[node]
            pair = (factor, was_fast) if slow else (was_slow, factor)
            if pair == picked[node]:
                continue
            new = {**parts, node: parts_of(node, pair)}
            trial = {**picked, node: pair}
            value = _likelihood(new) + _log_prior(trial)
            if value > best:
                best, parts, picked = value, new, trial
        if best == before:
            break
    return {
        node: one.scaled(*picked[node]) if node in picked else one
        for node, one in layout.noise.items()
    }


def _part(
    series: Series, noise: SensorNoise, residual: Column, columns: Column
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

"""Usual ways to pick effects, on the same cases and the same library.

All take residuals as white and independent, tunables fitted by least squares
without priors. They stand for what is common: the one effect with the lowest
error, forward selection by Akaike's criterion, and sequentially thresholded
least squares, the regression of SINDy (not the package itself).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bstm_daemon.gap.signatures import Sensed

MOST: Final = 3
THRESHOLD: Final = 0.1
"""Strength below which the thresholded regression drops an effect."""

ROUNDS: Final = 10
RIDGE: Final = 1e-6


def lowest_error(one: Sensed) -> list[str]:
    """Return the effect that leaves the lowest RMS, tunables re-fitted."""
    residual, columns = _projected(one)
    errors = {}
    for name, column in columns.items():
        a = -(column @ residual) / max(float(column @ column), 1e-12)
        if a > 0.0:
            errors[name] = float(np.sum((residual + a * column) ** 2))
    return [min(errors, key=lambda name: errors[name])] if errors else []


def forward_aic(one: Sensed) -> list[str]:
    """Return effects added as long as Akaike's criterion falls."""
    residual, columns = _projected(one)
    count = len(residual)
    chosen: list[str] = []
    best = count * np.log(residual @ residual / count)
    while len(chosen) < MOST:
        scores = {}
        for name in columns:
            if name in chosen:
                continue
            trial = np.column_stack([columns[n] for n in (*chosen, name)])
            a, *_ = np.linalg.lstsq(trial, -residual, rcond=None)
            if np.all(a > 0.0):
                left = residual + trial @ a
                scores[name] = count * np.log(left @ left / count) + 2.0 * (
                    len(chosen) + 1
                )
        if not scores or min(scores.values()) >= best:
            break
        name = min(scores, key=lambda key: scores[key])
        chosen.append(name)
        best = scores[name]
    return chosen


def thresholded(one: Sensed) -> list[str]:
    """Return what sequentially thresholded least squares keeps."""
    residual, columns = _projected(one)
    kept = list(columns)
    for _ in range(ROUNDS):
        if not kept:
            break
        matrix = np.column_stack([columns[name] for name in kept])
        gram = matrix.T @ matrix
        gram += RIDGE * np.trace(gram) / len(kept) * np.eye(len(kept))
        a = np.linalg.solve(gram, -matrix.T @ residual)
        left = [n for n, x in zip(kept, a, strict=True) if x > THRESHOLD]
        if left == kept:
            break
        kept = left
    return kept


RIVALS: Final[Mapping[str, Callable[[Sensed], list[str]]]] = {
    "lowest RMS": lowest_error,
    "forward AIC": forward_aic,
    "thresholded least squares": thresholded,
}


def _projected(one: Sensed) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return residuals and library [K] with the tunables taken out."""
    basis = np.linalg.qr(one.jacobian_k)[0]

    def free(values: np.ndarray) -> np.ndarray:
        return np.asarray(values - basis @ (basis.T @ values))

    return free(one.base_k), {
        name: free(terms.sum(axis=0)) for name, terms in one.terms_k.items()
    }

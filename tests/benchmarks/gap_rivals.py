"""Usual ways to pick effects, on the same cases and the same library.

All take residuals as white and independent, tunables fitted by least squares
without priors: the one effect with the lowest error, forward selection by
Akaike's criterion, and discrepancy SINDy (Kaheman and others 2019), the
sparse regression of pysindy on what the model's rates lack, alone and as an
ensemble. Without pysindy (extra ``benchmark``) its rows are missing.

SINDy fits time derivatives. White noise of 1 K between samples a second apart
is one of 1.4 K/s; what an effect lacks in a caliper moves it by 0.01 K/s. So
it gets the weak form, integrals of the rates over windows of some 40 s, of
residuals and of every effect alike. Its threshold is that of lowest BIC.
"""

from __future__ import annotations

import warnings
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from gap_cases import Evidence

    Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

MOST: Final = 3
THRESHOLDS: Final = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4, 2.0)
"""Strengths below which the sparse regression drops an effect."""

RIDGE: Final = 1e-3
"""Of its normalised library."""

WINDOW_POINTS: Final = 2
"""Residuals are kept every 18 to 21 s."""

MEMBERS: Final = 40
INCLUDED: Final = 0.6
"""Share of the ensemble that must hold an effect, as usual for E-SINDy."""


def lowest_error(one: Evidence) -> list[str]:
    """Return the effect that leaves the lowest RMS, tunables re-fitted."""
    residual, columns = _projected(one)
    errors = {}
    for name, column in columns.items():
        a = -(column @ residual) / max(float(column @ column), 1e-12)
        if a > 0.0:
            errors[name] = float(np.sum((residual + a * column) ** 2))
    return [min(errors, key=lambda name: errors[name])] if errors else []


def forward_aic(one: Evidence) -> list[str]:
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


def sindy(one: Evidence) -> list[str]:
    """Return what pysindy's thresholded least squares keeps."""
    rates, names, library = _weak(one)
    return _positive(names, _sparse(rates, library)[1])


def ensemble_sindy(one: Evidence) -> list[str]:
    """Return what most of an ensemble over windows keeps."""
    rates, names, library = _weak(one)
    pysindy = _pysindy()
    threshold, _ = _sparse(rates, library)
    optimizer = pysindy.EnsembleOptimizer(
        pysindy.STLSQ(threshold=threshold, alpha=RIDGE),
        bagging=True,
        n_models=MEMBERS,
    )
    # it draws from NumPy's global state
    np.random.seed(0)  # noqa: NPY002
    optimizer.fit(library, rates[:, None])
    members = np.array(optimizer.coef_list)[:, 0]
    often = (np.abs(members) > 0.0).mean(axis=0) >= INCLUDED
    return _positive(names, np.where(often, np.median(members, axis=0), 0.0))


LABELS: Final = (
    *("lowest RMS", "forward AIC"),
    *("SINDy (pysindy)", "E-SINDy (pysindy)"),
)
"""Of all, also of those that can not be asked here."""


def _rivals() -> dict[str, Callable[[Evidence], list[str]]]:
    ways = (lowest_error, forward_aic, sindy, ensemble_sindy)
    usable = len(ways) if find_spec("pysindy") is not None else 2
    return dict(zip(LABELS[:usable], ways[:usable], strict=True))


RIVALS: Final[Mapping[str, Callable[[Evidence], list[str]]]] = _rivals()


def _pysindy() -> Any:
    # no stubs, and not there with every benchmark
    return import_module("pysindy")


def _sparse(rates: Array, library: Array) -> tuple[float, Array]:
    """Return threshold and strengths (effects,) of the lowest BIC."""
    stlsq, count = _pysindy().STLSQ, len(rates)
    best, found = float("inf"), (THRESHOLDS[0], np.zeros(library.shape[1]))
    for threshold in THRESHOLDS:
        optimizer = stlsq(threshold=threshold, alpha=RIDGE)
        with warnings.catch_warnings():
            # that nothing is left is an answer here
            warnings.simplefilter("ignore")
            optimizer.fit(library, rates[:, None])
        strengths = optimizer.coef_[0]
        left = rates - library @ strengths
        bic = count * np.log(left @ left / count)
        bic += np.log(count) * np.count_nonzero(strengths)
        if bic < best:
            best, found = bic, (threshold, strengths)
    return found


def _projected(one: Evidence) -> tuple[Array, dict[str, Array]]:
    """Return residuals and library [K] with the tunables taken out."""
    whole = one.sensed
    free = _without(whole.jacobian_k)
    return free(whole.base_k), {
        name: free(terms.sum(axis=0)) for name, terms in whole.terms_k.items()
    }


def _weak(one: Evidence) -> tuple[Array, list[str], Array]:
    """Return what the model's rates lack, names, and the library.

    (windows,) [K] over a window and (windows, effects) [K] at strength 1,
    the tunables taken out of both.
    """
    whole = one.sensed
    names = list(whole.terms_k)
    columns = np.column_stack(
        [
            whole.base_k,
            whole.jacobian_k,
            *(whole.terms_k[name].sum(axis=0) for name in names),
        ]
    )
    parts, begin = [], 0
    for series in one.series:
        end = begin + len(series.time_s)
        parts.append(np.diff(columns[begin:end:WINDOW_POINTS], axis=0))
        begin = end
    rates = np.concatenate(parts)
    count = whole.jacobian_k.shape[1]
    free = _without(rates[:, 1 : 1 + count])
    return -free(rates[:, 0]), names, free(rates[:, 1 + count :])


def _without(jacobian: Array) -> Callable[[Array], Array]:
    basis = np.linalg.qr(jacobian)[0]

    def free(values: Array) -> Array:
        return np.asarray(values - basis @ (basis.T @ values))

    return free


def _positive(names: list[str], strengths: Array) -> list[str]:
    """Return the names of strengths above 0, the strongest first."""
    order = np.argsort(-strengths)
    return [names[i] for i in order if strengths[i] > 0.0]

"""Linear regression against certified values and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.analysis.statistics.gls import (
    correlation_inflation,
    fit_linear,
    solution_operator,
)

LONGLEY = """
60323 83.0 234289 2356 1590 107608 1947
61122 88.5 259426 2325 1456 108632 1948
60171 88.2 258054 3682 1616 109773 1949
61187 89.5 284599 3351 1650 110929 1950
63221 96.2 328975 2099 3099 112075 1951
63639 98.1 346999 1932 3594 113270 1952
64989 99.0 365385 1870 3547 115094 1953
63761 100.0 363112 3578 3350 116219 1954
66019 101.2 397469 2904 3048 117388 1955
67857 104.6 419180 2822 2857 118734 1956
68169 108.4 442769 2936 2798 120445 1957
66513 110.8 444546 4681 2637 121950 1958
68655 112.6 482704 3813 2552 123366 1959
69564 114.2 502601 3931 2514 125368 1960
69331 115.7 518173 4806 2572 127852 1961
70551 116.9 554894 4007 2827 130081 1962
"""
"""NIST Statistical Reference Datasets, Longley: higher difficulty."""

CERTIFIED = (
    (-3482258.63459582, 890420.383607373),
    (15.0618722713733, 84.9149257747669),
    (-0.358191792925910e-01, 0.334910077722432e-01),
    (-2.02022980381683, 0.488399681651699),
    (-1.03322686717359, 0.214274163161675),
    (-0.511041056535807e-01, 0.226073200069370),
    (1829.15146461355, 455.478499142212),
)
CERTIFIED_RESIDUAL = 304.854073561965


def test_longley() -> None:
    table = np.array([line.split() for line in LONGLEY.split("\n") if line])
    y, x = table[:, 0].astype(float), table[:, 1:].astype(float)
    fit = fit_linear(np.column_stack((np.ones(len(y)), x)), y)

    estimate, error = np.array(CERTIFIED).T
    assert fit.estimate == pytest.approx(estimate, rel=1e-7)
    assert np.sqrt(fit.variance) == pytest.approx(CERTIFIED_RESIDUAL, rel=1e-9)
    assert np.sqrt(fit.variance * np.diag(fit.inverse)) == pytest.approx(
        error, rel=1e-5
    )


def test_a_weight_is_a_repetition() -> None:
    """A point of weight 2 counts as four of weight 1."""
    x = np.array([0.0, 1.0, 2.0, 3.0])
    y = np.array([0.1, 0.9, 2.3, 2.8])
    times = np.array([1, 4, 1, 4])

    weighted = fit_linear(
        np.column_stack((np.ones(4), x)), y, np.sqrt(times.astype(float))
    )
    repeated = fit_linear(
        np.column_stack((np.ones(10), np.repeat(x, times))),
        np.repeat(y, times),
    )

    assert weighted.estimate == pytest.approx(repeated.estimate)
    assert weighted.inverse == pytest.approx(repeated.inverse)


def test_the_operator_is_the_solution() -> None:
    """Columns nine orders of magnitude apart."""
    rng = np.random.default_rng(3)
    design = rng.normal(size=(30, 2)) * [1e-6, 1e3]
    values = rng.normal(size=30)

    assert solution_operator(design) @ values == pytest.approx(
        fit_linear(design, values).estimate
    )


def test_correlated_neighbours_enlarge_the_error_of_a_mean() -> None:
    """An autoregression with r = 0.6: four times the variance, not one."""
    rng = np.random.default_rng(5)
    means, told = [], []
    for _ in range(300):
        noise = rng.normal(size=400)
        for i in range(1, 400):
            noise[i] += 0.6 * noise[i - 1]
        fit = fit_linear(np.ones((400, 1)), noise)
        means.append(float(fit.estimate[0]))
        told.append(float(fit.covariance[0, 0]))

    assert np.mean(told) == pytest.approx(np.var(means), rel=0.25)
    assert correlation_inflation(np.array([1.0, -1.0, 1.0, -1.0])) == 1.0

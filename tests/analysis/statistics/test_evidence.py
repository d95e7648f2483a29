"""Bayes factors of linear terms against integrals done otherwise."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.analysis.statistics.evidence import (
    Projector,
    fit_terms,
    mean_evidence,
)

RNG = np.random.default_rng(8)
JACOBIAN = RNG.normal(size=(25, 3))
PRIOR = np.array([0.5, 2.0, 1.0])
COLUMNS = RNG.normal(size=(25, 2))
RESIDUAL = RNG.normal(size=25)


def log_normal(covariance: np.ndarray) -> float:
    """Return the log likelihood of the residual, constants left out."""
    return float(
        -0.5 * np.linalg.slogdet(covariance)[1]
        - 0.5 * RESIDUAL @ np.linalg.solve(covariance, RESIDUAL)
    )


def test_the_projector_is_the_inverse_covariance() -> None:
    """1 + J P J' inverted (Woodbury)."""
    covariance = np.eye(25) + (JACOBIAN * PRIOR**2) @ JACOBIAN.T

    assert Projector(JACOBIAN, PRIOR)(RESIDUAL) == pytest.approx(
        np.linalg.solve(covariance, RESIDUAL)
    )


@pytest.mark.parametrize("prior", [1.0, 1.5, 0.2])
def test_evidence_of_terms_is_a_ratio_of_densities(prior: float) -> None:
    without = np.eye(25) + (JACOBIAN * PRIOR**2) @ JACOBIAN.T
    beside = without + prior**2 * COLUMNS @ COLUMNS.T

    found = fit_terms(Projector(JACOBIAN, PRIOR), RESIDUAL, COLUMNS, prior)

    assert found.log_evidence == pytest.approx(
        log_normal(beside) - log_normal(without)
    )


def test_strengths_take_the_terms_out_of_the_residual() -> None:
    """Generalised least squares with the known covariance."""
    found = fit_terms(Projector(JACOBIAN, PRIOR), RESIDUAL, COLUMNS, 1e6)
    inverse = np.linalg.inv(np.eye(25) + (JACOBIAN * PRIOR**2) @ JACOBIAN.T)
    normal = COLUMNS.T @ inverse @ COLUMNS

    assert -found.strengths == pytest.approx(
        np.linalg.solve(normal, COLUMNS.T @ inverse @ RESIDUAL)
    )
    assert found.covariance == pytest.approx(np.linalg.inv(normal))


def test_mean_evidence_of_far_alternatives_does_not_overflow() -> None:
    assert mean_evidence([1000.0, 0.0]) == pytest.approx(1000.0 - np.log(2.0))
    assert mean_evidence([-np.inf, -np.inf]) == -np.inf

"""Student's t distribution as a prior."""

from math import inf

import numpy as np
import pytest

from bstm_daemon.analysis.statistics.student import as_normal


@pytest.mark.parametrize("freedom", [1.0, 4.0, 10.0])
def test_it_holds_as_the_density_falls(freedom: float) -> None:
    """By the ratio of densities, scaled to the normal curvature at 0."""
    off = np.array([-7.0, -1.0, 0.0, 0.1, 3.0])

    held = as_normal(off, freedom)

    density = (1.0 + off**2 / freedom) ** (-(freedom + 1.0) / 2.0)
    scaled = density ** (freedom / (freedom + 1.0))
    assert np.exp(-(held**2) / 2.0) == pytest.approx(scaled)
    assert np.sign(held).tolist() == np.sign(off).tolist()
    assert as_normal(np.array([1e-4]), freedom) == pytest.approx([1e-4])
    # of a problem's points, (k, p)
    assert as_normal(off[:, None], freedom).shape == (5, 1)


def test_without_end_it_is_the_normal_prior() -> None:
    off = np.array([-7.0, 0.5])

    assert as_normal(off, inf).tolist() == [-7.0, 0.5]
    assert as_normal(off, 1e9) == pytest.approx(off)

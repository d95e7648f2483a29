"""Thickness over whole pad lives of three kinds of driver."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.full
@pytest.mark.slow
@pytest.mark.parametrize("name", ["calm", "brisk", "hard"])
def test_thickness_is_within_half_a_millimetre(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """With all three switches, against wear of another model."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    lives = import_module("pad_life")
    driver = next(one for one in lives.DRIVERS if one.name == name)
    pace = lives.PACES[name]

    truth = lives.wear_out(driver, pace)
    life = lives.estimate(truth, lives.car(pace), lives.SWITCHES)
    deaf = lives.estimate(truth, lives.car(pace), ())

    assert np.abs(life.error_m).max() < 0.5e-3
    # without a switch the interval says what it does not know
    assert np.mean(np.abs(deaf.error_m) <= 2.0 * deaf.std_m) > 0.9
    assert np.abs(deaf.error_m).max() > np.abs(life.error_m).max()

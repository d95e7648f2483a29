"""What the errors of a node by model are made of."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap.holdout_comparison import (
    CONFIGURED,
    EXTENDED,
    _errors,
)


def test_errors_of_a_node_are_those_of_its_own_part() -> None:
    """Two series of two drives; the models are apart by what they show."""
    time_s = np.arange(0.0, 50.0, 10.0)
    measured_k = 273.15 + np.array([20.0, 80.0, 390.0, 380.0, 70.0])
    series = [
        SimpleNamespace(drive=1, node="disc", time_s=time_s, measured_k=None),
        SimpleNamespace(
            drive=0, node="fluid", time_s=time_s, measured_k=measured_k
        ),
    ]
    there: Any = SimpleNamespace(
        series=series,
        edges=[0, 5, 10],
        recordings=[
            SimpleNamespace(name="first.log"),
            SimpleNamespace(name="second.log"),
        ],
    )
    before = np.array([0.0, 6.0, -40.0, 4.0, 2.0])
    after = np.array([0.0, 315.0, -2.0, 6.0, 1.0])
    apart = {
        CONFIGURED: np.concatenate((np.full(5, 99.0), before)),
        EXTENDED: np.concatenate((np.full(5, 99.0), after)),
    }

    found = _errors(there, apart, 1)

    assert (found.drive, found.node) == ("first.log", "fluid")
    assert found.measured_c == pytest.approx([20.0, 80.0, 390.0, 380.0, 70.0])
    assert found.model_c[CONFIGURED] == pytest.approx(
        [20.0, 86.0, 350.0, 384.0, 72.0]
    )
    assert found.model_c[EXTENDED] == pytest.approx(
        [20.0, 395.0, 388.0, 386.0, 71.0]
    )
    assert found.rms_k == pytest.approx(
        {CONFIGURED: 331.2**0.5, EXTENDED: 19853.2**0.5}
    )
    assert found.peak_error_k == pytest.approx(
        {CONFIGURED: -6.0, EXTENDED: 5.0}
    )
    assert found.peak_late_s == {CONFIGURED: 10.0, EXTENDED: -10.0}

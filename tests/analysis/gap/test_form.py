"""What differs from day to day is not missing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap.form import DAILY, daily
from bstm_daemon.analysis.gap.signatures import Sensed


def test_each_drive_differs_by_its_own_in_each_form() -> None:
    """By what is small; two series of the first drive; a clock drifts too."""
    comparison: Any = SimpleNamespace(
        edges=np.array([0, 2, 3, 5]),
        series=[SimpleNamespace(drive=drive) for drive in (0, 0, 1)],
    )
    mass, late, drifting = (
        np.vstack((size * np.arange(1.0, 6.0), np.full(5, 0.5)))
        for size in (1.0, 2.0, 3.0)
    )
    simulated = Sensed(
        *(np.zeros(5), np.zeros((5, 1))),
        {"clock_offset": late, "mass_error": mass, "hub_heat": mass},
        *((), ()),
        forms_k={"clock_offset": (drifting,), "hub_heat": (late,)},
    )

    columns, deviations = daily(comparison, simulated)

    first = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
    wanted = [
        part * (terms[0] + DAILY[name] * terms[1])
        for name, terms in (
            ("mass_error", mass),
            ("clock_offset", late),
            ("clock_offset", drifting),
        )
        for part in (first, 1.0 - first)
    ]
    assert columns == pytest.approx(np.column_stack(wanted))
    assert deviations == pytest.approx(
        [DAILY["mass_error"]] * 2 + [DAILY["clock_offset"]] * 4
    )


def test_nothing_differs_where_nothing_is_excited() -> None:
    comparison: Any = SimpleNamespace(
        edges=np.array([0, 4]), series=[SimpleNamespace(drive=0)]
    )
    nothing = Sensed(np.zeros(4), np.zeros((4, 1)), {}, (), ())

    columns, deviations = daily(comparison, nothing)

    assert columns.shape == (4, 0)
    assert deviations.shape == (0,)

"""A model against what thermocouples measured."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.gap.comparison import at_steps
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.drives import GRID_S
from bstm_daemon.analysis.matching.march import march
from bstm_daemon.analysis.matching.targets import targets_of
from bstm_daemon.analysis.matching.thermocouples import InPad, lagged
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.estimator.corner_model import compile_corner

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.config.sections import Config


def test_a_late_thermocouple_below_the_face_shows_its_place_late(
    config: Config, made: Callable[..., Recording]
) -> None:
    recording = made({})
    placed = {"FL": {"pad_front": InPad(0.002)}}
    drive = replace(recording.drive, placed=placed)
    target = targets_of(config, ["FL"])[0]
    comparison = compare(target, [replace(recording, drive=drive)])
    late = EffectConfig(name="thermocouple_lag", parameters={"strength": 2.0})

    found_k = comparison.residuals_k(comparison.start[None], [late])[:, 0]

    number, one = next(
        (i, one)
        for i, one in enumerate(comparison.series)
        if one.node == "pad_front"
    )
    there_k = march([compile_corner(config, target.corner)], drive, "FL")[
        "pad_front"
    ]
    shown_k = at_steps(lagged(there_k, 30.0, GRID_S), one.steps)[:, 0]
    own = slice(*comparison.edges[number : number + 2])
    assert np.ptp(shown_k - at_steps(there_k, one.steps)[:, 0]) > 5.0
    assert found_k[own] == pytest.approx(shown_k - one.measured_k, abs=1e-6)

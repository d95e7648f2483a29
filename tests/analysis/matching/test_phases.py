"""Phases of a drive by its own signals."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.phases import hard_stops
from bstm_daemon.channels import CHANNELS


def stops(deceleration_ms2: float, power_w: float, count: int = 3) -> Drive:
    """Return a drive with stops from 30 m/s, each followed by rest."""
    down = np.arange(30.0, 0.0, -deceleration_ms2 * GRID_S)
    once = np.concatenate((np.full(20, 30.0), down, np.zeros(20)))
    # back to speed off the brake
    up = np.arange(0.0, 30.0, GRID_S)
    speed_ms = np.tile(np.concatenate((once, up)), count)
    braked = np.tile(
        np.concatenate(
            (np.zeros(20), np.ones(len(down)), np.zeros(20 + len(up)))
        ),
        count,
    )
    rows = np.zeros((len(speed_ms), 1, len(CHANNELS)))
    rows[:, 0, CHANNELS.index("speed_ms")] = speed_ms
    rows[:, 0, CHANNELS.index("brake_power_w")] = power_w * braked
    return Drive("stops", 0.0, ("FL",), rows, {"FL": {}})


@pytest.mark.parametrize(
    ("deceleration_ms2", "power_w", "found"),
    [(6.0, 50e3, 3), (2.0, 20e3, 0), (6.0, 0.0, 0)],
)
def test_hard_stops_are_counted(
    deceleration_ms2: float, power_w: float, found: int
) -> None:
    assert hard_stops(stops(deceleration_ms2, power_w), "FL") == found

"""Hydraulics: two circuits, the anti-lock system, the line in front."""

import numpy as np
import pytest

from bstm_daemon.simulation import NOMINAL, Effects
from bstm_daemon.simulation.hydraulics import (
    MODULATION_HZ,
    SECONDARY,
    line_pressure,
    wheel_pressures,
)
from bstm_daemon.simulation.profile import SAMPLE_S

GAINS = NOMINAL.gains
PULSE = np.concatenate(
    (np.zeros(50), np.full(100, 3e6), np.zeros(100), np.full(150, 1e6))
)
NONE = np.zeros(len(PULSE))


def test_all_wheels_get_the_demand() -> None:
    pressures = wheel_pressures(PULSE, GAINS, Effects(), modulation=NONE)

    np.testing.assert_array_equal(pressures, np.tile(PULSE, (4, 1)).T)


def test_second_circuit_is_late_and_the_force_the_same() -> None:
    pressures = wheel_pressures(
        PULSE, GAINS, Effects(hydraulic_lag=1.0), modulation=NONE
    )

    np.testing.assert_allclose(pressures @ GAINS, PULSE * GAINS.sum())
    assert pressures.min() >= 0.0
    early, late = pressures[55, ~SECONDARY], pressures[55, SECONDARY]
    assert early.min() > 3e6 > late.max()
    # both settle at the demand, both end with it
    np.testing.assert_allclose(pressures[149], 3e6, rtol=0.01)
    assert not pressures[150].any()


def test_anti_lock_swings_left_against_right() -> None:
    demand = np.full(400, 4e6)
    pressures = wheel_pressures(
        demand, GAINS, Effects(), modulation=np.full(400, 0.5)
    )

    np.testing.assert_allclose(pressures @ GAINS, 4e6 * GAINS.sum())
    assert pressures[:, 0].max() == pytest.approx(6e6, rel=0.01)
    # nobody gains over the cycles of one step of the reality
    step = round(0.5 / SAMPLE_S)
    assert (MODULATION_HZ * 0.5).is_integer()
    np.testing.assert_allclose(pressures[:step].mean(axis=0), 4e6)


def test_line_leads_the_clamp() -> None:
    clamp = np.concatenate((np.zeros(50), np.linspace(0, 2e6, 100)))

    plain = line_pressure(clamp, Effects())
    lagging = line_pressure(clamp, Effects(hydraulic_lag=1.0))
    pushed = line_pressure(clamp, Effects(pushout_pressure=1.0))

    np.testing.assert_array_equal(plain, clamp)
    # 2 MPa a second, 0.15 s ahead
    assert lagging[100] - clamp[100] == pytest.approx(3.03e5, rel=0.01)
    assert pushed[149] - clamp[149] == pytest.approx(1e5, rel=1e-3)
    # the seals give way bit by bit
    assert 0 < pushed[51] - clamp[51] < 0.5e5
    assert pushed[10] == 0.0

"""Heat paths that are in no catalogue: what they do."""

from collections.abc import Callable

import numpy as np
import pytest

from bstm_daemon.model.effects.catalogue import effect_names
from bstm_daemon.simulation import (
    EFFECT_NAMES,
    Effects,
    LaneInputs,
    march_lanes,
)
from bstm_daemon.simulation.parameters import FRONT, UNHEARD_NAMES

Inputs = Callable[..., LaneInputs]


def shifts(
    make: Inputs, name: str, start_k: float, *, speed_ms: float
) -> dict[str, float]:
    """Return what *name* adds after 10 min without braking, by node [K]."""
    inputs = make(600, 1.0, speed_ms=np.full(600, speed_ms))
    result = march_lanes(
        [FRONT] * 2,
        [Effects(), Effects().with_strength(name, 1.0)],
        inputs,
        start_k=np.full(2, start_k),
    )
    return {
        node: float(series[-1, 1] - series[-1, 0])
        for node, series in result.nodes.items()
    }


def test_no_catalogue_has_them() -> None:
    assert not set(UNHEARD_NAMES) & set(EFFECT_NAMES)
    assert not set(UNHEARD_NAMES) & set(effect_names())
    assert len(EFFECT_NAMES) == 37


def test_duct_is_shut_below_its_temperature(lane_inputs: Inputs) -> None:
    hot = shifts(lane_inputs, "brake_duct", 900.0, speed_ms=25.0)
    warm = shifts(lane_inputs, "brake_duct", 520.0, speed_ms=25.0)
    standing = shifts(lane_inputs, "brake_duct", 700.0, speed_ms=0.0)

    assert hot["disc"] < -1.0
    assert warm["disc"] == pytest.approx(0.0, abs=0.01)
    assert standing["disc"] == pytest.approx(0.0, abs=1e-9)


def test_damper_heats_the_fluid_on_the_move_only(lane_inputs: Inputs) -> None:
    moving = shifts(lane_inputs, "damper_heat", 300.0, speed_ms=20.0)
    standing = shifts(lane_inputs, "damper_heat", 300.0, speed_ms=0.0)

    assert moving["fluid"] > 2.0
    assert standing["fluid"] == pytest.approx(0.0, abs=1e-9)


def test_shield_leads_heat_to_the_caliper(lane_inputs: Inputs) -> None:
    inputs = lane_inputs(
        1200,
        1.0,
        speed_ms=np.full(1200, 10.0),
        power_w=np.full((1200, 2), 12e3),
        pressure_pa=np.full(1200, 1e6),
        contact=np.ones(1200),
    )
    result = march_lanes(
        [FRONT] * 2,
        [Effects(), Effects(dust_shield=1.0)],
        inputs,
        start_k=np.full(2, 290.0),
    )

    def shift(node: str) -> float:
        series = result.nodes[node]
        return float(series[-1, 1] - series[-1, 0])

    assert shift("fluid") > 3.0
    assert shift("disc") < -3.0

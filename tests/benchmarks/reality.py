"""How much faster than time the simulated car's brakes are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from side_by_side import Goal, Outcome, Table, Work, take_turns

from bstm_daemon.simulation import Effects, LaneInputs, Mesh
from bstm_daemon.simulation.lanes import Lanes, State, start_state
from bstm_daemon.simulation.parameters import FRONT
from bstm_daemon.simulation.reality import (
    extension,
    march_compiled,
    march_numpy,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

STEP_S = 0.5
LANES = (4, 64)


def run(*, full: bool) -> Outcome:
    """Measure the real-time factor per core and corner."""
    compiled = extension()
    if compiled is None:
        msg = "the compiled reality is not installed"
        raise RuntimeError(msg)
    works: dict[str, Work] = {}
    for count in LANES:
        lanes = Lanes([FRONT] * count, [Effects()] * count, Mesh())
        slow = descent(120 if full else 40, count)
        fast = descent(2400 if full else 800, count)
        _check_equal(compiled, lanes, slow)
        works[f"NumPy {count}"] = Work(
            _numpy(lanes, slow), count * float(slow.step_s.sum())
        )
        works[f"C {count}"] = Work(
            _compiled(compiled, lanes, fast), count * float(fast.step_s.sum())
        )
    timings = take_turns(works, 9 if full else 5)

    def factor(name: str) -> float:
        return 1.0 / timings.median(name)

    outcome = Outcome(
        "Reality",
        f"Brake corners of the simulated car without effects, usual cells, "
        f"step {STEP_S} s, braking and rolling in turn. Real-time factor = "
        "simulated seconds x corners / CPU seconds. NumPy and C agree to "
        "1e-7 K, checked in the run.",
    )
    outcome.goals = [
        # factors of real time follow the load of the machine
        Goal("NumPy, 64 lanes, against time", factor("NumPy 64"), 2000.0, 0.5),
        Goal("C, 64 lanes, against time", factor("C 64"), 10_000.0, 0.5),
    ]
    outcome.tables = [
        Table(
            "Real-time factor per core and corner",
            ("lanes", "NumPy", "C", "C against NumPy"),
            tuple(
                (
                    f"{count}",
                    f"{factor(f'NumPy {count}'):.0f}x",
                    f"{factor(f'C {count}'):.0f}x",
                    f"{timings.ratio(f'NumPy {count}', f'C {count}'):.1f}x",
                )
                for count in LANES
            ),
        )
    ]
    return outcome


def descent(steps: int, lanes: int) -> LaneInputs:
    """Return a drag of 35 s and 15 s of rolling, again and again."""
    at_s = np.arange(steps) * STEP_S
    braking = at_s % 50.0 < 35.0
    column = np.ones((steps, 1))
    strength = np.linspace(0.5, 1.5, lanes)
    return LaneInputs(
        step_s=np.full(steps, STEP_S),
        keep=np.arange(steps) == steps - 1,
        speed_ms=np.where(braking, 10.0, 15.0)[:, None],
        power_w=np.where(braking, 8e3, 0.0)[:, None] * strength,
        pressure_pa=np.where(braking, 1e6, 0.0)[:, None] * column,
        contact=braking.astype(float)[:, None],
        ambient_k=283.15 * column,
        wetness=0.0 * column,
        pumping_pa_s=0.0 * column,
    )


def _numpy(lanes: Lanes, inputs: LaneInputs) -> Callable[[], object]:
    return lambda: march_numpy(lanes, _start(lanes), inputs)


def _compiled(
    compiled: ModuleType, lanes: Lanes, inputs: LaneInputs
) -> Callable[[], object]:
    return lambda: march_compiled(compiled, lanes, _start(lanes), inputs)


def _start(lanes: Lanes) -> State:
    return start_state(lanes, np.full(lanes.count, 283.15))


def _check_equal(
    compiled: ModuleType, lanes: Lanes, inputs: LaneInputs
) -> None:
    one = march_numpy(lanes, _start(lanes), inputs).state
    two = march_compiled(compiled, lanes, _start(lanes), inputs).state
    np.testing.assert_allclose(one.chain_k, two.chain_k, rtol=0, atol=1e-7)
    np.testing.assert_allclose(one.lump_k, two.lump_k, rtol=0, atol=1e-7)

"""The observer's constants are those that docs/heat-input.md states."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bstm_daemon.model.heat import observer_rules as rules

TEXT = (Path(__file__).parents[3] / "docs" / "heat-input.md").read_text(
    encoding="utf-8"
)
FLAT = re.sub(r"(?<!\n)\n(?!\n)", " ", TEXT)
"""Each paragraph in one line."""
PLACES = {
    "μ": (0,),
    "b'": (1,),
    "\u03c3": (2,),
    "k": (3,),
    "level": (4,),
    "speed, pressure": (5, 6),
    "drift": (7,),
}


def numbers(text: str) -> list[float]:
    """Return the numbers of *text*, with their signs."""
    plain = text.replace("\u2212", "-")
    return [float(n) for n in re.findall(r"-?\d+(?:\.\d+)?(?:e-\d+)?", plain)]


def cells(first: str) -> list[str]:
    """Return the row of a table that begins with *first*."""
    row = re.search(rf"^\| {re.escape(first)} \|(.*)\|$", TEXT, re.MULTILINE)
    assert row is not None
    return [cell.strip() for cell in row[1].split("|")]


def item(first: str) -> str:
    """Return the item of a list that begins with *first*, in one line."""
    found = re.search(
        rf"^- {re.escape(first)}: (.*?)\.(?=\n- |\n\n)",
        TEXT,
        re.MULTILINE | re.DOTALL,
    )
    assert found is not None
    return " ".join(found[1].split())


@pytest.mark.parametrize("state", PLACES)
def test_priors_walks_and_bounds_of_each_state(state: str) -> None:
    _, before, walk, bounds = cells(state)
    deviation = numbers(before)[-1]
    ends = numbers(bounds)
    low, high = ends if len(ends) == 2 else (-ends[0], ends[0])
    for place in PLACES[state]:
        assert rules.P0_STD[place] == deviation
        assert rules.Q[place] == (numbers(walk) or [0.0])[0]
        assert (rules.MIN_STATE[place], rules.MAX_STATE[place]) == (low, high)


def test_what_the_table_of_states_says_beside() -> None:
    """A load may change in a stop; drift passes; bodies pitch."""
    assert numbers(cells("μ")[2])[1:] == [rules.LOAD_STD, rules.STOOD_S]
    assert numbers(cells("drift")[0]) == [rules.DRIFT_S]
    assert numbers(cells("k")[1])[0] == rules.PITCH
    assert numbers(cells("Δ(g f_r)")[1])[-1] == rules.ROLLING_STD


def test_noise_of_a_window() -> None:
    (said,) = re.findall(
        r"^The noise variance of a window (.*?)\.\n\n", FLAT, re.MULTILINE
    )
    (own, torque, drag, gusts) = numbers(said.replace("m/s²", ""))

    assert own == rules.ACCEL_NOISE
    assert torque == pytest.approx(100.0 * rules.TORQUE_NOISE)
    assert drag == pytest.approx(100.0 * rules.DRAG_TORQUE_NOISE)
    assert gusts == pytest.approx(100.0 * rules.WIND_SHARE)
    assert "multiplied by eight" in said
    assert rules.CORRELATED_WINDOWS == 8.0


def test_gates_of_the_filters() -> None:
    assert numbers(item("**mass, drag**"))[0] == rules.RELEASED_S
    assert numbers(item("**friction**"))[:2] == [
        rules.PRESSED_S,
        rules.LEAST_BRAKE_N,
    ]
    assert numbers(item("**all**").replace("m/s²", ""))[:3] == [
        rules.CALM_S,
        rules.LEAST_SPEED_MS,
        rules.MOST_LATERAL_MS2,
    ]
    assert numbers(item("**scale and pitch**").replace("m/s²", "")) == [
        rules.ROUGHNESS_MS2,
        rules.RESTART_S,
    ]
    assert numbers(item("**outliers**")) == [rules.OUTLIER]


def test_thresholds_of_what_the_observer_finds() -> None:
    when, _, then = item("`external_force_suspected`").partition("**Then**")
    assert numbers(when.replace("m/s²", "")) == [
        rules.EXTERNAL_S,
        rules.IDLE_OUTLIER,
        rules.OUTLIER,
        rules.EXTERNAL_MS2,
        rules.EXTERNAL_SHARE,
    ]
    assert numbers(then) == [rules.EXTERNAL_HOLD_S]
    assert numbers(
        item("`acceleration_scale`").partition("**Then**")[0]
    ) == pytest.approx([100.0 * rules.GAIN_LOW, 100.0 * rules.GAIN_HIGH])
    assert numbers(item("`wheel_radius`").partition("**Then**")[0]) == [
        100.0 * rules.RADIUS_LIMIT
    ]
    assert numbers(
        item("`pressure_dead`").partition("**Then**")[0].replace("m/s²", "")
    ) == [
        rules.DEAD_S,
        rules.DEAD_MS2,
    ]

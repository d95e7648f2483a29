"""What a restart carries over, and what it refuses."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.advice.advisor import Advisor
from bstm_daemon.config.reading import load_config
from bstm_daemon.estimator.memory import SavedSamples, StateError, checked
from bstm_daemon.files import shipped_file

CONFIG = load_config(shipped_file("config/example_vehicle.toml"))

VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.sampled_from(["nan", "inf", "-inf", "text"]),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=4,
)


MEMORIES = [
    (machine, key)
    for machine, saved in Advisor(CONFIG, {}).export()["machines"].items()
    for key in saved
]


def test_every_memory_is_known() -> None:
    assert {machine for machine, _ in MEMORIES} == {
        *("departure", "descent", "emergency", "pedal", "isolation")
    }
    assert len(MEMORIES) > 15


def test_what_was_exported_comes_back() -> None:
    first = Advisor(CONFIG, {})
    first.descent.slope_power_w = 12_500.0
    first.descent._last = (7_000_000, 12.5)
    first.emergency._last = (7_000_000, 12.5, None)
    first.pedal._feel = 0.75
    saved = json.loads(json.dumps(first.export()))

    second = Advisor(CONFIG, {})
    second.restore(saved)

    assert second.export() == first.export()
    assert second.descent._last == (7_000_000, 12.5)


@pytest.mark.parametrize(
    ("machine", "key", "value"),
    [
        ("pedal", "_feel", None),
        ("pedal", "_feel", "nan"),
        ("pedal", "_feel", 1.5),
        ("isolation", "_requested", 1.0),
        ("departure", "_stopped_us", 1.5),
        ("departure", "phase", 99),
        ("descent", "_last", 3.0),
        ("descent", "_last", [1]),
        ("descent", "slope_power_w", [1.0]),
        ("emergency", "score", "inf"),
    ],
)
def test_anything_else_is_refused(
    machine: str, key: str, value: object
) -> None:
    advisor = Advisor(CONFIG, {})
    saved = advisor.export()
    saved["machines"][machine][key] = value

    with pytest.raises((TypeError, ValueError)):
        advisor.restore(saved)


@given(place=st.sampled_from(MEMORIES), value=VALUES)
def test_what_is_taken_is_given_back(
    place: tuple[str, str], value: Any
) -> None:
    """Whatever a file holds: refused, or memory of the same kind."""
    machine, key = place
    advisor = Advisor(CONFIG, {})
    saved = advisor.export()
    before = json.dumps(saved["machines"][machine])
    saved["machines"][machine][key] = value
    try:
        advisor.restore(saved)
    except (TypeError, ValueError):
        after = json.dumps(advisor.export()["machines"][machine])
        assert after == before
    else:
        again = Advisor(CONFIG, {})
        again.restore(json.loads(json.dumps(advisor.export())))
        assert repr(again.export()) == repr(advisor.export())


def test_a_tuple_that_is_none_is_worded() -> None:
    document = {"times": [], "numbers": [], "flags": 3, "open_flags": 0}

    with pytest.raises(StateError, match="flags = 3: must be a list, each"):
        checked(SavedSamples, document)

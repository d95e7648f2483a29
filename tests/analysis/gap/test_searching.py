"""Forms of an effect: the best is taken, and the choice costs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap.changes import forms_of
from bstm_daemon.analysis.gap.comparison import at_steps
from bstm_daemon.analysis.gap.fitting import directions
from bstm_daemon.analysis.gap.searching import _far, _in_best_forms, search
from bstm_daemon.analysis.gap.signatures import NO_FORM, Sensed, sensed
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.targets import targets_of
from bstm_daemon.analysis.matching.thermocouples import Thermocouple

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.config.sections import Config


@pytest.mark.slow
def test_the_form_that_is_there_is_taken(
    config: Config, made: Callable[..., Recording]
) -> None:
    comparison = compare(targets_of(config, ["FL"])[0], [made({})])
    simulated = sensed(comparison, ["clock_offset", "disc_wear"])
    basis = directions(comparison)
    (drifting,) = forms_of("clock_offset")
    for terms, form in (
        (simulated.terms_k["clock_offset"], NO_FORM),
        (simulated.forms_k["clock_offset"][0], drifting),
    ):
        comparison.forms.clear()
        missing_k = 2.0 * terms[0] + 4.0 * terms[1]
        of_form = replace(simulated, base_k=simulated.base_k - missing_k)

        known, naming = search(comparison, of_form, basis)

        assert comparison.forms["clock_offset"] == form
        found = {one.name: one for one in naming.candidates}["clock_offset"]
        assert found.strength == pytest.approx(2.0, rel=0.1)
        costs = {one.name: one.form_cost for one in known.signatures}
        assert 0.0 < costs["clock_offset"] <= np.log(2.0) + 1e-9
        assert costs["disc_wear"] == 0.0
    _, effects = comparison.placed(comparison.start, {"clock_offset": 2.0})
    assert effects[0].parameters == {"strength": 2.0, **drifting}


def test_each_effect_is_taken_in_the_form_that_explains_more() -> None:
    """And what the choice costs is its evidence over the mean of both."""
    rising, falling = np.linspace(0.0, 5.0, 40), np.linspace(5.0, 0.0, 40)
    flat = np.zeros(40)
    simulated = Sensed(
        base_k=-rising,
        jacobian_k=np.zeros((40, 1)),
        terms_k={
            "clock_offset": np.array([falling, flat]),
            "thermocouple_lag": np.array([rising, flat]),
            "backplate_loss": np.array([falling, flat]),
        },
        silent=(),
        unknown_k=(),
        form_costs={"backplate_loss": 0.5},
    )
    comparison: Any = SimpleNamespace(forms={})
    layout: Any = SimpleNamespace(prior=np.ones(1), whiten=lambda k: k)

    other = {"drift_s_h": 3.0}
    options = [(NO_FORM, falling), (other, rising)]
    every = {
        name: [(form, np.array([column, flat])) for form, column in of]
        for name, of in (
            ("clock_offset", options),
            ("thermocouple_lag", [(NO_FORM, rising), (other, falling)]),
        )
    }

    found = _in_best_forms(comparison, layout, simulated, every)

    for name, terms in found.terms_k.items():
        expected = falling if name == "backplate_loss" else rising
        assert terms[0].tolist() == expected.tolist()
    # the other one explains next to nothing
    assert found.form_costs == {
        "backplate_loss": 0.5,
        **dict.fromkeys(every, pytest.approx(np.log(2.0), abs=0.01)),
    }
    assert comparison.forms == {"clock_offset": other, "thermocouple_lag": {}}


def test_large_changes_at_the_head_are_simulated_where_they_are() -> None:
    sizes = {
        "hub_heat": 9.0,
        "change.a": 0.7,
        "change.b": -0.8,
        "change.c": 0.9,
        "change.fifth": 2.0,
        "change.named": 1.5,
        "change.done": 3.0,
    }
    naming: Any = SimpleNamespace(
        candidates=[
            SimpleNamespace(name=name, strength=size)
            for name, size in sizes.items()
        ],
        names=("change.named", "change.done"),
    )

    # where it is simulated already, a tenth of it is near enough
    done = {"change.done": 3.29, "change.named": 1.34, "change.c": 0.9}
    assert _far(naming, done) == {"change.b": -0.8, "change.named": 1.5}
    done = {"change.done": 3.31, "change.named": 1.36, "change.c": -0.9}
    assert _far(naming, done) == {
        "change.b": -0.8,
        "change.c": 0.9,
        "change.done": 3.0,
    }


@pytest.mark.slow
def test_a_late_clock_is_found(
    config: Config, made: Callable[..., Recording]
) -> None:
    """12 s late; the model's own temperatures stay what they are."""
    recording = made({})
    drive = recording.drive
    measured = {
        corner: {
            node: replace(one, time_s=one.time_s + 12.0)
            for node, one in couples.items()
        }
        for corner, couples in drive.measured.items()
    }
    late = replace(recording, drive=replace(drive, measured=measured))
    comparison = compare(targets_of(config, ["FL"])[0], [late])
    simulated = sensed(comparison, ["clock_offset", "thermocouple_lag"])

    _, naming = search(comparison, simulated, directions(comparison))

    assert naming.names[0] == "clock_offset"
    assert naming.candidates[0].strength == pytest.approx(2.0, rel=0.3)
    assert not any(comparison.forms.values())


@pytest.mark.slow
def test_one_late_sensor_is_no_late_clock(
    config: Config, made: Callable[..., Recording]
) -> None:
    """The disc's thermocouple follows with 20 s, the others at once."""
    recording = made({})
    measured = {
        corner: {**couples, "disc": lagging(couples["disc"], 20.0)}
        for corner, couples in recording.drive.measured.items()
    }
    late = replace(
        recording, drive=replace(recording.drive, measured=measured)
    )
    comparison = compare(targets_of(config, ["FL"])[0], [late])
    simulated = sensed(comparison, ["clock_offset", "thermocouple_lag"])

    _, naming = search(comparison, simulated, directions(comparison))

    assert naming.names == ("thermocouple_lag",)
    assert comparison.forms["thermocouple_lag"] == {"sensor": 1.0}
    assert naming.candidates[0].strength == pytest.approx(20 / 15, rel=0.3)


def lagging(one: Thermocouple, lag_s: float) -> Thermocouple:
    """Return what a sensor of that time constant shows of *one*."""
    shown_k = one.temperature_k.copy()
    follows = 1.0 - np.exp(-np.diff(one.time_s) / lag_s)
    for i, share in enumerate(follows):
        shown_k[i + 1] = (1.0 - share) * shown_k[i]
        shown_k[i + 1] += share * one.temperature_k[i + 1]
    return Thermocouple(one.time_s, shown_k)


def test_between_steps_is_a_straight_line() -> None:
    values = np.array([[0.0, 10.0], [2.0, 20.0], [4.0, 0.0]])
    found = at_steps(values, np.array([-1.0, 0.5, 1.0, 2.0, 7.0]))
    expected = [[0, 10], [1, 15], [2, 20], [4, 0], [4, 0]]
    assert found.tolist() == expected

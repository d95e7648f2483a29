"""What the errors of a node by model are made of."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pytest

from bstm_daemon.analysis.gap import holdout_comparison, workflow
from bstm_daemon.analysis.gap.holdout_comparison import (
    CONFIGURED,
    EXTENDED,
    SCALED,
    Shown,
    Shrink,
    _errors,
    _shrink,
    confirmed,
    fitted_and_shown,
)
from bstm_daemon.analysis.gap.naming import Answer, Naming
from bstm_daemon.analysis.gap.workflow import find_gap
from bstm_daemon.analysis.statistics.series import white_noise
from bstm_daemon.report.gap import gap_text

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.config.sections import Config


@pytest.mark.parametrize(
    ("before_k", "after_k", "drift_k", "gained", "disc_drift_k", "against"),
    [
        (3.0, 5.1, 1.0, 1.24, 1.0, True),
        # by less than 2 K, than a quarter, than what the match left there
        (3.0, 4.9, 1.0, 1.24, 1.0, False),
        (10.0, 12.4, 1.0, 1.24, 1.0, False),
        (3.0, 5.1, 2.2, 1.24, 1.0, False),
        # where all nodes together are a quarter better for certain
        (3.0, 5.1, 1.0, 1.26, 1.0, False),
        # where they are so in drifts, which the discs have less of
        (3.0, 5.1, 1.0, 1.24, 0.165, True),
        (3.0, 5.1, 1.0, 1.24, 0.158, False),
    ],
)
def test_what_contradicts_is_beyond_all_four(
    before_k: float,
    after_k: float,
    drift_k: float,
    gained: float,
    disc_drift_k: float,
    *,
    against: bool,
) -> None:
    errors: Any = tuple(
        SimpleNamespace(
            node=node,
            time_s=np.zeros(count),
            rms_k={SCALED: 3.0, EXTENDED: rms_k},
        )
        for node, count, rms_k in (("disc", 10, 1.0), ("fluid", 90, after_k))
    )
    errors[1].rms_k[SCALED] = before_k
    noise: Any = {
        node: SimpleNamespace(drift_k=k)
        for node, k in (("disc", disc_drift_k), ("fluid", drift_k))
    }

    for held_out in (True, False):
        shrinks = {SCALED: Shrink(2.0, gained, 3.0)}
        shown = Shown(held_out, shrinks, {}, errors, {}, {}, ())

        found = shown.against(noise)

        assert found is (errors[1] if against and held_out else None)


@pytest.mark.parametrize(
    ("held_out", "factor", "better", "answer"),
    [
        (True, 1.11, True, "name"),
        (True, 1.09, False, "undecided"),
        (True, 0.8, False, "undecided"),
        # by the drives that were fitted nothing is confirmed
        (False, 1.01, True, "name"),
        (False, 0.99, False, "name"),
    ],
)
def test_a_name_needs_held_out_drives_that_gain(
    factor: float, answer: str, *, held_out: bool, better: bool
) -> None:
    shrinks = {
        CONFIGURED: Shrink(factor, 0.5, 2.0),
        SCALED: Shrink(9.0, 0.5, 9.0),
    }
    same = {SCALED: 1.0, EXTENDED: 1.0}
    one: Any = SimpleNamespace(node="disc", time_s=np.zeros(9), rms_k=same)
    shown = Shown(held_out, shrinks, {}, (one,), {}, {}, ())
    noise: Any = {"disc": SimpleNamespace(drift_k=1.0)}
    naming = Naming("name", ("hub_heat",), 0.97, (), {"": 0.01}, "heat")

    found = confirmed(naming, shown, noise)

    assert shown.better == better
    assert (found.answer, found.names) == (answer, ("hub_heat",))
    assert found.probability == 0.97
    assert found.reason == (
        "heat"
        if answer == "name"
        else f"with it the error of held-out drives is {factor:.2f} times "
        "smaller, and a name needs 1.1"
    )


TWO: Final = ("hub_heat", "caliper_bypass")


@pytest.mark.parametrize(
    ("answer", "held_out", "factors", "count"),
    [
        # the second one, or even two, must make the error less
        ("name", True, {1: 2.0, 2: 2.1}, 2),
        ("name", True, {1: 2.0, 2: 2.0}, 1),
        ("name", True, {1: 2.0, 2: 1.9}, 1),
        ("name", False, {2: 1.9}, 2),
        # terms of one description belong together
        ("composed", True, {2: 1.9}, 2),
    ],
)
def test_of_several_names_as_many_are_given_as_held_out_drives_gain_by(
    monkeypatch: pytest.MonkeyPatch,
    answer: Answer,
    factors: dict[int, float],
    count: int,
    *,
    held_out: bool,
) -> None:
    start = dict.fromkeys(TWO, 1.0)

    def show(_: Any, own: Any, *__: Any, **___: Any) -> Any:
        shrink = Shrink(factors[len(own)], 0.5, 9.0)
        return SimpleNamespace(shrinks={CONFIGURED: shrink}, of=own)

    monkeypatch.setattr(holdout_comparison, "baseline_fits", lambda *_: {})
    monkeypatch.setattr(
        holdout_comparison, "fit", lambda _, start, *__, **___: start
    )
    monkeypatch.setattr(holdout_comparison, "show", show)
    naming = Naming(answer, TWO, 0.97, (), {"": 0.01}, "together")
    nothing: Any = np.zeros((3, 0))
    drives: Any = ["other.log"] if held_out else []

    found, own, shown = fitted_and_shown(
        *(naming, start, nothing, nothing, drives), known_k=nothing
    )

    assert list(own) == list(shown.of) == list(TWO[:count])
    assert found.names == TWO[:count]
    assert found.answer == answer
    assert found.reason == (
        "together"
        if count == 2
        else "together; held-out drives gain nothing by caliper_bypass"
    )


@pytest.mark.slow
@pytest.mark.parametrize("held_out_has_it", [True, False])
def test_a_name_that_a_held_out_drive_contradicts_is_not_given(
    config: Config,
    made: Callable[..., Recording],
    monkeypatch: pytest.MonkeyPatch,
    *,
    held_out_has_it: bool,
) -> None:
    """What is hidden in the searched drive is in the other one, or is not."""
    monkeypatch.setattr(
        workflow, "candidates", lambda _: ["gap_conduction", "hub_conduction"]
    )
    hidden = {"gap_conduction": 1.3}
    drive = made(hidden)
    other = made(hidden if held_out_has_it else {}, "other", seed=3)

    (found,) = find_gap(config, [drive], [other], until="adopt")

    assert found.naming is not None
    if held_out_has_it:
        assert found.naming.answer == "name"
        assert found.naming.names == ("gap_conduction",)
        assert found.adopted == ("gap_conduction",)
        return
    assert (found.naming.answer, found.naming.names) == ("unknown", ())
    assert (found.adopted, found.values, found.worse) == ((), (), False)
    head, *lines = gap_text(found).splitlines()
    assert ": missing: none of the known effects, heat at" in head
    said = "other, held out, contradicts gap_conduction: pad_front is"
    assert any(said in line for line in lines)


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


def test_a_gap_shrinks_by_what_is_left_beside_the_noise() -> None:
    """Of the series asked for, the noise of each point taken off."""
    rng = np.random.default_rng(6)
    time_s = np.arange(0.0, 4000.0, 10.0)
    count = len(time_s)
    smooth = 400.0 + 0.01 * time_s
    series = [
        SimpleNamespace(
            time_s=time_s,
            measured_k=smooth + rng.normal(0.0, white_k, count),
        )
        for white_k in (1.0, 0.0)
    ]
    there: Any = SimpleNamespace(series=series, edges=[0, count, 2 * count])
    before = np.concatenate((np.full(count, 5.0), np.full(count, 9.0)))
    apart = {SCALED: before, EXTENDED: np.full(2 * count, 2.0)}

    found = _shrink(there, apart, SCALED, [0])
    second = _shrink(there, apart, SCALED, [1])

    variance = white_noise(series[0].measured_k) ** 2
    assert 0.7 < variance < 1.4
    wanted = np.sqrt((25.0 - variance) / (4.0 - variance))
    assert found.factor == pytest.approx(wanted)
    # each block is as the others
    assert (found.lower, found.upper) == pytest.approx((wanted, wanted))
    assert second.factor == pytest.approx(4.5)

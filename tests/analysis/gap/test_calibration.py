"""Match, search, add, match again: what is added, dropped, left alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, cast

import pytest

from bstm_daemon.analysis.gap import calibration
from bstm_daemon.analysis.gap.calibration import (
    Calibration,
    Step,
    _against,
    _known_before,
)
from bstm_daemon.analysis.gap.naming import Naming
from bstm_daemon.analysis.gap.searching import search
from bstm_daemon.analysis.matching import matcher
from bstm_daemon.analysis.matching.changes import learned
from bstm_daemon.analysis.matching.coarse import Reading
from bstm_daemon.analysis.matching.matcher import match_drives
from bstm_daemon.analysis.matching.refine import Accuracy, NodeAccuracy
from bstm_daemon.analysis.matching.tunables import MASS, strength_key
from bstm_daemon.analysis.matching.workflow import Matched
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.report.match import step_json, step_lines

from ...made_drives import EXAMPLE  # noqa: TID252  (tests are no package)
from ...made_matches import match_of  # noqa: TID252

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.analysis.gap.calibration import Calibrated
    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.gap.signatures import Linearised
    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.analysis.matching.tunables import Target
    from bstm_daemon.config.sections import Config

HIDDEN: Final = {"gap_conduction": 1.0}

AMONG: Final = (
    "gap_conduction", "hub_conduction", "disc_radiation_driving",
    "backplate_loss", "bracket_conduction", "caliper_radiation",
    "shim_contact",
)  # fmt: skip
"""Effects on temperatures: these drives have no samples to heat anew."""


def test_an_effect_has_the_strength_that_was_matched(target: Target) -> None:
    """And says so; one that no match fitted stays as it is."""
    effect = EffectConfig(
        name="local_air",
        parameters={"strength": 1.0, "delay_s": 3.0},
        provenance={"source": "bstm gap", "data": ["a"]},
    )
    match = match_of(target, {strength_key("local_air"): 2.0}, after=target)

    found = calibration._as_matched(effect, match)

    assert found.parameters == {"strength": 2.0, "delay_s": 3.0}
    # 0.2 of 2: exp(1.645 * 0.1) on either side
    assert found.provenance == {
        "source": "bstm match",
        "data": ["a"],
        "strength_sd": 0.2,
        "strength_90": [1.697, 2.358],
    }
    other = effect.model_copy(update={"name": "disc_hat"})
    assert calibration._as_matched(other, match) is other


@pytest.fixture
def calibrated(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Calibrated]:
    """Return what matches recordings, and searches them."""
    _, signal_map = load_vehicle(EXAMPLE)

    def run(recordings: Sequence[Recording]) -> Calibrated:
        named = {one.name: one for one in recordings}

        def matched(
            logs: Sequence[Path],
            config: Config,
            _: object,
            guessed: frozenset[str],
            **__: object,
        ) -> Matched:
            drives = [named[log.name].drive for log in logs]
            found = match_drives(
                config,
                [Reading(None, drives)],
                guessed=guessed,
                beside=False,
            )
            return Matched(config, found, [], [])

        def read(log: Path, *_: object) -> Recording:
            return named[log.name]

        # heat through the contact has its own test
        monkeypatch.setattr(matcher, "with_contact", lambda *_: None)
        monkeypatch.setattr(calibration, "match_logs", matched)
        monkeypatch.setattr(calibration, "read_recording", read)
        monkeypatch.setattr(calibration, "candidates", lambda _: list(AMONG))
        logs = [Path(name) for name in named]
        return Calibration(logs, signal_map).run(config)

    return run


def left_out(
    rms_k: float,
    *each_k: float,
    peak_k: float = 30.0,
    names: tuple[str, ...] = ("one", "two"),
) -> Match:
    """Return a match of that RMS of its fluid on what was left out.

    *peak_k* is the largest error of its disc on the last.
    """
    accuracy = Accuracy(
        {},
        len(each_k),
        " and ".join(names),
        {},
        {"fluid": rms_k},
        each_k=tuple({"fluid": one} for one in each_k),
        peaks_k=({"disc": 30.0}, {"disc": peak_k}),
    )
    drives = [SimpleNamespace(name=name) for name in names]
    found = SimpleNamespace(accuracy=accuracy, drives=drives)
    return cast("Match", found)


@pytest.mark.parametrize(
    ("after", "why"),
    [
        (left_out(8.0, 9.0, 7.0), ""),
        (left_out(9.5, 9.5, 9.5), "leaves 0.95 times the error"),
        (left_out(8.0, 4.0, 10.4), ""),
        (left_out(8.0, 4.0, 10.6), "1.06 times the error on two"),
        (left_out(8.0, 9.0, 7.0, peak_k=37.0), ""),
        (
            left_out(8.0, 9.0, 7.0, peak_k=42.0),
            "disc up to 42 K off on two, 30 K before",
        ),
    ],
)
def test_an_addition_must_gain_and_harm_no_drive(
    after: Match, why: str
) -> None:
    assert _against(left_out(10.0, 10.0, 10.0), after) == why


def test_a_match_that_gains_takes_the_place_of_the_one_before(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Corner by corner; what harms is dropped, and nothing else is tried."""
    config = target.config
    key = strength_key("gap_conduction")
    asked: list[tuple[frozenset[str], list[str]]] = []
    searched: list[tuple[tuple[str, ...], float, bool]] = []

    def match_logs(
        _: Any, of: Config, __: Any, guessed: frozenset[str], **given: Any
    ) -> Matched:
        asked.append((guessed, [one.name for one in of.effect]))
        given["progress"](0.5)
        matches = []
        for corner, gains in (("FL", True), ("RL", False)):
            rms_k = 2.0 if not of.effect else 1.0 if gains else 3.0
            one = match_of(
                target.of(corner),
                {key: 1.4} if of.effect else {},
                after=replace(target.of(corner), config=of),
                rms_k={"disc": rms_k},
            )
            matches.append(one)
        return Matched(of, matches, [], ["no stop"])

    def look(
        _: Calibration, match: Match, *, alone: bool
    ) -> tuple[Step, list[EffectConfig]]:
        (corner,) = match.corners
        rms_k = match.accuracy.rms_k
        searched.append((match.corners, rms_k["disc"], alone))
        naming = Naming("nothing", (), 0.9, (), {}, "")
        if match.joint.values:
            return Step(match.corners, naming, rms_k), []
        effect = EffectConfig(name="gap_conduction", corner=corner)
        return Step(match.corners, naming, rms_k, "gap_conduction"), [effect]

    monkeypatch.setattr(calibration, "match_logs", match_logs)
    monkeypatch.setattr(Calibration, "_searched", look)
    shown: list[tuple[float, str]] = []
    _, signal_map = load_vehicle(EXAMPLE)

    found = Calibration(
        [], signal_map, progress=lambda *of: shown.append(of)
    ).run(config, frozenset({"cooling.s_per_s"}))

    assert asked == [
        (frozenset({"cooling.s_per_s"}), []),
        (frozenset({"cooling.s_per_s", key}), ["gap_conduction"] * 2),
    ]
    assert shown == [(0.5, ""), (0.5, "with what was named")]
    assert searched == [
        (("FL",), 2.0, False),
        (("RL",), 2.0, False),
        (("FL",), 1.0, False),
    ]
    kept = [(one.corners, one.kept, one.after_k) for one in found.steps]
    assert kept == [
        (("FL",), True, {"disc": 1.0}),
        (("RL",), False, {"disc": 3.0}),
        (("FL",), False, {}),
    ]
    assert found.steps[1].why == "leaves 1.50 times the error"
    left, right = found.matched.matches
    assert (left.joint.values, right.joint.values) == ({key: 1.4}, {})
    assert left.before.config.effect == []
    assert found.matched.why_not == ["no stop"]
    (effect,) = found.effects
    assert (effect.corner, effect.parameters["strength"]) == ("FL", 1.4)


def test_a_search_knows_what_the_match_learned(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, signal_map = load_vehicle(EXAMPLE)
    read: list[Any] = []

    def recording(log: Path, config: Config, *of: Any) -> str:
        read.append((log, config.matched, *of))
        return f"recording of {log}"

    monkeypatch.setattr(calibration, "read_recording", recording)
    monkeypatch.setattr(calibration, "compare", lambda *of: of)
    drives = cast("Any", ["one", "two"])
    match = replace(match_of(target, {MASS: 1.1}), drives=drives)
    known = learned(match)
    logs = [Path("one"), Path("two")]

    of, recordings = Calibration(logs, signal_map)._comparison(match, known)

    assert of.config.matched == [known]
    assert of.corners == target.corners
    assert of.setting(MASS) == 1.1
    assert recordings == ["recording of one", "recording of two"]
    assert read == [(log, [known], signal_map, {}) for log in logs]


@pytest.mark.parametrize("verdict", [(), ("no stop",)])
def test_a_search_of_its_own_drives_does_not_count_them_twice(
    target: Target, verdict: tuple[str, ...]
) -> None:
    """The priors hold again, and what is left may be a part that lacks."""
    form = {"disc": NodeAccuracy(7.0, 0.02)}
    drives = cast("Any", ["one", "two"])
    match = match_of(target, {MASS: 1.1}, verdict=verdict)
    match = replace(match, form=form, drives=drives)
    after = learned(match)
    assert after.form_k == {"disc": 7.0}

    before = _known_before(match)

    mass = after.names.index(MASS)
    assert after.factor[mass][mass] < 0.11
    assert (before.names, before.values) == (after.names, after.values)
    for i, name in enumerate(before.names):
        prior = match.after.tunable(name).prior
        assert before.factor[i] == pytest.approx([*[0.0] * i, prior], rel=1e-3)
    assert before.form_k == ({} if verdict else {"disc": 7.0})
    assert before.form_share == ({} if verdict else {"disc": 0.02})


@pytest.mark.slow
@pytest.mark.full  # tests/cli/test_match.py has it through the command
def test_what_is_hidden_in_all_drives_is_added(
    calibrated: Callable[..., Calibrated], made: Callable[..., Recording]
) -> None:
    """The match alone hides it in other values."""
    found = calibrated([made(HIDDEN, "one"), made(HIDDEN, "two", seed=2)])

    first, last = found.steps
    assert (first.added, first.kept) == ("gap_conduction", True)
    assert first.before_k["pad_front"] > 20.0
    assert first.after_k["pad_front"] < 3.0
    assert first.before_k["fluid"] > 1.2
    assert first.after_k["fluid"] < 0.7
    assert last.naming.answer == "nothing"
    (effect,) = found.effects
    assert (effect.name, effect.corner) == ("gap_conduction", "all")
    assert effect.parameters["strength"] == pytest.approx(1.0, rel=0.05)
    low, high = effect.provenance["strength_90"]
    assert low < effect.parameters["strength"] < high
    (match,) = found.matched.matches
    assert match.verdict == ()
    assert match.before.config.effect == []
    assert max(one["pad_front"] for one in match.accuracy.peaks_k) < 12.0
    # as configured, it errs by the effect
    assert match.accuracy.before_k["pad_front"] > 50.0
    lines = step_lines(found.steps)
    assert "with gap_conduction: disc " in lines[0]
    assert lines[0].endswith(": kept")
    assert lines[1].startswith("step 2, FL: no missing effect visible")


@pytest.mark.slow
@pytest.mark.full
def test_nothing_is_added_where_nothing_is_hidden(
    calibrated: Callable[..., Calibrated], made: Callable[..., Recording]
) -> None:
    found = calibrated([made(name="one"), made(name="two", seed=2)])

    (step,) = found.steps
    assert (step.naming.answer, step.added, step.kept) == (
        "nothing",
        "",
        False,
    )
    assert found.effects == ()


@pytest.mark.slow
@pytest.mark.full  # with made-up matches it runs every time, above
def test_what_the_other_drive_contradicts_is_dropped(
    calibrated: Callable[..., Calibrated],
    made: Callable[..., Recording],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One drive has it, the other has not, and the search names it."""

    def named(*args: Any) -> tuple[Linearised, Naming]:
        known, naming = search(*args)
        names = ["gap_conduction"]
        return known, naming.answered("name", names, 0.99, "made")

    monkeypatch.setattr(calibration, "search", named)

    found = calibrated([made(HIDDEN, "one"), made(name="two", seed=2)])

    (step,) = found.steps
    assert (step.added, step.kept) == ("gap_conduction", False)
    assert step.why.startswith(("leaves ", "1."))
    assert found.effects == ()
    (match,) = found.matched.matches
    assert match.after.config.effect == []
    assert match.verdict
    assert f": dropped, {step.why}" in step_lines(found.steps)[0]
    assert step_json(step)["held_out_after_k"] == step.after_k

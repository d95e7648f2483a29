"""What is done up to each step that can be asked for, with known answers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import pytest

from bstm_daemon.analysis.gap import holdout_comparison, naming, workflow
from bstm_daemon.analysis.gap.advising import Prospect
from bstm_daemon.analysis.gap.evidence import Candidate
from bstm_daemon.analysis.gap.holdout_comparison import (
    CONFIGURED,
    EXTENDED,
    SCALED,
    Shrink,
)
from bstm_daemon.analysis.gap.joint_effects import JointEffects
from bstm_daemon.analysis.gap.naming import Answer, Naming
from bstm_daemon.analysis.gap.signatures import Linearised
from bstm_daemon.analysis.gap.workflow import (
    STEPS,
    Question,
    advise_before,
    compare,
    find_gap,
)
from bstm_daemon.analysis.matching.tunables import Target
from bstm_daemon.errors import LogError
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.config.sections import Config

ORDER = ("locate", "sensed", "search", "fit", "show", "map")
"""What follows what; advice comes behind the search."""


@pytest.fixture
def steps(
    monkeypatch: pytest.MonkeyPatch, config: Config, made: Any
) -> Callable[..., tuple[Any, list[str]]]:
    """Return what finds a gap of a known *naming*: it, and what was done."""

    def run(
        found: Naming,
        until: str,
        question: Question = workflow.ANY,
        against: Any = None,
        held_out: Sequence[Any] = (),
    ) -> tuple[Any, list[str]]:
        done: list[str] = []

        def says(name: str, value: Any = None) -> Callable[..., Any]:
            def work(*_: Any, **__: Any) -> Any:
                done.append(name)
                return value

            return work

        def without(names: Collection[str]) -> Any:
            done.extend(f"not {one}" for one in names)
            return SimpleNamespace(jacobian_k=None, without=without)

        known = Linearised(
            *(np.zeros(3), np.zeros((3, 5)), (), ("shim_contact",), ())
        )
        one_by_one = iter(held_out)
        shown = SimpleNamespace(
            against=lambda _: next(one_by_one, against),
            better=True,
            shrinks={CONFIGURED: Shrink(2.0, 1.5, 2.5)},
        )
        extended = SimpleNamespace(strengths={"gap_conduction": 1.2})
        for name, value in (
            ("locate", "a map"),
            (
                "sensed",
                SimpleNamespace(jacobian_k=None, without=without),
            ),
            ("search", (known, found)),
        ):
            monkeypatch.setattr(workflow, name, says(name, value))
        for module in (workflow, holdout_comparison):
            monkeypatch.setattr(module, "fit", says("fit", extended))
            monkeypatch.setattr(module, "show", says("show", shown))
            monkeypatch.setattr(module, "baseline_fits", lambda *_: {})
        monkeypatch.setattr(workflow, "directions", lambda _: np.zeros((5, 2)))
        monkeypatch.setattr(workflow, "starts", lambda _: {})
        monkeypatch.setattr(workflow, "written", lambda *_: (("value",), "e"))
        monkeypatch.setattr(workflow, "_map", says("map", "the map after"))
        monkeypatch.setattr(workflow, "_prospects", lambda *_: ([], None))
        monkeypatch.setattr(
            workflow,
            "advise",
            lambda own, _, members, __: (
                done.append(f"advise {own.jacobian.shape[1]}")
                or ("advice", *members)
            ),
        )
        (gap,) = find_gap(
            *(config, [made()], [made()] if held_out else ()),
            until=until,
            question=question,
        )
        return gap, done

    return run


NAMED = Naming("name", ("gap_conduction",), 0.99, (), {"": 0.01}, "")
TWINS = Naming(
    *("class", ("gap_conduction", "shim_contact"), 0.97, ()),
    *({"gap_conduction": 0.6, "shim_contact": 0.37}, ""),
)


@pytest.mark.parametrize(
    ("until", "done"),
    [
        ("locate", ORDER[:1]),
        *((until, ORDER[:3]) for until in ("gate", "name", "advise")),
        ("adopt", ORDER[:5]),
        ("show", ORDER),
    ],
)
def test_nothing_is_done_beyond_what_is_asked_for(
    steps: Callable[..., tuple[Any, list[str]]],
    until: str,
    done: Sequence[str],
    config: Config,
    made: Callable[..., Recording],
) -> None:
    points = compare(Target(config, ("FL",)), [made()]).edges[-1]

    gap, found = steps(NAMED, until)

    assert until in STEPS
    assert found == [*done]
    assert gap.recordings == ("made",)
    assert gap.points == points
    assert gap.located == "a map"
    assert gap.naming is (None if until == "locate" else NAMED)
    is_adopted = until in {"adopt", "show"}
    assert gap.adopted == (("gap_conduction",) if is_adopted else ())
    assert gap.values == (("value",) if is_adopted else ())
    assert gap.after == ("the map after" if until == "show" else None)


def off(node: str) -> Any:
    """Return errors of *node* that contradict what is written."""
    return SimpleNamespace(
        drive="b.log", node=node, rms_k={SCALED: 2.0, EXTENDED: 5.0}
    )


@pytest.mark.parametrize(
    ("against", "answer", "asked"),
    [
        ((off("fluid"), None, off("disc")), "undecided", 2),
        ((None, off("fluid"), off("disc")), "undecided", 1),
        ((off("fluid"), off("disc"), off("pad_back")), "unknown", 3),
    ],
)
def test_what_is_not_decided_is_none_of_the_known_if_each_is_contradicted(
    steps: Callable[..., tuple[Any, list[str]]],
    against: Sequence[Any],
    answer: Answer,
    asked: int,
) -> None:
    """The likeliest three are asked, not a fourth."""
    members = ("gap_conduction", "shim_contact", "disc_hat", "hub_heat")
    one = Candidate("", 1.0, 0.1, 9.0, 5.0, 0.5)
    naming = Naming(
        *("undecided", members, 0.9),
        *(tuple(replace(one, name=name) for name in members), {"": 0.2}, ""),
    )

    gap, done = steps(naming, "show", held_out=against)

    assert gap.naming.answer == answer
    assert done.count("fit") == asked
    if answer == "unknown":
        assert gap.naming.names == ()
        assert gap.naming.probability == pytest.approx(0.8)
        assert gap.naming.reason.startswith(
            "b.log, held out, contradicts gap_conduction, shim_contact, "
            "disc_hat: pad_back is 5.0 K off"
        )


@pytest.mark.parametrize("answer", ["name", "class", "composed"])
def test_what_is_contradicted_is_none_of_the_known(
    steps: Callable[..., tuple[Any, list[str]]], answer: Answer
) -> None:
    """Whatever the answer; nothing can be adopted."""
    named = NAMED.answered(answer, ("gap_conduction",), 0.9, "")
    gap, done = steps(named, "show", against=off("fluid"))

    assert [one for one in done if one in ORDER] == [*ORDER[:5]]
    assert (gap.naming.answer, gap.naming.names) == ("unknown", ())
    assert gap.naming.probability == pytest.approx(0.99)
    assert gap.naming.reason == (
        "b.log, held out, contradicts gap_conduction: fluid is 5.0 K off, "
        "2.0 K with heat and cooling re-fitted instead"
    )
    assert not gap.adopted
    assert gap.shown is None


def test_nothing_is_fitted_where_nothing_is_named(
    steps: Callable[..., tuple[Any, list[str]]],
) -> None:
    unknown = NAMED.answered("unknown", (), 0.9, "")

    gap, found = steps(unknown, "show")

    assert found == [*ORDER[:3]]
    assert gap.silent == ("shim_contact",)
    assert gap.fit is None


def test_what_it_is_known_not_to_be_is_left_out(
    steps: Callable[..., tuple[Any, list[str]]],
    config: Config,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of what temperatures show, and of what forces do."""
    asked = []

    def forces(*_: Any, without: Collection[str]) -> Any:
        asked.append(without)
        return SimpleNamespace(naming=NAMED.answered("nothing", (), 0.6, ""))

    monkeypatch.setattr(workflow, "find_force_gap", forces)
    known = SimpleNamespace(corners=(), forces={"friction_fade": 0.1})
    monkeypatch.setitem(vars(config), "matched", [known])
    question = Question(without=frozenset({"pad_wear"}))

    _, done = steps(NAMED.answered("nothing", (), 0.6, ""), "name", question)

    assert done == ["locate", "sensed", "not pad_wear", "search"]
    assert asked == [{"pad_wear"}]


@pytest.mark.parametrize("answer", ["name", "nothing", "unknown", None])
@pytest.mark.parametrize("shown", ["nothing", "unknown", "composed"])
def test_forces_are_asked_where_temperatures_name_nothing(
    steps: Callable[..., tuple[Any, list[str]]],
    config: Config,
    monkeypatch: pytest.MonkeyPatch,
    answer: Answer | None,
    shown: Answer,
) -> None:
    """Of a car whose forces are known: a clear name, or that it is unknown.

    The latter only where temperatures show nothing.
    """
    done = []

    def forces(*of: Any, without: Collection[str]) -> Any:
        done.append((of, *without))
        if answer is None:
            msg = "no force"
            raise LogError(msg)
        naming = NAMED.answered(answer, ("friction_fade",), 0.99, "hot")
        return SimpleNamespace(naming=naming)

    monkeypatch.setattr(workflow, "find_force_gap", forces)
    nothing = NAMED.answered(shown, (), 0.6, "")

    gap, found = steps(nothing, "name")
    assert gap.naming is nothing
    assert not done

    known = SimpleNamespace(corners=(), forces={"friction_fade": 0.1})
    monkeypatch.setitem(vars(config), "matched", [known])
    named, _ = steps(NAMED, "name")
    assert named.naming is NAMED
    assert not done
    gap, found = steps(nothing, "name")

    assert len(done) == 1
    assert found == [*ORDER[:3]]
    if answer == "name" or (answer, shown) == ("unknown", "nothing"):
        assert gap.naming.answer == answer
        assert gap.naming.names == ("friction_fade",)
        assert gap.naming.reason.endswith("pressure against motion: hot")
        assert gap.naming.found
    else:
        assert gap.naming is nothing
    assert not gap.adopted


FADE = "friction_fade"


@pytest.mark.parametrize("answer", ["name", "unknown"])
def test_forces_are_asked_where_held_out_drives_contradict_the_name(
    steps: Callable[..., tuple[Any, list[str]]],
    config: Config,
    monkeypatch: pytest.MonkeyPatch,
    answer: Answer,
) -> None:
    """What they do not name stays without one."""
    naming = NAMED.answered(answer, (FADE,), 0.99, "hot")
    monkeypatch.setattr(
        workflow,
        "find_force_gap",
        lambda *_, **__: SimpleNamespace(naming=naming),
    )
    known = SimpleNamespace(corners=(), forces={FADE: 0.1})
    monkeypatch.setitem(vars(config), "matched", [known])

    gap, _ = steps(NAMED, "show", against=off("disc"))

    if answer == "name":
        assert (gap.naming.answer, gap.naming.names) == ("name", (FADE,))
        assert gap.naming.reason == "by forces, pressure against motion: hot"
    else:
        assert (gap.naming.answer, gap.naming.names) == ("unknown", ())
        assert "contradicts gap_conduction" in gap.naming.reason
    assert not gap.adopted
    assert gap.shown is None


@pytest.mark.parametrize(
    ("evidence", "reach", "strength", "refuted"),
    [
        (-0.1, 0.8, 0.9, (FADE,)),
        (-0.1, 0.8, -0.9, (FADE,)),
        (0.1, 0.8, 0.9, ()),
        (-0.1, 1.0, 0.9, ()),
        (-0.1, 1.0, -0.9, ()),
        (0.1, 0.8, -0.9, (FADE,)),
        (0.1, 0.8, -0.2, (FADE,)),
    ],
)
def test_forces_refute_a_friction_that_they_would_show(
    evidence: float, reach: float, strength: float, refuted: tuple[str, ...]
) -> None:
    """Whether it is named or only the best; of what heats, and if asked.

    Or that they show with the other sign.
    """
    own = Candidate(FADE, 0.1, 0.1, 0.0, evidence, reach)
    other = Candidate("wet_disc", 0.1, 0.1, 0.0, -1.0, 0.1)
    forces: Any = SimpleNamespace(
        naming=replace(NAMED, candidates=(own, other))
    )
    comparison: Any = SimpleNamespace(is_on_heat=lambda name: name == FADE)
    fades = Candidate(FADE, strength, 0.1, 9.0, 8.0, 0.5)
    wet = Candidate("wet_disc", 3.0, 0.1, 9.0, 7.0, 0.5)

    def found(
        answer: Answer, names: tuple[str, ...], *candidates: Candidate
    ) -> tuple[str, ...]:
        naming = replace(NAMED, candidates=candidates)
        naming = naming.answered(answer, names, 0.9, "")
        return workflow._refuted(naming, comparison, lambda: forces)

    assert found("name", (FADE,), fades, wet) == refuted
    assert found("name", ("wet_disc", FADE), wet, fades) == refuted
    assert found("unknown", (), fades, wet) == refuted
    assert found("unknown", (), wet, fades) == ()
    assert found("nothing", (), fades, wet) == ()
    named = replace(NAMED, candidates=(fades,)).answered(
        *("name", (FADE,), 0.9, "")
    )
    assert workflow._refuted(named, comparison, lambda: None) == ()


def test_what_forces_refute_is_searched_without(
    steps: Callable[..., tuple[Any, list[str]]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Until no more is refuted."""
    refuted = [FADE, "wet_disc"]
    monkeypatch.setattr(
        workflow,
        "_refuted",
        lambda naming, *_: naming.found and tuple(refuted and [refuted.pop()]),
    )
    nothing = NAMED.answered("nothing", (), 0.9, "")

    _, found = steps(nothing, "name")
    assert found == [*ORDER[:3]]
    _, found = steps(NAMED, "name")
    assert found == [
        *("locate", "sensed", "search", "not wet_disc", "search"),
        *(f"not {FADE}", "search"),
    ]


@pytest.mark.parametrize(
    ("name", "strength", "against", "of_one_day"),
    [
        ("thermocouple_lag", 0.19, -0.1, True),
        ("clock_offset", -0.19, -0.1, True),
        # one that is not small, or that each drive has, is the car's
        ("thermocouple_lag", 0.21, -0.1, False),
        ("thermocouple_lag", 0.19, 0.1, False),
        ("wet_disc", 0.19, -0.1, False),
    ],
)
def test_a_small_error_of_a_sensor_on_one_day_is_left_out(
    name: str, strength: float, against: float, *, of_one_day: bool
) -> None:
    best = Candidate(name, strength, 0.01, 30.0, 20.0, 0.05)
    other = Candidate("friction_fade", 0.5, 0.1, 9.0, 7.0, 0.5)
    drives = {"one.log": 20.0, "other.log": against}
    naming = replace(
        NAMED, candidates=(best, other), cross_validated=drives
    ).answered("unknown", (), 0.9, "")

    assert workflow._of_one_day(naming) == ((name,) if of_one_day else ())
    nothing = naming.answered("nothing", (), 0.9, "")
    assert workflow._of_one_day(nothing) == ()


def test_what_can_not_be_told_apart_is_advised_on(
    steps: Callable[..., tuple[Any, list[str]]],
) -> None:
    """Also before it is shown; by the jacobian of the tunables alone."""
    gap, found = steps(TWINS, "show")
    assert found[3] == "advise 2"
    assert found[4:] == [*ORDER[3:]]
    assert gap.members[:2] == ("gap_conduction", "shim_contact")
    assert gap.advice == ("advice", *gap.members)

    _, found = steps(TWINS, "adopt")
    assert not any(one.startswith("advise") for one in found)

    among = ("hub_conduction", "local_air")
    gap, found = steps(NAMED, "advise", Question(among=among))
    assert found == [*ORDER[:3], "advise 2"]
    assert gap.members == among


def test_before_any_drive_it_is_asked_of_the_first_measured_corners(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def prospects(target: Any, *of: Any) -> Any:
        asked.append((target.corners, *of[:3]))
        return ["a drive"], np.ones(3)

    monkeypatch.setattr(workflow, "_prospects", prospects)
    monkeypatch.setattr(
        workflow, "advise", lambda known, *of: (known.residual, *of)
    )
    question = Question(among=("gap_conduction", "shim_contact"))
    nodes = "temp_fl_disc", "temp_fr_disc", "temp_fr_fluid", "temp_rl_disc"
    present = {ROLE_INDEX[node]: 500_000 for node in nodes}

    gap = advise_before(config, present, question)

    couples = {"FL": ("disc",), "FR": ("disc", "fluid")}
    assert asked == [(("FL", "FR"), present, couples, question)]
    assert (gap.corners, gap.recordings, gap.points) == (("FL", "FR"), (), 0)
    residual, prior, members, drives = gap.advice
    assert len(residual) == 0
    assert prior.tolist() == [1.0, 1.0, 1.0]
    assert members == gap.members == question.among
    assert drives == ["a drive"]

    with pytest.raises(LogError, match="no role temp_<corner>_<node> is"):
        advise_before(config, {}, question)


def test_each_drive_of_the_menu_is_shown_and_has_the_noise_of_the_data(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    noises: list[Any] = []
    comparison = SimpleNamespace(
        noise={"disc": "usual", "fluid": "usual"}, set_noise=noises.append
    )
    monkeypatch.setattr(
        workflow, "candidate_drive", lambda name, *_: (name, f"the {name}")
    )
    monkeypatch.setattr(workflow, "compare", lambda *_: comparison)
    monkeypatch.setattr(workflow, "directions", lambda _: np.eye(3)[:, :2])
    monkeypatch.setattr(workflow, "prior_along", lambda *_: np.ones(2))
    monkeypatch.setattr(
        workflow,
        "prospect",
        lambda *of: Prospect("", of[2], 60.0, np.eye(3), {}),
    )
    shown: list[float] = []
    question = Question(menu=("m13", "m15"))

    found, prior = workflow._prospects(
        *(target, {}, {}, question, shown.append),
        noise={"fluid": "known"},  # type: ignore[dict-item]
    )

    assert shown == [0.5, 1.0]
    assert [one.description for one in found] == ["the m13", "the m15"]
    assert [one.jacobian.shape for one in found] == [(3, 2)] * 2
    assert prior.tolist() == [1.0, 1.0]
    assert noises == [{"disc": "usual", "fluid": "known"}] * 2


@pytest.mark.parametrize("answer", get_args(Answer))
def test_all_answers_but_nothing_have_found_something(answer: Answer) -> None:
    assert NAMED.answered(answer, (), 0.9, "").found is (answer != "nothing")


@pytest.mark.parametrize(
    ("sure", "answer", "names", "probability", "reason"),
    [
        ("ab", "name", "ab", 0.8, "together they explain 75 %"),
        ("b", "name", "b", naming.SURE, "and another one, perhaps a"),
        ("", "undecided", "ab", 0.8, "several effects at once, in more than"),
    ],
)
def test_of_several_those_are_named_that_are_sure(
    sure: str, answer: str, names: str, probability: float, reason: str
) -> None:
    common = Naming("nothing", (), 0.0, (), {}, "", explained=0.75)
    both = tuple(
        Candidate(name, 1.0, 0.1, 50.0, 40.0, 0.1) for name in ("a", "b")
    )

    found = naming._together(common, JointEffects(both, None, 0.8, (*sure,)))

    assert (found.answer, found.names) == (answer, (*names,))
    assert found.probability == probability
    assert found.reason.startswith(reason)

"""Composed effects: found, sized and written where no catalogue has them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pytest

from bstm_daemon.analysis.gap import composing, workflow
from bstm_daemon.analysis.gap.advising import samples_of
from bstm_daemon.analysis.gap.comparison import with_effects
from bstm_daemon.analysis.gap.composing import (
    Search,
    _as_likely,
    _listed_gain,
    _misread,
    _not_contradicted,
    cost,
    with_composed,
)
from bstm_daemon.analysis.gap.evidence import Candidate
from bstm_daemon.analysis.gap.heat_response import BLOCK, Response
from bstm_daemon.analysis.gap.holdout_comparison import REFITTED
from bstm_daemon.analysis.gap.naming import Naming
from bstm_daemon.analysis.gap.recording import recorded
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
    signature_of,
)
from bstm_daemon.analysis.gap.unnamed import Unnamed
from bstm_daemon.analysis.gap.workflow import compare, find_gap
from bstm_daemon.analysis.identify.writing import write_changed
from bstm_daemon.analysis.matching.drives import GRID_S
from bstm_daemon.analysis.matching.march import model_of
from bstm_daemon.analysis.matching.thermocouples import (
    InPad,
    lagged,
    lining_of,
)
from bstm_daemon.analysis.matching.tunables import TUNABLES, Target
from bstm_daemon.analysis.statistics.evidence import FREE, Projector
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.model.effects.composed import PATHS, PREFIX, read
from bstm_daemon.report.gap import headline
from bstm_daemon.simulation import load_drive, simulate
from bstm_daemon.simulation.parameters import Effects

from ...made_drives import EXAMPLE  # noqa: TID252  (tests are no package)
from .test_advising import MATCHED, present

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bstm_daemon.analysis.gap.comparison import Comparison
    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.config.sections import Config

AMONG: Final = (
    *("gap_conduction", "hub_conduction", "disc_radiation_driving"),
    *("backplate_loss", "caliper_radiation", "shim_contact"),
)
FEW: Final = ("disc to air", "fluid to air", "heat at fluid")
"""Paths that are enough for what is tested, and quickly searched."""


@pytest.fixture(autouse=True)
def among(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let these effects and paths be all that there are."""
    monkeypatch.setattr(workflow, "candidates", lambda _: list(AMONG))
    few = {text: PATHS[text] for text in FEW}
    monkeypatch.setattr(composing, "PATHS", few)


def hiding(config: Config, **terms: float) -> Config:
    return with_effects(
        config, [EffectConfig(name="composed", parameters=terms)]
    )


def unexplained(comparison: Comparison) -> Linearised:
    base_k = comparison.residuals_k(comparison.start[None])[:, 0]
    none = np.zeros((len(base_k), len(comparison.prior)))
    return Linearised(comparison.whiten(base_k), none, (), (), ())


@pytest.mark.parametrize(
    ("text", "alike"),
    [
        ("disc to air, driving, above 300 degC", 0.95),
        ("fluid to air, rising with speed", 0.98),
        ("heat at fluid, fading within 400 s after braking", 0.98),
    ],
)
def test_the_response_is_that_of_the_whole_model(
    target: Target, made: Callable[..., Recording], text: str, alike: float
) -> None:
    """Linear about the measured temperatures, against a march with it."""
    comparison = compare(target, [made()])
    search = Search(comparison, comparison, unexplained(comparison))
    term = read(text, 0.3 * read(text).path.size)
    name = PREFIX + text
    comparison.sizes[name] = term.size

    (found,) = search.columns([term]).T

    whole = signature_of(comparison, name, search.base_k, (0.5, 1.0))
    assert whole is not None
    column = whole.at(1.0)
    size = np.linalg.norm(column)
    assert found @ column > alike * np.linalg.norm(found) * size
    assert np.linalg.norm(found) == pytest.approx(size, rel=0.12)


def test_the_response_is_at_the_thermocouple_and_as_late(
    config: Config, made: Callable[..., Recording]
) -> None:
    """One as deep as the second node shows that node, 20 s late."""
    drive = made().drive
    model = model_of(config, "FL")
    _, depth_m, *_ = lining_of(model.network).values()
    deep = replace(drive, placed={"FL": {"pad_front": InPad(depth_m)}})
    late = model.with_lag({"pad_front": 20.0})
    (term,) = terms = [read("disc to air", 5.0)]

    second = Response(model, drive, terms).of(terms, ["pad_1"])["pad_1"]
    shown = Response(late, deep, terms).of([term], ["pad_front"])["pad_front"]

    assert np.ptp(second) > 1.0
    block_s = BLOCK * GRID_S
    assert shown == pytest.approx(lagged(second, 20.0, block_s))


@pytest.mark.slow
def test_the_hidden_term_is_first_and_of_its_size(
    target: Target, config: Config, made: Callable[..., Recording]
) -> None:
    text = "fluid to air, rising with speed"
    hidden = hiding(config, **{text: 1.5})
    comparison = compare(target, [made(of=hidden)])
    search = Search(comparison, comparison, unexplained(comparison))

    found = search.best([])

    best = found[0][0]
    assert best.name == PREFIX + text
    evidence = [one.log_evidence for one, _ in found]
    assert evidence == sorted(evidence, reverse=True)
    size = comparison.sizes[best.name] * best.strength
    assert size == pytest.approx(1.5, rel=0.1)


def test_a_term_is_ranked_at_its_best_size() -> None:
    """With a free prior on its strength; evidence is paid for its words."""
    rng = np.random.default_rng(4)
    one, two, noise = rng.normal(0.0, 1.0, (3, 200))
    terms = [read("disc to air"), read("fluid to air, wet")]
    residual = -3.0 * two + 0.1 * noise
    search: Any = SimpleNamespace(known=SimpleNamespace(residual=residual))
    columns = np.column_stack((one, two))

    project: Any = lambda of: of  # noqa: E731
    found = Search.ranked(search, terms, columns, project)

    best, second = found[0]
    assert second.path == terms[1].path
    precision = two @ two + FREE**-2
    strength = -(two @ residual) / precision
    assert second.size == pytest.approx(strength * terms[1].size)
    assert best == pytest.approx(
        0.5 * strength**2 * precision
        - 0.5 * np.log(precision * FREE**2)
        - cost(terms[1])
    )


def test_each_clause_costs(target: Target) -> None:
    """More words must explain more."""
    costs = [
        cost(read(text))
        for text in (
            "disc to air",
            "disc to air, wet",
            "disc to air, wet, above 30 km/h",
        )
    ]

    assert costs[1] - costs[0] == pytest.approx(costs[2] - costs[1])
    assert costs[1] - costs[0] > 3.0


def test_nothing_is_composed_where_nothing_is_missing(
    target: Target, made: Callable[..., Recording]
) -> None:
    comparison = compare(target, [made()])
    known = unexplained(comparison)
    nothing = Naming("nothing", (), 0.9, (), {"": 0.9}, "")

    same, naming = with_composed(comparison, comparison, known, nothing)

    assert same is known
    assert naming is nothing
    assert not comparison.sizes


@pytest.mark.slow
def test_a_composed_term_is_answered_beside_what_is_known(
    target: Target, config: Config, made: Callable[..., Recording]
) -> None:
    """With its signature; where no effect was named, for the same reason."""
    text = "fluid to air, rising with speed"
    hidden = hiding(config, **{text: 1.5})
    drives = [made(of=hidden), made(name="b", of=hidden, seed=2)]
    comparison = compare(target, drives)
    known = unexplained(comparison)
    unnamed = Naming("unknown", (), 0.9, (), {"": 0.0}, "no listed effect")

    more, naming = with_composed(comparison, comparison, known, unnamed)

    assert naming.answer == "composed"
    assert naming.names == (PREFIX + text,)
    assert [one.name for one in more.signatures] == [PREFIX + text]
    assert naming.reason == "no listed effect"
    assert naming.probability == naming.odds[PREFIX + text]
    assert set(naming.cross_validated) == {"made", "b"}
    assert min(naming.cross_validated.values()) > 0.0


def test_terms_of_other_paths_that_are_nearly_as_likely_are_told() -> None:
    """Each path once, by its best; not what is three or more behind."""

    def term(text: str, log_evidence: float) -> Candidate:
        return Candidate(PREFIX + text, 1.0, 0.1, 20.0, log_evidence, 0.3)

    found = [
        term("heat at fluid, driving", 15.0),
        term("heat at fluid, braking", 14.8),
        term("disc to fluid", 14.1),
        term("disc to fluid, wet", 13.0),
        term("disc to air", 12.0),
        term("pad_back to fluid", 11.9),
    ]

    assert _as_likely(found) == ["disc to fluid", "disc to air"]
    assert _as_likely(found[:2]) == []


def candidate(name: str, evidence: float, gain: float = 1.0) -> Candidate:
    return Candidate(name, 1.0, 0.1, gain, evidence, 1.0)


@pytest.mark.parametrize(
    ("against", "left", "said"),
    [
        ({}, ("a", "b", "c", "d"), 1.0),
        ({"a"}, ("b", "c", "d"), 2.0),
        ({"a", "b"}, ("c", "d"), 3.0),
        # d is too much less likely to be asked
        ({"a", "b", "c"}, ("a", "b", "c", "d"), -4.0),
    ],
)
def test_the_likeliest_that_no_drive_contradicts_is_the_first(
    monkeypatch: pytest.MonkeyPatch,
    against: set[str],
    left: tuple[str, ...],
    said: float,
) -> None:
    evidence = {"a": 20.0, "b": 18.0, "c": 17.0, "d": 16.9}
    found: Any = [(candidate(name, e), name) for name, e in evidence.items()]
    drives = {
        name: {"one": -4.0 - i if name in against else 1.0 + i, "two": 9.0}
        for i, name in enumerate(evidence)
    }
    monkeypatch.setattr(
        composing, "cross_validated", lambda *of: drives[of[-1]]
    )
    unused: Any = None

    rest, validated = _not_contradicted(unused, unused, found)

    assert tuple(name for _, name in rest) == left
    assert validated == {"one": said, "two": 9.0}


def test_what_is_most_likely_explains_what_its_strength_allows() -> None:
    """A name is fitted freely beside others; what is undecided is not."""
    own, other = np.array([4.0, 0.0]), np.array([0.0, 2.0])
    known = Linearised(
        *(np.array([8.0, -6.0]), np.zeros((2, 1))),
        tuple(
            Signature(name, one, 0.0 * one, one, either_sign=False)
            for name, one in (("own", own), ("other", other))
        ),
        *((), ()),
    )
    project = Projector(known.jacobian, np.ones(1))
    naming = Naming(
        *("undecided", ("own", "other"), 0.9),
        (candidate("other", 3.0, 18.0), candidate("own", 2.0, 0.5)),
        *({}, ""),
    )

    # -2 and 3 with a prior of 1.5: b^2 / (a^2 + 1.5^-2) / 2 each
    free = 32.0**2 / (16.0 + FREE**-2) + 12.0**2 / (4.0 + FREE**-2)
    named = naming.answered("name", ("own", "other"), 0.9, "")
    assert _listed_gain(project, known, named) == pytest.approx(free / 2.0)
    assert _listed_gain(project, known, naming) == 0.5
    nothing = naming.answered("unknown", (), 0.9, "")
    assert _listed_gain(project, known, nothing) == 0.0


def test_an_error_of_a_reading_is_as_likely_as_it_explains() -> None:
    one = np.array([0.0, 3.0, 4.0])
    known = Linearised(-one, np.zeros((3, 1)), (), (), ())
    project = Projector(known.jacobian, np.ones(1))

    assert _misread(project, known) == -np.inf
    reading = Unnamed("reading of disc", "always", one, is_heat=False)
    # alone, all of one place and all are the same one: 25^2 / 26 / 2, less
    # the logarithm of how much narrower its strength has become
    there = replace(known, readings=(reading,))
    expected = 0.5 * (25.0**2 / 26.0 - np.log(26.0))
    assert _misread(project, there) == pytest.approx(expected)


@pytest.mark.slow  # two searches and a fit
def test_it_is_named_adopted_and_shrinks_a_held_out_drive(
    config: Config, made: Callable[..., Recording], tmp_path: Path
) -> None:
    text = "disc to air, driving, above 100 degC"
    real = hiding(config, **{text: 8.0})
    drives = [made(of=real), made(name="b", seed=2, of=real)]
    held_out = made(name="c", seed=3, of=real)

    (found,) = find_gap(config, drives, [held_out])

    assert found.naming is not None
    assert found.naming.answer == "composed"
    assert "none of the known effects; best description: disc to air" in (
        headline(found)
    )
    assert found.shown is not None
    assert found.shown.shrinks[REFITTED].factor > 1.5
    new = tmp_path / "new.toml"
    write_changed(EXAMPLE, new, found.values, "", "", found.entries)
    written = load_config(new)
    (entry,) = written.effect
    assert entry.name == "composed"
    (size,) = entry.parameters.values()
    assert size == pytest.approx(8.0, rel=0.35)
    assert entry.provenance["data"] == ["made", "b"]
    program = compile_corner(written, written.corner[0])
    assert set(entry.parameters) <= set(program.ledger_names)
    (again,) = find_gap(written, drives, until="name")
    assert again.naming is not None
    assert again.naming.answer == "nothing"


@pytest.mark.slow  # a search of the whole grammar
def test_a_listed_name_stays_where_composing_is_not_clearly_better(
    target: Target, made: Callable[..., Recording]
) -> None:
    recordings = [
        made({"gap_conduction": 1.3}),
        made({"gap_conduction": 1.3}, "other", seed=2),
    ]
    (found,) = find_gap(target.config, recordings, until="name")

    assert found.naming is not None
    assert found.naming.names == ("gap_conduction",)


@pytest.mark.full  # two simulated drives and a search of the whole grammar
@pytest.mark.slow
def test_an_effect_that_is_not_listed_is_described_where_and_when_it_acts(
    config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gap of released pads conducts, in the simulated reality.

    Its physics is other code and another form than any term.
    """
    unlisted = [one for one in AMONG if one != "gap_conduction"]
    monkeypatch.setattr(workflow, "candidates", lambda _: unlisted)
    monkeypatch.setattr(composing, "PATHS", PATHS)
    changes = {
        "heat": config.heat.model_copy(update={"mode": "ff"}),
        "cooling": config.cooling.model_copy(update={"form": "conductance"}),
    }
    plain = Target(config.model_copy(update=changes), ("FL", "FR"))
    target = plain.changed(
        {
            key: factor * plain.value(TUNABLES[key])
            for key, factor in MATCHED.items()
        }
    )
    drives = []
    for seed, name in enumerate(("simalp", "rich")):
        simulated = simulate(
            load_drive(name),
            preset=Effects(gap_conduction=1.5),
            sensors="n2",
            seed=11 + seed,
        )
        samples = samples_of(simulated, present(), temperatures=True)
        drives.append(recorded(name, [samples], target.config, present()))

    (found,) = find_gap(target.config, drives, until="name")

    assert found.naming is not None
    assert found.naming.answer == "composed"
    first = read(found.naming.names[0].removeprefix(PREFIX))
    assert (first.path.a, first.path.b) == ("disc", "pad_front")
    assert [form.words for form, _ in first.clauses] == ["brake off"]
    assert found.naming.candidates[0].z > 20.0

"""The grammar of composed effects: words, dimensions, signs, both forms."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.effects.catalogue import (
    apply_effects,
    effect_class,
    effect_names,
    problems_of,
)
from bstm_daemon.model.effects.composed import (
    AIR,
    FORMS,
    PATHS,
    SIZES,
    Composed,
    Term,
    bounded,
    is_composed,
    read,
)
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.thermal.brake_corner import build_corner
from bstm_daemon.model.thermal.kernel import Batch

from .conftest import INPUTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.model.effects.composed import Form, Path
    from bstm_daemon.model.thermal.brake_corner import CornerSpec

    from .conftest import Corner

    Clauses = tuple[tuple[Form, float], ...]
    Make = Callable[..., Corner]

HOT = "disc to air, driving, above 300 degC"
EVERY = (
    *((path, ()) for path in PATHS.values()),
    *(
        (PATHS["disc to air"], ((form, form.grid[-1]),))
        for form in FORMS.values()
    ),
)


def tour(corner: Corner) -> Corner:
    """Begin hot, brake hard, roll in the rain, brake again, park."""
    corner.warm(disc=1030.0, pad_front=720.0, fluid=390.0)
    corner.drive(60, 30e3, speed_ms=20.0, pressure_pa=3e6)
    corner.drive(60, wetness=1.0, speed_ms=36.0)
    return corner.drive(60, 10e3).drive(300, speed_ms=0.0)


@pytest.mark.parametrize(("path", "clauses"), EVERY)
def test_a_term_is_read_as_it_is_written(path: Path, clauses: Clauses) -> None:
    term = Term(path, clauses, path.size)

    assert read(str(term), path.size) == term


@pytest.mark.parametrize(("path", "clauses"), EVERY)
def test_every_path_and_form_acts_and_conserves_energy(
    corner: Make, path: Path, clauses: Clauses
) -> None:
    """Nothing but a source or the air can add heat."""
    term = Term(path, clauses, path.size)
    if path.kind == "source":
        term = replace(term, clauses=((FORMS["braking"], 0.0),))
    base = tour(corner(None)).nodes()

    there = tour(corner("composed", **{str(term): 3.0 * term.size}))

    moved = {k: there.nodes()[k] - base[k] for k in base}
    assert max(map(abs, moved.values())) > 0.05
    ledger = there.ledger()
    assert abs(ledger.residual) < 1e-9 * ledger.generated


@pytest.mark.parametrize(
    ("text", "node", "sign"),
    [
        ("disc to air, driving", "disc", -1.0),
        ("disc to fluid, driving", "fluid", 1.0),
        ("disc by air to fluid", "fluid", 1.0),
        ("heat at pad_front, braking", "pad_front", 1.0),
        ("share of the brake heat", "disc", 1.0),
        ("disc to a mass within 120 s", "disc", -1.0),
        ("share of disc to air", "disc", -1.0),
    ],
)
def test_a_term_moves_its_node_the_way_it_says(
    corner: Make, text: str, node: str, sign: float
) -> None:
    size = read(text).path.size
    base = tour(corner(None)).nodes()

    found = tour(corner("composed", **{text: size})).nodes()

    assert sign * (found[node] - base[node]) > 0.1


def test_a_form_is_what_its_words_say(corner: Make) -> None:
    """A threshold, a speed and a phase: the heat that a link carries [J]."""

    def lost_j(clauses: str, disc_k: float, speed_ms: float) -> float:
        made = corner("composed", **{f"disc to air{clauses}": 5.0})
        made.warm(disc=disc_k).drive(0.25, speed_ms=speed_ms)
        at = made.program.ledger_names.index(f"disc to air{clauses}")
        return float(made.batch.ledger[at])

    plain = lost_j("", 673.15, 20.0)
    assert plain == pytest.approx(5.0 * 390.0 * 0.25, rel=1e-3)
    assert lost_j(", above 300 degC", 673.15, 20.0) == pytest.approx(plain)
    assert lost_j(", above 300 degC", 553.15, 20.0) == 0.0
    assert lost_j(", rising with speed", 673.15, 20.0) == pytest.approx(
        0.5 * plain, rel=1e-3
    )
    assert lost_j(", parked", 673.15, 20.0) == 0.0
    assert lost_j(", above 60 km/h", 673.15, 10.0) == 0.0


def test_a_latch_stays_and_what_fades_fades(corner: Make) -> None:
    made = corner(
        "composed",
        **{
            "disc to air, once above 350 degC": 1.0,
            "fluid to air, fading within 60 s after braking": 0.5,
            "pad_back to air, rising until 3 MJ of braking": 0.5,
        },
    )

    made.warm(disc=700.0).drive(1.0).warm(disc=300.0).drive(10.0)
    assert made["composed_disc_once_above_350_degC"] == 1.0
    made.drive(600.0, 2500.0)
    assert made[
        "composed_fluid_fading_within_60_s_after_braking"
    ] == pytest.approx(1.0, abs=1e-3)
    assert made[
        "composed_pad_back_rising_until_3_MJ_of_braking"
    ] == pytest.approx(0.5)
    made.drive(60.0)
    assert made[
        "composed_fluid_fading_within_60_s_after_braking"
    ] == pytest.approx(0.37, abs=0.01)


def test_what_is_warming_is_whole_after_its_time_of_driving(
    corner: Make,
) -> None:
    """In proportion to the time driven; parked it fades."""
    words = "warming within 200 s of driving"
    made = corner("composed", **{f"heat at fluid, {words}": 30.0})
    found = []

    for seconds, speed_ms in (
        *((50.0, 20.0), (250.0, 5.0)),
        *((200.0, 0.0), (100.0, 20.0)),
    ):
        made.drive(seconds, speed_ms=speed_ms)
        found.append(made["composed_fluid_warming_within_200_s_of_driving"])

    assert found == pytest.approx([0.25, 1.0, 0.3679, 0.8679], abs=2e-3)


def test_a_share_of_all_leaves_nothing(corner: Make) -> None:
    """Minus one takes the conductance off, and no more than that."""
    whole = tour(corner("composed", **{"share of disc to air": -1.0}))
    half = tour(corner("composed", **{"share of disc to air": -0.5}))

    assert whole["disc"] > half["disc"] > tour(corner(None))["disc"]
    energy_j = dict(
        zip(whole.program.ledger_names, whole.batch.ledger, strict=True)
    )
    for name in ("disc_convection", "disc_radiation"):
        back_j = energy_j[f"share of disc to air {name}"]
        assert back_j == pytest.approx(energy_j[name], rel=0.01)


@pytest.mark.parametrize(
    ("text", "size", "says"),
    [
        ("disc to air", -1.0, "allowed 0 to 500 W/K"),
        ("share of disc to air", -1.2, "allowed -1 to 10 1"),
        ("share of the brake heat", -1.1, "allowed -1 to 2"),
        ("heat at disc", 100.0, "heat needs a cause"),
        ("heat at disc, driving", -100.0, "a sink needs a temperature"),
        ("disc to air, parked, braking", 1.0, "two clauses on one driver"),
        (HOT + ", above 60 km/h", 1.0, "more than 2 clauses"),
        ("disc to a mass within 120 s, wet", 1.0, "a mass takes no clause"),
        ("disc to air, above 3000 degC", 1.0, "allowed"),
        ("disc to moon", 1.0, "no path 'disc to moon'; there are: disc to"),
        ("disc to air, at night", 1.0, "no clause 'at night'; there are:"),
    ],
)
def test_what_physics_forbids_is_refused(
    text: str, size: float, says: str
) -> None:
    entry = EffectConfig(name="composed", parameters={text: size})

    (problem,) = problems_of([entry])

    assert problem.startswith("[[effect]] composed parameters.")
    assert says in problem
    with pytest.raises(ValueError, match="parameters"):
        Composed(entry.parameters)


def test_terms_together_take_away_no_more_than_all() -> None:
    half = {f"share of disc to air, {one}": -0.6 for one in ("wet", "parked")}

    (problem,) = Composed.problems(half)

    assert problem == (
        "parameters.'share of disc to air, parked': the terms take away more "
        "than all"
    )
    assert not Composed.problems({**half, "strength": 0.8})


def test_each_term_is_told_what_is_wrong_with_it() -> None:
    values = {"strength": 1.0, "disc to moon": 1.0, "disc to air, at": 1.0}

    found = Composed.problems({**values, "disc to air": -1.0})

    said = [line.partition(": ")[0] for line in found]
    assert said == [f"parameters.'{k}'" for k in (*values, "disc to air")][1:]


@pytest.mark.parametrize("last", ["composed", "local_air"])
def test_what_goes_to_the_air_begins_where_it_says(
    make_spec: Callable[..., CornerSpec], last: str
) -> None:
    """It goes to the air beside the brake; the fluid's by its caliper."""
    spec = make_spec(thermal={})
    base = CornerModel(spec, build_corner(spec, INPUTS), True)
    paths = [p for p in PATHS.values() if (p.kind, p.b) == ("link", AIR)]
    entries = [
        EffectConfig(
            name="composed", parameters={p.text: p.size for p in paths}
        ),
        *(EffectConfig(name=n) for n in ("local_air", "caliper_fluid_split")),
    ]
    entries.sort(key=lambda one: one.name == last)

    net = apply_effects(base, entries).network

    for path in paths:
        link = net.link(path.text)
        start = {"fluid": "caliper"}.get(path.a, path.a)
        assert (link.a, link.b) == (start, "air")


def test_sizes_have_the_dimension_of_their_path() -> None:
    """W/K on links, W on sources, none on shares of what has its own."""
    units = {kind: unit for kind, (unit, *_) in SIZES.items()}

    assert units == {
        "link": "W/K",
        "mass": "W/K",
        "carried": "W/K",
        "source": "W",
        "share": "1",
        "heat": "1",
    }
    assert read("share of disc to air", -0.45).said == "45 % less"
    assert read("share of disc to air", 0.45).said == "45 % more"
    assert read(HOT, 4.2).said == "4.2 W/K"


def test_strength_scales_all_sizes_and_0_is_absence(corner: Make) -> None:
    once = tour(corner("composed", **{HOT: 2.0})).nodes()
    scaled = tour(corner("composed", strength=0.5, **{HOT: 4.0})).nodes()
    absent = tour(corner("composed", strength=0.0, **{HOT: 4.0})).nodes()

    assert scaled == once
    assert absent == tour(corner(None)).nodes()


def test_it_is_beside_the_catalogue_and_not_of_it() -> None:
    assert effect_class("composed") is Composed
    assert "composed" not in effect_names()
    assert Composed.number not in {
        effect_class(n).number for n in effect_names()
    }
    assert Composed.description.startswith("A heat path that no effect")
    assert is_composed(f"composed.{HOT}")
    assert not any(map(is_composed, effect_names()))


def test_a_path_that_a_structure_lacks_is_a_worded_problem(
    make_spec: Callable[..., CornerSpec],
) -> None:
    spec = make_spec(thermal={})
    net = build_corner(spec, INPUTS)
    bare = CornerModel(spec, replace(net, links=()), heat_from_pressure=True)

    with pytest.raises(ValueError, match="no share of disc to air"):
        read("share of disc to air, wet").edit(bare)


def test_both_forms_are_equal_bit_for_bit(corner: Make) -> None:
    """Three terms, every kind of part: links, sources, memories, a mass."""
    terms = {
        "share of disc to air, once above 350 degC": -0.4,
        "heat at fluid, rising with speed": 80.0,
        "disc to a mass within 120 s": 2.0,
        "disc by air to pad_back, fading within 60 s after braking": 0.3,
    }
    fast = corner("composed", **terms)
    slow = corner("composed", **terms)
    slow.batch = Batch([slow.program], 283.15, kernel=None)

    if fast.batch.kernel is None:
        pytest.skip("the compiled form is not installed")
    assert tour(fast).batch.state == tour(slow).batch.state
    assert fast.batch.ledger == slow.batch.ledger


def test_terms_of_a_path_are_held_to_what_there_is() -> None:
    wet, driving = "share of disc to air, wet", "share of disc to air, driving"
    sizes = {wet: -0.6, driving: -0.9, "fluid to air": 0.4}
    least = SIZES["share"][1]

    found = bounded(sizes)

    assert found[wet] + found[driving] == pytest.approx(least)
    assert Composed.problems(sizes)
    assert not Composed.problems(found)
    assert found[wet] / found[driving] == pytest.approx(0.6 / 0.9)
    assert found["fluid to air"] == 0.4
    assert bounded({wet: -0.3, driving: 0.5}) == {wet: -0.3, driving: 0.5}

"""``bstm gap`` in words: what a reader would take wrongly is not said."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bstm_daemon.analysis.gap.evidence import Candidate
from bstm_daemon.analysis.gap.holdout_comparison import (
    CONFIGURED,
    EXTENDED,
    Shrink,
)
from bstm_daemon.analysis.gap.naming import Answer, Naming
from bstm_daemon.analysis.gap.residual_heat import Cell, Place
from bstm_daemon.analysis.gap.workflow import Gap
from bstm_daemon.model.effects.effect import SIGNED_STRENGTH
from bstm_daemon.report.gap import (
    MATCH_FIRST,
    adopted_text,
    answer_line,
    answer_tile,
    candidate_rows,
    probability_tile,
    reach_lines,
    sentence,
    times,
    unnamed_lines,
)
from bstm_daemon.report.gap_forces import acceleration
from bstm_daemon.report.gap_page import (
    WEAK_EVIDENCE,
    evidence_bars,
    head_tiles,
    heat_map,
)


def candidate(
    name: str, log_evidence: float = 0.0, reach: float = 1.0
) -> Candidate:
    return Candidate(name, 1.0, 0.5, 1.0, log_evidence, reach)


def naming(answer: Answer, *candidates: Candidate) -> Naming:
    names = tuple(one.name for one in candidates)
    odds = dict.fromkeys(names, 0.4)
    return Naming(
        answer,
        () if answer in {"nothing", "unknown"} else names,
        0.8,
        candidates,
        odds,
        "so it is",
    )


def test_a_gap_that_grows_is_not_called_smaller() -> None:
    assert times(Shrink(2.5, 1.7, 3.9)) == "2.5 times smaller (1.7 to 3.9)"
    assert times(Shrink(0.5, 0.4, 0.8)) == "2.0 times larger (1.2 to 2.5)"


def test_a_strength_that_no_effect_can_have_shows_nothing() -> None:
    beyond = SIGNED_STRENGTH.upper * 1.01
    found = naming(
        "nothing",
        candidate("residual_drag", reach=beyond),
        candidate("pad_wear", reach=0.32),
    )

    near, far = reach_lines(found)

    assert near.endswith("from the strength of: pad_wear 0.32")
    assert far == "too weak in these drives at any strength: residual_drag"
    assert len(reach_lines(naming("nothing", candidate("pad_wear")))) == 1


def test_residual_heat_without_a_name_is_for_the_match() -> None:
    """Else nothing visible stands beside a map that is blue and red."""
    hot: Any = SimpleNamespace(places=(1,))
    pale: Any = SimpleNamespace(places=())
    found = naming("nothing", candidate("pad_wear"))
    named = naming("name", candidate("pad_wear"))

    assert MATCH_FIRST in unnamed_lines(Gap(("FL",), (), 1, hot, found))
    assert MATCH_FIRST not in unnamed_lines(Gap(("FL",), (), 1, pale, found))
    assert unnamed_lines(Gap(("FL",), (), 1, hot, named)) == []


def test_no_evidence_has_no_sign() -> None:
    (row,) = candidate_rows(naming("nothing", candidate("pad_wear", -0.04)))

    assert row[4] == "0.0"


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ("nothing", "nothing visible"),
        ("unknown", "not in the catalogue"),
        ("undecided", "not decided"),
        ("class", "pad wear or wet disc"),
        ("name", "pad wear and wet disc"),
    ],
)
def test_the_head_of_the_page_says_the_answer(
    answer: Answer, said: str
) -> None:
    found = naming(answer, candidate("pad_wear"), candidate("wet_disc"))

    assert answer_tile(found)[0] == said
    assert ("nothing" in probability_tile(found)[1]) == (answer == "nothing")


def test_the_head_is_of_the_corners_that_lack_something() -> None:
    front = Gap(("FL", "FR"), (), 1, None, naming("nothing"))
    wear = naming("name", candidate("pad_wear"))
    rear = Gap(("RL", "RR"), (), 1, None, wear)

    assert head_tiles([front, rear])[0] == (
        "pad wear",
        "missing effect, RL, RR",
    )
    assert head_tiles([front])[0] == ("nothing visible", "missing effect")


def test_one_of_a_class_is_not_written_as_if_it_were_known() -> None:
    def gap(answer: Answer) -> Gap:
        found: Any = SimpleNamespace(
            naming=naming(answer, candidate("pad_wear"), candidate("wet_disc"))
        )
        found.adopted = ("pad_wear",)
        return cast("Gap", found)

    assert adopted_text([gap("name")]) == "pad_wear"
    assert adopted_text([gap("class")]) == (
        "pad_wear (one of pad_wear, wet_disc; these drives cannot "
        "distinguish them)"
    )


def test_an_error_within_the_noise_is_not_a_figure() -> None:
    assert acceleration(0.0) == "none"
    assert acceleration(0.1834) == "0.183 m/s2"


def test_next_to_no_evidence_looks_like_it() -> None:
    weak = evidence_bars(naming("nothing", candidate("pad_wear", 0.26)))
    strong = evidence_bars(naming("name", candidate("pad_wear", 260.0)))

    assert weak.layout["xaxis"]["range"] == [0.0, WEAK_EVIDENCE]
    assert strong.layout["xaxis"]["range"][1] > 260.0


def shown(before_k: float, after_k: float) -> Any:
    """Return one node over one held-out drive, before and after."""
    rms_k = {CONFIGURED: before_k, EXTENDED: after_k}
    return SimpleNamespace(
        held_out=True,
        errors=(SimpleNamespace(rms_k=rms_k),),
        shrinks={CONFIGURED: Shrink(1.6, 1.2, 2.2)},
    )


def test_the_page_begins_with_a_sentence_for_a_person() -> None:
    place = Place("pad_front", "", "parked", 301e3, 11.6)
    link = Place("disc", "pad_front", "driving", -122e3, 3.7)
    named = naming("name", candidate("gap_conduction"))

    def gap(place: Place, found: Naming) -> Gap:
        located: Any = SimpleNamespace(places=(place,))
        parts = ("FL",), (), 1, located, found
        return Gap(*parts, shown=shown(6.4, 4.5))

    assert sentence(gap(place, named)) == (
        "While parked the model has 301 kJ too little heat at the pad front; "
        "likely cause: the narrow gap of a released brake still conducts "
        "heat; with it the error on held-out drives falls from 6.4 to 4.5 K."
    )
    assert sentence(gap(link, naming("unknown"))).startswith(
        "While driving the model has 122 kJ too much heat between the disc "
        "and the pad front; none of the known effects explains it;"
    )
    of_front = replace(
        naming("unknown"),
        unknown_place="reading of pad_front that differs with its excess",
    )
    assert (
        "; none of the known effects explains it; most like it: reading of "
        "pad front that differs with its excess;"
    ) in sentence(gap(link, of_front))
    fit: Any = SimpleNamespace(strengths={"pad_wear": 1.0})
    open_one = replace(
        gap(place, naming("undecided", candidate("pad_wear"))), fit=fit
    )
    assert sentence(open_one).endswith(
        "; the drives do not decide which effect is missing; with pad_wear "
        "the error on held-out drives falls from 6.4 to 4.5 K."
    )


def test_the_tile_is_of_what_is_written() -> None:
    """Not of the re-fitted tunables, which no file has."""
    found = naming("name", candidate("pad_wear"))
    gap = Gap(("FL",), (), 1, None, found, shown=shown(6.4, 4.5))

    assert head_tiles([gap])[-1] == ("1.6 x", "smaller gap, as written")


def test_colour_and_text_of_a_cell_are_the_same_heat_in_order() -> None:
    cells = [
        Cell("disc", "parked", "200 to 300 degC", -80e3, 1e3, 9),
        Cell("disc", "braking", "> 450 degC", 40e3, 1e3, 9),
        Cell("disc", "braking", "< 100 degC", 7e3, 5e3, 9),
        Cell("fluid", "braking", "< 100 degC", 20e3, 1e3, 9),
    ]

    (drawn,) = heat_map(cells).data

    # plotly draws the first row at the bottom
    assert drawn["y"][::-1] == [
        *("braking < 100 °C", "braking > 450 °C", "parked 200-300 °C")
    ]
    assert drawn["z"][::-1] == [[0.0, 20.0], [40.0, None], [-80.0, None]]
    assert drawn["text"][::-1] == [["·", "+20"], ["+40", ""], ["-80", ""]]
    assert (drawn["zmin"], drawn["zmax"]) == (-80.0, 80.0)
    assert "kJ" in drawn["colorbar"]["title"]["text"]


def test_a_change_is_no_missing_effect() -> None:
    air = Candidate("change.disc_air", -0.45, 0.1, 9.0, 12.0, 0.5)
    changed = naming("name", air)

    assert answer_line(changed, "this data") == (
        "changed: convection from the disc to the wheel well -27 % since the "
        "match: rim or wheel cover closed, cooling duct blocked? "
        "(probability 80.0 %)"
    )
    assert answer_tile(changed)[1] == "change"
    (row,) = candidate_rows(changed)
    assert row[:3] == (
        "convection from the disc to the wheel well",
        "-27 %",
        "7 %",
    )
    (near,) = reach_lines(changed)
    assert near.endswith("convection from the disc to the wheel well +42 %")
    both = naming("name", air, candidate("pad_wear"))
    assert answer_line(both, "this data").startswith(
        "missing: convection from the disc to the wheel well -27 % since the "
        "match, pad_wear ("
    )


def test_a_matched_car_is_not_sent_back_to_the_match() -> None:
    hot: Any = SimpleNamespace(places=(1,))
    found = naming("nothing", candidate("pad_wear"))

    gap = Gap(("FL",), (), 1, hot, found, matched=True)

    assert MATCH_FIRST not in unnamed_lines(gap)


def test_a_composed_effect_is_said_in_its_own_words() -> None:
    """Each term with its size at the strength that was found."""
    names = (
        "composed.disc to air, driving, above 300 degC",
        "composed.share of fluid to air, parked",
    )
    found = replace(
        naming("composed", *map(candidate, names)),
        sizes=dict(zip(names, (4.2, -0.45), strict=True)),
    )
    words = (
        "disc to air, driving, above 300 degC: 4.2 W/K",
        "share of fluid to air, parked: 45 % less",
    )

    assert answer_line(found, "this data") == (
        "missing: none of the known effects; best description: "
        + "; ".join(words)
    )
    assert answer_tile(found) == (
        " and ".join(words),
        "missing effect, in no catalogue",
    )
    assert words[0] in sentence(Gap(("FL",), ("a",), 1, naming=found))
    rows = candidate_rows(found)
    assert rows[0][0] == "disc to air, driving, above 300 degC"
    assert found.adoptable == names

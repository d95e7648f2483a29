"""Strengths of effects as values that are matched, and written."""

from __future__ import annotations

from math import exp
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.identify.writing import Change, write_changed
from bstm_daemon.analysis.matching.changes import changes_of
from bstm_daemon.analysis.matching.coarse import Reading
from bstm_daemon.analysis.matching.effect_values import effect_value
from bstm_daemon.analysis.matching.identifiability import verdicts
from bstm_daemon.analysis.matching.matcher import match_drives
from bstm_daemon.analysis.matching.problem import Problem
from bstm_daemon.analysis.matching.targets import targets_of
from bstm_daemon.analysis.matching.tunables import (
    AIR_AT_REST,
    BRACKET_LOSS,
    CONDUCTANCE,
    IN_BORE,
    LINING,
    REFINED,
    STRENGTHS,
    TO_CALIPER,
    TUNABLES,
    VIEW,
    WIND,
    Target,
    refined_keys,
    strength_key,
)
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.effects.catalogue import (
    effect_class,
    effects_of,
    problems_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.config.sections import Config

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "config" / "example_vehicle.toml"
GAP = strength_key("gap_conduction")
BRACKET = strength_key("bracket_conduction")
RIGHT = {GAP: 1.8, BRACKET: 0.5, IN_BORE: 800.0}
SPLIT = strength_key("caliper_fluid_split")
SLOW_FLUID = {SPLIT: 3.0, TO_CALIPER: 20.0}

ENTRIES = """
# measured by hand
[[effect]]
name = "gap_conduction"
# of all four
parameters = {strength = 1.0, conductance_w_m2k = 150.0}  # a guess
"""


@pytest.fixture(scope="module")
def extended(target: Target) -> Target:
    thermal = target.config.thermal.model_copy(
        update={"structure": "extended"}
    )
    config = target.config.model_copy(update={"thermal": thermal})
    return Target(config, target.corners)


@pytest.fixture(scope="module")
def match(extended: Target, made: Callable[..., Drive]) -> Match:
    drive = made(
        RIGHT | SLOW_FLUID,
        noise_k=0.3,
        target=extended,
        nodes=("disc", "pad_front", "pad_back", "fluid", "caliper"),
    )
    return match_drives(
        extended.config, [Reading(None, [drive])], beside=False
    )[0]


def test_each_strength_has_the_prior_of_its_kind(extended: Target) -> None:
    radiation = strength_key("disc_caliper_radiation")
    keys = (radiation, BRACKET)
    problem = Problem(extended, [], keys, [], [], None)
    off = np.array([[0.0, 0.8], [-2.0, -0.4]])

    held = problem.of_priors(problem.start + off)

    squares = 10.0 * np.log1p((off[:, 0] / 0.3) ** 2 / 10.0)
    assert held[:, 0] == pytest.approx(np.sign(off[:, 0]) * np.sqrt(squares))
    assert held[:, 1] == pytest.approx([2.0, -1.0])


@pytest.mark.slow
def test_the_strength_of_an_effect_is_found(match: Match) -> None:
    for key, right in RIGHT.items():
        found = match.joint.values[key]
        assert found == pytest.approx(right, rel=0.1), key
        deviation = match.joint.standard_deviation(key)
        assert abs(found - right) < 4.0 * deviation + 0.02 * right
    # what divides the resistance from the shim on shows little
    values = match.joint.values
    assert values[TO_CALIPER] / values[SPLIT] == pytest.approx(
        20.0 / 3.0, rel=0.2
    )


@pytest.mark.slow
def test_the_verdicts_name_strengths_too(match: Match) -> None:
    found = {one.key: one for one in verdicts(match.joint)}

    assert found[GAP].settled
    assert found[GAP].share < 0.5


def test_strengths_of_what_the_structure_has_are_refined(
    target: Target, extended: Target
) -> None:
    assert refined_keys(target) == REFINED
    assert set(refined_keys(extended)) - set(REFINED) == {
        AIR_AT_REST,
        BRACKET_LOSS,
        CONDUCTANCE,
        IN_BORE,
        *LINING,
        TO_CALIPER,
        VIEW,
        WIND,
        *map(strength_key, STRENGTHS),
    }


def test_what_is_switched_off_stays_off(extended: Target) -> None:
    off = EffectConfig(name="disc_hat", parameters={"strength": 0.0})
    config = extended.config.model_copy(update={"effect": [off]})

    keys = refined_keys(Target(config, extended.corners))

    assert strength_key("disc_hat") not in keys
    assert GAP in keys


def test_an_entry_of_the_file_is_refined_too(target: Target) -> None:
    own = EffectConfig(name="hub_conduction", corner="FL")
    config = target.config.model_copy(update={"effect": [own]})

    assert strength_key("hub_conduction") in refined_keys(
        Target(config, ("FL",))
    )
    assert refined_keys(Target(config, ("FR",))) == REFINED


@pytest.mark.parametrize("corner", ["all", "FL"])
def test_other_corners_keep_their_strength(
    extended: Target, corner: str
) -> None:
    own = EffectConfig.model_validate(
        {
            "name": "disc_hat",
            "corner": corner,
            "parameters": {"strength": 2.0, "mass_kg": 3.0},
        }
    )
    config = extended.config.model_copy(update={"effect": [own]})
    target = Target(config, ("FL", "FR"))

    changed = target.changed({strength_key("disc_hat"): 1.5})

    def strength(name: str) -> float:
        return effect_value(changed.config, name, "disc_hat.strength")

    before = 2.0 if corner == "all" else 1.0
    assert [strength(name) for name in ("FL", "FR", "RL", "RR")] == [
        *(1.5, 1.5),
        *(before, before),
    ]
    assert effect_value(changed.config, "FL", "disc_hat.mass_kg") == 3.0
    assert not problems_of(changed.config.effect)
    names = [(one.name, one.corner) for one in effects_of(changed.config)]
    assert len(names) == len(set(names))


def test_entries_of_other_corners_stay_as_they_are(extended: Target) -> None:
    """What the structure has there gets no entry."""
    rear = EffectConfig(
        name="disc_hat", corner="RL", parameters={"strength": 2.0}
    )
    config = extended.config.model_copy(update={"effect": [rear]})

    values = {strength_key("disc_hat"): 1.5, GAP: 0.5, BRACKET: 0.7}
    changed = Target(config, ("FL",)).changed(values)

    found = [
        (one.name, one.corner, dict(one.parameters))
        for one in changed.config.effect
    ]
    assert sorted(found, key=str) == [
        ("bracket_conduction", "FL", {"strength": 0.7}),
        ("disc_hat", "FL", {"strength": 1.5}),
        ("disc_hat", "RL", {"strength": 2.0}),
        ("gap_conduction", "FL", {"strength": 0.5}),
    ]


def test_corners_with_different_strengths_are_matched_apart(
    config: Config,
) -> None:
    own = EffectConfig(name="disc_hat", corner="FL")
    changed = config.model_copy(update={"effect": [own]})

    found = targets_of(changed, ["FL", "FR"])

    assert [one.corners for one in found] == [("FL",), ("FR",)]


@pytest.mark.slow
def test_matched_strengths_become_entries_of_the_file(
    match: Match, extended: Target, tmp_path: Path
) -> None:
    source = tmp_path / "car.toml"
    source.write_text(EXAMPLE.read_text("utf-8") + ENTRIES, "utf-8")
    changed = tmp_path / "new.toml"
    origin = "matched, made.log, 2026-11-21"

    changes = changes_of([match], extended.config, origin)
    write_changed(source, changed, changes, origin)

    text = changed.read_text("utf-8")
    new = load_config(changed)
    found = match.joint.values[GAP]
    # the right one is alike
    for corner in ("FL", "FR"):
        strength = effect_value(new, corner, "gap_conduction.strength")
        assert strength == pytest.approx(found, rel=1e-4)
    # what stood there for all corners goes on for the others
    assert effect_value(new, "RL", "gap_conduction.strength") == 1.0
    for corner in ("FL", "RR"):
        assert (
            effect_value(new, corner, "gap_conduction.conductance_w_m2k")
            == 150.0
        )
    for comment in ("# measured by hand", "# of all four"):
        assert comment in text
    line = next(one for one in text.splitlines() if origin in one and
                "conductance_w_m2k" in one)  # fmt: skip
    assert "; was 1.0 (a guess)" in line
    assert ", sd " in line


def test_an_effect_of_the_structure_gets_an_entry(tmp_path: Path) -> None:
    changed = tmp_path / "new.toml"
    changes = [
        Change("effect", "strength", 1.25, "FL", "matched, sd 0.1", "disc_hat")
    ]

    write_changed(EXAMPLE, changed, changes, "matched")

    text = changed.read_text("utf-8")
    (entry,) = load_config(changed).effect
    assert (entry.name, entry.corner) == ("disc_hat", "FL")
    assert entry.parameters == {"strength": 1.25}
    assert "# matched, sd 0.1; was typical" in text


def test_values_of_one_line_are_told_in_its_one_comment(
    tmp_path: Path,
) -> None:
    source = tmp_path / "car.toml"
    entry = (
        '\n[[effect]]\nname = "disc_hat"\n'
        "parameters = { strength = 0.5 } # matched (typical)\n"
    )
    source.write_text(EXAMPLE.read_text("utf-8") + entry, "utf-8")
    changes = [
        Change("effect", key, value, "all", "", "disc_hat")
        for key, value in {"strength": 2.0, "conductance_w_k": 0.7}.items()
    ]

    write_changed(source, tmp_path / "new.toml", changes, "fitted")

    assert "# fitted; was 0.5, typical (matched (typical))" in (
        tmp_path / "new.toml"
    ).read_text("utf-8")


def test_each_value_of_a_line_tells_its_deviation(tmp_path: Path) -> None:
    changes = [
        Change("effect", key, 2.0, "FL", f"matched, sd {sd}", "disc_hat")
        for key, sd in {"strength": 0.1, "conductance_w_k": 0.3}.items()
    ]

    write_changed(EXAMPLE, tmp_path / "new.toml", changes, "matched")

    assert "# matched, sd 0.1, 0.3; was typical, typical\n" in (
        tmp_path / "new.toml"
    ).read_text("utf-8")


def test_a_value_that_is_matched_again_keeps_its_history(
    tmp_path: Path,
) -> None:
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    for source, target, value, sd in (
        (EXAMPLE, first, 0.7, 0.1),
        (first, second, 0.8, 0.2),
    ):
        note = f"matched, sd {sd}"
        change = Change("thermal", "disc_view_factor", value, "", note)
        write_changed(source, target, [change], "matched")

    assert (
        "disc_view_factor = 0.8 "
        "# matched, sd 0.2; was 0.7 (matched, sd 0.1; was 1.0)\n"
    ) in second.read_text("utf-8")


@pytest.mark.parametrize("name", sorted(STRENGTHS))
def test_bounds_are_within_the_catalogue(name: str) -> None:
    one = TUNABLES[strength_key(name)]

    most = effect_class(name).most_strength
    assert 0.0 < one.lower < 1.0 < one.upper <= most
    # a value at its bound is still one that the effect takes
    assert one.lower <= exp(one.bounds()[0])
    assert exp(one.bounds()[1]) <= one.upper


def test_a_strength_at_its_bound_stays_inside(extended: Target) -> None:
    """The exponential of a bound's logarithm rounds to beyond it."""
    key = strength_key("disc_caliper_radiation")
    most = effect_class("disc_caliper_radiation").most_strength
    beyond = float(np.exp(np.log(most)))
    assert beyond > most

    changed = extended.changed({key: beyond})

    assert changed.value(TUNABLES[key]) == most
    assert changed.changed({key: 0.5}).value(TUNABLES[key]) == 0.5

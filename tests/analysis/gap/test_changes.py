"""Values that have changed since the match: candidates, words, answers."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.gap import workflow
from bstm_daemon.analysis.gap.adopting import written
from bstm_daemon.analysis.gap.changes import (
    HEAT_SCALE,
    KINDS,
    STEP,
    factor_of,
    forms_of,
    largest,
    of_sensor,
    said,
    said_percent,
    trials,
)
from bstm_daemon.analysis.gap.comparison import Comparison, with_effects
from bstm_daemon.analysis.gap.evidence import Candidate
from bstm_daemon.analysis.gap.fitting import Fit
from bstm_daemon.analysis.gap.form import form_k, with_form
from bstm_daemon.analysis.gap.naming import Naming
from bstm_daemon.analysis.gap.searching import _simulated_there
from bstm_daemon.analysis.gap.signatures import (
    Sensed,
    _change_strengths,
    candidates,
    of_large_change,
    sensed,
    signature_of,
    whitened_signature,
)
from bstm_daemon.analysis.gap.workflow import compare, find_gap
from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.analysis.matching.learned import entry
from bstm_daemon.analysis.matching.tunables import (
    AIR_AT_REST,
    BRACKET_LOSS,
    IN_BORE,
    MASS,
    S_SPEEDS_MS,
    SIDES,
    TO_CALIPER,
    TUNABLES,
    VIEW,
    WIND,
    Target,
    refined_keys,
    strength_key,
    usable,
)
from bstm_daemon.config.estimates import MatchedConfig
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.effects.catalogue import effect_class, effect_names
from bstm_daemon.report.gap import headline

from ...made_drives import effect_entries  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.config.sections import Config

AMONG = (
    "gap_conduction", "hub_conduction", "disc_radiation_driving",
    "backplate_loss", "bracket_conduction", "caliper_radiation",
    "shim_contact",
)  # fmt: skip
"""Effects on temperatures: these drives have no samples to heat anew."""

EXAMPLE = Path(__file__).parents[3] / "config" / "example_vehicle.toml"

CONDUCTION = "bracket_conduction"
MORE = f"change.{strength_key(CONDUCTION)}"

EMPTY = MatchedConfig(
    corners=["FL"],
    names=[],
    values=[],
    factor=[],
    form_k={"disc": 2.0, "pad_front": 2.0, "pad_back": 1.0, "fluid": 1.0},
)
KNOWN_TO = 0.25
"""Of its prior, how well a match knows a value."""


@pytest.fixture(scope="module")
def matched(config: Config) -> Target:
    """Return the front left corner with what its match learned."""
    plain = Target(config, ("FL",))
    keys, _ = usable(plain, refined_keys(plain))
    prior = np.array([KNOWN_TO * TUNABLES[key].prior for key in keys])
    known = entry(plain, keys, np.diag(prior**2), EMPTY)
    return Target(config.model_copy(update={"matched": [known]}), ("FL",))


@pytest.fixture(autouse=True)
def among(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let these effects be all that there are."""
    monkeypatch.setattr(workflow, "candidates", lambda _: list(AMONG))


def ff(config: Config) -> Config:
    heat = config.heat.model_copy(update={"mode": "ff"})
    return config.model_copy(update={"heat": heat})


def test_each_value_is_a_candidate_and_what_one_cause_moves_is_one(
    config: Config,
) -> None:
    keys = (*S_SPEEDS_MS, MASS, "thermal.pad_static_loss_w_k", HEAT_SCALE)
    # nothing that happens to a car changes how its caliper is built
    built = strength_key("caliper_fluid_split")

    found = trials(ff(config), (*keys, built))

    assert list(found) == [
        "change.disc_air",
        "change.disc_mass",
        "change.brake_heat",
        "change.thermal.pad_static_loss_w_k",
    ]
    assert found["change.disc_air"].direction.tolist() == [
        STEP, STEP, STEP, 0.0, 0.0, 0.0, 0.0,
    ]  # fmt: skip


def test_heat_from_motion_says_nothing_of_friction(config: Config) -> None:
    heat = config.heat.model_copy(update={"mode": "fb"})
    moving = config.model_copy(update={"heat": heat})

    assert not trials(moving, (HEAT_SCALE,))


def test_an_effect_on_the_heat_that_the_model_has_can_change(
    config: Config,
) -> None:
    fading = with_effects(config, effect_entries({"friction_fade": 0.7}))

    found = trials(fading, ())["change.effect.friction_fade.strength"]

    (there,) = found.effects_at(1.0)
    assert there.parameters["strength"] == pytest.approx(0.7 * np.exp(STEP))
    # no further than physics allows
    (bound,) = found.effects_at(4.0)
    assert bound.parameters["strength"] == 5.0
    # a structure has it for each corner, and all of them change
    whole = config.thermal.model_copy(update={"structure": "extended"})
    extended = config.model_copy(update={"thermal": whole})
    found = trials(extended, ())["change.effect.friction_fade.strength"]
    changed = {one.corner: one.parameters for one in found.effects_at(1.0)}
    assert changed == {
        one.name: {"strength": pytest.approx(np.exp(STEP))}
        for one in config.corner
    }
    off = with_effects(config, effect_entries({"friction_fade": 0.0}))
    assert not trials(off, ())
    assert "friction_fade" in candidates(off)
    assert "friction_fade" not in candidates(fading)


def test_one_pass_tells_what_a_strength_on_the_heat_changes(
    config: Config, matched: Target, made: Callable[..., Recording]
) -> None:
    """More and less of an effect that the heat is linear in."""
    fading = with_effects(config, effect_entries({"friction_fade": 0.7}))
    name = "change.effect.friction_fade.strength"
    comparison = compare(matched, [made()])
    comparison.trials = trials(fading, comparison.keys)
    base = np.zeros(int(comparison.edges[-1]))
    column = np.linspace(-1.0, 1.0, len(base))
    seen = []

    def residuals_k(_: object, effects: list[EffectConfig]) -> Column:
        seen.append(effects[0].parameters["strength"])
        return ((seen[-1] - 0.7) * column)[:, None]

    comparison.residuals_k = residuals_k  # type: ignore[assignment]

    signature = signature_of(comparison, name, base)

    assert signature is not None
    assert len(seen) == 1
    for a in (-0.5, 0.5):
        change_k = comparison.whiten(0.7 * np.expm1(STEP * a) * column)
        assert signature.at(a) == pytest.approx(change_k)


def test_every_value_that_can_change_has_its_words() -> None:
    on_heat = [n for n in effect_names() if effect_class(n).kind == "heat"]
    # nothing that happens to a car changes how these are built
    built = map(strength_key, ("caliper_fluid_split", "disc_hat"))
    can = {*TUNABLES, HEAT_SCALE, *map(strength_key, on_heat)}
    can -= {*built, IN_BORE, TO_CALIPER, AIR_AT_REST, BRACKET_LOSS, WIND, VIEW}
    # factors between sides end in the values of each corner
    can -= {*SIDES}

    assert {key for kind in KINDS.values() for key in kind.keys} == can
    for kind in KINDS.values():
        words = (kind.what, kind.less, kind.more)
        assert all(0 < len(one) < 70 and "_" not in one for one in words)


def test_a_change_is_said_in_plain_words() -> None:
    strength = np.log(0.66) / STEP

    assert factor_of("change.disc_air", strength) == pytest.approx(0.66)
    (heat,) = (n for n, kind in KINDS.items() if HEAT_SCALE in kind.keys)
    # all heat is known better than one coefficient
    assert factor_of(f"change.{heat}", 1.0) == pytest.approx(1.2214, abs=1e-4)
    assert said("change.disc_air", strength) == (
        "convection from the disc to the wheel well -34 % since the match: "
        "rim or wheel cover closed, cooling duct blocked?"
    )
    assert said("change.effect.bracket_conduction.strength", -strength) == (
        "conduction from the backplates to the bracket +52 % since the "
        "match: new clips, pads that jam in the slides?"
    )
    for factor, words in (3.99, "+299 %"), (4.01, "4-fold"), (21.8, "22-fold"):
        much = np.log(factor) / STEP
        assert said_percent("change.disc_air", much) == words


@pytest.mark.slow
@pytest.mark.parametrize(
    "factor", [0.65, pytest.param(1.5, marks=pytest.mark.full)]
)
def test_a_value_that_has_changed_is_named_and_written(
    matched: Target, made: Callable[..., Recording], factor: float
) -> None:
    """Cooling by the wheel's air, less and more of it."""
    cooling = matched.config.cooling
    s = [factor * one for one in cooling.s_per_s]
    other = matched.config.model_copy(
        update={"cooling": cooling.model_copy(update={"s_per_s": s})}
    )
    drives = [made(of=other), made(name="b", seed=2, of=other)]

    (found,) = find_gap(matched.config, drives[:1], drives[1:], until="adopt")

    assert found.adopted == ("change.disc_air",)
    assert found.shown is not None
    assert found.shown.better
    sign = "-" if factor < 1.0 else "+"
    said_of = headline(found)
    assert "changed: convection from the disc to the wheel well" in said_of
    assert f"well {sign}" in said_of
    (change,) = found.entries.changes
    assert change.factor == pytest.approx(factor, rel=0.1)
    (value,) = (one for one in found.values if one.key == "cooling.s_per_s")
    assert isinstance(value.value, tuple)
    assert value.value[2] == pytest.approx(s[2], rel=0.1)
    (known,) = found.entries.matched
    assert known.names == matched.config.matched[0].names


@pytest.mark.slow
def test_nothing_has_changed_where_nothing_has(
    matched: Target, made: Callable[..., Recording]
) -> None:
    (found,) = find_gap(matched.config, [made(), made(name="b", seed=2)])

    assert found.naming is not None
    assert found.naming.answer == "nothing"


@pytest.mark.slow
def test_a_large_change_is_simulated_again_without_the_form(
    matched: Target, made: Callable[..., Recording]
) -> None:
    """What the form lacks is in the residuals with and without the change."""
    comparison = compare(matched, [made()])
    base_k = sensed(comparison, ()).base_k
    ((_, plain),) = of_large_change(
        comparison, base_k, "change.disc_air", -0.6
    )

    comparison.form_k = np.full(len(base_k), 3.0)
    ((form, terms),) = of_large_change(
        comparison, base_k + 3.0, "change.disc_air", -0.6
    )

    assert form == {}
    assert terms == pytest.approx(plain, abs=1e-9)


def conducting(
    config: Config, drives: list[Recording], **values: float
) -> Comparison:
    """Return a comparison that fits the bracket's conduction, of *values*."""
    own = EffectConfig(name=CONDUCTION, corner="FL", parameters=values)
    target = Target(with_effects(config, [own]), ("FL",))
    found = Comparison(
        target,
        drives,
        [strength_key(CONDUCTION), BRACKET_LOSS],
        compare(target, drives).noise,
    )
    found.trials = trials(target.config, found.keys)
    return found


def test_a_path_that_the_model_has_little_of_is_tried_at_much(
    config: Config, made: Callable[..., Recording]
) -> None:
    """As far as it can go."""
    for strength, second in (0.5, 2.0), (5.0, np.log(2.0) / STEP), (9.9, 0.5):
        tried = conducting(config, [made()], strength=strength)
        assert _change_strengths(tried, MORE) == pytest.approx((-0.5, second))

    tried.trials["change.disc_air"] = tried.trials[MORE]
    assert _change_strengths(tried, "change.disc_air") == (-0.5, 0.5)


@pytest.mark.slow
def test_more_of_a_path_may_have_another_form(
    config: Config, made: Callable[..., Recording]
) -> None:
    """Its strength is that of the change, its values those of the form."""
    drives = [made()]
    comparison = conducting(config, drives, strength=0.5, loss_w_k=0.4)
    base_k = comparison.residuals_k(comparison.start[None])[:, 0]
    forms = forms_of(MORE, comparison.keys)
    # what the match has fitted stays
    assert forms == (
        {"pressed_rise": 0.0},
        {"pressed_rise": 0.0, "capacity_j_k": 600.0},
    )

    options = of_large_change(comparison, base_k, MORE, 3.0)

    assert [form for form, _ in options] == [{}, *forms]
    for (form, terms), change in product(options, (1.5, 3.0)):
        x, effects = comparison.placed(
            comparison.start, {MORE: change}, {MORE: form}
        )
        (there,) = (
            one
            for one in comparison.config(x, effects).effect
            if one.name == CONDUCTION
        )
        assert there.parameters == {
            "strength": pytest.approx(0.5 * np.exp(change * STEP)),
            "loss_w_k": pytest.approx(0.4),
            **form,
        }
        changed = conducting(config, drives, **there.parameters)
        moved_k = changed.residuals_k(changed.start[None])[:, 0] - base_k
        assert change * terms[0] + change**2 * terms[1] == pytest.approx(
            moved_k, abs=1e-6
        )


def test_what_is_at_its_bound_is_not_simulated_as_more(
    config: Config, made: Callable[..., Recording]
) -> None:
    comparison = conducting(config, [made()], strength=10.0)
    before = sensed(comparison, ())

    there = _simulated_there(comparison, comparison, before, {MORE: 1.0})

    assert MORE in before.terms_k
    assert there.terms_k[MORE] is before.terms_k[MORE]
    assert MORE not in there.near
    less = _simulated_there(comparison, comparison, before, {MORE: -1.0})
    assert less.near == {MORE: -1.0}
    assert less.terms_k[MORE] is not before.terms_k[MORE]
    assert less.form_costs[MORE] > 0.0


def test_the_form_that_fits_is_written_with_the_change(
    config: Config, made: Callable[..., Recording], tmp_path: Path
) -> None:
    """A file with the strength and without the form is another model."""
    comparison = conducting(config, [made()], strength=0.5, loss_w_k=0.4)
    comparison.forms[MORE] = forms_of(MORE, comparison.keys)[1]
    x, effects = comparison.placed(comparison.start, {MORE: 3.0})
    found = Fit(x, {MORE: 3.0}, {MORE: 0.1}, 0.0, np.eye(3), tuple(effects))
    one = Candidate(MORE, 3.0, 0.1, 50.0, 45.0, 0.5)
    naming = Naming("name", (MORE,), 0.99, (one,), {MORE: 0.99, "": 0.01}, "")

    values, entries = written(comparison, found, naming)

    source, new = tmp_path / "source.toml", tmp_path / "new.toml"
    write_changed(
        EXAMPLE, source, (), "", "", Entries(comparison.target.config.effect)
    )
    write_changed(source, new, values, "bstm gap", "", entries)
    (effect,) = load_config(new).effect
    assert effect.parameters == {
        "strength": pytest.approx(0.5 * np.exp(3.0 * STEP), rel=1e-4),
        "loss_w_k": 0.4,
        "pressed_rise": 0.0,
        "capacity_j_k": 600.0,
    }
    (change,) = entries.changes
    assert change.factor == pytest.approx(np.exp(3.0 * STEP))


@pytest.mark.slow
def test_what_the_form_lacks_is_taken_off_later_drives(
    matched: Target, made: Callable[..., Recording]
) -> None:
    """A pad that conducts more when it is released, as it did at the match."""
    lacking = {"gap_conduction": 1.0}
    learning = compare(matched, [made(lacking), made(lacking, "b", seed=2)])
    known = with_form(
        matched.config.matched[0], learning, sensed(learning, AMONG)
    )
    config = matched.config.model_copy(update={"matched": [known]})
    later = compare(
        replace(matched, config=config), [made(lacking, "c", seed=3)]
    )
    later.trials = {}

    simulated = sensed(later, AMONG)
    offset_k = form_k(later, simulated)

    before_k = np.sqrt(np.mean(simulated.base_k**2))
    after_k = np.sqrt(np.mean((simulated.base_k + offset_k) ** 2))
    assert after_k < 0.2 * before_k
    assert known.form["gap_conduction"] > 0.1
    plain = compare(matched, [made(lacking, "c", seed=3)])
    plain.trials = {}
    assert not np.any(form_k(plain, simulated))


def test_an_effect_on_what_a_sensor_reads_is_told_not_fitted() -> None:
    assert of_sensor("clock_offset")
    assert not of_sensor("gap_conduction")
    assert not of_sensor("change.disc_mass")


def test_what_heats_the_brakes_is_an_effect_on_heat_or_its_change(
    matched: Target, made: Callable[..., Recording]
) -> None:
    entry = EffectConfig(name="friction_fade", parameters={"strength": 1.0})
    config = matched.config.model_copy(update={"effect": [entry]})
    comparison = compare(replace(matched, config=config), [made()])

    assert comparison.is_on_heat("mass_error")
    assert comparison.is_on_heat("change.effect.friction_fade.strength")
    assert not comparison.is_on_heat("change.disc_mass")
    assert not comparison.is_on_heat("gap_conduction")
    assert not comparison.is_on_heat("composed.disc, driving, constant")


def test_candidates_can_be_left_out_of_what_was_simulated() -> None:
    column = np.zeros((2, 3))
    one = Sensed(
        *(np.zeros(3), np.zeros((3, 1)), {"a": column, "b": column}, ("c",)),
        *((), {}, {"a": (column,)}),
    )

    left = one.without({"a", "c"})

    assert left.terms_k.keys() == {"b"}
    assert not left.forms_k
    assert left.silent == ("c",)
    assert one.terms_k.keys() == {"a", "b"}


def test_a_change_is_large_only_where_it_is_simulated(
    matched: Target, made: Callable[..., Recording]
) -> None:
    layout = compare(matched, [made()])
    terms = np.ones((2, sum(len(one.time_s) for one in layout.series)))
    most = {
        (name, near): whitened_signature(layout, name, terms, near).most
        for name in ("change.effect.disc_hat.strength", "change.disc_air")
        for near in (1.0, 3.0)
    }
    most |= {
        name: whitened_signature(layout, name, terms).most
        for name in ("disc_hat", "mass_error")
    }

    assert most == {
        ("change.effect.disc_hat.strength", 1.0): 4.0,
        ("change.effect.disc_hat.strength", 3.0): 6.0,
        ("change.disc_air", 1.0): 4.0,
        ("change.disc_air", 3.0): 4.0,
        "disc_hat": 4.0,
        "mass_error": 10.0,
    }


def test_what_is_no_strength_of_a_path_has_no_form_of_one() -> None:
    for name in (
        "change.disc_air",
        f"change.{BRACKET_LOSS}",
        "change.effect.friction_fade.strength",
    ):
        assert forms_of(name) == ()
        assert largest(name) == 4.0
    assert forms_of(CONDUCTION) == effect_class(CONDUCTION).forms

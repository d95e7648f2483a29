"""Values that have changed since the match: candidates, words, answers."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.gap import workflow
from bstm_daemon.analysis.gap.changes import (
    HEAT_SCALE,
    KINDS,
    STEP,
    factor_of,
    of_sensor,
    said,
    trials,
)
from bstm_daemon.analysis.gap.comparison import with_effects
from bstm_daemon.analysis.gap.form import form_k, with_form
from bstm_daemon.analysis.gap.signatures import (
    Sensed,
    candidates,
    sensed,
    sharpened,
    signature_of,
)
from bstm_daemon.analysis.gap.workflow import compare, find_gap
from bstm_daemon.analysis.matching.learned import entry
from bstm_daemon.analysis.matching.tunables import (
    AIR_AT_REST,
    BRACKET_LOSS,
    IN_BORE,
    MASS,
    S_SPEEDS_MS,
    SIDES,
    TUNABLES,
    WIND,
    Target,
    refined_keys,
    strength_key,
    usable,
)
from bstm_daemon.config.estimates import MatchedConfig
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
    # factors between sides end in the values of each corner
    can = {*TUNABLES, HEAT_SCALE, *map(strength_key, on_heat)}
    can -= {*built, AIR_AT_REST, BRACKET_LOSS, IN_BORE, WIND, *SIDES}

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


@pytest.mark.parametrize(
    "factor", [0.65, pytest.param(1.5, marks=pytest.mark.slow)]
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


def test_a_large_change_is_simulated_again_without_the_form(
    matched: Target, made: Callable[..., Recording]
) -> None:
    """What the form lacks is in the residuals with and without the change."""
    at = {"change.disc_air": -0.6}
    comparison = compare(matched, [made()])
    before = sensed(comparison, ())
    plain = sharpened(comparison, before, at)

    comparison.form_k = np.full(len(before.base_k), 3.0)
    turned = replace(before, base_k=before.base_k + comparison.form_k)
    found = sharpened(comparison, turned, at)

    assert found.near == at
    assert found.terms_k["change.disc_air"] == pytest.approx(
        plain.terms_k["change.disc_air"], abs=1e-9
    )


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

"""The catalogue: found by file, checked, applied to the right corner."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import bstm_daemon
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.effects import entries
from bstm_daemon.model.effects.catalogue import (
    apply_effects,
    effect_class,
    effect_names,
    problems_of,
)
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.thermal.brake_corner import CornerSpec, build_corner
from bstm_daemon.model.thermal.program import compile_network

if TYPE_CHECKING:
    from collections.abc import Callable

INPUTS = (
    *("speed_ms", "brake_on", "ambient_k", "brake_power_w", "pressure_pa"),
    "wetness",
)


def test_an_effect_is_its_file() -> None:
    """Every file of the folder is one effect of that name."""
    folder = Path(entries.__path__[0])
    files = {p.stem for p in folder.glob("*.py")} - {"__init__"}
    assert set(effect_names()) == files
    for name in files:
        assert effect_class(name).name == name


def test_numbers_are_unique_and_texts_there() -> None:
    """What the report and the workflow print of each."""
    classes = [effect_class(name) for name in effect_names()]
    assert len({cls.number for cls in classes}) == len(classes)
    for cls in classes:
        assert cls.description.endswith(".")
        assert cls.signature.endswith(".")


@given(st.data())
def test_bounds_hold(data: st.DataObject) -> None:
    """Any value inside is taken, outside is refused, typical is inside."""
    cls = effect_class(data.draw(st.sampled_from(effect_names())))
    parameter = data.draw(st.sampled_from(cls.parameters()))
    assert parameter.lower <= parameter.typical <= parameter.upper
    given_value = data.draw(st.floats(-1e9, 1e9))
    inside = parameter.lower <= given_value <= parameter.upper
    problems = cls.problems({parameter.name: given_value})
    assert (problems == []) is inside
    if inside:
        effect = cls({parameter.name: given_value})
        assert effect[parameter.name] == given_value
    else:
        unit = "" if parameter.unit == "1" else f" {parameter.unit}"
        bounds = f"{parameter.lower:g} to {parameter.upper:g}"
        assert problems[0].endswith(f"allowed {bounds}{unit}")
        with pytest.raises(ValueError, match=parameter.name):
            cls({parameter.name: given_value})


@given(st.data())
def test_any_allowed_values_build(
    make_spec: Callable[..., CornerSpec], data: st.DataObject
) -> None:
    """No corner of the bounds makes a network that can not compile."""
    cls = effect_class(data.draw(st.sampled_from(effect_names())))
    values = {
        p.name: data.draw(
            st.one_of(
                st.sampled_from([p.lower, p.upper]),
                st.floats(p.lower, p.upper),
            )
        )
        for p in cls.parameters()
    }
    spec = make_spec()
    model = CornerModel(spec, build_corner(spec, INPUTS), True)
    compile_network(cls(values).apply(model).network)


def entry(name: str, corner: Any = "all", **parameters: float) -> EffectConfig:
    """Return an ``[[effect]]`` entry."""
    return EffectConfig(name=name, corner=corner, parameters=parameters)


def test_problems_name_entry_and_cure() -> None:
    """Unknown name with a hint, unknown parameter, bounds, nan."""
    assert problems_of([entry("wet_disc"), entry("shim_contact", "FL")]) == []
    (text,) = problems_of([entry("wet_disk")])
    assert "did you mean 'wet_disc'?" in text
    (text,) = problems_of([entry("radiance")])
    assert "docs/effects.md lists them" in text
    (text,) = problems_of([entry("wet_disc", rain=1.0)])
    assert text.startswith("[[effect]] wet_disc parameters.rain: unknown")
    assert "evaporation_w_k" in text
    (text,) = problems_of([entry("wet_disc", strength=6.0)])
    assert text.endswith("allowed 0 to 5")
    with pytest.raises(KeyError):
        effect_class("effect")


@pytest.mark.parametrize(
    ("one", "other", "twice"),
    [
        ("FL", "FL", True),
        ("FL", "FR", False),
        ("all", "FL", True),
        ("FL", "all", True),
        ("all", "all", True),
    ],
)
def test_given_twice(one: str, other: str, *, twice: bool) -> None:
    """The same effect on the same corner, in any order."""
    found = problems_of([entry("wet_disc", one), entry("wet_disc", other)])
    assert bool(found) is twice
    if twice:
        assert "given twice" in found[0]


def test_applied_to_its_corner_only(
    make_spec: Callable[..., CornerSpec],
) -> None:
    """An entry for FR leaves FL as it is."""
    spec = make_spec()
    model = CornerModel(spec, build_corner(spec, INPUTS), True)
    assert apply_effects(model, [entry("wet_disc", "FR")]) is model
    edited = apply_effects(model, [entry("wet_disc", "FL")])
    assert edited.network.link("wet_disc").a == "disc"


def test_each_entry_is_told_what_is_wrong_with_it() -> None:
    """One line each, however many there are before it."""
    found = problems_of(
        [
            *(entry("wet_disc", "FL"), entry("wet_disc", "FR")),
            *(entry("wet_disc"), entry("brake_share", "FL")),
            entry("mass_error", "RL"),
        ]
    )

    car = "acts on the whole car, leave 'corner' out"
    assert found == [
        "[[effect]] wet_disc: given twice for corner FL",
        f'[[effect]] brake_share corner = "FL": {car}',
        f'[[effect]] mass_error corner = "RL": {car}',
    ]


def test_forms_are_other_values_of_what_the_effect_has() -> None:
    for name in effect_names():
        cls = effect_class(name)
        typical = {p.name: p.typical for p in cls.own_parameters}
        found = [typical]
        for form in cls.forms:
            assert not cls.problems(form)
            assert typical | form not in found
            found.append(typical | form)


def test_effects_are_plain_edits() -> None:
    """Neither the kernel nor its reference knows an effect by name."""
    root = Path(bstm_daemon.__file__).parent
    for file in (
        "native/thermal/march.c",
        "model/thermal/reference.py",
        "model/thermal/program.py",
    ):
        text = (root / file).read_text("utf-8")
        for name in effect_names():
            assert name not in text


def test_heat_of_the_engine_goes_to_the_air_where_there_is_one(
    make_spec: Callable[..., CornerSpec],
) -> None:
    spec = make_spec(thermal={})
    plain = CornerModel(spec, build_corner(spec, INPUTS), True)
    heat = entry("engine_heat", strength=2.0)
    for beside, expected in (
        ([], {plain.caliper: 120.0}),
        ([entry("local_air")], {plain.caliper: 120.0, "air": 400.0}),
    ):
        net = apply_effects(plain, [heat, *beside]).network
        sources = [one for one in net.sources if one.name.startswith("engine")]
        assert {one.node: one.gain for one in sources} == expected


def test_heat_of_the_hub_comes_to_the_bracket_by_the_knuckle(
    make_spec: Callable[..., CornerSpec],
) -> None:
    """A share of that to the disc; to the caliper where no bracket is."""
    spec = make_spec(thermal={})
    plain = CornerModel(spec, build_corner(spec, INPUTS), True)
    heat = entry("hub_heat", bracket_share=0.4)
    bracket = entry("bracket_conduction")
    for beside, node in (([], plain.caliper), ([bracket], "bracket")):
        net = apply_effects(plain, [heat, *beside]).network
        own, other = net.sources[-2:]
        assert (own.name, own.node) == ("hub_heat", "disc")
        assert (other.name, other.node) == ("knuckle_heat", node)
        assert other.gain == pytest.approx(0.4 * own.gain)
        assert other.factors == own.factors
    net = apply_effects(plain, [entry("hub_heat")]).network
    assert net.sources[-1].name == "hub_heat"


@pytest.mark.parametrize(
    "name", ["cooling_band", "layer_opening", "shim_contact"]
)
def test_a_loss_ends_where_nothing_is_left(name: str) -> None:
    """Of the typical loss as much as there is, and no more than that."""
    loss = effect_class(name)({"strength": effect_class(name).most_strength})

    assert 0.85 < loss.scaled("loss") <= 1.0

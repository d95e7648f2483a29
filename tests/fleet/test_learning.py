"""What cars share, on evidence whose answers are known."""

from __future__ import annotations

from math import log, pi, sqrt
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.gap.evidence import strength_prior
from bstm_daemon.analysis.gap.heat_only import find_force_gap
from bstm_daemon.analysis.gap.joint_effects import NormalEquations
from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.analysis.matching.targets import targets_of
from bstm_daemon.analysis.matching.tunables import (
    MASS,
    SLOW,
    STILL,
    TUNABLES,
    Target,
)
from bstm_daemon.config.estimates import ChangeConfig, MatchedConfig
from bstm_daemon.config.reading import load_config
from bstm_daemon.fleet.learning import (
    SPREADS,
    Finding,
    Searched,
    learn,
    odd_ones,
    pool,
    type_prior,
    write_prior,
)

from ..analysis.gap import test_heat_only  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

NAMES = (
    *("gap_conduction", "hub_conduction", "thermocouple_offset"),
    *("change.disc_capacity", "local_air", "pad_wear", "shim_contact"),
    *("disc_hat", "wet_disc", "pad_capacity", "pad_conductivity"),
    *("backplate_loss", "caliper_bypass", "caliper_radiation", "disc_wear"),
    *("fluid_exchange", "friction_fade", "hydraulic_lag", "mass_error"),
    *("residual_drag", "brake_share", "bracket_conduction"),
)


def car(
    name: str,
    strengths: Mapping[str, float] | None = None,
    *,
    deviation: float = 0.1,
    answer: str = "name",
    names: Sequence[str] = NAMES,
    noise: Mapping[str, float] | None = None,
    alike: Mapping[tuple[str, str], float] | None = None,
) -> Searched:
    """Return a car whose data have *strengths*, each known to *deviation*.

    *noise* is added to strengths in deviations; *alike* are cosines of two
    effects.
    """
    cosine = np.eye(len(names))
    for (one, other), value in (alike or {}).items():
        i, j = names.index(one), names.index(other)
        cosine[i, j] = cosine[j, i] = value
    information = cosine / deviation**2
    true = np.array([(strengths or {}).get(one, 0.0) for one in names])
    drawn = np.array([(noise or {}).get(one, 0.0) for one in names])
    score = information @ true + drawn / deviation
    return Searched(
        name,
        answer,
        NormalEquations(tuple(names), score, information, 0.0 * score),
    )


def only(found: list[Finding]) -> Finding:
    assert len(found) == 1, found
    return found[0]


def test_a_pool_is_the_integral_over_strength_and_spread() -> None:
    """By brute force, car by car and over the common strength."""
    score, information = np.array([60.0, 35.0]), np.array([40.0, 30.0])
    grid, weights = strength_prior(either_sign=False)

    found = pool("gap_conduction", score, information)

    a = np.linspace(-8.0, 10.0, 40_001)
    step = a[1] - a[0]
    together, own = [], [[], []]
    for m, weight in zip(grid, weights, strict=True):
        for t in SPREADS:
            normal = np.exp(-0.5 * ((a - m) / (t * m)) ** 2)
            normal /= t * m * sqrt(2.0 * pi)
            integrals = [
                float(np.sum(normal * np.exp(s * a - 0.5 * g * a**2)) * step)
                for s, g in zip(score, information, strict=True)
            ]
            share = weight / len(SPREADS)
            together.append(share * integrals[0] * integrals[1])
            for each, integral in zip(own, integrals, strict=True):
                each.append(share * integral)
    assert found.common == pytest.approx(log(sum(together)), abs=0.02)
    assert found.own == pytest.approx([log(sum(one)) for one in own], abs=0.02)
    assert found.common > found.own.sum()
    assert found.strength == pytest.approx(95.0 / 70.0, abs=0.1)


def test_what_all_cars_have_is_the_types() -> None:
    strengths = (1.0, 1.1, 0.9, 1.0)
    cars = [
        car(f"car{i}", {"gap_conduction": a}) for i, a in enumerate(strengths)
    ]

    found = only(learn(cars))

    assert (found.names, found.scope) == (("gap_conduction",), "type")
    assert found.carriers == ("car0", "car1", "car2", "car3")
    assert found.probability > 0.99
    assert found.strength == pytest.approx(1.0, abs=0.05)
    assert found.spread == pytest.approx(0.1, abs=0.05)


def test_cars_that_show_little_alone_show_it_together() -> None:
    """2.6 deviations each: none would name it, nor would two of them."""
    cars = [
        car(
            f"car{i}",
            {"gap_conduction": 0.78},
            deviation=0.3,
            answer="nothing",
        )
        for i in range(10)
    ]

    found = only(learn(cars))

    assert (found.names, found.scope) == (("gap_conduction",), "type")
    assert found.strength == pytest.approx(0.78, abs=0.1)
    assert learn(cars[:2]) == []


def test_cars_that_could_not_show_it_do_not_speak_against_it() -> None:
    others = [n for n in NAMES if n != "gap_conduction"]
    cars = [car(f"car{i}", {"gap_conduction": 1.0}) for i in range(2)]
    cars += [car(f"car{i}", names=others) for i in range(2, 4)]

    found = only(learn(cars))

    assert found.scope == "type"
    assert found.carriers == ("car0", "car1")


def test_one_car_that_shows_it_does_not_speak_for_many_that_can_not() -> None:
    others = [n for n in NAMES if n != "gap_conduction"]
    cars = [car("car0", {"gap_conduction": 1.0})]
    cars += [car(f"car{i}", names=others) for i in range(1, 20)]

    found = only(learn(cars))

    assert (found.scope, tuple(found.strengths)) == ("car", ("car0",))


@pytest.mark.parametrize("count", [4, 40])
def test_what_one_car_has_is_its_own(count: int) -> None:
    cars = [car(f"car{i}") for i in range(count)]
    cars[2] = car("car2", {"change.disc_capacity": -0.9})

    found = only(learn(cars))

    assert (found.names, found.scope) == (("change.disc_capacity",), "car")
    assert found.carriers == tuple(found.strengths) == ("car2",)
    assert found.probability > 0.95
    assert found.strengths["car2"] == pytest.approx((-0.9, 0.1))


def test_a_sensor_of_one_car_is_named_as_one() -> None:
    cars = [car(f"car{i}") for i in range(4)]
    cars[1] = car("car1", {"thermocouple_offset": 1.2})

    found = only(learn(cars))

    assert (found.names, found.scope) == (("thermocouple_offset",), "sensor")
    assert tuple(found.strengths) == ("car1",)


def test_some_cars_have_it() -> None:
    has = {0, 3, 4}
    cars = [
        car(f"car{i}", {"local_air": 1.0 + 0.2 * i} if i in has else None)
        for i in range(7)
    ]

    found = only(learn(cars))

    assert (found.names, found.scope) == (("local_air",), "car")
    assert tuple(found.strengths) == ("car0", "car3", "car4")


def test_nothing_is_found_in_noise() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        cars = [
            car(
                f"car{i}",
                noise=dict(
                    zip(NAMES, rng.normal(size=len(NAMES)), strict=True)
                ),
                deviation=float(rng.uniform(0.05, 1.0)),
                answer="nothing",
            )
            for i in range(8)
        ]

        assert learn(cars) == []


def test_form_errors_that_are_alike_do_not_add_up_to_an_effect() -> None:
    """Each car 1.5 deviations off the same way, for the model's form."""
    noise = {"hub_conduction": 1.5}
    cars = [car(f"car{i}", noise=noise, answer="nothing") for i in range(30)]

    assert learn(cars) == []


def test_the_types_effect_and_one_cars_own() -> None:
    """The own one is found beside it, though its car has both."""
    alike = {("gap_conduction", "shim_contact"): 0.6}
    cars = [
        car(f"car{i}", {"gap_conduction": 1.0}, alike=alike) for i in range(4)
    ]
    both = {"gap_conduction": 1.0, "hub_conduction": 1.5}
    cars[1] = car("car1", both, alike=alike)

    first, second = sorted(learn(cars), key=lambda one: one.names)

    assert (first.names, first.scope) == (("gap_conduction",), "type")
    assert (second.names, second.scope) == (("hub_conduction",), "car")
    assert tuple(second.strengths) == ("car1",)


def test_twins_are_a_class_that_other_cars_can_resolve() -> None:
    twins = {("gap_conduction", "shim_contact"): 0.999}
    hidden = {"gap_conduction": 1.0}
    cars = [car(f"car{i}", hidden, alike=twins) for i in range(3)]

    found = only(learn(cars))
    assert set(found.names) == {"gap_conduction", "shim_contact"}

    cars.append(car("car3", hidden))
    assert only(learn(cars)).names == ("gap_conduction",)


def test_twins_in_one_car_are_a_class() -> None:
    twins = {("local_air", "pad_wear"): 0.999}
    cars = [car(f"car{i}") for i in range(4)]
    cars[3] = car("car3", {"local_air": 1.0}, alike=twins)

    found = only(learn(cars))

    assert set(found.names) == {"local_air", "pad_wear"}
    assert (found.scope, tuple(found.strengths)) == ("car", ("car3",))


@pytest.mark.parametrize("answer", ["unknown", "composed"])
def test_what_no_effect_explains_in_most_cars_gets_no_name(
    answer: str,
) -> None:
    cars = [
        car(f"car{i}", {"local_air": 1.0}, answer=answer) for i in range(4)
    ]

    found = only(learn(cars))

    assert (found.names, found.scope) == ((), "type")


@pytest.mark.slow
def test_by_forces_where_no_car_has_a_thermocouple() -> None:
    found = []
    for strength in (2.0, 0.0):
        effects = {"friction_pressure": strength}
        drive = test_heat_only.driven("rich", effects, sensors="none")
        naming = find_force_gap(test_heat_only.car()[0], [drive]).naming
        assert naming.equations is not None
        found.append((naming.answer, naming.equations))
    has, plain = found

    def fleet(*cars: tuple[str, NormalEquations]) -> list[Finding]:
        return learn([Searched(f"car{i}", *one) for i, one in enumerate(cars)])

    all_have = only(fleet(has, has, has))
    assert (all_have.names, all_have.scope) == (("friction_pressure",), "type")
    assert all_have.strength == pytest.approx(2.0, rel=0.2)
    one_has = only(fleet(plain, has, plain, plain))
    assert one_has.names == ("friction_pressure",)
    assert (one_has.scope, one_has.carriers) == ("car", ("car1",))
    assert fleet(plain, plain, plain) == []


def test_one_car_alone_teaches_nothing_about_its_type() -> None:
    assert learn([car("car0", {"gap_conduction": 1.0})]) == []
    assert learn([]) == []


def test_a_types_value_is_the_mean_and_the_cars_spread() -> None:
    rng = np.random.default_rng(2)
    logs = 0.3 + 0.1 * rng.standard_normal(200)

    mean, deviation = type_prior(logs, np.full(200, 0.02), usual=0.2)

    assert mean == pytest.approx(0.3, abs=0.02)
    assert deviation == pytest.approx(0.1, abs=0.015)


def test_few_cars_that_agree_do_not_promise_too_much() -> None:
    mean, deviation = type_prior(
        np.array([0.1, 0.1, 0.1]), np.full(3, 0.01), usual=0.2
    )

    assert mean == pytest.approx(0.1, abs=1e-6)
    assert 0.05 < deviation < 0.2


def test_a_value_that_a_match_left_open_has_little_weight() -> None:
    mean, _ = type_prior(
        np.array([0.1, 0.1, 0.9]), np.array([0.01, 0.01, 1.0]), usual=0.1
    )

    assert mean == pytest.approx(0.1, abs=0.02)


def test_the_odd_one_out() -> None:
    values = {f"car{i}": (float(i % 3), 1.0) for i in range(9)}
    values["odd"] = (20.0, 1.0)

    found = odd_ones(values)

    assert list(found) == ["odd"]
    assert found["odd"] == pytest.approx(19.0 / np.hypot(1.0, sqrt(10 / 9)))
    assert odd_ones({"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (99.0, 1.0)}) == {}


def test_no_odd_one_out_where_all_are_noisy() -> None:
    rng = np.random.default_rng(3)
    odd = 0
    for _ in range(100):
        drawn = rng.normal(size=6)
        odd += len(
            odd_ones({f"car{i}": (v, 0.2) for i, v in enumerate(drawn)})
        )

    assert odd <= 3


EXAMPLE = Path(__file__).parents[2] / "config" / "example_vehicle.toml"
EMISSIVITY = "thermal.disc_emissivity"


def matched(
    folder: Path, name: str, mass: float, s_slow: float, still_sd: float = 1.0
) -> Path:
    """Write a car whose front corners were matched."""
    path = folder / f"{name}.toml"
    values = [mass, s_slow, 0.29]
    known = MatchedConfig(
        corners=["FL", "FR"],
        names=[MASS, SLOW, STILL],
        values=values,
        factor=[[0.01], [0.003, 0.02], [0.0, 0.0, still_sd]],
    )
    change = ChangeConfig(name="disc_capacity", factor=0.9)
    write_changed(EXAMPLE, path, [], "", "", Entries((), [change], [known]))
    return path


def front(path: Path) -> Target:
    return targets_of(load_config(path), ["FL", "FR"])[0]


def prior_of(values: Sequence[float], sds: Sequence[float], key: str) -> tuple:
    return type_prior(np.log(values), np.array(sds), TUNABLES[key].prior)


@pytest.mark.slow
def test_the_next_car_begins_with_what_its_type_has(tmp_path: Path) -> None:
    masses, slow = (1.02, 1.05, 0.99, 1.03, 1.01), (2e-3, 2.2e-3, 2.1e-3)
    slow = (*slow, 1.9e-3, 2.05e-3)
    cars = [
        matched(tmp_path, f"car{i}", *pair)
        for i, pair in enumerate(zip(masses, slow, strict=True))
    ]
    out = tmp_path / "type.toml"

    assert write_prior("golf", [*cars, EXAMPLE], out) == 5

    config = load_config(out)
    assert config.matched == config.change == []
    (known,) = config.priors
    assert (known.corners, known.cars) == (["FL", "FR"], 5)
    # no match knew it, so the type has nothing to say
    assert STILL not in known.names
    mean, sd = prior_of(masses, [0.01] * 5, MASS)
    target = front(out)
    assert target.value(TUNABLES[MASS]) == pytest.approx(
        np.exp(mean), rel=1e-4
    )
    assert target.setting(SLOW) == pytest.approx(known.values[1], rel=1e-4)
    assert known.values[1] == pytest.approx(2.05e-3, rel=0.02)
    # bstm match asks the target
    assert target.tunable(MASS).prior == pytest.approx(sd, rel=1e-4)
    assert sd < 0.8 * TUNABLES[MASS].prior
    assert target.tunable(SLOW).prior < TUNABLES[SLOW].prior
    assert target.tunable(EMISSIVITY) == TUNABLES[EMISSIVITY]


@pytest.mark.slow
def test_a_value_that_was_edited_has_the_usual_prior(tmp_path: Path) -> None:
    cars = [
        matched(tmp_path, f"car{i}", 1.0 + 0.01 * i, 2e-3) for i in range(5)
    ]
    out = tmp_path / "type.toml"
    write_prior("golf", cars, out)

    edited = front(out).changed({MASS: 1.2})

    assert edited.tunable(MASS) == TUNABLES[MASS]
    # and what nobody has measured stays wide
    guessed = Target(load_config(out), ("FL", "FR"), frozenset({MASS}))
    assert guessed.tunable(MASS).prior == 1.0


def test_one_matched_car_is_no_type(tmp_path: Path) -> None:
    car = matched(tmp_path, "car", 1.0, 2e-3)
    out = tmp_path / "type.toml"

    assert write_prior("golf", [car, EXAMPLE], out) == 0
    assert write_prior("golf", [], out) == 0
    assert not out.exists()

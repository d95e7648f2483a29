"""Effects on the heat input, named without a thermocouple."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest

from bstm_daemon.analysis.gap.advising import samples_of
from bstm_daemon.analysis.gap.changes import LARGEST, factor_of
from bstm_daemon.analysis.gap.evidence import (
    Candidate,
    may_stand_in,
)
from bstm_daemon.analysis.gap.force_balance import (
    CHANGE,
    COLD_C,
    FRICTION,
    LEAST_MS2,
    STEADY,
    ForceComparison,
    bedded_n,
    drag_n,
    held_n,
    unpressed_n,
)
from bstm_daemon.analysis.gap.forces import _motion_n, forces
from bstm_daemon.analysis.gap.form import DAILY
from bstm_daemon.analysis.gap.heat_only import (
    FOURFOLD,
    LEARNED,
    NOTHING_SEEN,
    ForceGap,
    _at_bound,
    _in_logarithms,
    _logarithm,
    find_force_gap,
    learned_forces,
    linearised,
)
from bstm_daemon.analysis.gap.naming import Naming
from bstm_daemon.analysis.gap.recording import Packed, Recording, recorded
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.channels import CHANNELS
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.estimates import MatchedConfig
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.errors import LogError
from bstm_daemon.files import shipped_file
from bstm_daemon.model.effects.catalogue import effect_class
from bstm_daemon.model.effects.entries.friction_in_stop import RELEASE_S
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.report.gap_forces import force_text
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.simulation import load_drive, simulate
from bstm_daemon.simulation.parameters import Effects
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config


def car() -> tuple[Config, dict[int, int]]:
    """Return the example car, heat by pressure, and what its bus has."""
    config, signal_map = load_vehicle(
        shipped_file("config/example_vehicle.toml")
    )
    heat = config.heat.model_copy(update={"mode": "ff"})
    config = config.model_copy(update={"heat": heat})
    return config, present_roles(signal_map)


def driven(
    name: str, effects: dict[str, float], *, sensors: str = "n1", seed: int = 3
) -> Recording:
    """Return a drive of the simulated car, no temperature recorded."""
    config, present = car()
    simulated = simulate(
        load_drive(name),
        preset=Effects(**effects),
        sensors=sensors,
        seed=seed,
    )
    return recorded(
        name,
        [samples_of(simulated, present)],
        config,
        present,
    )


@pytest.mark.parametrize(
    ("share", "at_bound"),
    [(0.0, True), (0.5, False), (1.0, True), (1.5, True)],
)
def test_a_strength_at_its_bound_is_told(
    share: float,
    at_bound: bool,  # noqa: FBT001
) -> None:
    bounds = effect_class("friction_fade").parameters()[0]
    strength = bounds.lower + share * (bounds.upper - bounds.lower)

    assert _at_bound("friction_fade", strength) is at_bound


@pytest.mark.parametrize(
    ("slope", "bias"),
    [("flat", 0.0), ("accelerometer", 0.0), ("accelerometer", 0.3)],
)
def test_the_force_of_a_drive_is_its_equation_of_motion(
    slope: str, bias: float
) -> None:
    """Eq 4.11 on a car that slows evenly, by speed or accelerometer."""
    config, present = car()
    known = EffectConfig(
        name="accelerometer_bias",
        parameters={"strength": 1.0, "bias_ms2": bias},
    )
    config = config.model_copy(update={"effect": (known,) if bias else ()})
    heat = config.heat.model_copy(update={"slope": slope})
    config = config.model_copy(update={"heat": heat})
    steps = 60
    speed = 30.0 - 2.0 * GRID_S * np.arange(steps)
    inputs = np.zeros((steps, 4, len(CHANNELS)))
    drive = Drive("a", 0.0, ("FL", "FR", "RL", "RR"), inputs, {})
    held = {"powertrain_torque": 400.0, "acceleration_longitudinal": -1.5}
    stamps = np.arange(steps) * round(1e6 * GRID_S)
    events = Events(
        np.concatenate([stamps + 1] * 2),
        np.repeat([ROLE_INDEX[name] for name in held], steps),
        np.repeat([*held.values()], steps),
    )
    recording = Recording(drive, present, Packed(events), inputs)

    force, inertia_n, driven, has_accelerometer, known = _motion_n(
        recording, config, speed
    )

    car_of = Vehicle.of_config(config.vehicle)
    drag = (car_of.quadratic * speed + car_of.linear) * speed + car_of.constant
    inertia = -2.0 * (car_of.mass_kg + car_of.rotating_mass_kg)
    if slope == "accelerometer":
        inertia = (
            -(1.5 + bias) * car_of.mass_kg - 2.0 * car_of.rotating_mass_kg
        )
    assert driven == pytest.approx(400.0 / config.vehicle.wheel_radius_m)
    wanted = 400.0 / config.vehicle.wheel_radius_m - drag - inertia
    assert force == pytest.approx(wanted)
    assert inertia_n == pytest.approx(inertia)
    # and over windows
    inputs[:, :, CHANNELS.index("speed_ms")] = speed[:, None]
    seen: Any = SimpleNamespace(
        name="a",
        drive=drive,
        present=present,
        step_means=recording.step_means,
        thin_inputs_of=lambda _: inputs,
    )
    part = forces(seen, config)
    assert part.inertia_n[:5] == pytest.approx(inertia)
    assert part.motion_n[0] == pytest.approx(force[1], rel=1e-2)
    assert has_accelerometer is (slope == "accelerometer")
    assert known


def test_pads_that_rub_brake_by_their_torque_while_released() -> None:
    """All of it where they are hot, a share where they are cold."""
    config, present = car()
    heat = {"cold_share": 0.4, "hot_c": 220.0, "torque_nm": 6.0}
    effect = effect_class("residual_drag")({"strength": 2.0, **heat})
    steps = 40
    inputs = np.zeros((steps, 4, len(CHANNELS)))
    inputs[:, :, CHANNELS.index("ambient_k")] = COLD_C + 100.0 + KELVIN_OFFSET
    none = Events(np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0))
    drive = Drive("a", 0.0, ("FL", "FR", "RL", "RR"), inputs, {})
    recording = Recording(drive, present, Packed(none), inputs)
    part: Any = SimpleNamespace(
        speed_ms=np.ones(3),
        first=np.array([0, 10, 20]),
        braked=np.array([0.0, 0.25, 1.0]),
    )

    found = drag_n(effect, recording, part, config)

    # half-way from cold to hot
    wheel_n = 2.0 * 6.0 * (0.4 + 0.6 * 0.5) / config.vehicle.wheel_radius_m
    corners = len(config.disc_corners())
    wanted = corners * wheel_n * np.array([1.0, 0.75, 0.0])
    assert found == pytest.approx(wanted, rel=1e-3)


def test_linings_lose_friction_with_their_first_heat() -> None:
    effect = effect_class("friction_history")(
        {"strength": 1.0, "drop": 0.2, "bedding_energy_j": 1.0e5}
    )
    part: Any = SimpleNamespace(
        time_s=np.array([0.0, 1.0, 2.0]),
        speed_ms=np.array([10.0, 10.0, 10.0]),
        pressed_n=np.array([[0.0, 5000.0, 5000.0], [0.0, 0.0, 2000.0]]),
    )
    none: Any = None

    found = bedded_n(effect, none, part, none)

    # after 50 and 100 kJ, and 20 kJ
    half, whole, little = (0.2 * (1.0 - np.exp(-x)) for x in (0.5, 1.0, 0.2))
    assert found == pytest.approx(
        [0.0, -5000.0 * half, -(5000.0 * whole + 2000.0 * little)]
    )


@pytest.mark.slow
def test_nothing_is_named_where_nothing_is_missing() -> None:
    found = find_force_gap(car()[0], [driven("rich", {}, sensors="none")])

    assert found.naming.answer == "nothing"
    assert not found.entries.effects
    assert found.pressed_j == pytest.approx(found.motion_j, rel=0.02)
    assert found.before_ms2 < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "strength"),
    [
        ("friction_pressure", 2.0),
        pytest.param("friction_fade", 1.5, marks=pytest.mark.full),
    ],
)
def test_friction_is_named_by_force_alone(name: str, strength: float) -> None:
    recording = driven("rich", {name: strength})
    other = driven("track", {name: strength}, seed=5)

    found = find_force_gap(car()[0], [recording], [other])

    assert (found.naming.answer, found.naming.names) == ("name", (name,))
    # another form: the strength is not exactly that of the simulated car
    assert found.strengths[name] == pytest.approx(strength, rel=0.3)
    assert found.held_out
    assert found.after_ms2 < 0.6 * found.before_ms2
    assert found.entries.effects[0].provenance["data"] == ["rich"]


@pytest.mark.slow
def test_twins_of_the_motion_are_a_class() -> None:
    found = find_force_gap(
        car()[0], [driven("rich", {"mass_error": 1.5}, sensors="none")]
    )

    assert found.naming.answer in {"name", "class"}
    assert found.naming.names[0] == "mass_error"
    assert set(found.naming.names) <= {"mass_error", "powertrain_torque_error"}
    assert found.strengths["mass_error"] == pytest.approx(1.5, abs=0.3)
    # of a class each member has its own probability, and says what it may be
    (entry,) = found.entries.effects
    own = found.naming.odds["mass_error"]
    assert entry.provenance["probability"] == pytest.approx(own, abs=1e-4)
    if found.naming.answer == "class":
        assert own < 0.95 <= found.naming.probability
        assert entry.provenance["or"] == ["powertrain_torque_error"]


def test_braking_without_pressure_is_beyond_zero_and_pressed_windows() -> None:
    """An accelerometer's zero; windows that a braking begins and ends in."""
    typical = effect_class("brake_without_pressure")({"strength": 1.0})
    config: Any = SimpleNamespace(vehicle=SimpleNamespace(mass_kg=2000.0))
    zero_n = 350.0

    def unpressed(motion: list[float], *, begun: bool) -> list[float]:
        braked = [0.0] * 3 + [0.4 * begun] * 2 + [0.0] * 4
        part: Any = SimpleNamespace(
            motion_n=np.array(motion) + zero_n,
            braked=np.array(braked),
            whole_n=9000.0 * np.array(braked),
        )
        found = unpressed_n(typical, cast("Recording", None), part, config)
        return found.tolist()

    nothing = [0.0] * 9
    braking = [0.0, 0.0, 0.0, 3700.0, 3700.0, 0.0, 0.0, 0.0, 0.0]
    assert unpressed(nothing, begun=False) == nothing
    assert unpressed(braking, begun=True) == nothing
    # the windows about it, with what the motion shows there
    assert unpressed(braking, begun=False) == [
        *(0.0, 0.0, zero_n, 3700.0 + zero_n, 3700.0 + zero_n),
        *(zero_n, 0.0, 0.0, 0.0),
    ]
    # two windows of three may be of one
    most = [0.0] * 3 + [3700.0] * 6
    assert unpressed(most, begun=False) == [
        *(0.0, 0.0, zero_n),
        *[3700.0 + zero_n] * 6,
    ]


@pytest.mark.slow
def test_braking_without_pressure_is_named() -> None:
    found = find_force_gap(car()[0], [driven("assist", {})])

    assert found.naming.answer == "name"
    assert found.naming.reason != NOTHING_SEEN
    assert found.naming.names[0] == "brake_without_pressure"
    assert found.strengths["brake_without_pressure"] > 0.7
    assert found.motion_j > 5.0 * found.pressed_j
    assert found.after_ms2 < 0.2 * found.before_ms2

    others = find_force_gap(
        *(car()[0], [driven("assist", {})]), without={"brake_without_pressure"}
    )
    left = {one.name for one in found.naming.candidates}
    assert {one.name for one in others.naming.candidates} == left - {
        "brake_without_pressure"
    }


@pytest.mark.slow
def test_what_forces_can_not_tell_is_said() -> None:
    found = find_force_gap(car()[0], [driven("idiada-step", {})])

    assert "thermocouple" in found.unseen["hub_conduction"]
    assert found.unseen["brake_share"].startswith("leaves the force")
    assert found.seen.keys().isdisjoint(found.unseen)
    assert "mass_error" in found.seen.keys() | found.unseen.keys()
    assert set(found.seen) <= {one.name for one in found.naming.candidates}


@pytest.mark.slow
def test_released_or_not_must_be_known() -> None:
    """Without pressure and switch every braking is one without pressure."""
    config, present = car()
    telling = {
        number
        for name, number in ROLE_INDEX.items()
        if name == "brake_switch" or name.endswith("_pressure")
    }
    telling |= {ROLE_INDEX[f"wheel_pressure_{c}"] for c in ("fl", "fr")}
    telling |= {ROLE_INDEX[f"wheel_pressure_{c}"] for c in ("rl", "rr")}
    simulated = simulate(load_drive("assist"), sensors="none", seed=3)
    blind = {role: us for role, us in present.items() if role not in telling}
    recording = recorded(
        "assist",
        [samples_of(simulated, blind)],
        config,
        blind,
    )

    found = find_force_gap(config, [recording])

    assert "brake switch" in found.unseen["brake_without_pressure"]
    assert "brake_without_pressure" not in found.naming.names


def test_without_torque_there_is_no_force() -> None:
    config, present = car()
    torque = ROLE_INDEX["powertrain_torque"]
    simulated = simulate(load_drive("idiada-step"), sensors="none", seed=3)
    blind = {role: us for role, us in present.items() if role != torque}
    heat = config.heat.model_copy(update={"assume_powertrain_torque_nm": None})
    config = config.model_copy(update={"heat": heat})
    recording = recorded("x", [samples_of(simulated, blind)], config, blind)

    with pytest.raises(LogError, match=r"x: .* this needs speed, and torque"):
        find_force_gap(config, [recording])


def test_the_windows_do_not_depend_on_the_configuration() -> None:
    config, _ = car()
    recording = driven("idiada-step", {}, sensors="none")
    vehicle = config.vehicle.model_copy(update={"mass_kg": 2500.0})
    heavy = config.model_copy(update={"vehicle": vehicle})

    one, two = forces(recording, config), forces(recording, heavy)

    assert np.array_equal(one.first, two.first)
    assert np.array_equal(np.isnan(one.motion_n), np.isnan(two.motion_n))
    assert np.nanmax(two.motion_n) > np.nanmax(one.motion_n)


def matched_to(
    config: Config, forces: dict[str, tuple[float, float]]
) -> Config:
    """Return *config* with what a match learned of its forces."""
    one = MatchedConfig(
        corners=["FL"],
        names=["thermal.disc_emissivity"],
        values=[0.5],
        factor=[[0.1]],
        forces={name: a for name, (a, _) in forces.items()},
        forces_sd={name: sd for name, (_, sd) in forces.items()},
    )
    return config.model_copy(update={"matched": [one]})


def test_what_the_match_saw_is_taken_off_and_its_doubt_left_open() -> None:
    config = car()[0]
    recording = driven("idiada-step", {}, sensors="none")
    plain = ForceComparison(config, [recording])
    drag = {
        "residual_drag": (0.4, 0.05),
        "air drag": (-0.2, 0.1),
        "pitch": (0.01, 0.01),
    }

    found = ForceComparison(
        matched_to(config, {**drag, "gone": (1.0, 1.0)}), [recording]
    )

    column = plain.changed_n("residual_drag")
    known_n = 0.4 * column - 0.2 * plain.steady_n["air drag"]
    known_n += 0.01 * plain.steady_n["pitch"]
    assert found.base_n == pytest.approx(plain.base_n + known_n)
    daily = sorted(name for name in DAILY if effect_class(name).kind == "heat")
    days = [found.changed_n(name) for name in daily]
    own = found.jacobian_n[:, plain.jacobian_n.shape[1] :]
    assert own == pytest.approx(np.column_stack([column, *days]))
    steady = [one.name for one in plain.tunables if one.name in STEADY]
    assert steady == [name for name in STEADY if name != "friction"]
    for one, learned in (plain, ()), (found, drag):
        priors = [STEADY[name][name in learned] for name in steady]
        assert one.prior[: 1 + len(priors)] == pytest.approx(
            [FRICTION, *priors]
        )
    assert found.prior[len(plain.prior) :] == pytest.approx(
        [0.05, *(DAILY[name] for name in daily)]
    )
    assert np.array_equal(found.layout.prior, found.prior)


def test_the_noise_of_the_motion_is_no_lack_of_mass() -> None:
    """Less mass would have less noise: all forces would shrink together."""
    config = car()[0]
    recording = driven("idiada-step", {}, sensors="none")
    comparison = ForceComparison(config, [recording])
    mass_kg = config.vehicle.mass_kg
    vehicle = config.vehicle.model_copy(update={"mass_kg": 1.0})
    empty = config.model_copy(update={"vehicle": vehicle})

    found = comparison.changed_n("mass_error")

    of_mass_n = comparison.base_n - ForceComparison(empty, [recording]).base_n
    of_mass_n *= mass_kg / (mass_kg - 1.0)
    # least squares of the residual and of the tunables' priors at once
    noise_n = LEAST_MS2 * mass_kg
    rows = np.vstack(
        (comparison.jacobian_n / noise_n, np.diag(1.0 / comparison.prior))
    )
    nothing = np.zeros(len(comparison.prior))
    values = np.concatenate((-comparison.base_n / noise_n, nothing))
    best, *_ = np.linalg.lstsq(rows, values, rcond=None)
    left_n = comparison.base_n + comparison.jacobian_n @ best
    assert found == pytest.approx(0.06 * (of_mass_n - left_n), abs=1e-4)
    assert np.std(left_n) > 5.0


@pytest.mark.slow
def test_an_adopted_mass_is_what_forces_are_measured_by() -> None:
    """Its change has no noise in it either, and no match learns it."""
    name = "change.effect.mass_error.strength"
    config = matched_to(car()[0], {name: (1.0, 0.5)})
    entry = EffectConfig(name="mass_error", parameters={"strength": 2.0})
    config = config.model_copy(update={"effect": [entry]})
    recording = driven("idiada-step", {}, sensors="none")

    comparison = ForceComparison(config, [recording])

    more = entry.model_copy(
        update={"parameters": {"strength": 2.0 * np.exp(0.35)}}
    )
    other = config.model_copy(update={"effect": [more], "matched": []})
    same = config.model_copy(update={"matched": []})
    heavier, base = (
        ForceComparison(one, [recording]).base_n for one in (other, same)
    )
    assert comparison.base_n == pytest.approx(base)
    share = 0.12 * np.expm1(0.35) / 1.12
    wanted = (heavier - base - share * comparison.noise_n) / 0.5
    assert comparison.changed_n(name) == pytest.approx(wanted, abs=1e-4)
    assert np.std(comparison.noise_n) > 5.0
    assert name not in learned_forces(config, [recording])


@pytest.mark.slow
def test_what_is_alike_on_all_drives_is_learned_without_the_mass() -> None:
    """A drag area of 0.8 of the right one: a quarter more is learned."""
    config = car()[0]
    recording = driven("idiada-step", {}, sensors="none")
    area = 0.8 * config.vehicle.drag_area_m2
    vehicle = config.vehicle.model_copy(update={"drag_area_m2": area})
    other = config.model_copy(update={"vehicle": vehicle})

    right, wrong = (
        learned_forces(one, [recording]) for one in (config, other)
    )

    assert set(STEADY) <= right.keys()
    assert "mass_error" not in right
    shares = [1.0 + one["air drag"][0] for one in (right, wrong)]
    assert shares[1] / shares[0] == pytest.approx(1.25, abs=0.12)
    known = ForceComparison(matched_to(other, wrong), [recording])
    unknown = ForceComparison(other, [recording])
    assert np.std(known.base_n) < np.std(unknown.base_n)


@pytest.mark.slow
def test_wheels_that_follow_the_torque_late_are_learned() -> None:
    """By as much as the torque comes too early."""
    config = car()[0]
    recording = driven("idiada-step", {}, sensors="none")
    (thin,) = recording.thin.pieces(len(recording.thin))
    torque = thin.role == ROLE_INDEX["powertrain_torque"]
    time_us = np.where(torque, thin.time_us - 100_000, thin.time_us)
    order = np.argsort(time_us, kind="stable")
    early = Events(time_us[order], thin.role[order], thin.value[order])

    before, after = (
        learned_forces(config, [one])["torque lag"][0]
        for one in (
            recording,
            replace(recording, thin=Packed(early), _means={}),
        )
    )

    assert after - before == pytest.approx(0.1, abs=0.03)


@pytest.mark.slow
def test_friction_and_load_of_each_drive_are_its_own() -> None:
    config = matched_to(car()[0], {"residual_drag": (0.0, 0.05)})
    one, two = (
        driven("idiada-step", {}, sensors="none", seed=seed) for seed in (3, 4)
    )

    both = ForceComparison(config, [one, two])

    first, second = (ForceComparison(config, [each]) for each in (one, two))
    n = len(first.base_n)
    of_first, of_second = both.jacobian_n[:, 0], both.jacobian_n[:, 1]
    assert of_first[:n] == pytest.approx(first.jacobian_n[:, 0])
    assert of_second[n:] == pytest.approx(second.jacobian_n[:, 0])
    assert not of_first[n:].any()
    assert not of_second[:n].any()
    assert both.prior[:2] == pytest.approx([FRICTION, FRICTION])
    last = both.jacobian_n[:, -1]
    assert not last[:n].any()
    assert last[n:] == pytest.approx(second.jacobian_n[:, -1])


def test_friction_of_a_held_brake_rises_and_is_forgotten() -> None:
    """As an exponential in the middle of each window, and a slower fall."""
    effect = effect_class("friction_in_stop")(
        {"strength": 2.0, "rise": 0.1, "time_s": 4.0}
    )
    braked = np.array([1.0] * 5 + [0.0] * 3 + [0.5] * 60)
    part: Any = SimpleNamespace(
        time_s=2.0 * np.arange(len(braked)),
        braked=braked,
        whole_n=np.full(len(braked), 1000.0),
    )

    found = held_n(effect, None, part, None)  # type: ignore[arg-type]

    middle_s = 2.0 * np.arange(5) + 1.0
    held = 1.0 - np.exp(-middle_s / 4.0)
    assert found[:5] == pytest.approx(200.0 * held)
    left = 1.0 - np.exp(-10.0 / 4.0)
    fall = np.exp(-(2.0 * np.arange(3) + 1.0) / RELEASE_S)
    assert found[5:8] == pytest.approx(200.0 * left * fall)
    # half held, half released: where what it gains is what it forgets
    ends = (0.5 / 4.0) / (0.5 / 4.0 + 0.5 / RELEASE_S)
    assert found[-1] == pytest.approx(200.0 * ends)


@pytest.mark.slow
def test_a_car_of_another_friction_law_shows_only_what_is_new() -> None:
    """Its match knows the law; without that it is named each time."""
    config = car()[0]
    learned = learned_forces(
        config, [driven("rich", {"friction_pressure": 2.0})]
    )
    again = driven("rich", {"friction_pressure": 2.0}, seed=5)
    hot = {"friction_pressure": 2.0, "friction_fade": 2.0}

    of_law = find_force_gap(config, [again]).naming
    known = matched_to(config, learned)
    nothing = find_force_gap(known, [again]).naming
    found = find_force_gap(known, [driven("rich", hot, seed=5)]).naming

    assert of_law.names == ("friction_pressure",)
    assert nothing.answer == "nothing"
    assert (found.answer, found.names) == ("name", ("friction_fade",))
    strength, deviation = learned["friction_pressure"]
    assert strength == pytest.approx(2.0, rel=0.4)
    assert 0.0 < deviation < LEARNED
    # what was learned before does not count when it is learned anew
    assert learned_forces(known, [again]).keys() == learned.keys()


@pytest.mark.slow
def test_effects_that_a_matched_model_has_can_change() -> None:
    config = matched_to(car()[0], {})
    entry = EffectConfig(name="friction_pressure", parameters={"strength": 1})
    config = config.model_copy(update={"effect": [entry]})
    recording = driven("idiada-step", {}, sensors="none")

    comparison = ForceComparison(config, [recording])

    (name,) = comparison.trials
    assert name == "change.effect.friction_pressure.strength"
    more = entry.model_copy(update={"parameters": {"strength": np.exp(0.35)}})
    other = config.model_copy(update={"effect": [more]})
    change = ForceComparison(other, [recording]).base_n - comparison.base_n
    assert comparison.changed_n(name) == pytest.approx(change / 0.5)
    found, unseen = linearised(comparison)
    most = {one.name: one.most for one in found.signatures}
    assert most.get(name) == FOURFOLD
    assert most["mass_error"] == effect_class("mass_error").most_strength
    assert most["residual_drag"] == LARGEST
    assert "friction_pressure" not in unseen


@pytest.mark.slow
def test_a_drive_without_pressure_or_force_teaches_nothing() -> None:
    config, _ = car()
    recording = driven("idiada-step", {}, sensors="none")
    pressure = ROLE_INDEX["primary_pressure"]
    blind = replace(
        recording, drive=replace(recording.drive, roles=frozenset())
    )

    assert pressure in recording.present
    assert learned_forces(config, [recording])
    assert learned_forces(config, [recording, blind]) == {}


def test_a_value_that_changed_is_told_and_not_written() -> None:
    change = "change.effect.friction_fade.strength"
    one = Candidate(change, 1.0, 0.2, 12.5, 10.0, 0.7)
    odds = {change: 0.99, "": 0.01}
    naming = Naming("name", (change,), 0.99, (one,), odds, "a reason")
    gap = ForceGap(
        *(("a.log",), 7, naming, {change: 1.0}, {change: 0.2}, {}, {}),
        *(("a.log",), False, 0.02, 0.03, 1e6, 2e6),
    )

    assert not gap.adopted
    assert not gap.worse
    assert not gap.entries.effects
    text = force_text(gap)
    assert "fall of the friction of hot brakes +101 % since the match" in text
    assert change not in text
    assert "error of the car's acceleration" not in text
    both = replace(
        gap,
        strengths={change: 1.0, "mass_error": 0.5},
        deviations={change: 0.2, "mass_error": 0.1},
    )
    assert both.adopted == ("mass_error",)
    assert both.worse
    (entry,) = both.entries.effects
    assert (entry.name, entry.parameters) == ("mass_error", {"strength": 0.5})
    assert "mass_error: strength 0.50 +- 0.10" in force_text(both)


def test_a_change_has_bounds_of_its_own() -> None:
    name = "change.effect.friction_fade.strength"

    assert not _at_bound(name, -3.9)
    assert _at_bound(name, -4.0)
    assert _at_bound(name, 4.0)


@pytest.mark.parametrize("factor", [0.5, 1.4, 4.1])
def test_a_change_by_forces_is_told_as_the_factor_it_has(
    factor: float,
) -> None:
    """Forces are linear in friction, a strength is a logarithm."""
    name = "change.effect.friction_fade.strength"
    half = factor_of(name, CHANGE)
    linear = CHANGE * (factor - 1.0) / (half - 1.0)

    assert factor_of(name, _logarithm(name, linear)) == pytest.approx(factor)
    assert _logarithm(name, -9.0) == pytest.approx(-LARGEST)
    assert _logarithm("mass_error", linear) == linear
    one = Candidate(name, linear, 0.1, 2.0, 1.0, 0.5)
    told = _in_logarithms(one)
    assert factor_of(name, told.strength) == pytest.approx(factor)
    ends = [_logarithm(name, linear + d) for d in (-1e-4, 1e-4)]
    assert told.deviation == pytest.approx(0.1 * (ends[1] - ends[0]) / 2e-4)


def test_four_times_the_fade_of_a_match_is_no_stand_in() -> None:
    one = Candidate("change", FOURFOLD, 0.5, 20.0, 15.0, 0.5)

    assert not may_stand_in(one, FOURFOLD)
    assert may_stand_in(one, LARGEST)

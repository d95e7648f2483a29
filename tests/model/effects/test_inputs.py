"""Effects on the heat input and on the measurement: samples to rows."""

from __future__ import annotations

from array import array
from itertools import pairwise
from math import exp
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.channels import CHANNELS
from bstm_daemon.estimator.corner_model import corner_model
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.model.effects.catalogue import (
    edited_inputs,
    effect_class,
    effect_names,
    problems_of,
)
from bstm_daemon.model.effects.model import (
    Correction,
    InputModel,
    corrected,
    corrections_by_role,
)
from bstm_daemon.model.effects.tables import sensors_of
from bstm_daemon.native.loader import VARIABLE
from bstm_daemon.roles import MEASURED_NODES, ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config.sections import Config
    from bstm_daemon.native.loader import Kernel

    from .conftest import Corner

AMBIENT_C = 10.0
ROLES = (
    *("vehicle_speed", "primary_pressure", "acceleration_longitudinal"),
    *("powertrain_torque", "temp_fl_disc"),
)
MASS_KG, RADIUS_M = 2194.0, 0.3418
INPUT_EFFECTS = (
    *("pushout_pressure", "hydraulic_lag", "thermocouple_offset"),
    *("accelerometer_bias", "mass_error", "brake_share"),
    *("powertrain_torque_error", "friction_fade", "friction_speed"),
    *("friction_pressure", "brake_without_pressure"),
)


@pytest.fixture
def car(make_car: Any, make_corner: Any) -> Callable[..., Config]:
    """Return the maker of a car: (mode, effect, its parameters)."""

    def make(
        mode: str, name: str | None = None, **parameters: float
    ) -> Config:
        entry = [{"name": name, "parameters": parameters}] if name else []
        corners = [make_corner(n) for n in ("FL", "FR")]
        corners += [
            make_corner(n, circuit="secondary", friction_coefficient=0.1)
            for n in ("RL", "RR")
        ]
        made: Config = make_car(
            *corners,
            vehicle={"ambient_c": AMBIENT_C, "front_share": 0.7},
            heat={"mode": mode, "slope": "accelerometer"},
            effect=entry,
        )
        return made

    return make


def rows_of(
    config: Config,
    seconds: float = 4.0,
    pressure_pa: float = 2e6,
    felt_ms2: float = -3.0,
) -> array[float]:
    """Brake from the first second on at 20 m/s; all corners."""
    present = {ROLE_INDEX[role]: 500_000 for role in ROLES}
    times, roles, values = array("q"), array("i"), array("d")
    for at in range(0, round(seconds * 1e6), 20_000):
        braking = at >= 1_000_000
        for role, value in zip(
            ROLES,
            (
                20.0,
                pressure_pa if braking else 0.0,
                felt_ms2 if braking else 0.0,
                -100.0,
                600.0,
            ),
            strict=True,
        ):
            times.append(at)
            roles.append(ROLE_INDEX[role])
            values.append(value)
    found = array("d")
    for block in Estimator(config, present).advance(times, roles, values):
        found.extend(block.rows)
    return found


def column(rows: array[float], channel: str, corner: int = 0) -> list[float]:
    """Return one channel of one corner."""
    wide = 4 * len(CHANNELS)
    first = corner * len(CHANNELS) + CHANNELS.index(channel)
    return list(rows[first::wide])


def power(config: Config, corner: int = 0) -> float:
    """Return the brake power [W] once everything is steady."""
    return column(rows_of(config), "brake_power_w", corner)[-1]


@pytest.mark.parametrize("name", INPUT_EFFECTS)
@pytest.mark.parametrize("mode", ["ff", "fb"])
def test_strength_zero_is_absence(
    car: Callable[..., Config], name: str, mode: str
) -> None:
    """Not a bit of any row differs."""
    base = rows_of(car(mode)).tobytes()
    assert rows_of(car(mode, name, strength=0.0)).tobytes() == base


@pytest.mark.parametrize("name", INPUT_EFFECTS)
def test_the_file_stays_as_it_is(
    car: Callable[..., Config], name: str
) -> None:
    """An edit is of the model, never of the configuration itself."""
    config = car("ff", name)
    before = config.model_dump()
    edited = edited_inputs(config)
    law = corner_model(config, config.corner[0]).friction
    assert config.model_dump() == before
    assert (
        edited.corrections
        or edited.config != config
        or edited.unpressed_share
        or not law.nominal
    )


def test_a_car_without_effects_is_itself(car: Callable[..., Config]) -> None:
    """No edit, no copy, no correction."""
    config = car("ff")
    assert edited_inputs(config).config is config
    assert edited_inputs(config).corrections == ()


def test_what_acts_on_the_car_is_for_all_corners() -> None:
    """A corner of a car-wide effect is refused by name."""
    from bstm_daemon.config.sections import EffectConfig  # noqa: PLC0415

    wide = [n for n in effect_names() if effect_class(n).whole_car]
    assert set(wide) >= {"mass_error", "brake_share", "hydraulic_lag"}
    for name in wide:
        (text,) = problems_of([EffectConfig(name=name, corner="FL")])
        assert text == (
            f'[[effect]] {name} corner = "FL": acts on the whole car, '
            "leave 'corner' out"
        )


def test_pushout_takes_off_pressure(car: Callable[..., Config]) -> None:
    """2 MPa less 0.1 MPa; twice the strength, twice the loss."""
    base = power(car("ff"))
    once = power(car("ff", "pushout_pressure"))
    twice = power(car("ff", "pushout_pressure", strength=2.0))
    assert once / base == pytest.approx(1.9 / 2.0, rel=1e-9)
    assert twice / base == pytest.approx(1.8 / 2.0, rel=1e-9)
    assert power(car("fb", "pushout_pressure")) == power(car("fb"))


def test_friction_over_speed_and_pressure(car: Callable[..., Config]) -> None:
    """Power laws, 1 at 10 m/s and 1 MPa; not a watt of Feed-Back."""
    base = power(car("ff"))
    for name, ratio in (
        ("friction_speed", 2.0**-0.1),
        ("friction_pressure", 2.0**-0.05),
    ):
        assert power(car("ff", name)) / base == pytest.approx(ratio, rel=1e-6)
        rising = power(car("ff", name, strength=-1.0))
        assert rising / base == pytest.approx(1.0 / ratio, rel=1e-6)
        assert power(car("fb", name)) == power(car("fb"))


def test_friction_falls_on_a_line(car: Callable[..., Config]) -> None:
    """10 % for 10 m/s, 5 % for 1 MPa; a tenth of it is left."""
    base = power(car("ff"))
    for name, ratio, strength in (
        ("friction_speed", 0.9, 1.0),
        ("friction_pressure", 0.95, 1.0),
        ("friction_pressure", 1.1, -2.0),
    ):
        there = power(car("ff", name, strength=strength, linear=1.0))
        assert there / base == pytest.approx(ratio, rel=1e-6)
    law = effect_class("friction_speed")
    steep = law({"strength": 5.0, "exponent": 0.3, "linear": 1.0})
    model = corner_model(car("ff"), car("ff").corner[0])
    assert min(steep.apply(model).friction.speed) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("between_c", "ratio"), [(300.0, 1.0), (440.0, 0.86), (700.0, 0.72)]
)
def test_friction_fades_over_the_interface(
    car: Callable[..., Config], between_c: float, ratio: float
) -> None:
    """Half way along the ramp half of the fall."""
    found = []
    for config in (car("ff"), car("ff", "friction_fade")):
        present = {ROLE_INDEX[role]: 500_000 for role in ROLES[:2]}
        estimator = Estimator(
            config, present, initial_k=between_c + 273.15, history_known=True
        )
        samples = [
            (at, ROLE_INDEX[role], value)
            for at in range(0, 300_000, 20_000)
            for role, value in zip(ROLES, (20.0, 2e6), strict=False)
        ]
        blocks = estimator.advance(
            *(
                array(code, [s[i] for s in samples])
                for i, code in enumerate("qid")
            )
        )
        found.append(column(blocks[0].rows, "brake_power_w")[-1])
    assert found[1] / found[0] == pytest.approx(ratio, abs=0.012)


@pytest.mark.parametrize("mode", ["ff", "fb"])
def test_braking_without_pressure_counts(
    car: Callable[..., Config], mode: str
) -> None:
    """Felt and not pressed: nothing without the effect, all with it."""
    force_n = 0.0
    for name, strength in (
        (None, 1.0),
        ("brake_without_pressure", 1.0),
        ("brake_without_pressure", 0.5),
    ):
        given = {"strength": strength} if name else {}
        rows = rows_of(car(mode, name, **given), pressure_pa=0.0)
        power = column(rows, "brake_power_w")
        pads_on = column(rows, "brake_on")
        assert power[:9] == [0.0] * 9
        if name is None:
            assert max(power) == 0.0
            assert max(pads_on) == 0.0
            continue
        assert pads_on[-1] == pytest.approx(1.0)
        # what Feed-Back makes of the same motion with the brake pressed
        pressed = column(rows_of(car("fb")), "brake_power_w")[-1]
        force_n = pressed / 20.0
        assert power[-1] == pytest.approx(strength * pressed, rel=1e-9)
    assert force_n > 300.0


@pytest.mark.parametrize("name", INPUT_EFFECTS)
@pytest.mark.parametrize("pressure_pa", [0.0, 2e6])
def test_forms_agree(
    monkeypatch: pytest.MonkeyPatch,
    compiled: Kernel,
    car: Callable[..., Config],
    name: str,
    pressure_pa: float,
) -> None:
    """Pure Python and compiled, bit for bit."""
    assert compiled is not None
    found = []
    for form in ("reference", "compiled"):
        monkeypatch.setenv(VARIABLE, form)
        rows = rows_of(car("ff", name), 2.0, pressure_pa)
        found.append(rows.tobytes())
    assert found[0] == found[1]


def test_what_is_not_felt_or_is_pressed_stays(
    car: Callable[..., Config],
) -> None:
    """Coasting is no braking, and pressed brakes are as they were."""
    there = car("ff", "brake_without_pressure")
    rolling = rows_of(there, pressure_pa=0.0, felt_ms2=-0.2)
    assert max(column(rolling, "brake_power_w")) == 0.0
    assert rows_of(there).tobytes() == rows_of(car("ff")).tobytes()


def test_pushout_of_one_corner(make_car: Any, make_corner: Any) -> None:
    """Only the corner that it is given for."""
    config = make_car(
        *(make_corner(n) for n in ("FL", "FR", "RL", "RR")),
        effect=[{"name": "pushout_pressure", "corner": "FR"}],
    )
    found = [
        one.pushout_pressure_pa for one in edited_inputs(config).config.corner
    ]
    assert found == [0.0, 1e5, 0.0, 0.0]


def test_lag_delays_each_circuit(car: Callable[..., Config]) -> None:
    """0.2 s after the step 1 - exp(-t/T) of the pressure is there."""
    rows = rows_of(car("ff", "hydraulic_lag"))
    for corner, lag_s in ((0, 0.15), (2, 0.3)):
        pressure = column(rows, "pressure_pa", corner)
        # publications every 0.1 s hold the mean of the last 0.05 s
        at = 11
        assert pressure[9] == 0.0
        mean = 1.0 - lag_s / 0.05 * (exp(-0.15 / lag_s) - exp(-0.2 / lag_s))
        assert pressure[at] == pytest.approx(2e6 * mean, rel=1e-6)
    assert column(rows_of(car("ff")), "pressure_pa")[11] == pytest.approx(2e6)


def test_bias_is_a_force_of_the_mass(car: Callable[..., Config]) -> None:
    """What the sensor reads too much, the brake has done more."""
    share = 0.35
    base = power(car("fb"))
    more = power(car("fb", "accelerometer_bias"))
    assert more - base == pytest.approx(
        share * MASS_KG * 0.08 * 20.0, rel=1e-9
    )
    less = power(car("fb", "accelerometer_bias", strength=-1.0))
    assert less - base == pytest.approx(base - more, rel=1e-9)


def test_mass_scales_the_felt_force(car: Callable[..., Config]) -> None:
    """6 % more mass: 6 % more inertia, and a little more resistance."""
    base, more = power(car("fb")), power(car("fb", "mass_error"))
    inertia = 0.35 * MASS_KG * 3.0 * 20.0
    rolling = 0.35 * 0.014 * MASS_KG * 9.81 * 20.0
    assert more - base == pytest.approx(0.06 * (inertia - rolling), rel=1e-3)


def test_share_moves_between_the_axles(car: Callable[..., Config]) -> None:
    """The front gets a tenth more, and the car the same."""
    for mode in ("ff", "fb"):
        base = [power(car(mode), c) for c in range(4)]
        moved = [power(car(mode, "brake_share"), c) for c in range(4)]
        assert moved[0] / base[0] == pytest.approx(1.1, rel=1e-9)
        assert moved[2] / base[2] == pytest.approx(0.23 / 0.3, rel=1e-9)
        if mode == "fb":
            assert sum(moved) == pytest.approx(sum(base), rel=1e-12)


def test_a_share_that_is_all_or_nothing_stays(
    car: Callable[..., Config],
) -> None:
    """A car that brakes with one axle, and what has no strength."""
    share = effect_class("brake_share")
    for front in (0.01, 0.99):
        inputs = InputModel(car("ff")).with_vehicle(front_share=front)
        assert share({}).apply_to_inputs(inputs, None) is inputs
    inputs = InputModel(car("ff"))
    assert share({"strength": 0.0}).apply_to_inputs(inputs, None) is inputs


def test_torque_reading_is_undone(car: Callable[..., Config]) -> None:
    """Read = 0.92 T + 12 Nm: the engine drags more than it says."""
    base = power(car("fb"))
    there = power(car("fb", "powertrain_torque_error"))
    true_nm = (-100.0 - 12.0) / 0.92
    expected = 0.35 * (true_nm + 100.0) / RADIUS_M * 20.0
    assert there - base == pytest.approx(expected, rel=1e-9)
    assert there < base


def test_corrections_of_a_role_follow_each_other() -> None:
    """The second acts on what the first gives; others are left alone."""
    speed, torque = ROLE_INDEX["vehicle_speed"], ROLE_INDEX["gear"]
    rules = corrections_by_role(
        [
            Correction("vehicle_speed", 2.0, 1.0),
            Correction("vehicle_speed", 10.0, 0.5),
        ]
    )
    values = array("d", [3.0, 3.0])
    found = corrected(rules, array("i", [speed, torque]), values)
    assert list(found) == [70.5, 3.0]
    assert list(values) == [3.0, 3.0]
    whole = corrected(rules, np.array([speed, torque]), np.array(values))
    assert whole.tolist() == [70.5, 3.0]
    assert whole.dtype == float


def test_offset_is_taken_off_the_thermocouple(
    car: Callable[..., Config],
) -> None:
    """A reading made of T, 9 K and 2 % of the excess gives T again."""
    rows = rows_of(car("ff", "thermocouple_offset"))
    shown = column(rows, "measured_disc_k")[-1]
    excess = shown - 293.15
    assert 293.15 + 1.02 * excess + 9.0 == pytest.approx(600.0, abs=1e-9)


def test_offset_moves_a_forced_disc(car: Callable[..., Config]) -> None:
    """Heat from a measured disc starts from what the disc has."""
    estimators = []
    for config in (car("measured"), car("measured", "thermocouple_offset")):
        present = {ROLE_INDEX["temp_fl_disc"]: 500_000}
        estimator = Estimator(config, present)
        times = array("q", range(0, 2_000_000, 100_000))
        roles = array("i", [ROLE_INDEX["temp_fl_disc"]] * len(times))
        estimator.advance(times, roles, array("d", [600.0] * len(times)))
        estimators.append(estimator.state("FL")["disc"])
    assert estimators[0] == 600.0
    assert estimators[1] == pytest.approx(
        293.15 + (600.0 - 293.15 - 9.0) / 1.02
    )


def test_one_sensor_errs_alone(car: Callable[..., Config]) -> None:
    late = car("ff", "thermocouple_lag", sensor=1.0)
    lag_s = corner_model(late, late.corner[0]).lag_s
    high = edited_inputs(car("ff", "thermocouple_offset", sensor=5.0))

    assert lag_s == {"disc": 15.0}
    for name in ("thermocouple_lag", "thermocouple_offset"):
        asked = {sensors_of(f["sensor"]) for f in effect_class(name).forms}
        assert asked == {
            (node,) for node in MEASURED_NODES if node != "disc_2"
        }
    losses = [
        f.get("loss", 0.0) for f in effect_class("thermocouple_lag").forms
    ]
    assert losses == [0.0] * 5 + [0.05] * 5 + [0.15] * 5
    assert {one.role for one in high.corrections} == {
        f"temp_{corner}_fluid" for corner in ("fl", "fr", "rl", "rr")
    }


def test_a_loose_sensor_reads_less_of_what_is_above_the_room(
    car: Callable[..., Config],
) -> None:
    """Strength 2 at a loss of 0.1: 80 of 100 K are read; at 20 degC all."""
    loose = car("ff", "thermocouple_lag", strength=2.0, sensor=1.0, loss=0.1)
    (own,) = [
        one
        for one in edited_inputs(loose).corrections
        if one.role == "temp_fl_disc"
    ]

    assert own.gain * (293.15 + 80.0) + own.offset == pytest.approx(393.15)
    assert own.gain * 293.15 + own.offset == pytest.approx(293.15)
    assert corner_model(loose, loose.corner[0]).lag_s == {"disc": 30.0}
    assert {one.role for one in edited_inputs(loose).corrections} == {
        f"temp_{corner}_disc" for corner in ("fl", "fr", "rl", "rr")
    }


def test_sensors_are_late_and_the_brake_is_not(
    car: Callable[..., Config],
) -> None:
    """By strength times time; the network has no part in it."""
    plain, slow = car("ff"), car("ff", "thermocouple_lag", strength=0.4)
    model = corner_model(slow, slow.corner[0])

    assert model.lag_s == dict.fromkeys(MEASURED_NODES, 6.0)
    assert model.network == corner_model(plain, plain.corner[0]).network
    assert corner_model(plain, plain.corner[0]).lag_s == {}


def test_heat_soak_grows_parked_and_clears(
    corner: Callable[..., Corner],
) -> None:
    """63 % after the time constant; driving clears it; parked it cools."""
    there, base = corner("ambient_heat_soak"), corner(None)
    for one in (there, base):
        one.warm(disc=500.0, fluid=400.0).drive(400, speed_ms=0.0)
    assert there["ambient_soak"] == pytest.approx(1.0 - exp(-1.0), rel=1e-3)
    nodes = base.nodes()
    for name in ("disc", "pad_front", "fluid"):
        assert there[name] < nodes[name] - 0.01
    ledger = there.ledger()
    assert abs(ledger.residual) < 1e-9 * sum(
        abs(j) for j in ledger.given_off.values()
    )
    there.drive(400, speed_ms=10.0)
    assert there["ambient_soak"] == 0.0


@pytest.mark.slow
def test_heat_soak_ends_at_the_true_air(corner: Callable[..., Corner]) -> None:
    """Parked for long, everything is as cold as the air really is."""
    there = corner("ambient_heat_soak", strength=0.5)
    for _ in range(60):
        there.drive(3600, speed_ms=0.0)
    for name, found in there.nodes().items():
        if name not in {"ambient", "dissolved"}:
            assert found == pytest.approx(283.15 - 4.0, abs=0.05)


def test_strengths_of_either_sign() -> None:
    """Where physics allows both, the bounds do; elsewhere they do not."""
    for name in effect_names():
        cls = effect_class(name)
        lower = cls.parameters()[0].lower
        assert (lower < 0.0) is cls.either_sign
    signs = [effect_class(n).either_sign for n in ("wet_disc", "mass_error")]
    assert signs == [False, True]


def test_steps_of_strength_are_steps_of_power(
    car: Callable[..., Config],
) -> None:
    """Power falls evenly as the push-out pressure rises."""
    found = [
        power(car("ff", "pushout_pressure", strength=s))
        for s in (0.0, 1.0, 2.0, 3.0)
    ]
    falls = [a - b for a, b in pairwise(found)]
    assert falls == pytest.approx([falls[0]] * 3, rel=1e-9)

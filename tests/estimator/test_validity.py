"""What the estimator says of its own estimates, corner by corner."""

from __future__ import annotations

from array import array
from itertools import groupby
from math import isclose, nan
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.bus.output.publication import Publication
from bstm_daemon.channels import (
    CORNER_PRESSURE_SUSPECT,
    FLAGS,
    WHEEL_SUSPECT,
)
from bstm_daemon.estimate import (
    NO_REASON,
    REASON_WORDS,
    CornerEstimate,
    Estimate,
    Reason,
    Validity,
)
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.validity import _is_possible, _remembered
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config.sections import Config, CornerConfig
    from bstm_daemon.native.loader import Kernel

SECOND = 1_000_000
TIMEOUT_US = 500_000


# few roles are mapped here
pytestmark = pytest.mark.usefixtures("all_verified")


def validity_of(
    config: Config, values: dict[str, float], silent: str = "", **options: Any
) -> dict[str, list[int]]:
    """Validity over 4 s of held values; *silent* stops after 2 s."""
    roles = {ROLE_INDEX[name]: value for name, value in values.items()}
    estimator = Estimator(config, dict.fromkeys(roles, TIMEOUT_US), **options)
    times, numbers, given = array("q"), array("i"), array("d")
    for at in range(0, 4 * SECOND, 20_000):
        for role, value in roles.items():
            if at < 2 * SECOND or role != ROLE_INDEX.get(silent):
                times.append(at)
                numbers.append(role)
                given.append(value)
    found: dict[str, list[int]] = {}
    for block in estimator.advance(times, numbers, given):
        for name, codes in block.validity.items():
            found.setdefault(name, []).extend(codes)
    return found


@pytest.fixture
def front(
    make_car: Callable[..., Config], make_corner: Callable[..., CornerConfig]
) -> Callable[..., Config]:
    """Return the maker of a car with two front corners."""

    def make(circuit: str = "primary", **sections: Any) -> Config:
        corners = [make_corner(n, circuit=circuit) for n in ("FL", "FR")]
        return make_car(*corners, **sections)

    return make


def test_one_silent_wheel_pressure_degrades_its_corner_only(
    front: Callable[..., Config],
) -> None:
    """A brake that is not seen is not valid because another one is."""
    found = validity_of(
        front(),
        {
            "vehicle_speed": 20.0,
            "wheel_pressure_fl": 2e6,
            "wheel_pressure_fr": 2e6,
        },
        silent="wheel_pressure_fl",
        history_known=True,
    )

    assert found["FL"][5] == Validity.VALID
    assert found["FL"][-1] == Validity.DEGRADED
    assert set(found["FR"][1:]) == {Validity.VALID}


def test_the_secondary_circuit_is_enough_for_its_corners(
    front: Callable[..., Config],
) -> None:
    """Corners of the secondary circuit need no primary pressure."""
    found = validity_of(
        front("secondary"),
        {"vehicle_speed": 20.0, "secondary_pressure": 1e6},
        history_known=True,
    )

    assert set(found["FL"][1:]) == {Validity.VALID}


def test_a_lost_thermocouple_degrades_a_measured_disc(
    front: Callable[..., Config],
) -> None:
    """In mode measured a disc that is free again is an assumption."""
    found = validity_of(
        front(heat={"mode": "measured"}),
        {
            "vehicle_speed": 20.0,
            "primary_pressure": 0.0,
            "temp_fl_disc": 500.0,
            "temp_fr_disc": 500.0,
        },
        silent="temp_fl_disc",
        history_known=True,
    )

    assert found["FL"][5] == Validity.VALID
    assert found["FL"][-1] == Validity.DEGRADED
    assert found["FR"][-1] == Validity.VALID


def test_an_unknown_start_is_felt_as_long_as_the_slowest_lump(
    front: Callable[..., Config],
) -> None:
    """A single exponential, 150 K to 5 K: ln 30 time constants."""
    slow = {
        "fluid_caliper_thermal_capacity_j_k": 4000.0,
        "fluid_static_convection_w_k": 0.5,
        # nothing but the fluid is slow, and nothing but air takes its heat
        "pad_backplate_thermal_resistance_m2k_w": 1e3,
    }
    cooling = {"speed_ms": [0.0, 10.0], "s_per_s": [5e-3, 5e-3]}
    estimator = Estimator(front(thermal=slow, cooling=cooling), {})

    # the pads give their heat to nothing here but the disc
    expected_s = 4000.0 / 0.5 * 3.4012
    assert isclose(estimator.settling_s, expected_s, rel_tol=0.01)


PUBLISHED_PER_S = 10
# the stability system brakes one wheel
MOVING = {"vehicle_speed": 20.0, "wheel_pressure_fr": 0.0, "esc_active": 1.0}
RELEASED = {**MOVING, "wheel_pressure_fl": 0.0}
BOTH = {**MOVING, "wheel_pressure_fl": 2e6}
Spans = list[tuple[float, dict[str, float]]]


def over_spans(
    config: Config, spans: Spans, **options: Any
) -> dict[str, list[int]]:
    """Validity by corner over spans of (seconds, held values).

    The reasons are by corner and " why".
    """
    names = {name for _, values in spans for name in values}
    present = {ROLE_INDEX[name]: TIMEOUT_US for name in names}
    estimator = Estimator(config, present, **options)
    times, numbers, given = array("q"), array("i"), array("d")
    at = 0
    for seconds, values in spans:
        end = at + round(seconds * SECOND)
        for stamp in range(at, end, 50_000):
            held = values or {"": 0.0}
            for name, value in held.items():
                times.append(stamp)
                numbers.append(ROLE_INDEX.get(name, TICK))
                given.append(value)
        at = end
    found: dict[str, list[int]] = {}
    for block in estimator.advance(times, numbers, given):
        for name, codes in block.validity.items():
            found.setdefault(name, []).extend(codes)
            why = block.reasons[name]
            assert [c == Validity.VALID for c in codes] == [not w for w in why]
            found.setdefault(f"{name} why", []).extend(why)
    return found


def reasons_in(found: dict[str, list[int]], corner: str) -> list[Reason]:
    """Different reasons of *corner*, in the order of time."""
    return [Reason(code) for code, _ in groupby(found[f"{corner} why"])]


def test_a_missing_input_and_lost_heat_are_told_apart(
    front: Callable[..., Config], compiled: Kernel
) -> None:
    """The pressure is missing, then the heat unknown; one remains."""
    assert compiled is not None
    spans: Spans = [(3.0, BOTH), (12.5, MOVING), (380.0, RELEASED)]
    found = over_spans(front(), spans, history_known=True)

    assert reasons_in(found, "FL") == [
        NO_REASON,
        Reason.INPUT_MISSING,
        Reason.INPUT_MISSING | Reason.HEAT_UNKNOWN,
        Reason.HEAT_UNKNOWN,
        NO_REASON,
    ]
    assert reasons_in(found, "FR") == [NO_REASON]


def test_an_unknown_start_is_a_reason_until_it_settles(
    front: Callable[..., Config], compiled: Kernel
) -> None:
    """It ends long before a parked brake would have come to rest."""
    assert compiled is not None
    cooling = {"speed_ms": [0.0, 9.0], "s_per_s": [0.005, 0.005]}
    thermal = {"fluid_dynamic_convection_ws_mk": 0.5}
    config = front(cooling=cooling, thermal=thermal)

    found = over_spans(config, [(1500.0, MOVING)])

    assert reasons_in(found, "FR") == [Reason.START_UNKNOWN, NO_REASON]
    minutes = found["FR why"].count(1) / PUBLISHED_PER_S / 60.0
    assert minutes == pytest.approx(18.8, abs=0.1)
    assert Estimator(config, {}).settling_s > 3600.0


def test_a_suspect_input_is_a_reason_of_its_own(
    front: Callable[..., Config],
) -> None:
    """A spike of the pressure: suspect for 2 s, not missing."""
    held = {"vehicle_speed": 20.0, "primary_pressure": 1e5}
    spike = held | {"primary_pressure": 3e7}
    spans: Spans = [(1.0, held), (0.05, spike), (4.0, held)]

    found = over_spans(front(), spans, history_known=True)

    assert reasons_in(found, "FL") == [
        NO_REASON,
        Reason.INPUT_SUSPECT,
        NO_REASON,
    ]
    assert found["FL why"].count(Reason.INPUT_SUSPECT) in {20, 21}


@pytest.mark.parametrize(
    ("more", "last"),
    [({}, Reason.INPUT_SUSPECT), ({"primary_pressure": 2e6}, NO_REASON)],
    ids=["no pressure", "pressure"],
)
def test_a_pedal_that_shows_no_braking_is_suspect_without_a_pressure(
    front: Callable[..., Config], more: dict[str, float], last: Reason
) -> None:
    """20 m/s of braking beyond drag in 7 s; a pressure would say it all."""
    held = {"vehicle_speed": 20.0, "acceleration_longitudinal": -3.5}
    heat = {"mode": "fb", "assume_powertrain_torque_nm": 0.0}

    found = over_spans(
        front(heat=heat),
        [(9.0, held | {"brake_switch": 0.0} | more)],
        history_known=True,
    )

    why = found["FL why"]
    assert not any(why[: 5 * PUBLISHED_PER_S])
    assert why[-1] == last.value


@pytest.mark.parametrize(
    ("mode", "more", "unproven"),
    [
        ("fused", {}, True),
        # what a sound model may be off by hides too much
        ("fused", {"temp_fl_disc": 300.0}, True),
        ("ff", {}, False),
    ],
)
def test_what_nothing_proved_is_unverified_and_remembered(
    front: Callable[..., Config],
    mode: str,
    more: dict[str, float],
    unproven: bool,  # noqa: FBT001
) -> None:
    """Pushed against the brakes for 10 s, then nobody knows for 5 min."""
    pushed = {
        **dict.fromkeys(("wheel_speed_fl", "wheel_speed_fr"), 10.0),
        "primary_pressure": 3e6,
        "acceleration_longitudinal": 0.0,
        "powertrain_torque": 0.0,
        **more,
    }
    slowing = {"acceleration_longitudinal": -9.0}
    spans: Spans = [(10.0, pushed), (20.0, pushed | slowing)]

    found = over_spans(front(heat={"mode": mode}), spans, history_known=True)

    for name in ("FL", "FR"):
        why = [Reason(code) for code in found[f"{name} why"]]
        assert (Reason.UNVERIFIED in why[95]) is unproven
        assert (Reason.UNVERIFIED in why[-1]) is unproven
        assert Reason.UNVERIFIED not in why[5]


@pytest.mark.parametrize(
    ("mode", "own", "besides"),
    [
        ("ff", WHEEL_SUSPECT | CORNER_PRESSURE_SUSPECT, set()),
        ("fb", 0, {"acceleration_suspect"}),
        (
            "fused",
            WHEEL_SUSPECT,
            {"acceleration_suspect", "acceleration_scale", "wheel_radius"}
            | {"pressure_dead"},
        ),
        (
            "measured",
            WHEEL_SUSPECT | CORNER_PRESSURE_SUSPECT,
            {"temperature_suspect"},
        ),
    ],
)
def test_findings_that_are_remembered_are_those_of_what_the_heat_is_from(
    front: Callable[..., Config], mode: str, own: int, besides: set[str]
) -> None:
    """Of this corner's wheel and pressure, and of what is mapped."""
    roles = "primary_pressure", "acceleration_longitudinal"
    present = dict.fromkeys((ROLE_INDEX[role] for role in roles), 0)
    config = front(heat={"mode": mode})

    found = _remembered(config, present, 2)

    always = {"speed_suspect", "pressure_contradicts", "ambient_suspect"}
    assert found == (own << 2) | sum(FLAGS[n] for n in always | besides)
    if mode == "fb":
        without = _remembered(config, {}, 2)
        expected = sum(FLAGS[n] for n in {*always, "switch_contradicts"})
        assert without == expected


def test_a_disc_too_hot_for_the_model_is_unverified_and_remembered(
    front: Callable[..., Config],
) -> None:
    """Braked to above 650 degC, then released."""
    spans: Spans = [(240.0, BOTH), (100.0, RELEASED)]

    found = over_spans(front(), spans, history_known=True)

    hot = [bool(code & Reason.UNVERIFIED) for code in found["FL why"]]
    assert not any(hot[:300])
    assert hot[-1]
    assert not any(found["FR why"])


def test_reasons_are_worded_in_the_order_of_their_bits() -> None:
    """Each has words of its own."""
    why = Reason.MODEL_DISAGREES | Reason.START_UNKNOWN

    assert why.words == ("start unknown", "model disagrees")
    assert not NO_REASON.words
    assert len({REASON_WORDS[one] for one in Reason}) == len(Reason) == 8


def test_heat_unknown_for_too_long_is_invalid_then_degraded(
    front: Callable[..., Config], compiled: Kernel
) -> None:
    """10 s of driving without this corner's pressure; 30 times as long."""
    assert compiled is not None
    spans: Spans = [(3.0, BOTH), (12.5, MOVING), (380.0, RELEASED)]
    found = over_spans(front(), spans, history_known=True)

    codes = found["FL"]
    lost = codes.index(Validity.INVALID)
    back = codes.index(Validity.DEGRADED, lost)
    # 0.5 s of time-out, 10 s of outage
    assert lost / PUBLISHED_PER_S == pytest.approx(13.5, abs=0.2)
    assert set(codes[lost:back]) == {Validity.INVALID}
    assert back / PUBLISHED_PER_S == pytest.approx(15.5, abs=0.2)
    degraded = codes[back:].count(Validity.DEGRADED)
    assert degraded / PUBLISHED_PER_S == pytest.approx(360.0, abs=2.0)
    assert codes[-1] == Validity.VALID
    assert set(found["FR"][1:]) == {Validity.VALID}


@pytest.mark.slow
def test_an_outage_is_not_felt_beyond_the_settling(
    front: Callable[..., Config], compiled: Kernel
) -> None:
    """A brake that settles in minutes forgets an hour of unknown heat."""
    assert compiled is not None
    config = front(cooling={"speed_ms": [0.0, 9.0], "s_per_s": [0.1, 0.1]})
    settling_s = Estimator(config, {}).settling_s
    spans: Spans = [(2.0, BOTH), (3600.0, MOVING), (settling_s + 60.0, BOTH)]

    codes = over_spans(config, spans, history_known=True)["FL"]

    end = round(3602.0 * PUBLISHED_PER_S)
    assert settling_s < 30.0 * 3600.0
    assert codes[end - 1] == Validity.INVALID
    assert codes[end:].count(
        Validity.DEGRADED
    ) / PUBLISHED_PER_S == pytest.approx(settling_s, abs=2.0)
    assert codes[-1] == Validity.VALID


def test_silence_alone_is_never_invalid(front: Callable[..., Config]) -> None:
    """Nobody knows that this car stands: it cools, degraded."""
    found = over_spans(front(), [(2.0, BOTH), (40.0, {})], history_known=True)

    assert set(found["FL"][30:]) == {Validity.DEGRADED}


PARKED = {"vehicle_speed": 0.0, "primary_pressure": 0.0, "park_brake": 1.0}


def sleeping(config: Config, spans: Spans) -> list[Reason]:
    """Different reasons of a corner over *spans*, after a short drive."""
    drive = PARKED | {"vehicle_speed": 2.0, "park_brake": 0.0}
    found = over_spans(config, [(2.0, drive), *spans], history_known=True)
    return reasons_in(found, "FL")


@pytest.mark.parametrize(
    "parked",
    [
        PARKED,
        {"vehicle_speed": 0.0, "primary_pressure": 0.0, "ignition": 0.0},
    ],
)
@pytest.mark.parametrize("mode", ["ff", "fused"])
def test_a_parked_car_with_a_sleeping_bus_is_valid(
    front: Callable[..., Config], parked: dict[str, float], mode: str
) -> None:
    """Degraded only until the silence is known: 0.5 to 1 s after the end."""
    config = front(heat={"mode": mode})
    drive = parked | {"vehicle_speed": 2.0, "ignition": 1.0}
    spans: Spans = [(2.0, drive), (61.0, parked), (60.0, {})]

    found = over_spans(config, spans, history_known=True)

    assert reasons_in(found, "FL") == [
        NO_REASON,
        Reason.INPUT_MISSING,
        NO_REASON,
    ]
    assert found["FL why"].count(Reason.INPUT_MISSING) in {5, 6}


@pytest.mark.parametrize(
    ("seconds", "other"),
    [
        (59.0, {}),
        (61.0, {"park_brake": 0.0}),
        (61.0, {"park_brake": 0.0, "ignition": 1.0}),
        (61.0, {"primary_pressure": 1e6}),
        (61.0, {"brake_switch": 1.0}),
        (61.0, {"vehicle_speed": 0.6}),
    ],
)
def test_a_silence_of_a_car_that_may_drive_off_is_degraded(
    front: Callable[..., Config], seconds: float, other: dict[str, float]
) -> None:
    """A short stop, no parking brake, a foot on the pedal, not at rest."""
    spans: Spans = [(61.0, PARKED), (1.0, PARKED | other)]
    if seconds < 60.0:
        spans = [(seconds, PARKED)]

    found = sleeping(front(), [*spans, (60.0, {})])

    assert found == [NO_REASON, Reason.INPUT_MISSING]


@pytest.mark.parametrize(("seconds", "valid"), [(1.9, True), (2.2, False)])
def test_the_messages_of_a_bus_that_goes_to_sleep_end_together(
    front: Callable[..., Config], seconds: float, valid: object
) -> None:
    """Nobody knows whether a car without a speed stands still."""
    awake = {"park_brake": 1.0, "primary_pressure": 0.0}

    found = sleeping(front(), [(61.0, PARKED), (seconds, awake), (60.0, {})])

    assert (found[-1] is NO_REASON) is valid
    assert found[1] is Reason.INPUT_MISSING


def test_a_sleeping_bus_that_wakes_without_a_speed_proves_nothing(
    front: Callable[..., Config],
) -> None:
    """One that wakes with it does, from the first speed on."""
    parked: Spans = [(61.0, PARKED), (10.0, {})]
    awake = {"primary_pressure": 0.0, "park_brake": 1.0}

    unknown = sleeping(front(), [*parked, (4.0, awake), (10.0, {})])
    known = sleeping(front(), [*parked, (4.0, PARKED), (10.0, {})])

    missing = Reason.INPUT_MISSING
    assert unknown == [NO_REASON, missing, NO_REASON, missing]
    assert known[-1] is NO_REASON


def test_thermocouples_of_a_logger_are_not_the_bus_of_the_car(
    front: Callable[..., Config],
) -> None:
    """They go on while the car sleeps; in mode measured they must."""
    hot = {"temp_fl_disc": 400.0, "temp_fr_disc": 400.0}
    config = front(heat={"mode": "measured"})
    parked: Spans = [(2.0, PARKED | hot), (61.0, PARKED | hot)]

    asleep = over_spans(config, [*parked, (20.0, hot)], history_known=True)
    cut = over_spans(config, [*parked, (20.0, {})], history_known=True)

    assert asleep["FL"][-1] == Validity.VALID
    assert cut["FL"][-1] == Validity.DEGRADED


@pytest.mark.slow
def test_air_that_nobody_measures_degrades_after_hours(
    front: Callable[..., Config], compiled: Kernel
) -> None:
    """It may have warmed by 10 K; after three hours, with its own reason."""
    assert compiled is not None
    hours = 3.1
    spans: Spans = [(61.0, PARKED), (hours * 3600.0, {})]

    found = over_spans(front(), spans, history_known=True)

    assert reasons_in(found, "FL") == [
        NO_REASON,
        Reason.INPUT_MISSING,
        NO_REASON,
        Reason.AMBIENT,
    ]
    late_s = found["FL why"].count(Reason.AMBIENT) / PUBLISHED_PER_S
    assert late_s == pytest.approx(0.1 * 3600.0, abs=0.5)
    assert Reason.AMBIENT.words == ("ambient",)


def test_a_parked_car_that_is_back_at_speed_was_driven(
    front: Callable[..., Config],
) -> None:
    """Its bus was cut: what it did meanwhile is remembered."""
    drive = PARKED | {"vehicle_speed": 20.0, "park_brake": 0.0}

    found = sleeping(front(), [(61.0, PARKED), (60.0, {}), (10.0, drive)])

    assert found[-1] is Reason.INPUT_SUSPECT


def test_feed_back_that_stands_in_is_degraded(
    front: Callable[..., Config],
) -> None:
    """With a declared torque the heat is known, if not as configured."""
    config = front(heat={"assume_powertrain_torque_nm": 0.0})
    found = over_spans(
        config, [(2.0, BOTH), (20.0, MOVING)], history_known=True
    )

    assert set(found["FL"][30:]) == {Validity.DEGRADED}


@pytest.mark.parametrize("mode", ["ff", "fb"])
@pytest.mark.parametrize("role", ["primary_pressure", "powertrain_torque"])
def test_a_suspect_input_degrades_where_it_counts(
    front: Callable[..., Config], mode: str, role: str
) -> None:
    """A spike every second: the pressure in ff, the torque in fb."""
    held = {
        "vehicle_speed": 20.0,
        "primary_pressure": 1e5,
        "powertrain_torque": 0.0,
        "acceleration_longitudinal": 0.0,
    }
    spike = {**held, role: 1.5e5 if role == "powertrain_torque" else 3e7}
    spans: Spans = [(1.0, held), *[(0.05, spike), (0.95, held)] * 3]

    codes = over_spans(front(heat={"mode": mode}), spans, history_known=True)[
        "FL"
    ]

    counts = (role == "primary_pressure") == (mode == "ff")
    assert set(codes[2:9]) == {Validity.VALID}
    assert set(codes[12:]) == {Validity.DEGRADED if counts else Validity.VALID}


def test_a_wheel_left_out_degrades_its_corner(
    front: Callable[..., Config],
) -> None:
    """Its brake goes by the speed of the others; theirs are sound."""
    values = {
        "vehicle_speed": 20.0,
        "wheel_speed_fl": 0.0,
        "wheel_speed_fr": 20.0,
        "primary_pressure": 1e6,
    }
    found = over_spans(front(), [(5.0, values)], history_known=True)

    assert set(found["FL"][25:]) == {Validity.DEGRADED}
    assert set(found["FR"][1:]) == {Validity.VALID}


def test_a_drum_is_published_as_not_available() -> None:
    """It is there, and says that it has no model; the status ignores it."""
    publication = Publication(["FL", "RL"], 0x5B0)
    valid = CornerEstimate(validity=Validity.VALID)

    frames = {
        f.name: f for f in publication.encode(Estimate(0, {"FL": valid}))
    }

    assert frames["BSTM_Status"].data[1] >> 4 == Validity.VALID
    assert frames["BSTM_FL_Temperatures"].data[1] >> 4 == Validity.VALID
    assert frames["BSTM_RL_Temperatures"].data[1] >> 4 == (
        Validity.NOT_AVAILABLE
    )


def test_a_temperature_is_above_200_k_and_below_1800_k() -> None:
    for kelvin in (200.0, 1800.0, 1e9, nan):
        assert not _is_possible([300.0, kelvin])
    assert _is_possible([200.1, 1799.9])

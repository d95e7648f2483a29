"""Wear and advice from frames to frames."""

from __future__ import annotations

import json
from array import array
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from cantools.database.can import Database

from bstm_daemon.advice.conditions import conditions_at
from bstm_daemon.bus.output import layout as output_layout
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.estimate import RiskLevel
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

ROOT = Path(__file__).parents[2]
SECOND = 1_000_000
START_US = 1_700_000_000 * SECOND
OURS = Database()
OURS.add_dbc_file(ROOT / "dbc" / "bstm.dbc")
CAR = Database()
CAR.add_dbc_file(ROOT / "dbc" / "example_vehicle.dbc")
CONFIG, SIGNALS = load_vehicle(ROOT / "config" / "example_vehicle.toml")

Sent = tuple[int, int, bytes]

PRESSED = [
    ROLE_INDEX[role]
    for role in ("vehicle_speed", "primary_pressure", "secondary_pressure")
]


def engine(
    *,
    requests: bool = True,
    history_known: bool = True,
    forecast: bool = True,
) -> Engine:
    """Return the example car's with or without the second switch."""
    publish = CONFIG.publish.model_copy(update={"requests": requests})
    config = CONFIG.model_copy(update={"publish": publish})
    return Engine(
        config, SIGNALS, history_known=history_known, forecast=forecast
    )


def hot_parked(car: Engine, fluid_k: float = 420.0) -> list[dict[str, Any]]:
    """Return the advice of *car* with a hot fluid, at rest for 5 s."""
    for batch, names in car.estimator.batches:
        for member in range(len(names)):
            fluid = batch.programs[member].state_names.index("fluid")
            batch.state[member * batch.width + fluid] = fluid_k
    return values(run(car, drive(0.0, 5.0, 0.0, 0.0)), "BSTM_Advice")


def frame(name: str, stamp_us: int, **values: float) -> Sent:
    """Return a frame of the car; signals not given are 0."""
    message = CAR.get_message_by_name(name)
    zeros = {
        signal.name: max(0.0, signal.minimum or 0.0)
        for signal in message.signals
    }
    data = message.encode(zeros | values, strict=False)
    return stamp_us, message.frame_id, data


def drive(
    begin_s: float, end_s: float, speed_kmh: float, bar: float
) -> Iterator[Sent]:
    """Return 20 frames a second of each kind."""
    for i in range(round(begin_s * 20), round(end_s * 20)):
        at_us = START_US + i * 50_000
        wheels = {f"WheelSpeed{c}": speed_kmh for c in output_layout.CORNERS}
        yield frame("WheelSpeeds", at_us, **wheels)
        yield frame(
            "BrakePressure", at_us, PressurePrimary=bar, PressureSecondary=bar
        )
        yield frame("Inertial", at_us, VehicleSpeed=speed_kmh)
        yield frame("Powertrain", at_us, Gear=4, EngineSpeed=1500)
        yield frame("Body", at_us, Ignition=1, BrakeSwitch=float(bar > 0))
        yield frame("Ambient", at_us, AmbientTemperature=20.0)


def run(car: Engine, frames: Iterable[Sent]) -> list[Any]:
    """Return what is published, ticking with every frame."""
    found = []
    for stamp_us, can_id, data in frames:
        car.frame(0, can_id, False, data, stamp_us)
        found += car.tick(stamp_us)
    return found


def values(published: list[Any], name: str) -> list[dict[str, Any]]:
    """Return the decoded frames *name*."""
    return [
        OURS.decode_message(out.can_id, out.data)  # type: ignore[misc]
        for _, out in published
        if out.name == name
    ]


def test_advice_needs_the_second_switch() -> None:
    frames = list(drive(0.0, 3.1, 36.0, 10.0))

    assert not values(run(engine(requests=False), frames), "BSTM_Advice")
    assert len(values(run(engine(), frames), "BSTM_Advice")) == 3


@pytest.mark.parametrize("forecast", [True, False])
def test_an_unknown_start_is_at_most_critical_and_alarms_nobody(
    *, forecast: bool
) -> None:
    """The bound may boil; that brakes are hot is not known by it."""
    frames = list(drive(0.0, 12.0, 0.0, 0.0))
    found = run(engine(history_known=False, forecast=forecast), frames)

    assert values(found, "BSTM_FL_Risk")[-1]["Level"] == "critical"
    assert values(found, "BSTM_FL_Temperatures")[-1]["Fluid"] < 30.0
    for advice in values(found, "BSTM_Advice"):
        assert (advice["Message"], advice["Sound"]) == ("none", "none")


def test_hot_brakes_alarm_though_the_start_is_unknown() -> None:
    """The estimate began cold, and it is hot."""
    found = hot_parked(engine(history_known=False), fluid_k=470.0)

    assert found[-1]["Message"] == "wait_before_departure"


@pytest.mark.slow
def test_a_descent_asks_for_a_lower_gear() -> None:
    """The example car has a manual gearbox; 36 km/h and 10 bar held."""
    found = values(run(engine(), drive(0.0, 60.0, 36.0, 10.0)), "BSTM_Advice")

    assert found[0]["ShiftAdvice"] == "none"
    assert found[-1]["ShiftAdvice"] == "shift_down"
    assert found[-1]["GearboxRequest"] == "none"
    assert found[-1]["Message"] == "none"
    assert found[-1]["EmergencyAssist"] == "off"
    assert found[-1]["PedalFeel"] == pytest.approx(100.0)


def test_a_hot_parked_car_asks_to_wait() -> None:
    """Level high by the margin; how long is not known without a forecast."""
    found = hot_parked(engine(forecast=False))

    assert found[0]["Message"] == "wait_before_departure"
    assert found[0]["Sound"] == "chime"
    assert found[-1]["Sound"] == "none"
    assert found[-1]["WaitingTime"] == "not_available"
    assert found[-1]["EmergencyAssist"] == "standby"
    assert found[-1]["PedalFeel"] < 100.0


def test_the_forecast_tells_how_long_to_wait() -> None:
    car = engine()

    found = hot_parked(car)

    assert car.estimate is not None
    waits = [
        corner.waiting_s
        for corner in car.estimate.corners.values()
        if corner.risk is not None and corner.risk.level >= RiskLevel.HIGH
    ]
    assert found[-1]["Message"] == "wait_before_departure"
    assert max(waits) > 60.0
    assert found[-1]["WaitingTime"] == pytest.approx(max(waits), abs=2.0)


def test_a_missing_pressure_is_not_known_to_advice() -> None:
    """The model takes it as 0: a pedal at the floor would be vapour."""
    estimator = Estimator(CONFIG, dict.fromkeys(PRESSED, 500_000))
    times, roles, pressures = array("q"), array("i"), array("d")
    for tenth in range(100):
        for role, value in zip(PRESSED, (20.0, 3e6, 3e6), strict=True):
            if role == PRESSED[0] or tenth < 50:
                times.append(START_US + tenth * 100_000)
                roles.append(role)
                pressures.append(value)
    told = [
        conditions_at(block.at(i), {}, {}).pressures_pa
        for block in estimator.advance(times, roles, pressures)
        for i in range(len(block.times_us))
    ]

    assert list(told[20].values()) == pytest.approx([3e6] * 4)
    assert all(map(isnan, told[-1].values()))


def test_wear_is_published_every_ten_seconds() -> None:
    published = run(engine(), drive(0.0, 41.0, 36.0, 10.0))
    found = values(published, "BSTM_FL_Wear")

    assert len(found) == 4
    assert found[0]["Validity"] == "degraded"
    assert found[0]["Source"] == "configured"
    assert found[0]["Level"] == "ok"
    assert found[0]["PadThickness"] == pytest.approx(11.0, abs=0.011)
    assert found[0]["PadThicknessStd"] == pytest.approx(0.5, abs=0.011)
    assert found[0]["RemainingDistance"] == "not_available"


@pytest.mark.parametrize(
    "cut_s",
    [
        pytest.param(2.0, marks=pytest.mark.slow),
        33.35,
        pytest.param(50.0, marks=pytest.mark.slow),
    ],
)
def test_a_restart_goes_on_with_the_same_bytes(cut_s: float) -> None:
    """Advice and wear in the state file; a forecast begins anew."""
    frames = [*drive(0.0, 45.0, 36.0, 10.0), *drive(45.0, 60.0, 0.0, 5.0)]
    cut_us = START_US + round(cut_s * SECOND)
    before = [f for f in frames if f[0] <= cut_us]
    whole = engine(forecast=False)
    expected = run(whole, frames)
    first = engine(forecast=False)
    run(first, before)
    text = json.dumps(first.export_state(), allow_nan=False)

    second = engine(history_known=False, forecast=False)
    restored = second.resume(json.loads(text), 0, before[-1][0])
    found = run(second, frames[len(before) :])

    assert restored.resumed
    assert [(at, out.name, out.data.hex()) for at, out in found] == [
        (at, out.name, out.data.hex()) for at, out in expected[-len(found) :]
    ]
    assert second.export_state() == whole.export_state()


@pytest.mark.parametrize(
    "advice", [None, {}, {"machines": 5}, "parked", "half"]
)
def test_advice_that_is_none_begins_parked(advice: object) -> None:
    first = engine()
    run(first, drive(0.0, 2.0, 36.0, 10.0))
    document = first.export_state()
    if advice == "half":
        # what it could be restored from is not taken either
        advice = document["advice"] | {"roles": 5}
    document |= {"advice": advice}
    second = engine(history_known=False)

    restored = second.resume(document, 0, document["time_us"])

    assert restored.resumed
    assert second.export_state()["advice"] == engine().export_state()["advice"]
    assert run(second, drive(2.0, 4.0, 36.0, 10.0))

"""Names, units and comments as hints to a role."""

from collections.abc import Callable

import pytest
from cantools.database.can import Database

from bstm_daemon.analysis.setup import name_rules
from bstm_daemon.analysis.setup.name_rules import name_matches
from bstm_daemon.roles import ROLE_INDEX

Maker = Callable[..., Database]


@pytest.mark.parametrize(
    ("signal", "role", "unit"),
    [
        ("WS_FL m/s", "wheel_speed_fl", "m/s"),
        ("WhlRl_W_Meas rad/s", "wheel_speed_rl", "rad/s"),
        ("WhlSpd_Rear_LH km/h", "wheel_speed_rl", "km/h"),
        ("SPEED m/s", "vehicle_speed", "m/s"),
        ("ESP_Bremsdruck Unit_Bar", "primary_pressure", "bar"),
        ("CYL_PRES Bar", "primary_pressure", "bar"),
        ("FrontBrakePressure PSI", "primary_pressure", "psi"),
        ("BrakePressureFL bar", "wheel_pressure_fl", "bar"),
        ("LONG_ACCEL m/s^2", "acceleration_longitudinal", "m/s2"),
        ("ACCEL_Y m/s^2", "acceleration_lateral", "m/s2"),
        ("RPM rpm", "engine_speed", "rpm"),
        ("BRAKE_PRESSED:1", "brake_switch", "bool"),
        ("EBRAKE:1", "park_brake", "bool"),
        ("WheelTorque Nm", "powertrain_torque", "Nm"),
        ("VCFRONT_tempAmbient C", "ambient_temperature", "degC"),
    ],
)
def test_a_plain_signal_has_one_role(
    make_database: Maker, signal: str, role: str, unit: str
) -> None:
    (match,) = name_matches(make_database([signal]))

    assert (match.role, match.unit, match.caveat) == (role, unit, "")


@pytest.mark.parametrize(
    "signal",
    [
        "STEER_ANGLE deg",
        "SET_SPEED km/h",
        "TIRE_PRESSURE_FL bar",
        "OilPressure bar",
        "FanSpeed rpm",
        "BrakePressureRequest bar",
        "WheelSpeedFL_QF:2",
        "WheelSpeedFL Nm",
        "ACCEL_PEDAL %",
        "BrakeFluidLevel %",
        "ESP_brakeDiscWipingActive:1",
        "EngineSpeedRpmFlag:1",
    ],
)
def test_what_only_sounds_alike_has_none(
    make_database: Maker, signal: str
) -> None:
    assert name_matches(make_database([signal])) == []


@pytest.mark.parametrize(
    ("signal", "role", "caveat"),
    [
        ("BRAKE %", "primary_pressure", "its unit in the DBC is '%'"),
        ("BRAKE_PRESSURE", "primary_pressure", "gives no unit"),
        ("RearBrakePressure PSI", "secondary_pressure", "of the rear"),
        ("WhlSpdRR", "wheel_speed_rr", "gives no unit"),
        ("MotorTorque Nm", "motor_torque", "at the wheels"),
    ],
)
def test_a_doubt_is_said(
    make_database: Maker, signal: str, role: str, caveat: str
) -> None:
    match = next(
        one
        for one in name_matches(make_database([signal]))
        if one.role == role
    )

    assert caveat in match.caveat


def test_a_signal_that_cannot_be_read_is_no_match(
    make_database: Maker,
) -> None:
    database = make_database(["WS_FL:70 m/s"])

    assert name_matches(database) == []


def test_every_rule_is_of_a_role() -> None:
    roles = {rule.role.format(corner="fl") for rule in name_rules._RULES}

    assert roles <= set(ROLE_INDEX)

"""Names, units and comments as hints to a role."""

from collections.abc import Callable

import pytest
from cantools.database.can import Database
from cantools.database.conversion import BaseConversion
from cantools.database.namedsignalvalue import NamedSignalValue
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.analysis.setup import name_rules
from bstm_daemon.analysis.setup.name_rules import (
    name_matches,
    unit_of,
    words_of,
)
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
        ("EngAout_N_Actl RPM", "engine_speed", "rpm"),
        ("Veh_V_ActlBrk kph", "vehicle_speed", "km/h"),
        ("WhlSp_FL kph", "wheel_speed_fl", "km/h"),
        ("VehLongComp_A m/s^2", "acceleration_longitudinal", "m/s2"),
        ("PrplWhlTot_Tq_Actl N-m", "powertrain_torque", "Nm"),
        ("PrkBrkActv_B_Actl:1", "park_brake", "bool"),
        ("BRAKE_PRESSED:1", "brake_switch", "bool"),
        ("EBRAKE:1", "park_brake", "bool"),
        ("WheelTorque Nm", "powertrain_torque", "Nm"),
        ("VCFRONT_tempAmbient C", "ambient_temperature", "degC"),
        # of loggers
        ("v km/h", "vehicle_speed", "km/h"),
        ("vGPS km/h", "gnss_speed", "km/h"),
        ("v_Rad_VL km/h", "wheel_speed_fl", "km/h"),
        ("p_Brems_V bar", "primary_pressure", "bar"),
        ("pBrakeFL bar", "wheel_pressure_fl", "bar"),
        ("Tamb C", "ambient_temperature", "degC"),
        ("Tdisc_FL C", "temp_fl_disc", "degC"),
        ("ROTOR_T_RL C", "temp_rl_disc", "degC"),
        ("IR_Disc_FR C", "temp_fr_disc", "degC"),
    ],
)
def test_a_plain_signal_has_one_role(
    make_database: Maker, signal: str, role: str, unit: str
) -> None:
    (match,) = name_matches(make_database([signal]))

    assert (match.role, match.unit, match.caveat) == (role, unit, "")


@pytest.mark.parametrize(
    "signal", ["pBrakeR bar", "Bremsdruck_HA bar", "BRAKE_PRESS_R bar"]
)
def test_a_pressure_of_the_rear_is_not_the_primary_one(
    make_database: Maker, signal: str
) -> None:
    (match,) = name_matches(make_database([signal]))

    assert match.role == "secondary_pressure"
    assert "of the rear" in match.caveat


@pytest.mark.parametrize(
    "signal", ["BrkTempFL C", "tbrake_fl C", "Bremse_T_VL C"]
)
def test_a_brake_s_temperature_may_be_its_disc_s(
    make_database: Maker, signal: str
) -> None:
    (match,) = name_matches(make_database([signal]))

    assert match.role == "temp_fl_disc"
    assert "the disc is assumed" in match.caveat


@pytest.mark.parametrize(
    "signal",
    [
        "STEER_ANGLE deg",
        "SET_SPEED km/h",
        "TIRE_PRESSURE_FL bar",
        "OilPressure bar",
        "FanSpeed rpm",
        "ClutchAC_B_Stat:1",
        "ESP_Verz_EPB_aktiv:1",
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
        ("BRAKE %", "primary_pressure", "its stated unit is '%'"),
        ("BRAKE_PRESSURE", "primary_pressure", "no unit is stated"),
        ("RearBrakePressure PSI", "secondary_pressure", "of the rear"),
        ("WhlSpdRR", "wheel_speed_rr", "no unit is stated"),
        ("MotorTorque Nm", "motor_torque", "at the wheels"),
        ("BrakePressureRequest bar", "primary_pressure", "a request"),
        ("BrkTqRqDrv N-m", "brake_torque", "a request"),
        ("WhlTqDes Nm", "powertrain_torque", "a request"),
        ("PrkBrkDecel_Actv:1", "park_brake", "more than a parking brake"),
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


def test_a_clutch_of_all_wheel_drive_is_named_by_its_message(
    make_database: Maker,
) -> None:
    database = make_database(["Kupplung_offen:1"])
    assert [one.role for one in name_matches(database)] == ["clutch_open"]

    database.messages[0].name = "Allrad_1"

    assert name_matches(database) == []


def test_measured_goes_before_derived_and_asked_for(
    make_database: Maker,
) -> None:
    names = ["BrkTqMeas Nm", "BrkTqEst Nm", "BrkTqRq Nm"]

    levels = [one.level for one in name_matches(make_database(names))]

    assert levels == [0, name_rules.DERIVED, name_rules.REQUEST]


def test_a_log_may_show_what_no_name_says(make_database: Maker) -> None:
    names = [
        "AY m/s2",
        "X1 Nm",
        "X2 bar",
        "SteerX Nm",
        "AYRq m/s2",
        "FUEL bar",
    ]

    matches = name_rules.unit_matches(make_database(names))

    assert [(one.role, one.signal.name) for one in matches] == [
        ("acceleration_longitudinal", "AY"),
        ("powertrain_torque", "X1"),
        ("primary_pressure", "X2"),
    ]


def test_the_selector_is_no_gear(make_database: Maker) -> None:
    database = make_database(["DI_gear"])
    database.messages[0].signals[0].conversion = BaseConversion.factory(
        choices={1: NamedSignalValue(1, "DI_GEAR_P")}
    )

    (match,) = name_matches(database)

    assert "selector" in match.caveat


def test_a_signal_that_cannot_be_read_is_no_match(
    make_database: Maker,
) -> None:
    database = make_database(["WS_FL:70 m/s"])

    assert name_matches(database) == []


def test_every_rule_is_of_a_role() -> None:
    roles = {rule.role.format(corner="fl") for rule in name_rules._RULES}

    assert roles <= set(ROLE_INDEX)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("WheelSpeedFL", "wheel speed fl"),
        ("WheelSpeedFL175", "wheel speed fl 175"),
        ("WHL_SPD_FL", "whl spd fl"),
        ("FLSpeedKPH", "fl speed kph"),
        ("ESP_VL_Radgeschw_02", "esp fl radgeschw 02"),
        ("ESP_wheelSpeedReR", "esp wheel speed rr"),
        ("SpeedWheelLeftFront", "speed wheel fl"),
        ("WhlSpdLR", "whl spd rl"),
        ("wheel_front_right", "wheel fr"),
        ("TempDisc2_FL", "temp disc2 fl"),
    ],
)
def test_a_name_is_taken_apart(name: str, words: str) -> None:
    assert words_of(name) == words.split()


@given(st.text(alphabet="abFLRr_019", max_size=20))
def test_any_name_can_be_taken_apart(name: str) -> None:
    assert "".join(words_of(name)).islower() or not any(
        letter.isalpha() for letter in name
    )


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("km/h", "km/h"),
        ("KPH", "km/h"),
        ("Unit_KiloMeterPerHour", "km/h"),
        ("m/s/s", "m/s2"),
        ("m/s^2", "m/s2"),
        ("PSI", "psi"),
        ("deg C", "degC"),
        ("Bar", "bar"),
        ("furlong", ""),
        ("", ""),
    ],
)
def test_units_are_recognised(
    make_database: Maker, text: str, unit: str
) -> None:
    signal = make_database([f"s {text}"]).messages[0].signals[0]

    assert unit_of(signal) == unit


def test_a_name_may_hold_the_unit(make_database: Maker) -> None:
    signal = make_database(["FLSpeedKPH"]).messages[0].signals[0]

    assert unit_of(signal) == "km/h"

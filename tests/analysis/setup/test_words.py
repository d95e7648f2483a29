"""Names and units taken apart."""

from collections.abc import Callable

import pytest
from cantools.database.can import Database
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.analysis.setup.words import unit_of, words_of

Maker = Callable[..., Database]


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

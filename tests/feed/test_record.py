"""A publication as a line of JSON."""

import json
import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from bstm_daemon.config.sections import Config
from bstm_daemon.estimate import (
    CornerEstimate,
    Estimate,
    Reason,
    RiskLevel,
    Validity,
)
from bstm_daemon.feed.record import RecordWriter, wear_percent

Make = Callable[[int], Estimate]


def test_a_line_has_every_value_of_the_car_and_its_corners(
    config: Config, estimate: Make
) -> None:
    writer = RecordWriter(config)

    line = writer.line(estimate(3), 2)

    assert line.endswith(b"}\n")
    record = json.loads(line)
    corners = record.pop("corners")
    assert record == {
        "schema": "bstm.feed",
        "version": 1,
        "vehicle": "example-vehicle",
        "seq": 2,
        "time_s": 1_700_000_000.3,
        "validity": "not_available",
        "state": "running",
        "heat_mode": "fused",
        "history_known": True,
        "level": "elevated",
        "probability": 0.02,
        "boiling_low_c": 152.0,
        "advice": {
            "validity": "valid",
            "message": "brakes_hot",
            "sound": "not_available",
            "shift_advice": "shift_down",
            "emergency_assist": "not_available",
            "waiting_s": "beyond",
        },
    }
    assert corners["FL"] == {
        "validity": "valid",
        "reasons": [],
        "level": "elevated",
        "sure_level": "elevated",
        "disc_c": 303.0,
        "pad_front_c": 250.0,
        "pad_back_c": 150.0,
        "fluid_c": 100.0,
        "boiling_c": 155.0,
        "margin_k": 55.0,
        "probability": 0.02,
        "peak_c": 127.0,
        "peak_in_s": 599,
        "waiting_s": "beyond",
        "fade": "high",
        "pad_mm": 5.5,
        "pad_wear_percent": 61.1,
        "wear_level": "check",
        "wear_validity": "degraded",
    }


def test_validity_and_reasons_are_those_of_the_corner(
    config: Config, estimate: Make
) -> None:
    corners = json.loads(RecordWriter(config).line(estimate(0)))["corners"]

    assert corners["FR"]["validity"] == "degraded"
    assert corners["FR"]["reasons"] == ["input missing", "unverified"]
    assert corners["RL"]["validity"] == "invalid"
    assert corners["RL"]["reasons"] == ["heat unknown"]
    assert corners["RL"]["level"] == "unknown"
    words = {"validity", "level", "sure_level", "fade"}
    words |= {"wear_level", "wear_validity", "reasons"}
    assert {
        key: value for key, value in corners["RR"].items() if key not in words
    } == dict.fromkeys(corners["RR"].keys() - words)


def test_equal_codes_of_two_enumerations_keep_their_own_words(
    config: Config, estimate: Make
) -> None:
    """VALID, NORMAL and OK are all 0."""
    made = estimate(0)
    corner = made.corners["FL"]._replace(
        validity=Validity.VALID,
        level=RiskLevel.NORMAL,
        reasons=Reason(0),
    )

    line = RecordWriter(config).line(replace(made, corners={"FL": corner}))

    found = json.loads(line)["corners"]["FL"]
    assert (found["validity"], found["level"]) == ("valid", "normal")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_null(
    config: Config, estimate: Make, value: float
) -> None:
    corner = CornerEstimate(disc_k=value, fluid_k=value, boiling_k=400.0)
    made = replace(estimate(0), corners={"FL": corner})

    found = json.loads(RecordWriter(config).line(made))["corners"]["FL"]

    assert found["disc_c"] is None
    assert found["margin_k"] is None


def test_a_vehicle_of_any_name_gives_a_line_of_json(
    config: Config, estimate: Make
) -> None:
    name = 'a "car":nan\nof ours'
    vehicle = config.vehicle.model_copy(update={"id": name})
    writer = RecordWriter(config.model_copy(update={"vehicle": vehicle}))

    line = writer.line(estimate(0))

    assert line.count(b"\n") == 1
    assert json.loads(line)["vehicle"] == name


@pytest.mark.parametrize(
    ("thickness_m", "percent"),
    [(0.012, 0.0), (0.013, 0.0), (0.007, 50.0), (0.002, 100.0), (0.0, 100.0)],
)
def test_wear_is_the_share_of_what_may_be_worn(
    thickness_m: float, percent: float
) -> None:
    assert wear_percent(thickness_m, 0.012, 0.002) == pytest.approx(percent)


def test_wear_is_unknown_without_a_thickness_or_a_span() -> None:
    assert math.isnan(wear_percent(math.nan, 0.012, 0.002))
    assert math.isnan(wear_percent(0.002, 0.002, 0.002))
    assert math.isnan(wear_percent(0.005, math.nan, math.nan))

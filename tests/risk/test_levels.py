"""Levels and their hysteresis."""

from math import nan

import pytest

from bstm_daemon.risk.levels import (
    HOLD_US,
    Level,
    LevelMemory,
    published_level,
)

SECOND_US = 1_000_000


@pytest.mark.parametrize(
    ("probability", "level"),
    [
        (0.0, Level.NORMAL),
        (0.0099, Level.NORMAL),
        (0.01, Level.ELEVATED),
        (0.1, Level.HIGH),
        (0.5, Level.CRITICAL),
        (1.0, Level.CRITICAL),
    ],
)
def test_a_level_rises_at_once(probability: float, level: Level) -> None:
    assert LevelMemory().by_probability(probability, 0) is level


def test_a_level_falls_one_at_a_time_after_a_minute_below() -> None:
    memory = LevelMemory(Level.CRITICAL)
    found = [
        memory.by_probability(0.0, second * SECOND_US) for second in range(200)
    ]

    assert found[59] is Level.CRITICAL
    assert found[60] is Level.HIGH
    assert found[120] is Level.ELEVATED
    assert found[180] is Level.NORMAL


def test_between_release_and_limit_nothing_changes() -> None:
    """7 % is below high's 10 %, but not below its release at 5 %."""
    memory = LevelMemory(Level.HIGH)
    for second in range(300):
        level = memory.by_probability(0.07, second * SECOND_US)
        assert level is Level.HIGH


def test_a_moment_above_begins_the_minute_anew() -> None:
    memory = LevelMemory(Level.HIGH)
    for second in range(59):
        memory.by_probability(0.0, second * SECOND_US)
    memory.by_probability(0.06, HOLD_US)

    assert memory.by_probability(0.0, HOLD_US + SECOND_US) is Level.HIGH
    assert memory.by_probability(0.0, 2 * HOLD_US) is Level.HIGH


def test_temperatures_have_a_release_20_k_below() -> None:
    memory, limits = LevelMemory(), [(773.0, 873.0, 973.0)]

    def at(kelvin: float, time_us: int) -> Level:
        return memory.by_temperatures([kelvin], limits, time_us)

    assert at(880.0, 0) is Level.HIGH
    assert at(860.0, SECOND_US) is Level.HIGH
    at(850.0, 2 * SECOND_US)
    assert at(850.0, 2 * SECOND_US + HOLD_US) is Level.ELEVATED


def test_the_part_that_is_still_hot_holds_the_level() -> None:
    """A pad 5 K below its limit, beside a disc that is far from its own."""
    memory = LevelMemory()
    limits = [(773.0, 873.0, 973.0), (673.0, 773.0, 873.0)]
    memory.by_temperatures((650.0, 680.0), limits, 0)
    for second in range(1, 200):
        level = memory.by_temperatures(
            (650.0, 668.0), limits, second * SECOND_US
        )

    assert level is Level.ELEVATED


def test_what_is_not_known_lowers_no_level() -> None:
    memory = LevelMemory(Level.HIGH)
    for second in range(200):
        level = memory.by_probability(nan, second * SECOND_US)

    assert level is Level.HIGH


def test_a_clock_set_back_does_not_hold_a_level_for_ever() -> None:
    memory = LevelMemory(Level.ELEVATED, below_since_us=10**15)
    memory.by_probability(0.0, 0)

    assert memory.by_probability(0.0, HOLD_US) is Level.NORMAL


@pytest.mark.parametrize("level", set(Level) - {Level.UNKNOWN})
def test_nothing_is_told_of_an_invalid_estimate(level: Level) -> None:
    told = published_level(level, usable=False, history_known=True)

    assert told is Level.UNKNOWN


def test_unknown_history_is_never_normal() -> None:
    """A raised level still holds: a cold start only underestimates."""
    for level in (Level.ELEVATED, Level.HIGH, Level.CRITICAL):
        told = published_level(level, usable=True, history_known=False)
        assert told is level
    normal = published_level(Level.NORMAL, usable=True, history_known=False)
    assert normal is Level.UNKNOWN

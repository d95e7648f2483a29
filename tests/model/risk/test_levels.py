"""Levels and their hysteresis."""

from math import inf, nan

import pytest

from bstm_daemon.estimate import RiskLevel, Validity
from bstm_daemon.model.risk.levels import (
    HOLD_US,
    LevelMemory,
    level_of,
    level_of_margin,
    published_level,
    sure_level,
)

SECOND_US = 1_000_000


@pytest.mark.parametrize(
    ("probability", "level"),
    [
        (0.0, RiskLevel.NORMAL),
        (0.0099, RiskLevel.NORMAL),
        (0.01, RiskLevel.ELEVATED),
        (0.1, RiskLevel.HIGH),
        (0.5, RiskLevel.CRITICAL),
        (1.0, RiskLevel.CRITICAL),
    ],
)
def test_a_level_rises_at_once(probability: float, level: RiskLevel) -> None:
    assert LevelMemory().by_probability(probability, 0) is level
    assert level_of(probability) is level


def test_a_level_falls_one_at_a_time_after_a_minute_below() -> None:
    memory = LevelMemory(RiskLevel.CRITICAL)
    found = [
        memory.by_probability(0.0, second * SECOND_US) for second in range(200)
    ]

    assert found[59] is RiskLevel.CRITICAL
    assert found[60] is RiskLevel.HIGH
    assert found[120] is RiskLevel.ELEVATED
    assert found[180] is RiskLevel.NORMAL


def test_between_release_and_limit_nothing_changes() -> None:
    """7 % is below high's 10 %, but not below its release at 5 %."""
    memory = LevelMemory(RiskLevel.HIGH)
    for second in range(300):
        level = memory.by_probability(0.07, second * SECOND_US)
        assert level is RiskLevel.HIGH


@pytest.mark.parametrize(
    ("level", "stays", "falls"),
    [
        (RiskLevel.ELEVATED, 0.005, 0.00499),
        (RiskLevel.HIGH, 0.05, 0.0499),
        (RiskLevel.CRITICAL, 0.25, 0.2499),
    ],
)
def test_a_level_is_left_below_half_of_where_it_begins(
    level: RiskLevel, stays: float, falls: float
) -> None:
    for probability, after in ((stays, level), (falls, RiskLevel(level - 1))):
        memory = LevelMemory(level)
        memory.by_probability(probability, 0)
        assert memory.by_probability(probability, HOLD_US) is after


def test_a_moment_above_begins_the_minute_anew() -> None:
    memory = LevelMemory(RiskLevel.HIGH)
    for second in range(59):
        memory.by_probability(0.0, second * SECOND_US)
    memory.by_probability(0.06, HOLD_US)

    assert memory.by_probability(0.0, HOLD_US + SECOND_US) is RiskLevel.HIGH
    assert memory.by_probability(0.0, 2 * HOLD_US) is RiskLevel.HIGH


def test_temperatures_have_a_release_20_k_below() -> None:
    memory, limits = LevelMemory(), [(773.0, 873.0, 973.0)]

    def at(kelvin: float, time_us: int) -> RiskLevel:
        return memory.by_temperatures([kelvin], limits, time_us)

    assert at(880.0, 0) is RiskLevel.HIGH
    assert at(860.0, SECOND_US) is RiskLevel.HIGH
    at(850.0, 2 * SECOND_US)
    assert at(850.0, 2 * SECOND_US + HOLD_US) is RiskLevel.ELEVATED


def test_the_part_that_is_still_hot_holds_the_level() -> None:
    """A pad 5 K below its limit, beside a disc that is far from its own."""
    memory = LevelMemory()
    limits = [(773.0, 873.0, 973.0), (673.0, 773.0, 873.0)]
    memory.by_temperatures((650.0, 680.0), limits, 0)
    for second in range(1, 200):
        level = memory.by_temperatures(
            (650.0, 668.0), limits, second * SECOND_US
        )

    assert level is RiskLevel.ELEVATED


def test_without_a_part_the_level_is_normal() -> None:
    memory = LevelMemory()

    for time_us in (0, HOLD_US, 2 * HOLD_US):
        assert memory.by_temperatures([], [], time_us) is RiskLevel.NORMAL


def test_what_is_not_known_lowers_no_level() -> None:
    """Nor a part without a temperature beside one that is cold."""
    memory, parts = LevelMemory(RiskLevel.HIGH), LevelMemory(RiskLevel.HIGH)
    limits = [(773.0, 873.0, 973.0)] * 2
    for second in range(200):
        level = memory.by_probability(nan, second * SECOND_US)
        held = parts.by_temperatures((nan, 300.0), limits, second * SECOND_US)

    assert level is held is RiskLevel.HIGH


def test_a_disc_that_has_cooled_is_normal_again() -> None:
    """One level a minute, and nothing rises below the first limit."""
    memory, limits = LevelMemory(RiskLevel.HIGH), [(773.0, 873.0, 973.0)]
    found = [
        memory.by_temperatures([740.0], limits, second * SECOND_US)
        for second in range(180)
    ]

    assert found[59] is RiskLevel.HIGH
    assert found[60] is found[119] is RiskLevel.ELEVATED
    assert found[120] is found[179] is RiskLevel.NORMAL


def test_a_clock_set_back_does_not_hold_a_level_for_ever() -> None:
    memory = LevelMemory(RiskLevel.ELEVATED, below_since_us=10**15)
    memory.by_probability(0.0, 0)

    assert memory.by_probability(0.0, HOLD_US) is RiskLevel.NORMAL


@pytest.mark.parametrize(
    ("margin_k", "level"),
    [
        (40.1, RiskLevel.NORMAL),
        (40.0, RiskLevel.ELEVATED),
        (20.1, RiskLevel.ELEVATED),
        (20.0, RiskLevel.HIGH),
        (0.1, RiskLevel.HIGH),
        (0.0, RiskLevel.CRITICAL),
        (-inf, RiskLevel.UNKNOWN),
        (inf, RiskLevel.UNKNOWN),
        (nan, RiskLevel.UNKNOWN),
    ],
)
def test_level_of_a_margin(margin_k: float, level: RiskLevel) -> None:
    """The bounds belong to the worse level."""
    assert level_of_margin(margin_k) is level


@pytest.mark.parametrize("validity", Validity)
@pytest.mark.parametrize("level", RiskLevel)
def test_no_level_of_an_estimate_that_is_not_usable(
    level: RiskLevel, validity: Validity
) -> None:
    usable = validity in {Validity.VALID, Validity.DEGRADED}
    published = published_level(level, validity)

    assert published is (level if usable else RiskLevel.UNKNOWN)


@pytest.mark.parametrize(
    ("least", "most", "sure"),
    [
        (RiskLevel.NORMAL, RiskLevel.NORMAL, RiskLevel.NORMAL),
        (RiskLevel.NORMAL, RiskLevel.ELEVATED, RiskLevel.UNKNOWN),
        (RiskLevel.NORMAL, RiskLevel.CRITICAL, RiskLevel.UNKNOWN),
        (RiskLevel.ELEVATED, RiskLevel.CRITICAL, RiskLevel.ELEVATED),
        (RiskLevel.CRITICAL, RiskLevel.CRITICAL, RiskLevel.CRITICAL),
        (RiskLevel.UNKNOWN, RiskLevel.UNKNOWN, RiskLevel.UNKNOWN),
    ],
)
def test_what_is_sure_between_two_bounds(
    least: RiskLevel, most: RiskLevel, sure: RiskLevel
) -> None:
    """Raised by the lower bound, or normal by the upper one."""
    assert sure_level(least, most) is sure


def test_a_part_is_cooled_just_below_20_k_under_its_limit() -> None:
    """At 20.0 K below it stays for ever, a little lower it falls."""
    limits = [(773.0, 873.0, 973.0)]
    for kelvin, after in ((853.0, RiskLevel.HIGH), (852.95, 1)):
        memory = LevelMemory(RiskLevel.HIGH)
        memory.by_temperatures([kelvin], limits, 0)
        found = memory.by_temperatures([kelvin], limits, HOLD_US)
        assert found == after


def test_a_level_of_probability_is_left_after_a_minute_and_not_before() -> (
    None
):
    """Counted from the first sample below, not from the last one above."""
    memory = LevelMemory(RiskLevel.CRITICAL)
    memory.by_probability(0.6, 0)
    memory.by_probability(0.0, 5 * SECOND_US)
    late = 5 * SECOND_US + HOLD_US

    assert memory.by_probability(0.0, late - 1) is RiskLevel.CRITICAL
    assert memory.by_probability(0.0, late) is RiskLevel.HIGH
    assert memory.below_since_us == late


@pytest.mark.parametrize(
    ("level", "least", "most", "sure"),
    [
        (0, 0.0, 0.0099, True),
        (0, 0.0, 0.01, False),
        (0, 0.01, 0.099, True),
        (1, 0.005, 0.099, True),
        (1, 0.0049, 0.0051, False),
        (1, 0.0, 0.0049, True),
        (2, 0.05, 0.49, True),
        (2, 0.05, 0.5, False),
        (3, 0.25, 1.0, True),
        # it falls, and may fall on, or stay
        (3, 0.06, 0.24, True),
        (3, 0.04, 0.24, False),
        (2, 0.0, 0.04, False),
        (2, 0.006, 0.04, True),
        (0, nan, nan, True),
        (0, 0.0, nan, True),
        (1, 0.0, nan, False),
    ],
)
def test_what_all_probabilities_between_do_is_sure(
    level: int, least: float, most: float, *, sure: bool
) -> None:
    memory = LevelMemory(RiskLevel(level))

    assert memory.is_sure(least, most) is sure


def test_a_fall_that_is_due_counts_as_well() -> None:
    """What keeps a level may raise it again once it has fallen."""
    falling = LevelMemory(RiskLevel.CRITICAL, below_since_us=1)

    assert LevelMemory(RiskLevel.CRITICAL).is_sure(0.3, 0.6)
    assert not falling.is_sure(0.3, 0.6)
    assert falling.is_sure(0.3, 0.45)

"""What is known of the fluid: configured, heard, remembered."""

from datetime import date

import pytest

from bstm_daemon.config.estimates import FluidConfig
from bstm_daemon.forecast.fluid import (
    CHANGED_ROLE,
    WATER_ROLE,
    FluidKnowledge,
    SavedFluid,
)

YEAR_US = 31_557_600_000_000
TODAY_US = 1_780_000_000_000_000  # 2026-05-28


def median(config: FluidConfig, time_us: int = TODAY_US) -> float:
    knowledge = FluidKnowledge(config)
    knowledge.boiling(time_us)
    return knowledge.water.median_percent


def test_age_counts_in_the_time_of_the_data() -> None:
    config = FluidConfig(changed=date(2025, 5, 28))

    assert median(config) == pytest.approx(1.5, abs=0.02)
    assert median(config, TODAY_US + YEAR_US) == pytest.approx(2.5, abs=0.02)


@pytest.mark.parametrize("time_us", [0, -1, 10**9, 2**62])
def test_a_log_without_a_calendar_knows_no_age(time_us: int) -> None:
    assert median(FluidConfig(changed=date(2025, 5, 28)), time_us) == 3.0


def test_a_change_in_the_future_is_no_age() -> None:
    assert median(FluidConfig(changed=date(2030, 1, 1))) == 3.0


def test_a_measurement_goes_before_age_and_ages() -> None:
    config = FluidConfig(
        changed=date(2020, 1, 1),
        water_percent=1.5,
        water_measured=date(2025, 5, 28),
    )

    assert median(config) == pytest.approx(2.5, abs=0.02)


def test_the_change_flag_counts_when_it_rises() -> None:
    """It begins a new fluid, of which nothing is measured."""
    knowledge = FluidKnowledge(FluidConfig(water_percent=4.0))
    before_k = knowledge.boiling(TODAY_US).quantile(0.5)
    knowledge.ingest(TODAY_US, CHANGED_ROLE, 1.0)
    fresh_k = knowledge.boiling(TODAY_US).quantile(0.5)
    knowledge.ingest(TODAY_US + YEAR_US, CHANGED_ROLE, 1.0)
    aged_k = knowledge.boiling(TODAY_US + YEAR_US).quantile(0.5)

    assert fresh_k > before_k + 50.0
    assert aged_k < fresh_k - 10.0


def test_a_resumed_change_is_that_of_the_bus() -> None:
    """Unless the configuration has a later one: the workshop's."""
    heard = FluidKnowledge(FluidConfig())
    heard.ingest(TODAY_US, CHANGED_ROLE, 1.0)
    document = SavedFluid(**heard.export())

    same = FluidKnowledge(FluidConfig(changed=date(2020, 1, 1)))
    same.resume(document)
    assert same.export()["changed"] == "2026-05-28"
    # the flag is still up: no other change
    same.ingest(TODAY_US + YEAR_US, CHANGED_ROLE, 1.0)
    assert same.export()["changed"] == "2026-05-28"

    newer = FluidKnowledge(FluidConfig(changed=date(2027, 1, 1)))
    newer.resume(document)
    assert newer.export()["changed"] == "2027-01-01"


def test_a_resumed_measurement_is_that_of_the_bus() -> None:
    heard = FluidKnowledge(FluidConfig())
    heard.ingest(TODAY_US, WATER_ROLE, 0.035)
    again = FluidKnowledge(FluidConfig())
    again.resume(SavedFluid(**heard.export()))

    assert again.export() == heard.export()
    again.boiling(TODAY_US)
    assert again.water.median_percent == pytest.approx(3.5)


@pytest.mark.parametrize(
    ("configured", "percent"),
    [(date(2026, 5, 1), 5.0), (date(2026, 5, 28), 5.0), (None, 5.0),
     (date(2026, 5, 29), 2.0)],
)  # fmt: skip
def test_of_two_measurements_the_later_one_holds(
    configured: date | None, percent: float
) -> None:
    """The bus measured 5 % on 2026-05-28, the workshop 2 % some day."""
    heard = FluidKnowledge(FluidConfig())
    heard.ingest(TODAY_US, WATER_ROLE, 0.05)
    config = FluidConfig(water_percent=2.0, water_measured=configured)
    again = FluidKnowledge(config)
    again.resume(SavedFluid(**heard.export()))

    assert again.export()["percent"] == percent


def test_a_new_value_counts_on_the_day_of_the_last() -> None:
    """And the same value on another day, by which it is younger."""
    knowledge = FluidKnowledge(FluidConfig())
    found = []
    for days, share in ((0, 0.02), (0, 0.05), (365, 0.05)):
        time_us = TODAY_US + days * 86_400_000_000
        knowledge.ingest(time_us, WATER_ROLE, share)
        knowledge.boiling(time_us)
        found.append(knowledge.water.median_percent)

    assert found == pytest.approx([2.0, 5.0, 5.0])


def test_a_value_that_is_no_number_is_no_measurement() -> None:
    knowledge = FluidKnowledge(FluidConfig(water_percent=2.0))
    knowledge.ingest(TODAY_US, WATER_ROLE, float("nan"))

    assert knowledge.export()["percent"] == 2.0

"""What spoke against the inputs of a drive, and unknown heat."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.channels import (
    CORNER_PRESSURE_SUSPECT,
    FLAGS,
    HEAT_LOST,
    WHEEL_SUSPECT,
)
from bstm_daemon.model.heat.plausibility import CAUSES, FAULTS, SUSPECT
from bstm_daemon.replay.results import Results
from bstm_daemon.report.drive_statistics import DriveStatistics, summary_table
from bstm_daemon.report.findings import (
    Finding,
    FindingCollector,
    ReasonCollector,
    StopFinder,
    Stretches,
    StretchFinder,
)
from bstm_daemon.report.text import WIDTH

if TYPE_CHECKING:
    import numpy.typing as npt

    Column = npt.NDArray[np.float64]


@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_pieces_do_not_matter(rows: int) -> None:
    """One over the edge of two pieces is one."""
    rng = np.random.default_rng(4)
    holds = np.repeat(rng.integers(0, 2, 40), rng.integers(1, 40, 40)) > 0
    elapsed_s = 0.1 * np.arange(len(holds))
    whole, parts = StretchFinder(1.0), StretchFinder(1.0)

    whole.add(elapsed_s, holds)
    for first in range(0, len(holds), rows):
        stretch = slice(first, first + rows)
        parts.add(elapsed_s[stretch], holds[stretch])

    assert whole.stretches() is not None
    assert parts.stretches() == whole.stretches()


def test_a_stretch_up_to_the_end_counts_and_may_go_on() -> None:
    """Asking does not end it."""
    finder = StretchFinder()
    for first in range(3):
        rows = 10 * first + np.arange(10)
        finder.add(1.0 * rows, np.full(10, fill_value=True))
        last_s = float(rows[-1])
        assert finder.stretches() == Stretches(last_s, last_s, 0.0, 0.0)


def test_stretches_know_their_first_begin() -> None:
    """Of all that are long enough; a single row has the time before it."""
    holds = np.array([0, 1, 1, 0, 0, 1, 1, 1, 0, 1, 0], dtype=bool)
    every, long = StretchFinder(), StretchFinder(2.5)
    for finder in (every, long):
        finder.add(1.0 * np.arange(len(holds)), holds)

    assert every.stretches() == Stretches(6.0, 3.0, 4.0, 0.0)
    assert long.stretches() == Stretches(3.0, 3.0, 4.0, 4.0)
    assert StretchFinder().stretches() is None


def _speeds() -> np.ndarray:
    speed_ms = np.full(200, 10.0)
    speed_ms[:20] = 0.0
    speed_ms[50:55] = 0.0
    speed_ms[80:120] = 0.0
    speed_ms[90] = 0.8
    speed_ms[100] = np.nan
    speed_ms[170:] = 0.4
    return speed_ms


@pytest.mark.parametrize("rows", [1, 13, 200])
def test_stops_are_where_a_moving_vehicle_comes_to_rest(rows: int) -> None:
    """Not the standstill at the start, not a crossing, not a creep."""
    elapsed_s, speed_ms = np.arange(200.0), _speeds()
    finder = StopFinder()

    for first in range(0, 200, rows):
        stretch = slice(first, first + rows)
        finder.add(elapsed_s[stretch], speed_ms[stretch])

    assert finder.stops_s() == (80.0, 170.0)


def test_a_stop_is_one_when_it_has_lasted() -> None:
    elapsed_s, speed_ms = np.arange(200.0), _speeds()
    finder = StopFinder()

    finder.add(elapsed_s[:90], speed_ms[:90])
    assert finder.stops_s() == ()
    finder.add(elapsed_s[90:91], speed_ms[90:91])
    assert finder.stops_s() == (80.0,)
    finder.add(elapsed_s[91:], speed_ms[91:])
    assert finder.stops_s() == (80.0, 170.0)


CORNERS = ("RL", "FL", "FR", "RR")
"""As a configuration may have them."""


def findings_of(*stretches: tuple[float, int]) -> tuple[Finding, ...]:
    """Return what is found in *stretches*: seconds and flags."""
    flags = np.concatenate(
        [np.full(round(10 * s), bits) for s, bits in stretches]
    )
    collector = FindingCollector()
    collector.add(0.1 * (1 + np.arange(len(flags))), flags)
    return collector.findings(CORNERS)


def test_a_drive_without_findings_has_none() -> None:
    """Nor is a missing input one, nor a clock that was set."""
    quiet = FLAGS["speed_missing"] | FLAGS["clock_jump"] | FLAGS["silent"]

    assert findings_of((60.0, 0)) == ()
    assert findings_of((60.0, quiet)) == ()


def test_how_long_from_when_where_and_why() -> None:
    """Two stretches: the sum, the begin of the first, all reasons."""
    left = WHEEL_SUSPECT << 1 | FLAGS["wheels_contradict"]
    right = WHEEL_SUSPECT << 2 | FLAGS["stuck"]

    (found,) = findings_of((10.0, 0), (4.0, left), (2.0, 0), (3.0, right))

    assert found.corners == ("FL", "FR")
    assert found.total_s == pytest.approx(7.0)
    assert found.from_s == pytest.approx(10.0)
    assert found.text == (
        "wheel speed suspect (FL, FR) for 7 s, from 10 s on: a signal is "
        "stuck, wheel speeds contradict each other"
    )


def test_a_reason_stays_with_its_input() -> None:
    """Speed and pressure at once: the switch says nothing of a wheel."""
    flags = (
        FLAGS["pressure_suspect"]
        | CORNER_PRESSURE_SUSPECT << 3
        | FLAGS["switch_contradicts"]
        | WHEEL_SUSPECT
        | FLAGS["wheels_contradict"]
    )

    wheel, pressure = findings_of((1.0, 0), (5.0, flags))

    assert wheel.corners == ("RL",)
    assert wheel.reasons == ("wheel speeds contradict each other",)
    assert pressure.corners == ("RR",)
    assert pressure.reasons == ("braking without brake switch",)


def test_heat_of_another_source_and_of_none() -> None:
    """In the order of how bad it is, without reasons."""
    unknown = FLAGS["heat_unknown"]
    found = findings_of(
        (5.0, 0),
        (3.0, FLAGS["heat_substituted"]),
        (10.0, unknown),
        (6.0, unknown | HEAT_LOST << 2),
    )

    assert [one.text for one in found] == [
        "heat from the other source for 3 s, from 5 s on",
        "heat unknown for 16 s, from 8 s on",
        "heat unknown for too long (FR) for 6 s, from 18 s on",
    ]


def test_a_vehicle_speed_that_is_left_out_is_said() -> None:
    """It has no bit of its own while a wheel is sound: only the cause."""
    (found,) = findings_of((2.0, 0), (8.0, FLAGS["stuck"]))

    assert found.text == "a signal is stuck for 8 s, from 2 s on"


@pytest.mark.parametrize("bit", range(40))
def test_no_bit_that_speaks_against_an_input_is_lost(bit: int) -> None:
    """Each makes a finding; a moment of it makes none."""
    flags = 1 << bit
    told = SUSPECT | FAULTS["heat_lost"] | FAULTS["heat_doubt"]
    told |= FLAGS["heat_substituted"] | FLAGS["heat_unknown"]
    # comes with that of the pressure itself
    told &= ~(0b1111 * CORNER_PRESSURE_SUSPECT)

    assert bool(findings_of((1.0, 0), (2.0, flags))) == bool(flags & told)
    assert findings_of((1.0, 0), (0.5, flags), (1.0, 0)) == ()


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 13, 512])
def test_stretches_do_not_matter(rows: int) -> None:
    """A finding over the edge of a stretch is one; nothing grows."""
    rng = np.random.default_rng(7)
    bits = [0, WHEEL_SUSPECT | FLAGS["stuck"], FLAGS["heat_unknown"]]
    flags = np.repeat(rng.choice(bits, 90), rng.integers(1, 50, 90))
    elapsed_s = 0.1 * np.arange(len(flags))
    whole, parts = FindingCollector(), FindingCollector()

    whole.add(elapsed_s, flags)
    for first in range(0, len(flags), rows):
        stretch = slice(first, first + rows)
        parts.add(elapsed_s[stretch], flags[stretch])

    assert len(whole.findings(CORNERS)) == 2
    assert parts.findings(CORNERS) == whole.findings(CORNERS)


def test_screen_has_it() -> None:
    """At most as wide as the table; the names are those of the car."""
    flags = np.where(np.arange(600) < 100, 0, WHEEL_SUSPECT << 1 | CAUSES)
    columns = {
        "time_s": 5.0 + 0.1 * np.arange(600),
        "flags": flags.astype(np.float64),
    }
    statistics = DriveStatistics()
    statistics.write(Results(columns, CORNERS, ()))
    summary = statistics.summary()

    text = summary_table(summary)

    assert "\nwheel speed suspect (FL) for 50 s, from 10 s on: " in text
    assert max(map(len, text.splitlines())) <= WIDTH
    (found,) = summary.findings
    assert found.name == "wheel speed suspect"
    assert found.corners == ("FL",)
    assert found.total_s == pytest.approx(50.0)
    assert "a signal is stuck" in found.reasons


def test_reasons_add_up_over_corners_the_longest_first() -> None:
    """A time in which two corners have a reason counts once."""
    collector = ReasonCollector()
    unknown = np.nan
    for first in (0.0, 50.0):
        elapsed_s = first + 0.1 * (1 + np.arange(500))
        left = np.where(elapsed_s < 60.05, 1.0, 0.0)
        right = np.where(elapsed_s < 10.05, 1.0, unknown)
        right[elapsed_s > 90.05] = 36.0
        collector.add(elapsed_s, {"FR": right, "FL": left})

    longest, *others = collector.times()

    assert longest.words == "start unknown"
    assert longest.corners == ("FL", "FR")
    assert longest.total_s == pytest.approx(60.0)
    assert longest.share == pytest.approx(0.6)
    assert longest.text == (
        "start unknown for 60 s (60 %), from 0:00 on: FL FR"
    )
    assert [(one.words, one.corners, one.from_s) for one in others] == [
        ("input suspect", ("FR",), pytest.approx(90.0)),
        ("model disagrees", ("FR",), pytest.approx(90.0)),
    ]


def test_a_drive_that_is_valid_has_no_reasons() -> None:
    """Nor has one without rows."""
    collector = ReasonCollector()
    collector.add(np.empty(0), {})
    collector.add(np.array([0.0, 1.0]), {"FL": np.zeros(2)})

    assert collector.times() == ()

"""Stretches of a drive without an input."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.heat.sample_plan import FLAGS
from bstm_daemon.report.gaps import Gap, GapFinder, Stretches, StretchFinder
from bstm_daemon.report.tally import DriveTally
from bstm_daemon.results import Results

SPEED, PRESSURE = FLAGS["speed_missing"], FLAGS["pressure_missing"]


def results_of(flags: list[int], time_s: np.ndarray | None = None) -> Results:
    """Return ten rows a second with *flags*."""
    times = 5.0 + 0.1 * np.arange(len(flags)) if time_s is None else time_s
    columns = {"time_s": times, "flags": np.array(flags, dtype=float)}
    return Results(columns, (), ())


def input_gaps(results: Results, heat_mode: str) -> tuple[Gap, ...]:
    """Return what a tally of *results* finds."""
    tally = DriveTally()
    tally.write(results)
    return tally.gaps(heat_mode)


def test_total_and_longest() -> None:
    """Two gaps of speed, of 2 s and 3 s; the late frame does not count."""
    flags = [0] * 10 + [SPEED] * 20 + [0] * 10 + [SPEED] * 30
    flags += [0] * 5 + [SPEED] * 2 + [0] * 5

    (gap,) = input_gaps(results_of(flags), "ff")

    assert gap.name == "speed"
    assert gap.total_s == pytest.approx(5.0)
    assert gap.longest_s == pytest.approx(3.0)
    assert gap.longest_from_s == pytest.approx(3.9)


def test_only_what_the_heat_mode_needs() -> None:
    """Feed-Back goes without a pressure."""
    results = results_of([PRESSURE] * 40)

    assert [gap.name for gap in input_gaps(results, "ff")] == ["pressure"]
    assert input_gaps(results, "fb") == ()


def test_a_clock_set_back_is_no_negative_gap() -> None:
    """Only time that passed counts."""
    times = np.array([10.0, 11.0, 12.0, 2.0, 3.0, 4.0])
    flags = [0, SPEED, SPEED, SPEED, SPEED, 0]

    (gap,) = input_gaps(results_of(flags, times), "fb")

    assert gap.total_s == pytest.approx(3.0)


@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_stretches_do_not_matter(rows: int) -> None:
    """A gap over the edge of a stretch is one gap."""
    rng = np.random.default_rng(4)
    missing = np.repeat(rng.integers(0, 2, 40), rng.integers(1, 40, 40))
    flags = missing * float(SPEED)
    elapsed_s = 0.1 * np.arange(len(flags))
    whole, parts = GapFinder("speed"), GapFinder("speed")

    whole.add(elapsed_s, flags)
    for first in range(0, len(flags), rows):
        stretch = slice(first, first + rows)
        parts.add(elapsed_s[stretch], flags[stretch])

    assert whole.gap() is not None
    assert parts.gap() == whole.gap()


def test_a_gap_up_to_the_end_counts_and_may_go_on() -> None:
    """Asking does not end it."""
    finder = GapFinder("speed")
    for first in range(3):
        rows = 10 * first + np.arange(10)
        finder.add(1.0 * rows, np.full(10, float(SPEED)))
        gap = finder.gap()
        assert gap is not None
        assert gap.total_s == gap.longest_s == rows[-1]
        assert gap.longest_from_s == 0.0


def test_stretches_know_their_first_begin() -> None:
    """Of all that are long enough; a single row has the time before it."""
    holds = np.array([0, 1, 1, 0, 0, 1, 1, 1, 0, 1, 0], dtype=bool)
    every, long = StretchFinder(), StretchFinder(2.5)
    for finder in (every, long):
        finder.add(1.0 * np.arange(len(holds)), holds)

    assert every.stretches() == Stretches(6.0, 3.0, 4.0, 0.0)
    assert long.stretches() == Stretches(3.0, 3.0, 4.0, 4.0)
    assert StretchFinder().stretches() is None

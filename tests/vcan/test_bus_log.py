"""What candump wrote, by the lines that it belongs to."""

from __future__ import annotations

import pytest

from .bus_log import GRID_US, Cycles, at_their_lines, cycles_of

LINES = 20


def frames(number: int) -> list[str]:
    return [f"5B0#0010{number:02X}"]


def replay(at: set[int]) -> Cycles:
    return {us: frames(us // GRID_US) for us in at}


def cycles(lines: dict[int, int]) -> Cycles:
    """Return cycles by the line in which they were sent."""
    return {line * GRID_US: frames(own) for line, own in lines.items()}


def test_cycles_late_one_after_another_have_a_line_each() -> None:
    stamps = (2.1, 3.1, 3.5, 4.05)
    sent = [
        (int(at * GRID_US), frame)
        for own, at in enumerate(stamps, 1)
        for frame in frames(own)
    ]
    others = [(GRID_US, "100#00"), (5 * GRID_US, "100#00")]
    found = cycles_of([*others[:1], *sent, others[1], (6 * GRID_US, "5B0#FF")])
    assert [*found] == [GRID_US, 2 * GRID_US, 3 * GRID_US, 4 * GRID_US]
    assert [*found.values()] == [frames(own) for own in range(1, 5)]


@pytest.mark.parametrize(
    ("sent", "same"),
    [
        ({own: own for own in range(1, LINES)}, True),
        ({1: 1, 2: 2, 4: 3, 5: 5}, True),  # 3 late, 4 left out
        ({1: 1, 2: 2, 3: 2, 4: 4}, False),  # 3 says what 2 said
        ({own + 1: own for own in range(1, LINES)}, False),  # always late
    ],
)
def test_only_a_cycle_held_up_is_that_of_the_line_before(
    sent: dict[int, int], *, same: bool
) -> None:
    live, replayed = at_their_lines(
        cycles(sent), GRID_US, (LINES + 1) * GRID_US, replay
    )
    assert len(live) == len(sent)
    assert (live == replayed) == same

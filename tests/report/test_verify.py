"""What is said of verdicts, in a line."""

from __future__ import annotations

import numpy as np

from bstm_daemon.analysis.matching.verification import (
    NodeErrors,
    Verdict,
    compared,
)
from bstm_daemon.report.shell import Cell, Page
from bstm_daemon.report.verify import (
    VERDICTS,
    summary_line,
    verify_page,
)


def of(corner: str, node: str) -> NodeErrors:
    time_s = np.arange(1.0, 100.0)
    return compared(
        ("drive", corner, node, 100.0),
        (time_s, *(np.full(len(time_s), 50.0) for _ in range(3))),
        {},
        None,
    )


def test_the_baseline_is_counted_and_a_missing_one_named() -> None:
    verdicts = [
        Verdict("thesis", "drive", "FL", "fluid, largest", 3.0, 30.0),
        Verdict("baseline", "drive", "FL", "disc, RMS [K]", 9.0, 26.75),
        Verdict("baseline", "drive", "FL", "disc, RMS [K]", 9.0, 8.0),
    ]
    errors = [of("FL", "disc"), of("FL", "fluid"), of("FR", "fluid")]

    line = summary_line(errors, verdicts)

    assert "thesis: 1 of 1 met" in line
    assert "floor: 0 of 0 met" in line
    assert "baseline: 1 of 2 met" in line
    assert "no baseline at FR: its disc is not measured" in line
    assert [row[-2:] for row in VERDICTS.rows(verdicts)] == [
        ("3.0 of 30", "met"),
        ("9.0 of 26.8", "met"),
        ("9.0 of 8", "NOT MET"),
    ]


def test_the_page_has_a_sentence_and_a_tile_for_each_set_of_limits() -> None:
    verdicts = [
        Verdict("thesis", "drive", "FL", "fluid, largest error [K]", 3.0, 30),
        Verdict("floor", "drive", "FL", "fluid, largest error [K]", 3.0, 10),
        Verdict("goal", "drive", "FL", "fluid, largest error [K]", 3.0, 2),
        Verdict("goal", "drive", "FL", "fluid, RMS [K]", 1.0, 2.5),
    ]

    def page(required: str) -> Page:
        return verify_page([of("FL", "fluid")], verdicts, required, "")

    thesis, goal = page("thesis"), page("goal")

    assert [text for text, _ in thesis.tiles[:3]] == [
        *("met", "met", "1 of 2 missed")
    ]
    assert thesis.lead == Cell(
        "On 1 drive the estimate of the fluid was at most 0.0 K off (drive, "
        "FL); the thesis limits are met, those of goal are not.",
        tone="good",
    )
    assert isinstance(goal.lead, Cell)
    assert goal.lead.tone == "bad"
    assert goal.lead.text.endswith("not met: fluid, largest error [K].")
    # the curves first, then each requirement that is missed, folded
    assert goal.sections[0].plots
    missed = goal.sections[1]
    assert missed.folded
    assert missed.table is not None
    (row,) = missed.table.rows
    assert row[-1] == "the farthest that the estimate ever was from the sensor"

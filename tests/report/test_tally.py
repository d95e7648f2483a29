"""Figures that are made as rows come are those of the whole."""

from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.heat.sample_plan import FLAGS
from bstm_daemon.report.summary import DriveSummary
from bstm_daemon.report.tally import DriveTally, summarize
from bstm_daemon.report.traces import POINTS_A_TRACE, DriveCurves
from bstm_daemon.results import Results


def _pieces(results: Results, rows: int) -> list[Results]:
    return [
        Results(
            {
                name: column[first : first + rows]
                for name, column in results.columns.items()
            },
            results.corners,
            results.modelled,
        )
        for first in range(0, len(results), rows)
    ]


def _without_energies(summary: DriveSummary) -> DriveSummary:
    return replace(
        summary,
        standing_s=None,
        corners=tuple(
            replace(c, energy_j=None, energy_ff_j=None, energy_fb_j=None)
            for c in summary.corners
        ),
    )


@pytest.mark.parametrize("rows", [7, 999, 1024, 51_001])
def test_pieces_add_up(descent: Results, rows: int) -> None:
    """Sums to the rounding of another order, the rest to the bit."""
    tally = DriveTally()
    for piece in _pieces(descent, rows):
        tally.write(piece)

    whole, found = summarize(descent), tally.summary()

    assert tally.rows == len(descent)
    assert _without_energies(found) == _without_energies(whole)
    assert found.standing_s == pytest.approx(whole.standing_s)
    for ours, theirs in zip(found.corners, whole.corners, strict=True):
        assert ours.energy_j == pytest.approx(theirs.energy_j)
        assert ours.energy_fb_j == pytest.approx(theirs.energy_fb_j)


def test_equal_stretches_give_equal_bits(descent: Results) -> None:
    """A replay hands on the stretches into which a table is cut."""
    tally, curves, drawn = DriveTally(), DriveCurves(), DriveCurves()
    for stretch in descent.stretches():
        tally.write(stretch)
        curves.write(stretch)
    drawn.write(descent)

    assert tally.summary() == summarize(descent)
    assert curves.traces() == drawn.traces()
    assert curves.spans("FL") == drawn.spans("FL")


def test_doubtful_inputs_are_held_in_few_buckets(descent: Results) -> None:
    """In any pieces the same; a row in a day of rows is found again."""
    flags = np.zeros(len(descent))
    flags[20_000] = FLAGS["pressure_suspect"]
    flags[20_001] = FLAGS["pressure_missing"]
    with_flags = replace(descent, columns={**descent.columns, "flags": flags})
    whole, pieces, long = DriveCurves(), DriveCurves(), DriveCurves()
    whole.write(with_flags)
    for piece in _pieces(with_flags, 777):
        pieces.write(piece)
    for day in range(10):
        quiet = {"time_s": 5400.0 * day + descent.columns["time_s"]}
        quiet["flags"] = flags if day == 3 else 0.0 * flags
        long.write(Results(quiet, (), ()))

    assert whole.input_spans("speed") == []
    assert whole.input_spans("pressure") == pieces.input_spans("pressure")
    assert [code for code, _, _ in whole.input_spans("pressure")] == [1, 2]
    (span,) = long.input_spans("pressure")
    assert span[0] == 2
    assert span[1] <= 3 * 5400.0 + 2000.0 < span[2]


def test_curves_of_any_pieces_keep_every_peak(descent: Results) -> None:
    """However they come, the extremes are drawn."""
    curves, drawn = DriveCurves(), DriveCurves()
    drawn.write(descent)
    for piece in _pieces(descent, 777):
        curves.write(piece)

    for ours, theirs in zip(curves.traces(), drawn.traces(), strict=True):
        ys = [
            [y for y in trace.y if y is not None] for trace in (ours, theirs)
        ]
        assert len(ours.x) <= POINTS_A_TRACE
        assert (max(ys[0]), min(ys[0])) == (max(ys[1]), min(ys[1]))
        assert (ours.x[0], ours.x[-1]) == (theirs.x[0], theirs.x[-1])
    assert curves.spans("FL") == drawn.spans("FL")

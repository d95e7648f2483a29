"""A drive in few numbers; those made as rows come are those of the whole."""

from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.channels import FLAGS
from bstm_daemon.replay.results import Results
from bstm_daemon.report.drive_curves import POINTS_A_TRACE, DriveCurves
from bstm_daemon.report.drive_statistics import (
    DriveStatistics,
    DriveSummary,
    summary_table,
)
from bstm_daemon.report.findings import Stretches

SPEED, PRESSURE = FLAGS["speed_missing"], FLAGS["pressure_missing"]


def summarize(results: Results) -> DriveSummary:
    statistics = DriveStatistics()
    statistics.write(results)
    return statistics.summary()


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
        corners=tuple(replace(c, energies_j=()) for c in summary.corners),
    )


@pytest.mark.parametrize("rows", [211, 999, 1024, 51_001])
def test_pieces_add_up(descent: Results, rows: int) -> None:
    """Sums to the rounding of another order, the rest to the bit."""
    statistics = DriveStatistics()
    for piece in _pieces(descent, rows):
        statistics.write(piece)

    whole, found = summarize(descent), statistics.summary()

    assert statistics.rows == len(descent)
    assert _without_energies(found) == _without_energies(whole)
    assert found.standing_s == pytest.approx(whole.standing_s)
    for ours, theirs in zip(found.corners, whole.corners, strict=True):
        assert ours.energies_j == pytest.approx(theirs.energies_j)


@pytest.mark.slow
def test_equal_stretches_give_equal_bits(descent: Results) -> None:
    """A replay hands on the stretches into which a table is cut."""
    statistics, curves, drawn = DriveStatistics(), DriveCurves(), DriveCurves()
    for stretch in descent.stretches():
        statistics.write(stretch)
        curves.write(stretch)
    drawn.write(descent)

    assert statistics.summary() == summarize(descent)
    assert curves.traces() == drawn.traces()
    assert curves.spans("FL") == drawn.spans("FL")


@pytest.mark.slow
def test_doubtful_inputs_are_held_in_few_buckets(descent: Results) -> None:
    """In any pieces the same; a row in a day of rows is found again."""
    flags = np.zeros(len(descent))
    flags[10_000] = FLAGS["pressure_suspect"]
    flags[10_001] = FLAGS["pressure_missing"]
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
    assert [code for code, _, _ in whole.input_spans("pressure")] == [2, 3]
    (span,) = long.input_spans("pressure")
    assert span[0] == 3
    assert span[1] <= 3 * 5400.0 + 1000.0 < span[2]


@pytest.mark.slow
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


def test_descent_in_figures(descent: Results) -> None:
    summary = summarize(descent)
    left = summary.corners[0]
    fluid_c = descent.columns["FL.fluid_c"]

    assert [c.corner for c in summary.corners] == ["FL", "FR", "RL", "RR"]
    assert summary.start_s == 1.7e9
    assert summary.duration_s == pytest.approx(5100.0)
    assert summary.distance_m == pytest.approx(15_000.0)
    assert summary.top_speed_ms == 10.0
    assert summary.standing_s == pytest.approx(3600.0, abs=0.2)
    assert summary.stops_s == pytest.approx((1500.0,))
    assert left.peaks["disc"].time_s == pytest.approx(1500.0, abs=0.2)
    fluid = left.peaks["fluid"]
    assert fluid.temperature_c == fluid_c.max()
    assert fluid.after_stop_s == pytest.approx(
        np.argmax(fluid_c) / 10 - 1500, abs=0.01
    )
    assert fluid.after_stop_s is not None
    assert 8 * 60 < fluid.after_stop_s < 20 * 60
    assert not fluid.at_end
    assert left.margin_k == pytest.approx(155.0 - fluid_c.max())
    assert left.wet_boiling_point_c == pytest.approx(155.0)


def test_what_nobody_saw_is_not_standing(descent: Results) -> None:
    """Unless the bus sleeps, as that of a parked car does."""
    flags = np.zeros(len(descent))
    flags[20_000:26_000] = SPEED
    flags[30_000:36_000] = SPEED | FLAGS["asleep"]
    columns = descent.columns | {"flags": flags}
    seen = Results(columns, descent.corners, descent.modelled)

    summary = summarize(seen)

    assert summary.standing_s == pytest.approx(3000.0, abs=0.2)


def test_energy_is_the_time_integral_of_the_power(descent: Results) -> None:
    """A row is the mean since the row before, so steps weigh by length."""
    left = summarize(descent).corners[0]
    power_w = descent.columns["FL.brake_power_w"]

    used_j, forward_j, back_j = left.energies_j
    assert used_j == pytest.approx(power_w[1:].sum() * 0.1)
    assert forward_j == used_j
    assert back_j == pytest.approx(0.85 * used_j, rel=0.01)


def test_energy_of_uneven_rows_and_unknown_power() -> None:
    columns = {
        "time_s": np.array([0.0, 1.0, 11.0, 12.0]),
        "FL.brake_power_w": np.array([9.0, 100.0, 2.0, np.nan]),
        "FL.brake_power_fb_w": np.full(4, np.nan),
    }

    corner = summarize(Results(columns, ("FL",), ())).corners[0]

    assert corner.energies_j == (120.0, None, None)


def test_validity_shares_and_the_code_at_the_peak(descent: Results) -> None:
    columns = dict(descent.columns)
    columns["FL.validity"] = np.where(columns["speed_ms"] > 0, 2.0, 1.0)

    left = summarize(Results(columns, ("FL",), ("FL",))).corners[0]

    assert left.peaks["disc"].validity == 1
    assert left.peaks["fluid"].validity == 1
    assert left.validity_shares is not None
    assert left.validity_shares == pytest.approx(
        (0.0, 36_001 / 51_001, 15_000 / 51_001)
    )


def test_a_corner_without_a_model_has_energy_only(descent: Results) -> None:
    rear = summarize(descent).corners[2]

    assert not rear.modelled
    assert rear.peaks == {}
    assert rear.margin_k is None
    assert rear.validity_shares is None
    assert rear.energies_j[0] is not None


def test_a_peak_before_the_only_stop_is_negative() -> None:
    elapsed_s = np.arange(100.0)
    columns = {
        "time_s": elapsed_s,
        "speed_ms": np.where(elapsed_s < 60, 5.0, 0.0),
        "FL.fluid_c": 50 - np.abs(elapsed_s - 40),
    }

    peak = summarize(Results(columns, ("FL",), ("FL",))).corners[0].peaks

    assert peak["fluid"].after_stop_s == -20.0


def test_a_peak_in_the_last_row_is_no_peak_yet() -> None:
    elapsed_s = np.arange(100.0)
    columns = {"time_s": elapsed_s, "FL.fluid_c": elapsed_s}

    peak = summarize(Results(columns, ("FL",), ("FL",))).corners[0].peaks

    assert peak["fluid"].at_end
    assert peak["fluid"].after_stop_s is None


@pytest.mark.parametrize("rows", [0, 1])
def test_results_of_no_length_have_a_summary(rows: int) -> None:
    columns = {
        "time_s": np.arange(rows, dtype=float),
        "speed_ms": np.zeros(rows),
        "FL.disc_c": np.full(rows, 20.0),
        "FL.validity": np.zeros(rows),
        "FL.brake_power_w": np.zeros(rows),
    }

    summary = summarize(Results(columns, ("FL",), ("FL",)))

    assert summary.duration_s == 0.0
    assert summary.stops_s == ()


def results_of(flags: list[int], time_s: np.ndarray | None = None) -> Results:
    """Return ten rows a second with *flags*."""
    times = 5.0 + 0.1 * np.arange(len(flags)) if time_s is None else time_s
    columns = {"time_s": times, "flags": np.array(flags, dtype=float)}
    return Results(columns, (), ())


def input_gaps(results: Results, heat_mode: str) -> dict[str, Stretches]:
    """Return when inputs were missing."""
    statistics = DriveStatistics()
    statistics.write(results)
    return statistics.gaps(heat_mode)


def test_total_and_longest() -> None:
    """Two gaps of speed, of 2 s and 3 s; the late frame does not count."""
    flags = [0] * 10 + [SPEED] * 20 + [0] * 10 + [SPEED] * 30
    flags += [0] * 5 + [SPEED] * 2 + [0] * 5

    gap = input_gaps(results_of(flags), "ff")["speed"]

    assert gap.total_s == pytest.approx(5.0)
    assert gap.longest_s == pytest.approx(3.0)
    assert gap.longest_from_s == pytest.approx(3.9)


def test_only_what_the_heat_mode_needs() -> None:
    """Feed-Back goes without a pressure."""
    results = results_of([PRESSURE] * 40)

    assert list(input_gaps(results, "ff")) == ["pressure"]
    assert input_gaps(results, "fb") == {}


def test_nothing_is_missing_while_the_bus_sleeps() -> None:
    flags = [0] + [SPEED] * 20 + [SPEED | FLAGS["asleep"]] * 100

    gap = input_gaps(results_of(flags), "ff")["speed"]

    assert gap.total_s == pytest.approx(2.0)


def test_a_clock_set_back_is_no_negative_gap() -> None:
    """Only time that passed counts."""
    times = np.array([10.0, 11.0, 12.0, 2.0, 3.0, 4.0])
    flags = [0, SPEED, SPEED, SPEED, SPEED, 0]

    (gap,) = input_gaps(results_of(flags, times), "fb").values()

    assert gap.total_s == pytest.approx(3.0)


def test_table_of_the_descent(descent: Results) -> None:
    lines = summary_table(summarize(descent)).splitlines()
    left = next(line for line in lines if line.startswith("FL "))
    rear = next(line for line in lines if line.startswith("RL "))

    assert lines[0] == ("1 h 25 min, 15.0 km, at most 36 km/h, 1 h standing")
    assert left.split() == [
        "FL",
        "607",
        "0:25:00",
        "524",
        "0:25:00",
        "221",
        "0:25:00",
        "129",
        "0:35:29",
        "10:29",
        "26",
        "K",
        "9.15",
        "9.15",
        "7.77",
    ]
    assert rear.split()[1:7] == ["-"] * 6
    assert "FL FR: 97.8 % valid, 1.6 % degraded, 0.6 % invalid" in lines
    begin = lines.index("not valid because of")
    assert lines[begin + 1 : begin + 4] == [
        "- input suspect for 80 s (1.6 %), from 5:00 on: FL FR",
        "- input missing for 30 s (0.6 %), from 15:00 on: FL FR",
        "- heat unknown for 30 s (0.6 %), from 15:00 on: FL FR",
    ]
    assert "RL RR: no temperatures: not modelled" in lines


def test_table_is_ascii_aligned_and_narrow(descent: Results) -> None:
    text = summary_table(summarize(descent))
    lines = text.splitlines()
    table = [line for line in lines if line[:2] in {"co", "FL", "FR"}]

    assert text.isascii()
    assert max(map(len, lines)) <= 100
    assert len({len(line) for line in table[:3]}) == 1


def test_hot_long_and_doubtful_drive_still_fits() -> None:
    """Ten hours, 1000 degC, a margin below zero, hundreds of MJ."""
    elapsed_s = np.arange(0, 40_000, 10.0)
    columns = {"time_s": elapsed_s, "speed_ms": np.full(4000, 60.0)}
    for corner in ("FL", "FR"):
        for node in ("disc", "pad_front", "pad_back", "fluid"):
            columns[f"{corner}.{node}_c"] = 1000 * np.sin(elapsed_s / 24_000)
        columns[f"{corner}.margin_k"] = 155 - columns[f"{corner}.fluid_c"]
        for kind in ("", "_ff", "_fb"):
            columns[f"{corner}.brake_power{kind}_w"] = np.full(4000, 2e4)
        columns[f"{corner}.validity"] = np.full(4000, 2.0)

    text = summary_table(
        summarize(Results(columns, ("FL", "FR"), ("FL", "FR")))
    )

    assert max(map(len, text.splitlines())) <= 100
    assert "1000!10:28:20" in text
    assert "-845 K" in text
    assert "FL FR: 100 % invalid" in text
    assert "peak marks: ! invalid" in text


def test_a_peak_before_the_first_stop_is_explained() -> None:
    elapsed_s = np.arange(0.0, 600.0)
    columns = {
        "time_s": elapsed_s,
        "speed_ms": np.where(elapsed_s < 400.0, 20.0, 0.0),
        "FL.fluid_c": 90.0 - np.abs(elapsed_s - 300.0) / 10.0,
        "FL.validity": np.zeros(600),
    }

    def results() -> Results:
        return Results(columns, ("FL",), ("FL",))

    note = "after stop, negative: time before the first stop"

    early = summary_table(summarize(results())).splitlines()
    columns["FL.fluid_c"] = 90.0 - np.abs(elapsed_s - 500.0) / 10.0
    late = summary_table(summarize(results())).splitlines()

    assert note in early
    assert "-1:40" in next(line for line in early if line.startswith("FL"))
    assert note not in late


def test_short_drive_that_ends_too_early() -> None:
    elapsed_s = np.arange(90.0)
    columns = {"time_s": elapsed_s, "FL.fluid_c": 20 + elapsed_s}

    text = summary_table(summarize(Results(columns, ("FL",), ("FL",))))

    assert "109" in text
    assert "1:29" in text
    assert "FL: validity not recorded" in text
    assert "FL: fluid still rising at the end of the log" in text


@pytest.mark.parametrize(("rise_k", "rising"), [(0.9, False), (1.1, True)])
def test_what_hardly_rises_is_not_called_rising(
    rise_k: float, *, rising: bool
) -> None:
    elapsed_s = np.arange(90.0)
    columns = {
        "time_s": elapsed_s,
        "FL.fluid_c": 20.0 + rise_k * elapsed_s / elapsed_s[-1],
    }

    summary = summarize(Results(columns, ("FL",), ("FL",)))

    assert summary.corners[0].peaks["fluid"].at_end is rising
    assert ("still rising" in summary_table(summary)) is rising

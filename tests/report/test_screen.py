"""The table on screen."""

import numpy as np

from bstm_daemon.replay.results import Results
from bstm_daemon.report.drive_statistics import DriveStatistics, DriveSummary
from bstm_daemon.report.screen import summary_table


def summarize(results: Results) -> DriveSummary:
    statistics = DriveStatistics()
    statistics.write(results)
    return statistics.summary()


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

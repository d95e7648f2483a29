"""The curves of the plots."""

from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.estimate import REASON_WORDS
from bstm_daemon.replay.results import Results
from bstm_daemon.report.drive_curves import POINTS_A_TRACE, DriveCurves, Trace
from bstm_daemon.report.drive_statistics import DriveStatistics
from bstm_daemon.report.replay_figure import drive_plots

_THINNED: dict[int, tuple[Results, list[Trace]]] = {}
"""Traces by the identity of the results, which are kept with them."""


def _traces(results: Results) -> list[Trace]:
    if id(results) not in _THINNED:
        curves = DriveCurves()
        curves.write(results)
        _THINNED[id(results)] = results, curves.traces()
    return _THINNED[id(results)][1]


def _find(
    traces: list[Trace], panel: str, corner: str | None, label: str
) -> Trace:
    (found,) = [
        trace
        for trace in traces
        if (trace.panel, trace.corner, trace.label) == (panel, corner, label)
    ]
    return found


def _known(trace: Trace) -> list[float]:
    return [value for value in trace.y if value is not None]


@pytest.mark.slow
def test_units_are_those_of_the_panels(descent: Results) -> None:
    traces = _traces(descent)
    power = _find(traces, "power", "FL", "Feed-Forward")
    pressure_pa = descent.columns["FL.pressure_pa"]

    assert max(_known(_find(traces, "speed", None, "speed"))) == 36.0
    assert max(_known(power)) == pytest.approx(
        descent.columns["FL.brake_power_ff_w"].max() / 1e3, abs=0.005
    )
    assert max(_known(_find(traces, "pressure", None, "FL"))) == (
        pytest.approx(pressure_pa.max() / 1e5, abs=0.005)
    )


def test_corners_of_one_circuit_share_a_pressure_curve(
    descent: Results,
) -> None:
    labels = [t.label for t in _traces(descent) if t.panel == "pressure"]

    assert labels == ["FL", "FR", "RL RR"]


def test_measured_lies_over_estimated_in_the_same_colour(
    descent: Results,
) -> None:
    traces = _traces(descent)
    names = [t.label for t in traces if t.corner == "FL"]

    for node in ("disc", "pad front", "pad back", "fluid"):
        estimate = _find(traces, "temperature", "FL", node)
        measured = _find(traces, "temperature", "FL", f"{node}, sensor")
        assert names.index(node) < names.index(f"{node}, sensor")
        assert measured.look["line"]["color"] == estimate.look["line"]["color"]
        assert "dash" in measured.look["line"]
        # one sample in ten rows is joined, not broken
        assert None not in measured.y
    colours = {
        _find(traces, "temperature", "FL", node).look["line"]["color"]
        for node in ("disc", "pad front", "pad back", "fluid")
    }
    assert len(colours) == 4


def test_curves_are_thin_and_keep_the_peak(descent: Results) -> None:
    columns = dict(descent.columns)
    columns["FL.disc_c"] = columns["FL.disc_c"].copy()
    columns["FL.disc_c"][31_415] = 999.0
    traces = _traces(Results(columns, ("FL",), ("FL",)))
    disc = _find(traces, "temperature", "FL", "disc")

    assert all(len(trace.x) <= POINTS_A_TRACE for trace in traces)
    assert all(len(trace.x) == len(trace.y) for trace in traces)
    assert disc.x[disc.y.index(999.0)] == 3141.5
    assert disc.x[0] == 0.0
    assert disc.x[-1] == 5100.0


def test_boiling_point_is_a_line_of_two_points(descent: Results) -> None:
    line = _find(_traces(descent), "fluid", "FL", "wet boiling point 155 °C")

    assert line.x == [0.0, 5100.0]
    assert line.y == [155.0, 155.0]


def test_boiling_point_that_ages_is_a_curve(descent: Results) -> None:
    columns = dict(descent.columns)
    columns["FL.margin_k"] = columns["FL.margin_k"] - np.linspace(
        0, 10, len(columns["time_s"])
    )

    line = _find(
        _traces(Results(columns, ("FL",), ("FL",))),
        "fluid",
        "FL",
        "wet boiling point",
    )

    assert line.y[0] == 155.0
    assert line.y[-1] == 145.0


def test_gaps_stay_and_columns_without_numbers_go() -> None:
    columns = {
        "time_s": np.arange(6.0),
        "FL.disc_c": np.array([20.0, 21.0, np.nan, np.nan, 24.0, 25.0]),
        "FL.pad_back_c": np.full(6, np.nan),
    }

    (disc,) = _traces(Results(columns, ("FL",), ("FL",)))

    assert disc.y == [20.0, 21.0, None, None, 24.0, 25.0]


def advised(descent: Results) -> Results:
    """Return *descent* with a shift while it brakes and a wait behind it."""
    elapsed_s = descent.columns["time_s"] - descent.columns["time_s"][0]
    none = np.zeros(len(elapsed_s))
    waits = (elapsed_s >= 1560.0) & (elapsed_s < 3000.0)
    columns = {
        **descent.columns,
        "advice_message": waits.astype(float),
        "advice_waiting_s": np.where(waits, 3000.0 - elapsed_s, np.nan),
        "advice_shift": ((elapsed_s > 60.0) & (elapsed_s < 1500.0)) * 1.0,
        "advice_gearbox": none,
        "advice_pedal_feel": np.where(elapsed_s > 2000.0, 0.9, 1.0),
        "advice_isolation": none,
        "advice_assist": none,
        "advice_intervention": none,
    }
    return Results(columns, descent.corners, descent.modelled)


@pytest.mark.slow
def test_bars_lie_where_it_was_advised(descent: Results) -> None:
    curves = DriveCurves()
    curves.write(advised(descent))
    bars = [t for t in curves.traces() if t.panel == "advice"]

    assert [bar.label for bar in bars] == [
        "wait before departure",
        "driver: lower gear",
        "softer pedal",
    ]
    # the first one lies on top
    assert [bar.y[0] for bar in bars] == [3.0, 2.0, 1.0]
    assert bars[0].x[:2] == pytest.approx([1560.0, 3000.0], abs=0.2)
    assert bars[1].x[:2] == pytest.approx([60.0, 1500.0], abs=0.2)
    assert all(bar.y[2] is None for bar in bars)


@pytest.mark.slow
def test_panel_stands_under_the_pressure(descent: Results) -> None:
    rows = advised(descent)
    curves, statistics = DriveCurves(), DriveStatistics()
    curves.write(rows)
    statistics.write(rows)
    plots = drive_plots(curves, statistics.summary())
    titles = [title for title, _ in plots]

    place = titles.index("advice and requests")
    assert titles[place - 1] == "brake pressure [bar]"
    names = [one["name"] for one in plots[place][1].data]
    assert "wait before departure" in names


def test_sensors_are_called_what_they_are(descent: Results) -> None:
    """Those of a simulated car measured nothing, and a log does not say."""
    curves = DriveCurves()
    curves.write(descent)
    labels = {trace.label for trace in curves.traces()}

    assert "disc, sensor" in labels
    assert not any("measured" in label for label in labels)


@pytest.mark.slow
def test_no_advice_takes_no_room(descent: Results) -> None:
    quiet = advised(descent)
    for name in ("advice_message", "advice_shift"):
        quiet.columns[name][:] = 0.0
    quiet.columns["advice_pedal_feel"][:] = np.nan
    for rows in (descent, quiet):
        curves = DriveCurves()
        curves.write(rows)
        assert not [t for t in curves.traces() if t.panel == "advice"]


@pytest.mark.slow
def test_every_reason_has_a_bar_of_its_own(descent: Results) -> None:
    bits = np.full(len(descent.columns["time_s"]), float(sum(REASON_WORDS)))
    columns = {**descent.columns, "FL.reasons": bits}
    curves = DriveCurves()

    curves.write(replace(descent, columns=columns))

    bars = [
        one
        for one in curves.traces()
        if (one.panel, one.corner) == ("reasons", "FL")
    ]
    assert [one.label for one in bars] == list(REASON_WORDS.values())
    colours = {one.look["line"]["color"] for one in bars}
    assert len(colours) == len(bars)

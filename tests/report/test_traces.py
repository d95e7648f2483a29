"""The curves of the plots."""

import numpy as np
import pytest

from bstm_daemon.report.traces import POINTS_A_TRACE, DriveCurves, Trace
from bstm_daemon.results import Results


def _traces(results: Results) -> list[Trace]:
    curves = DriveCurves()
    curves.write(results)
    return curves.traces()


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
        measured = _find(traces, "temperature", "FL", f"{node}, measured")
        assert names.index(node) < names.index(f"{node}, measured")
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

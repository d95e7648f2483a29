"""Advice on the time line of the report."""

import numpy as np
import pytest

from bstm_daemon.report.figure import replay_figure
from bstm_daemon.report.layout import stamp, y_axis
from bstm_daemon.report.tally import DriveTally
from bstm_daemon.report.traces import DriveCurves
from bstm_daemon.results import Results


def told(descent: Results) -> Results:
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


def test_bars_lie_where_it_was_told(descent: Results) -> None:
    curves = DriveCurves()
    curves.write(told(descent))
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


def test_panel_stands_under_the_pressure(descent: Results) -> None:
    rows = told(descent)
    curves, tally = DriveCurves(), DriveTally()
    curves.write(rows)
    tally.write(rows)
    figure = replay_figure(curves, tally.summary())
    layout = figure.views[0].layout
    domains = {
        panel: layout[y_axis(panel, 0).replace("y", "yaxis")]["domain"]
        for panel in ("pressure", "advice")
    }

    assert domains["advice"][1] < domains["pressure"][0]
    named = [figure.traces[i]["name"] for i in figure.views[0].named]
    assert "wait before departure" in named
    axis = layout["xaxis"]
    assert axis["anchor"] == y_axis("advice", 0)
    assert axis["range"][0] == stamp(0.0)


def test_nothing_told_takes_no_room(descent: Results) -> None:
    quiet = told(descent)
    for name in ("advice_message", "advice_shift"):
        quiet.columns[name][:] = 0.0
    quiet.columns["advice_pedal_feel"][:] = np.nan
    for rows in (descent, quiet):
        curves = DriveCurves()
        curves.write(rows)
        assert not [t for t in curves.traces() if t.panel == "advice"]

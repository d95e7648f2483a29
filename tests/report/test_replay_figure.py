"""Panels of a drive: which curves, in which view, with which shades."""

import numpy as np
import pytest

from bstm_daemon.channels import FLAGS, WHEEL_SUSPECT
from bstm_daemon.replay.results import Results
from bstm_daemon.report.drive_curves import DriveCurves
from bstm_daemon.report.drive_statistics import DriveStatistics
from bstm_daemon.report.plots import Plot
from bstm_daemon.report.replay_figure import (
    INPUT_COLOURS,
    MISSING,
    OVERVIEW,
    PARKED,
    SUSPECT,
    drive_plots,
)

_DRAWN: dict[int, tuple[Results, list[tuple[str, Plot]]]] = {}
"""Plots by the identity of the results, which are kept with them."""


def _plots(results: Results) -> list[tuple[str, Plot]]:
    if id(results) not in _DRAWN:
        curves, statistics = DriveCurves(), DriveStatistics()
        curves.write(results)
        statistics.write(results)
        plots = drive_plots(curves, statistics.summary())
        _DRAWN[id(results)] = results, plots
    return _DRAWN[id(results)][1]


def _plot(results: Results, title: str) -> Plot:
    (found,) = [plot for name, plot in _plots(results) if name == title]
    return found


@pytest.mark.slow
def test_the_vehicle_stands_above_all_corners_and_each_one(
    descent: Results,
) -> None:
    """The margin first, in every view."""
    plots = _plots(descent)
    views = [plot.view for _, plot in plots]

    assert list(dict.fromkeys(views)) == [
        *("", OVERVIEW, "FL", "FR", "RL", "RR")
    ]
    assert [name for name, plot in plots if not plot.view] == [
        *("speed [km/h]", "brake pressure [bar]")
    ]
    for view in (OVERVIEW, "FL", "FR"):
        first = next(name for name, plot in plots if plot.view == view)
        assert first.endswith("margin of the fluid to wet boiling [K]")


def test_all_time_axes_are_alike_and_move_together(descent: Results) -> None:
    """So a stop can be followed down from the speed."""
    plots = [plot for _, plot in _plots(descent)]

    assert all(plot.linked and plot.clock for plot in plots)
    assert len({str(plot.layout["xaxis"]) for plot in plots}) == 1
    assert len({str(plot.layout["margin"]) for plot in plots}) == 1
    assert not plots[0].layout["margin"]["autoexpand"]


def test_corners_stand_in_one_panel(descent: Results) -> None:
    drawn = _plot(descent, "disc temperature [°C]")
    looks = [(one["name"], one["line"]["dash"]) for one in drawn.data]

    # the right side is dashed: it often covers the left one
    assert looks == [("FL", "solid"), ("FR", "6px,4px")]
    assert max(y for y in drawn.data[0]["y"] if y) == pytest.approx(
        descent.columns["FL.disc_c"].max(), abs=0.05
    )


def test_shades_mark_what_is_not_valid(descent: Results) -> None:
    for panel in ("temperature [°C]", "brake fluid temperature [°C]"):
        shapes = _plot(descent, f"FL: {panel}").layout["shapes"]

        # a degraded and an invalid stretch
        assert [shape["x0"] for shape in shapes] == [
            "2000-01-01 00:05:00.100",
            "2000-01-01 00:15:00.100",
        ]
        assert len({shape["fillcolor"] for shape in shapes}) == 2


def _shaded(results: Results, title: str) -> list[tuple[str, str, str]]:
    return [
        (shape["x0"][11:16], shape["x1"][11:16], shape["fillcolor"])
        for shape in _plot(results, title).layout["shapes"]
    ]


@pytest.mark.slow
def test_shades_mark_doubtful_inputs(descent: Results) -> None:
    """Each behind its own panel; power of every corner."""
    flags = np.zeros(len(descent))
    flags[1000:2000] = FLAGS["speed_suspect"]
    flags[3000:4000] = FLAGS["pressure_missing"] | FLAGS["heat_substituted"]
    flags[5000:6000] = WHEEL_SUSPECT << 1
    flags[7000:8000] = FLAGS["heat_unknown"] | FLAGS["torque_suspect"]
    columns = {**descent.columns, "flags": flags}
    results = Results(columns, descent.corners, descent.modelled)

    suspect, missing = INPUT_COLOURS[SUSPECT], INPUT_COLOURS[MISSING]
    assert _shaded(results, "speed [km/h]") == [
        ("00:01", "00:03", suspect),
        ("00:08", "00:10", suspect),
    ]
    assert _shaded(results, "brake pressure [bar]") == [
        ("00:05", "00:06", missing)
    ]
    power = [("00:05", "00:06", suspect), ("00:11", "00:13", missing)]
    for corner in ("FL: ", "FR: ", ""):
        assert _shaded(results, f"{corner}brake power [kW]") == power


@pytest.mark.slow
def test_a_parked_car_whose_bus_sleeps_lacks_nothing(
    descent: Results,
) -> None:
    """Where the bus does not sleep, the speed is missing."""
    flags = np.zeros(len(descent), np.int64)
    flags[18_000:24_000] = FLAGS["speed_missing"]
    flags[18_000:21_000] |= FLAGS["asleep"]
    columns = {**descent.columns, "flags": flags.astype(float)}
    results = Results(columns, descent.corners, descent.modelled)

    assert _shaded(results, "speed [km/h]") == [
        ("00:30", "00:35", INPUT_COLOURS[PARKED]),
        ("00:35", "00:40", INPUT_COLOURS[MISSING]),
    ]


def test_a_bar_a_reason(descent: Results) -> None:
    """In the words of the summary, where the estimate is shaded."""
    bars = _plot(descent, "FL: not valid because of").data

    assert [bar["name"] for bar in bars] == [
        *("input missing", "input suspect", "heat unknown")
    ]
    missing, suspect, _ = (bar["x"] for bar in bars)
    assert missing[:2] == pytest.approx([900.1, 930.0], abs=0.2)
    assert suspect[:2] == pytest.approx([300.1, 380.0], abs=0.2)


def test_the_fluid_peak_is_labelled(descent: Results) -> None:
    drawn = _plot(descent, "FL: brake fluid temperature [°C]")

    (note,) = drawn.layout["annotations"]
    assert note["text"] == "129 °C<br>10:29 after the stop"
    assert note["x"] == "2000-01-01 00:35:29.300"


def test_a_corner_without_a_model_has_power_alone(descent: Results) -> None:
    titles = [name for name, _ in _plots(descent)]

    assert [one for one in titles if one.startswith("RL")] == [
        "RL: brake power [kW]"
    ]


def test_names_are_text_in_plotly_too() -> None:
    """Plotly reads tags in names: escaped, they are shown as they are."""
    corner = '<a href="javascript:x">'
    columns = {
        "time_s": np.arange(3.0),
        f"{corner}.disc_c": np.arange(3.0),
        "FL.disc_c": np.arange(3.0),
        f"{corner}.pressure_pa": np.arange(3.0),
    }

    plots = _plots(Results(columns, (corner, "FL"), (corner, "FL")))

    drawn = str([(plot.data, plot.layout) for _, plot in plots])
    assert "<a" not in drawn
    assert "&lt;a" in drawn


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_results_of_no_length_have_plots(rows: int) -> None:
    columns = {
        "time_s": np.arange(rows, dtype=float),
        "speed_ms": np.zeros(rows),
        "FL.fluid_c": np.full(rows, 20.0),
        "FL.margin_k": np.full(rows, 135.0),
        "FL.validity": np.full(rows, 2.0),
    }

    plots = _plots(Results(columns, ("FL",), ("FL",)))

    assert bool(plots) == bool(rows)
    assert OVERVIEW not in {plot.view for _, plot in plots}

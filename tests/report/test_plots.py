"""Panels: curves, clouds, axes."""

import numpy as np

from bstm_daemon.report.plots import (
    CLOUD_POINTS,
    CURVE_POINTS,
    cloud,
    curve,
    numbers,
    right_axis,
    time_plot,
    wide_range,
)


def test_curve_is_thinned_and_keeps_its_peak() -> None:
    x = np.arange(50_000.0)
    y = np.zeros(50_000)
    y[12_345] = 7.0

    drawn = curve(x, y, "peak", "#000000")

    assert len(drawn["x"]) <= CURVE_POINTS
    assert max(drawn["y"]) == 7.0


def test_cloud_leaves_out_what_is_no_number() -> None:
    x = np.arange(10_000.0)
    y = np.where(x < 5000, np.nan, x)

    drawn = cloud(x, y, "", "#000000")

    assert len(drawn["x"]) <= CLOUD_POINTS
    assert min(drawn["x"]) == 5000.0
    assert not drawn["showlegend"]


def test_shaded_cloud_has_a_colour_a_point() -> None:
    x = np.arange(5.0)
    drawn = cloud(x, x, "", shade=10 * x, shade_title="bar")

    assert drawn["marker"]["color"] == [0.0, 10.0, 20.0, 30.0, 40.0]


def test_numbers_are_none_where_there_is_none() -> None:
    values = np.array([1.0, np.nan, np.inf, 1.234567])

    assert numbers(values) == [1.0, None, None, 1.2346]


def test_axis_of_noise_is_wide() -> None:
    noise = np.array([0.999, 1.0, 1.001])

    assert wide_range(noise, 0.15) == [0.85, 1.15]
    assert wide_range(np.array([np.nan]), 0.15) is None
    low, high = wide_range(np.array([0.2, 1.0, 3.0]), 0.15) or [0.0, 0.0]
    assert low < 0.25
    assert high > 2.9


def test_layout_changes_are_merged() -> None:
    drawn = time_plot([], "kW", (10.0, 70.0), yaxis2=right_axis("km/h"))

    assert drawn.clock
    assert drawn.layout["yaxis"]["title"]["text"] == "kW"
    assert drawn.layout["yaxis2"]["side"] == "right"
    assert drawn.layout["xaxis"]["range"][0].endswith("00:00:10.000")


def test_figures_of_a_time_axis_are_those_of_its_title() -> None:
    """Two figures of [h:min] on a long drive, seconds only zoomed in."""
    minutes = 60_000
    layout = time_plot([], "kW", (0.0, 7200.0)).layout["xaxis"]

    assert layout["title"]["text"] == "time [h:min]"
    assert "tickformat" not in layout
    coarse = layout["tickformatstops"][-1]
    assert coarse == {"dtickrange": [minutes, None], "value": "%-H:%M"}
    assert layout["tickformatstops"][1]["value"] == "%-H:%M:%S"

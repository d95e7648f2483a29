"""Views: which curves, on which axes."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from bstm_daemon.channels import FLAGS, WHEEL_SUSPECT
from bstm_daemon.replay.results import Results
from bstm_daemon.report.drive_curves import DriveCurves
from bstm_daemon.report.drive_statistics import DriveStatistics
from bstm_daemon.report.replay_figure import (
    INPUT_COLOURS,
    Figure,
    replay_figure,
    view_corners,
)


def _figure(results: Results) -> Figure:
    curves, statistics = DriveCurves(), DriveStatistics()
    curves.write(results)
    statistics.write(results)
    return replay_figure(curves, statistics.summary())


def _axes(layout: dict[str, Any], letter: str) -> dict[str, Any]:
    return {
        key.replace("axis", ""): value
        for key, value in layout.items()
        if key.startswith(f"{letter}axis")
    }


def test_axles_come_first_then_corners() -> None:
    names = [name for name, _ in view_corners(("RL", "FL", "FR", "RR"))]

    assert names == ["Front axle", "Rear axle", "FL", "FR", "RL", "RR"]
    assert view_corners(("FL", "RL")) == [("FL", ("FL",)), ("RL", ("RL",))]
    assert view_corners(()) == [("Vehicle", ())]


def test_every_view_has_an_axis_for_each_of_its_curves(
    descent: Results,
) -> None:
    """Declared axes are the used ones: plotly draws others askew."""
    figure = _figure(descent)

    for view in figure.views:
        traces = [figure.traces[i] for i in view.traces]
        assert {t["xaxis"] for t in traces} == set(_axes(view.layout, "x"))
        assert {t["yaxis"] for t in traces} == set(_axes(view.layout, "y"))
        assert {figure.traces[i]["legend"] for i in view.named} <= set(
            view.layout
        )


def test_all_time_axes_of_a_view_move_together(descent: Results) -> None:
    for view in _figure(descent).views:
        first, *others = _axes(view.layout, "x").items()
        assert first[0] == "x"
        assert all(axis["matches"] == "x" for _, axis in others)


def test_left_and_right_share_their_scale(descent: Results) -> None:
    layout = _figure(descent).views[0].layout
    left, right = layout["yaxis5"], layout["yaxis10"]

    assert right["matches"] == "y5"
    assert left["range"] == right["range"]
    assert left["range"][1] > descent.columns["FL.disc_measured_c"][::10].max()
    assert layout["xaxis2"]["domain"][1] < layout["xaxis3"]["domain"][0]


def test_panels_do_not_overlap_and_run_downwards(descent: Results) -> None:
    for view in _figure(descent).views:
        domains = sorted(
            {
                tuple(axis["domain"])
                for axis in _axes(view.layout, "y").values()
            }
        )
        for lower, upper in pairwise(domains):
            assert lower[1] < upper[0]
        speed = view.layout["yaxis"]["domain"]
        assert speed == domains[-1]


def test_a_legend_line_stands_for_both_sides(descent: Results) -> None:
    figure = _figure(descent)
    front = figure.views[0]
    names = [figure.traces[i]["legendgroup"] for i in front.named]

    assert len(names) == len(set(names))
    assert {figure.traces[i]["legendgroup"] for i in front.traces} == {
        *names,
        "speed speed",
    }


def test_shades_mark_what_is_not_valid(descent: Results) -> None:
    shapes = _figure(descent).views[0].layout["shapes"]
    left = [shape for shape in shapes if shape["xref"] == "x2"]

    # a degraded and an invalid stretch, each in two panels
    assert len(left) == 4
    assert {shape["x0"] for shape in left} == {
        "2000-01-01 00:05:00.100",
        "2000-01-01 00:15:00.100",
    }
    assert len({shape["fillcolor"] for shape in left}) == 2


def test_shades_mark_doubtful_inputs(descent: Results) -> None:
    """Each behind its own panel; power on both sides."""
    flags = np.zeros(len(descent))
    flags[1000:2000] = FLAGS["speed_suspect"]
    flags[3000:4000] = FLAGS["pressure_missing"] | FLAGS["heat_substituted"]
    flags[5000:6000] = WHEEL_SUSPECT << 1
    flags[7000:8000] = FLAGS["heat_unknown"] | FLAGS["torque_suspect"]
    columns = {**descent.columns, "flags": flags}
    results = Results(columns, descent.corners, descent.modelled)

    layout = _figure(results).views[0].layout

    def shaded(panel: str, axis: str) -> list[tuple[str, str, str]]:
        _, top = layout[panel]["domain"]
        return [
            (shape["x0"][11:16], shape["x1"][11:16], shape["fillcolor"])
            for shape in layout["shapes"]
            if (shape["xref"], shape["y1"]) == (axis, top)
        ]

    suspect, missing = INPUT_COLOURS[1], INPUT_COLOURS[2]
    assert shaded("yaxis", "x") == [
        ("00:01", "00:03", suspect),
        ("00:08", "00:10", suspect),
    ]
    assert shaded("yaxis2", "x") == [("00:05", "00:06", missing)]
    power = [("00:05", "00:06", suspect), ("00:11", "00:13", missing)]
    assert shaded("yaxis4", "x2") == shaded("yaxis9", "x3") == power


def test_a_bar_a_reason_below_the_fluid(descent: Results) -> None:
    """In the words of the summary, where the estimate is shaded."""
    curves = DriveCurves()
    curves.write(descent)
    traces = [
        (trace.corner, trace.label, trace.x)
        for trace in curves.traces()
        if trace.panel == "reasons"
    ]

    assert [trace[:2] for trace in traces] == [
        (corner, words)
        for corner in ("FL", "FR")
        for words in ("input missing", "input suspect", "heat unknown")
    ]
    missing, suspect, _ = (trace[2] for trace in traces[:3])
    assert missing[:2] == pytest.approx([900.1, 930.0], abs=0.2)
    assert suspect[:2] == pytest.approx([300.1, 380.0], abs=0.2)


def test_the_fluid_peak_is_labelled(descent: Results) -> None:
    notes = _figure(descent).views[0].layout["annotations"]

    (left,) = [note for note in notes if note.get("yref") == "y6"]
    assert left["text"] == "129 °C<br>10:29 after the stop"
    assert left["x"] == "2000-01-01 00:35:29.300"


def test_a_corner_without_a_model_says_so(descent: Results) -> None:
    results = Results(descent.columns, descent.corners, ("FL",))
    columns = {
        key: column
        for key, column in results.columns.items()
        if not key.startswith("FR.") or "power" in key
    }
    figure = _figure(Results(columns, ("FL", "FR"), ("FL",)))
    texts = [n["text"] for n in figure.views[0].layout["annotations"]]

    assert "<b>FR</b>  temperature [°C]: none, corner not modelled" in texts
    assert "yaxis10" not in figure.views[0].layout


def test_names_are_text_in_plotly_too() -> None:
    """Plotly reads tags in names: escaped, they are shown as they are."""
    corner = '<a href="javascript:x">'
    columns = {
        "time_s": np.arange(3.0),
        f"{corner}.disc_c": np.arange(3.0),
        f"{corner}.pressure_pa": np.arange(3.0),
    }

    figure = _figure(Results(columns, (corner,), (corner,)))

    drawn = [figure.traces, *(view.layout for view in figure.views)]
    assert "<a" not in str(drawn)
    assert "&lt;a" in str(figure.views[0].layout["annotations"])
    assert "&lt;a" in str(figure.traces)


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_results_of_no_length_have_a_figure(rows: int) -> None:
    columns = {
        "time_s": np.arange(rows, dtype=float),
        "speed_ms": np.zeros(rows),
        "FL.fluid_c": np.full(rows, 20.0),
        "FL.margin_k": np.full(rows, 135.0),
        "FL.validity": np.full(rows, 2.0),
    }

    figure = _figure(Results(columns, ("FL",), ("FL",)))

    assert len(figure.views) == 1
    assert bool(figure.traces) == bool(rows)

"""The figures that table, page and JSON share."""

import json

import numpy as np
import pytest

from bstm_daemon.report.summary import front_first, summary_json
from bstm_daemon.report.tally import summarize
from bstm_daemon.results import Results


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
    assert left.margin_time_s == fluid.time_s
    assert left.wet_boiling_point_c == pytest.approx(155.0)


def test_energy_is_the_time_integral_of_the_power(descent: Results) -> None:
    """A row is the mean since the row before, so steps weigh by length."""
    left = summarize(descent).corners[0]
    power_w = descent.columns["FL.brake_power_w"]

    assert left.energy_j == pytest.approx(power_w[1:].sum() * 0.1)
    assert left.energy_ff_j == left.energy_j
    assert left.energy_fb_j == pytest.approx(0.85 * left.energy_j, rel=0.01)


def test_energy_of_uneven_rows_and_unknown_power() -> None:
    columns = {
        "time_s": np.array([0.0, 1.0, 11.0, 12.0]),
        "FL.brake_power_w": np.array([9.0, 100.0, 2.0, np.nan]),
        "FL.brake_power_fb_w": np.full(4, np.nan),
    }

    corner = summarize(Results(columns, ("FL",), ())).corners[0]

    assert corner.energy_j == 120.0
    assert corner.energy_fb_j is None
    assert corner.energy_ff_j is None


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
    assert rear.energy_j is not None


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


def test_summary_is_json(descent: Results) -> None:
    """Every value survives, unknown ones as null."""
    read = json.loads(
        json.dumps(summary_json(summarize(descent)), allow_nan=False)
    )

    assert read["corners"][0]["peaks"]["disc"]["temperature_c"] == (
        pytest.approx(descent.columns["FL.disc_c"].max())
    )
    assert read["corners"][3]["margin_k"] is None


def test_front_axle_comes_first() -> None:
    assert front_first(("RR", "FR", "X", "RL", "FL")) == (
        "FL",
        "FR",
        "RL",
        "RR",
        "X",
    )

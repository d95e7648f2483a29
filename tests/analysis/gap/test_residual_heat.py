"""The residual heat against what a link that the model lacks has carried."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.gap.residual_heat import (
    REGIMES,
    locate,
    regimes,
    residual_heat,
)
from bstm_daemon.analysis.matching.drives import GRID_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.config.sections import Config

STRENGTH = 1.5
CONDUCTANCE_W_M2K = 130.0


def test_nothing_is_missing_where_the_model_is_right(
    config: Config, made: Callable[..., Recording]
) -> None:
    found = locate(config, [made()], ["FL"])

    assert found.places == ()
    assert max(abs(cell.z) for cell in found.cells) < 3.0


def test_the_pads_lack_what_the_gap_conducts(
    config: Config, made: Callable[..., Recording]
) -> None:
    recording = made({"gap_conduction": STRENGTH}, noise_k=0.0)

    heats = {
        one.node: one for one in residual_heat(config, recording.drive, "FL")
    }

    parked = heats["pad_front"].regime == REGIMES.index("parked")
    found_j = heats["pad_front"].missing_j[parked].sum()
    couples = recording.drive.measured["FL"]
    time_s = recording.drive.time_s
    standing = recording.drive.channel("FL", "speed_ms") == 0.0
    apart_k = couples["disc"].at(time_s) - couples["pad_front"].at(time_s)
    pad = config.corner[0].pad
    assert pad is not None
    conductance = 2.0 * pad.area_m2 * STRENGTH * CONDUCTANCE_W_M2K
    carried_j = conductance * np.nansum(apart_k[standing]) * GRID_S
    assert found_j == pytest.approx(carried_j, rel=0.15)


def test_the_map_says_where_and_when(
    config: Config, made: Callable[..., Recording]
) -> None:
    found = locate(config, [made({"gap_conduction": STRENGTH})], ["FL"])

    first = found.places[0]
    assert "pad_front" in {first.node, first.other}
    assert first.regime in {"parked", "driving"}
    assert str(first).endswith(first.regime)
    # drags of 2.5 and 3 bar, a stop of 10 bar, coasting in between
    pressures = {cell.bin for cell in found.by_pressure}
    assert pressures == {"< 2 bar", "2 to 10 bar"}
    speeds = {cell.bin for cell in found.by_speed}
    assert len(speeds) > 2
    assert {cell.bin for cell in found.by_time} == {
        "first half",
        "second half",
    }


def test_windows_have_the_regime_of_most_of_them(
    made: Callable[..., Recording],
) -> None:
    drive = made().drive

    found = regimes(drive, "FL")

    assert set(found[:23]) == {REGIMES.index("braking")}
    assert REGIMES[found[25]] == "driving"
    assert REGIMES[found[-1]] == "parked"


def test_a_node_that_reads_for_no_whole_window_has_no_heat(
    config: Config, made: Callable[..., Recording]
) -> None:
    drive = made().drive
    couples = dict(drive.measured["FL"])
    fluid = couples["fluid"]
    couples["fluid"] = replace(
        fluid,
        time_s=fluid.time_s[:8],
        temperature_k=fluid.temperature_k[:8],
    )

    found = residual_heat(
        config, replace(drive, measured={"FL": couples}), "FL"
    )

    assert [one.node for one in found] == ["disc", "pad_front", "pad_back"]


def test_a_drive_shorter_than_a_window_has_none(
    config: Config, made: Callable[..., Recording]
) -> None:
    drive = made().drive
    short = replace(drive, inputs=drive.inputs[:20])

    assert residual_heat(config, short, "FL") == []

"""The residual heat against what a link that the model lacks has carried."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.gap.residual_heat import (
    REGIMES,
    Cell,
    NodeHeat,
    _places,
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


def heat_of(node: str, missing_j: list[float], first: int = 0) -> NodeHeat:
    """Return windows while parked, one each half minute from *first* on."""
    count = len(missing_j)
    return NodeHeat(
        *("a drive", "FL", node),
        time_s=30.0 * (first + np.arange(count)),
        missing_j=np.array(missing_j),
        draws_j=np.zeros((2, count)),
        regime=np.full(count, REGIMES.index("parked")),
        temperature_k=np.full(count, 300.0),
        speed_ms=np.zeros(count),
        pressure_pa=np.zeros(count),
    )


@pytest.mark.parametrize(
    ("of_pad", "first", "linked"),
    [
        # what one lacks the other has too much, window by window
        ([-9.0, -1.0, -5.0, -9.0, -2.0, -6.0, -8.0, -4.0], 0, True),
        # alike in sum, not in time
        ([-1.0, -9.0, -1.0, -1.0, -9.0, -1.0, -1.0, -9.0], 0, False),
        # only windows of the same time count
        ([-9.0, -1.0, -5.0, -9.0, -2.0, -6.0, -8.0, -4.0], 20, False),
        # the same sign is no link
        ([9.0, 1.0, 5.0, 9.0, 2.0, 6.0, 8.0, 4.0], 0, False),
    ],
)
def test_a_link_is_where_two_nodes_are_wrong_against_each_other(
    of_pad: list[float],
    first: int,
    linked: bool,  # noqa: FBT001
) -> None:
    of_disc = [9.0, 1.0, 5.0, 9.0, 2.0, 6.0, 8.0, 4.0]
    heats = [heat_of("disc", of_disc), heat_of("pad_front", of_pad, first)]
    cells = [
        Cell("disc", "parked", "cold", 44.0, 4.0, 8),
        # of several the plainest counts, and of alike ones the first
        Cell("disc", "parked", "hot", -36.0, 3.0, 8),
        Cell("disc", "parked", "hotter", 60.0, 5.0, 8),
        Cell("pad_front", "parked", "cold", sum(of_pad), 4.5, 8),
        Cell("pad_front", "driving", "cold", 1.0, 1.0, 8),
    ]

    found = _places(heats, cells)

    z = abs(sum(of_pad)) / 4.5
    if linked:
        (link,) = found
        assert (link.node, link.other) == ("disc", "pad_front")
        assert (link.energy_j, link.z) == (-36.0, pytest.approx(z))
        assert str(link) == "disc - pad_front, parked"
    else:
        assert [(one.node, one.other) for one in found] == [
            ("disc", ""),
            ("pad_front", ""),
        ]
        assert [one.z for one in found] == [12.0, pytest.approx(z)]

"""Fewer thermocouples: searched with what is there, never a wrong name."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.analysis.gap.naming import Naming, name_effect
from bstm_daemon.analysis.gap.signatures import sensed
from bstm_daemon.analysis.gap.workflow import compare

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.matching.tunables import Target

HIDDEN = "caliper_radiation"
AMONG = (HIDDEN, "fluid_exchange", "gap_conduction", "hub_conduction")
SETS = {
    "all": ("disc", "pad_front", "pad_back", "fluid"),
    "disc and fluid": ("disc", "fluid"),
    "fluid": ("fluid",),
}


def with_only(recording: Recording, nodes: tuple[str, ...]) -> Recording:
    """Return *recording* with the thermocouples of *nodes*."""
    measured = {
        corner: {node: couples[node] for node in nodes}
        for corner, couples in recording.drive.measured.items()
    }
    return replace(
        recording, drive=replace(recording.drive, measured=measured)
    )


def searched(
    target: Target, recording: Recording, nodes: tuple[str, ...]
) -> Naming:
    comparison = compare(target, [with_only(recording, nodes)])
    return name_effect(
        comparison, sensed(comparison, AMONG).whitened(comparison)
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_no_set_gives_a_wrong_name(
    target: Target, made: Callable[..., Recording], name: str
) -> None:
    found = searched(target, made({HIDDEN: 2.5}), SETS[name])

    assert found.answer != "name" or found.names == (HIDDEN,)
    assert HIDDEN in {one.name for one in found.candidates}


@pytest.mark.slow
def test_what_is_not_measured_shows_later(
    target: Target, made: Callable[..., Recording]
) -> None:
    """The pads' gap needs a larger strength without a pad measured."""
    recording = made()

    reaches = {}
    for name, nodes in SETS.items():
        found = searched(target, recording, nodes)
        assert found.answer == "nothing"
        reaches[name] = {one.name: one.reach for one in found.candidates}

    assert (
        reaches["disc and fluid"]["gap_conduction"]
        > 2.0 * (reaches["all"]["gap_conduction"])
    )
    assert reaches["fluid"]["hub_conduction"] > (
        2.0 * reaches["disc and fluid"]["hub_conduction"]
    )

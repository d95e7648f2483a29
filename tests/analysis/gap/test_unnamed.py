"""The open set: heats at nodes, and readings that differ."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap.evidence import AHEAD, likeliest
from bstm_daemon.analysis.gap.fitting import directions
from bstm_daemon.analysis.gap.searching import search
from bstm_daemon.analysis.gap.signatures import sensed
from bstm_daemon.analysis.gap.unnamed import (
    READS_LATE_S,
    READS_LESS,
    READS_LOW_K,
    Unnamed,
    unnamed_readings,
)
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.thermocouples import Thermocouple
from bstm_daemon.analysis.statistics.evidence import Projector

from ...made_drives import AIR_K  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.matching.tunables import Target


def test_a_reading_differs_by_what_the_model_has() -> None:
    """The noise of the reading is in the residual, and not in the change."""
    time_s = np.array([0.0, 10.0, 20.0, 40.0])
    disc_k = AIR_K + np.array([10.0, 30.0, 50.0, 110.0])
    noise_k = np.array([1.0, -2.0, 0.5, 3.0])
    series = SimpleNamespace(
        node="disc",
        time_s=time_s,
        measured_k=disc_k + noise_k,
        rise_k=disc_k + noise_k - AIR_K,
    )
    fluid = SimpleNamespace(
        node="fluid",
        time_s=time_s[:2],
        measured_k=np.full(2, 300.0),
        rise_k=np.full(2, 10.0),
    )
    layout: Any = SimpleNamespace(
        series=(series, fluid), edges=np.array([0, 4, 6])
    )

    found = unnamed_readings(layout, np.array([*-noise_k, 1.0, 1.0]))

    by = {one.said: one.change.tolist() for one in found}
    excess = [READS_LESS * (one - AIR_K) for one in disc_k]
    rate = [-READS_LATE_S * one for one in (2.0, 2.0, 7.0 / 3.0, 3.0)]
    for which, disc, own in (
        ("with its excess", excess, [READS_LESS * 11.0] * 2),
        ("with its rate", rate, [0.0, 0.0]),
        ("always", [READS_LOW_K] * 4, [READS_LOW_K] * 2),
    ):
        said = f"that differs {which}"
        assert by[f"reading of disc {said}"] == pytest.approx(
            [*disc, 0.0, 0.0]
        )
        assert by[f"reading of fluid {said}"] == pytest.approx([0.0] * 4 + own)
    assert len(by) == 6


def test_heat_is_said_to_be_at_its_node() -> None:
    heat = Unnamed("disc", "parked", np.zeros(1))

    assert heat.said == "heat at disc, parked"


@pytest.mark.parametrize(
    ("error", "place"), [(4.0, "disc"), (4.6, "reading of disc")]
)
def test_a_reading_is_told_where_it_is_clearly_ahead_of_heat(
    error: float, place: str
) -> None:
    heat = Unnamed("disc", "parked", np.array([1.0, 0.0]))
    reading = Unnamed(
        "reading of disc", "always", np.array([0.0, 1.0]), is_heat=False
    )
    project = Projector(np.zeros((2, 1)), np.ones(1))

    found = likeliest(project, np.array([-2.8, -error]), [reading, heat])

    # x^2 / 4 each, the rest is alike
    ahead = (error**2 - 2.8**2) / 4.0
    assert (ahead > AHEAD) == (place == "reading of disc")
    assert found.place == place


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "late_s", "place"),
    [
        pytest.param(
            *(0.6, 0.0, "reading of pad_front that differs with its excess"),
            marks=pytest.mark.full,
        ),
        (1.0, 15.0, "reading of pad_front that differs with its rate"),
    ],
)
def test_an_error_of_a_reading_beyond_the_catalogue_is_told(
    target: Target,
    made: Callable[..., Recording],
    share: float,
    late_s: float,
    place: str,
) -> None:
    def misread(recording: Recording) -> Recording:
        drive = recording.drive
        true = drive.measured["FL"]["pad_front"]
        then_k = np.interp(
            true.time_s - late_s, true.time_s, true.temperature_k
        )
        wrong = Thermocouple(true.time_s, AIR_K + share * (then_k - AIR_K))
        couples = {**drive.measured["FL"], "pad_front": wrong}
        return replace(
            recording, drive=replace(drive, measured={"FL": couples})
        )

    drives = [misread(made(name=f"{seed}", seed=seed)) for seed in (1, 2)]
    comparison = compare(target, drives)
    simulated = sensed(comparison, ["backplate_loss"])

    _, found = search(comparison, simulated, directions(comparison))

    assert (found.answer, found.names) == ("unknown", ())
    assert found.unknown_place == place

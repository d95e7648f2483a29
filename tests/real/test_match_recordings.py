"""``bstm match`` on the Formula 1 sessions; docs/real-data.md has the figures.

From the typical values of ``bstm init``: nothing of this car is known. What
is left out of a fit is a whole session, or the second half of one.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from bstm_daemon.analysis.matching.baseline import baselines
from bstm_daemon.analysis.matching.coarse import (
    Reading,
    guesses_of,
    read_as_guessed,
)
from bstm_daemon.analysis.matching.drives import read_drives
from bstm_daemon.analysis.matching.matcher import match_drives
from bstm_daemon.analysis.matching.refine import errors_of, rms_of
from bstm_daemon.analysis.matching.tunables import Target
from bstm_daemon.cli.vehicle import load_vehicle

DATA = os.environ.get("BSTM_REAL_DATA")
F1 = Path(DATA or ".", "f1-five-channel")
CAR = Path(__file__).parent / "f1_typical.toml"
LOGS = [F1 / f"{name}.converted.csv" for name in ("Spain", "Hungary")]
MOST_HELD_K: Final = {(0, 1): 42.0, (1, 0): 31.0}
"""On the other session: what a disc of one node was known to reach."""

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        DATA is None or not F1.exists(),
        reason="BSTM_REAL_DATA does not name the folder of the recordings",
    ),
]


@pytest.fixture(scope="module")
def readings() -> list[Reading]:
    config, signal_map = load_vehicle(CAR)
    return read_as_guessed(
        config,
        guesses_of(CAR),
        lambda one: read_drives(LOGS, one, signal_map),
    )


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize(("fitted", "other"), [(0, 1), (1, 0)])
def test_no_worse_than_a_disc_of_one_node(
    readings: list[Reading],
    fitted: int,
    other: int,
    half: bool,  # noqa: FBT001
) -> None:
    config = load_vehicle(CAR)[0]
    whole = slice(None)
    seen, unseen = (fitted, whole), (other, whole)
    if half:
        middle = len(readings[0].drives[fitted]) // 2
        seen = (fitted, slice(0, middle))
        unseen = (fitted, slice(middle, None))

    (match,) = match_drives(
        config,
        [one.of([seen]) for one in readings],
        guessed=guesses_of(CAR),
        beside=False,
    )

    assert match.after.config.heat.derivative_filter_s < 0.1
    (held,) = next(
        one.of([unseen]).drives
        for one in readings
        if one.filter_s == match.after.config.heat.derivative_filter_s
    )
    simple, both = baselines(match.drives), []
    for corner in ("FL", "FR"):
        own = Target(match.after.config, (corner,))
        (fit_k,) = rms_of(errors_of(own, match.drives[0])).values()
        (held_k,) = rms_of(errors_of(own, held)).values()
        of_one_node = simple[corner][0]
        print(  # noqa: T201  (the figures of docs/real-data.md)
            f"{seen} {corner}: fit {fit_k:.1f} K, held out {held_k:.1f} K; "
            f"one node {of_one_node.rms_k:.1f}, "
            f"{of_one_node.rms_on([held]):.1f} K"
        )
        one_node_k = of_one_node.rms_on([held])
        # matched together, left and right may be 1 K off what each could be
        assert fit_k < of_one_node.rms_k + 1.0
        assert held_k < one_node_k + 1.0
        both.append((fit_k, of_one_node.rms_k, held_k, one_node_k))
        if not half:
            assert held_k < MOST_HELD_K[fitted, other]
    fit_k, simple_k, held_k, one_node_k = np.sqrt(np.mean(np.square(both), 0))
    assert fit_k < simple_k
    assert held_k < one_node_k

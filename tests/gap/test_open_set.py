"""What is missing although no effect of the catalogue explains it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.gap.layout import Layout, Series
from bstm_daemon.gap.naming import AGAINST, name_effect
from bstm_daemon.gap.noise import NodeNoise
from bstm_daemon.gap.projector import Projector
from bstm_daemon.gap.signatures import Linearised, Signature
from bstm_daemon.gap.unknown import (
    UnknownHeat,
    log_evidence,
    missing_evidence,
)

POINTS = 300
DRIVES = 2
NAMES = ("hub_conduction", "gap_conduction", "pad_wear", "disc_hat")
WHITE = NodeNoise(1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PRIOR = np.ones(2)


def drive(number: int) -> Series:
    time_s = 10.0 * np.arange(POINTS)
    still = np.zeros(POINTS)
    return Series(
        number,
        "disc",
        (("FL", "disc"),),
        np.arange(POINTS),
        time_s,
        still,
        still,
        still,
    )


@pytest.fixture
def layout() -> Layout:
    series = [drive(number) for number in range(DRIVES)]
    return Layout(series, {"disc": WHITE}, PRIOR, ("a", "b"))


@pytest.fixture
def quiet() -> Linearised:
    """Return two drives with nothing missing."""
    rng = np.random.default_rng(4)
    size = DRIVES * POINTS
    signatures = []
    for name in NAMES:
        change = rng.normal(0.0, 0.2, size)
        signatures.append(
            Signature(name, change, 0.0 * change, change, either_sign=False)
        )
    heats = tuple(
        UnknownHeat(node, regime, rng.normal(0.0, 0.2, size))
        for node in ("disc", "fluid")
        for regime in ("braking", "driving", "parked")
    )
    return Linearised(
        rng.normal(0.0, 1.0, size),
        rng.normal(0.0, 1.0, (size, 2)),
        tuple(signatures),
        (),
        heats,
    )


def test_nothing_missing_is_said_to_be_nothing(
    layout: Layout, quiet: Linearised
) -> None:
    assert name_effect(layout, quiet).answer == "nothing"


def test_heat_at_one_place_does_not_pay_for_all_places(
    layout: Layout, quiet: Linearised
) -> None:
    project = Projector(quiet.jacobian, layout.prior)
    residual = quiet.residual - 0.9 * quiet.unknown[1].change
    everywhere = np.column_stack([one.change for one in quiet.unknown])

    at_one = missing_evidence(project, residual, quiet.unknown)

    assert at_one > log_evidence(project, residual, everywhere) + 1.0


def test_an_effect_that_another_drive_contradicts_is_not_named(
    layout: Layout, quiet: Linearised
) -> None:
    own = quiet.signatures[0]
    both = np.repeat((3.0, 0.0), POINTS)
    agreed = replace(quiet, residual=quiet.residual - 3.0 * own.kelvin)
    contradicted = replace(quiet, residual=quiet.residual - both * own.kelvin)

    named = name_effect(layout, agreed)
    refused = name_effect(layout, contradicted)

    assert (named.answer, named.names) == ("name", (own.name,))
    assert min(refused.cross_validated.values()) < -AGAINST
    assert refused.answer == "unknown"

"""A pressure without a unit: proven by the car that slows down, or not."""

from collections.abc import Callable

import numpy as np
import pytest
from cantools.database.can import Database

from bstm_daemon.analysis.setup.behaviour import Motion
from bstm_daemon.analysis.setup.pressure_unit import assumed_unit
from bstm_daemon.analysis.setup.proposal import propose
from bstm_daemon.analysis.setup.recording import Recording, Samples, Series

Maker = Callable[..., Samples]

TIME_S = np.arange(0.0, 120.0, 0.02)
BRAKING: Series = np.where(
    np.abs(TIME_S % 30.0 - 20.0) < 2.0,
    np.sin((TIME_S % 30.0 - 18.0) * np.pi / 4.0),
    0.0,
)
"""Four applications of 4 s, each with its hardest in the middle."""

SPEED_MS: Series = 30.0 - np.cumsum(
    np.where(BRAKING > 0.0, 3.0 * BRAKING, -0.38) * 0.02
)
BAR: Series = 25.0 * BRAKING
"""Some 8 bar for 1 m/s2."""


@pytest.fixture
def motion(series: Maker) -> Motion:
    return Motion({"speed": series(SPEED_MS)})


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(1.0, "bar"), (0.1, "MPa"), (100.0, "kPa"), (1e5, "Pa"), (2.0, "bar")],
)
def test_the_unit_is_the_one_that_slows_a_car(
    motion: Motion, series: Maker, factor: float, unit: str
) -> None:
    found = assumed_unit(motion, series(factor * BAR))

    assert found is not None
    assert found[0] == unit
    assert f"highest value of {25 * factor:g}" in found[1]
    assert "for 1 m/s2" in found[1]


@pytest.mark.parametrize(
    "value",
    [
        pytest.param(np.where(BRAKING > 0.0, 25.0, 0.0), id="flag"),
        pytest.param(np.round(BRAKING * 5), id="few levels"),
        pytest.param(25.0 - BAR, id="rests at its highest"),
        pytest.param(BAR - 5.0, id="below zero"),
        pytest.param(np.roll(BAR, 400), id="while the car speeds up"),
        pytest.param(0.0 * BAR, id="never"),
        pytest.param(1e-3 * BAR, id="no usual pressure"),
        pytest.param(
            np.where((TIME_S > 50) & (TIME_S < 50.3), BAR, 0.0), id="too short"
        ),
        pytest.param(
            BAR + 380.0 * np.eye(1, len(TIME_S), 1)[0], id="beyond a brake"
        ),
    ],
)
def test_what_is_no_pressure_has_no_unit(
    motion: Motion, series: Maker, value: Series
) -> None:
    assert assumed_unit(motion, series(value)) is None


def test_without_motion_there_is_no_proof(series: Maker) -> None:
    motion = Motion({"speed": series(0.0 * SPEED_MS)})

    assert assumed_unit(motion, series(BAR)) is None


def test_wheels_on_rollers_prove_nothing(series: Maker) -> None:
    """They stop faster than any car."""
    motion = Motion({"speed": series(8.0 * (SPEED_MS - SPEED_MS.min()))})

    assert assumed_unit(motion, series(8.0 * BAR)) is None


@pytest.mark.parametrize(
    ("signals", "proven"),
    [
        (["SPEED m/s", "BRAKE %"], "BRAKE"),
        (["SPEED m/s", "BrakePressure"], "BrakePressure"),
        (["SPEED m/s", "BRAKE %", "BrakePressure bar"], "BrakePressure"),
        (["SPEED m/s", "RearBrakePressure"], None),
    ],
)
def test_a_proven_pressure_is_proposed(
    make_database: Callable[..., Database],
    signals: list[str],
    proven: str | None,
) -> None:
    """A unit of the DBC is better; a rear circuit asks for more than one."""
    recording = Recording(
        interface="can0",
        duration_s=120.0,
        samples={
            ("M0", name.split()[0]): Samples(
                TIME_S, SPEED_MS if "SPEED" in name else BAR
            )
            for name in signals
        },
    )

    found = {
        one.role: (one.match.signal.name, one.unit)
        for one in propose(make_database(signals), recording).sure
    }

    expected = (proven, "bar") if proven else None
    assert found.get("primary_pressure") == expected
    assert "secondary_pressure" not in found

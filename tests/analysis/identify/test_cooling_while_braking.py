"""``identify cooling --while-braking``: S as a line, heat from motion."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.analysis.identify.cooling_while_braking import (
    BrakedAxle,
    identify_while_braking,
)
from bstm_daemon.analysis.identify.driving import Driving, driving_of
from bstm_daemon.analysis.identify.writing import cooling_changes
from bstm_daemon.analysis.quality.recording import read_recording
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError

Logged = Callable[..., Path]
Reader = Callable[[Path], Driving]
Example = tuple[Config, SignalMap]

REAL = os.environ.get("BSTM_REAL_DATA")
F1 = Path(__file__).parents[2] / "real" / "f1.toml"
TABLE = (
    "\n[cooling]\nspeed_ms = [0.0, 50.0, 91.7]\ns_per_s = [1e-2, 4e-2, 8e-2]\n"
)
FLAT = (
    "disc.heat_capacity_j_kgk = "
    "{temperature_c = [0.0, 1200.0], value = [1500.0, 1500.0]}"
)


def with_form(config: Config, form: str) -> Config:
    cooling = config.cooling.model_copy(update={"form": form})
    return config.model_copy(update={"cooling": cooling})


@pytest.fixture(scope="module")
def found(logged: Logged, driving: Reader, example: Example) -> BrakedAxle:
    """Return the front discs of `m04`: stops and speeds up to 150 km/h."""
    config = with_form(example[0], "conductance")
    reading = driving(logged("m04", "n2"))
    (axle,) = identify_while_braking([reading], config).axles
    return axle


@pytest.mark.slow
def test_line_over_speed(found: BrakedAxle) -> None:
    """The reality's h A over m c_p: in 15 %, and two and a half errors."""
    for speed_kmh, true in (
        (50.0, 3.17e-3),
        (90.0, 5.07e-3),
        (150.0, 7.63e-3),
    ):
        value, error = found.at(speed_kmh / 3.6)
        assert value == pytest.approx(true, rel=0.15)
        assert abs(value - true) < 2.5 * error
    assert not found.caveat


@pytest.mark.slow
def test_windows_not_fitted_are_predicted(found: BrakedAxle) -> None:
    """20 to 720 °C: nearly as well as those fitted; not fitted as better."""
    assert found.fitted_k < found.held_k < 12.0
    assert found.held_k < 1.3 * found.fitted_k
    measured = np.stack([w.disc_k for w in found.windows], axis=1)
    apart = measured - found.held_model_k
    assert np.sqrt(np.mean(apart**2)) == pytest.approx(found.held_k)


@pytest.mark.slow
def test_heat_of_the_configured_car(found: BrakedAxle) -> None:
    """Mass, shares and disc are right to 15 %, tyre slip is in it."""
    assert found.heat[0] == pytest.approx(1.0, abs=0.2)
    assert found.heat[1] < 0.1


@pytest.mark.slow
def test_table_to_configure(found: BrakedAxle, example: Example) -> None:
    changes = cooling_changes([found], example[0])

    keys = {(c.section, c.key, c.corner) for c in changes}
    assert ("cooling", "s_per_s", "") in keys
    assert ("corner", "cooling.speed_ms", "RL") in keys
    assert not any("fraction" in change.key for change in changes)
    assert [speed for speed, *_ in found.table] == example[0].cooling.speed_ms
    # below 5 % of the time: 18 km/h and rest keep the configured shape
    rest, slow = found.table[:2]
    assert not rest[2]
    assert not slow[2]
    assert rest[1] / slow[1] == pytest.approx(
        found.disc.s_per_s[0] / found.disc.s_per_s[1]
    )
    assert rest[1] > 0.0


@pytest.mark.slow
def test_what_is_faster_is_told_of_the_table_that_is_found(
    found: BrakedAxle,
) -> None:
    """The line's end is a point of the table if it is beyond its last."""
    top_ms = found.held_ms[1]
    speeds_ms, s_per_s = found.disc.speeds_ms[:3], found.disc.s_per_s[:3]
    disc = replace(found.disc, speeds_ms=speeds_ms, s_per_s=s_per_s)
    short = replace(found, disc=disc)
    speed = np.concatenate([one.speed_ms for one in found.windows])

    share, end_ms = short.beyond

    assert end_ms == top_ms > 10.0
    assert share == np.mean(speed > top_ms)
    assert share < 0.1 < np.mean(speed > 10.0)
    vague = replace(short, covariance=1e3 * np.eye(2))
    assert vague.beyond == (np.mean(speed > 10.0), 10.0)


@pytest.mark.slow
def test_too_little_is_said(
    logged: Logged, driving: Reader, example: Example
) -> None:
    with pytest.raises(LogError, match=r"4 stretches of 90 s .* front 0"):
        identify_while_braking([driving(logged("coastdown"))], example[0])


@pytest.mark.real
@pytest.mark.skipif(
    REAL is None, reason="BSTM_REAL_DATA names no folder of recordings"
)
@pytest.mark.parametrize(
    ("name", "held_k", "at_200_kmh"),
    [("Spain", 35.0, 0.048), ("Hungary", 50.0, 0.052)],
)
def test_formula_1(
    tmp_path: Path, name: str, held_k: float, at_200_kmh: float
) -> None:
    """Carbon discs up to 1257 °C: laps that were not fitted."""
    lines = [
        FLAT if line.startswith("disc.heat_capacity") else line
        for line in F1.read_text("utf-8").splitlines()
    ]
    car = tmp_path / "f1.toml"
    car.write_text("\n".join(lines) + TABLE, "utf-8")
    config, plan = load_vehicle(car)
    log = Path(str(REAL)) / "f1-five-channel" / f"{name}.converted.csv"
    reading = driving_of(name, read_recording([log], plan), config, plan)

    (axle,) = identify_while_braking([reading], config).axles

    assert axle.held_k < held_k
    value, error = axle.at(200.0 / 3.6)
    assert value == pytest.approx(at_200_kmh, rel=0.1)
    assert error < 0.1 * value
    # whatever slows the car besides: downforce's drag, recovery, engine
    assert axle.resist[0] > 1.5

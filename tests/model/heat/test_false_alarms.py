"""No false alarms: drives that are as they should be, and real recordings."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.channels import FLAGS, WHEEL_SUSPECT
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.model.heat.plausibility import reasons
from bstm_daemon.roles import CORNERS, ROLE_INDEX, ROLES
from bstm_daemon.simulation.drives import load_drive
from bstm_daemon.simulation.simulate import simulate
from tests.replayed import replay_log

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.simulation.simulate import SimulatedDrive

ROOT = Path(__file__).parents[3]
REAL = os.environ.get("BSTM_REAL_DATA")

SETTINGS = sum(
    FLAGS[name]
    for name in (
        *("acceleration_missing", "torque_missing", "ambient_missing"),
        *("settled", "silent"),
    )
)
"""What a car may lack, and a bus that sleeps: no finding about an input."""

DRIVES = ("rich", "city", "slippery", "track", "alpine-descent", "assist")
QUICK = {("slippery", "n4"), ("assist", "n1")}
"""The others take a second or two each."""

LONG = {
    *(("rich", sensors) for sensors in ("n1", "n3", "n4")),
    *(("alpine-descent", sensors) for sensors in ("n2", "n3", "n4")),
}
"""Left to `.ci/full`."""


def samples_of(drive: SimulatedDrive) -> tuple[Any, Any, Any, dict[int, int]]:
    """Return stamps, roles and values while the bus is on; time-outs."""
    names = [name for name in drive.roles if name in ROLE_INDEX]
    numbers = np.array([ROLE_INDEX[name] for name in names], np.int32)
    stamps = np.rint(drive.time_s * 1e6).astype(np.int64)
    values = np.column_stack([drive.roles[name] for name in names])
    keep = np.repeat(drive.bus_on, len(names))
    return (
        np.repeat(stamps, len(names))[keep],
        np.tile(numbers, len(stamps))[keep],
        values.astype(np.float64).ravel()[keep],
        {int(n): round(ROLES[n].timeout_s * 1e6) for n in numbers},
    )


@pytest.mark.usefixtures("compiled_chosen")
@pytest.mark.parametrize(
    ("drive", "sensors"),
    [
        pytest.param(
            drive,
            sensors,
            marks=[pytest.mark.slow] * ((drive, sensors) not in QUICK)
            + [pytest.mark.full] * ((drive, sensors) in LONG),
        )
        for drive in DRIVES
        for sensors in ("n1", "n2", "n3", "n4")
    ],
)
def test_a_sound_car_raises_nothing(
    make_car: Any,
    make_corner: Any,
    drive: str,
    sensors: str,
) -> None:
    """Bends, ABS, ESC, assistance, lights, ignition off: no suspicion."""
    car = make_car(*(make_corner(name) for name in CORNERS))
    simulated = simulate(
        load_drive(drive), preset="road", sensors=sensors, seed=3
    )
    *columns, present = samples_of(simulated)
    estimator = Estimator(car, present)
    assert estimator.compiled

    found = 0
    for block in estimator.advance(*columns):
        # while the bus sleeps its inputs are missing, and that is right
        flags = np.frombuffer(block.flags, np.int64)
        awake = flags[(flags & FLAGS["speed_missing"]) == 0]
        found |= int(np.bitwise_or.reduce(awake, initial=0))

    assert reasons(found & ~SETTINGS) == []
    assert estimator.samples.memory().checks.jumps_refused == 0
    assert estimator.samples.memory().checks.out_of_range == 0


needs_recordings = pytest.mark.skipif(
    not REAL, reason="BSTM_REAL_DATA names no folder of recordings"
)


@pytest.fixture
def flags_of(tmp_path: Path) -> Callable[..., Any]:
    """Return what replays a recording and returns its flags and times."""

    def replay(
        config: str,
        log: str,
        *without: str,
        dbc: Any = None,
        edit: tuple[str, str] = ("", ""),
    ) -> Any:
        text = (ROOT / config).read_text(encoding="utf-8")
        assert edit[0] in text
        text = text.replace(*edit) if edit[0] else text
        data = Path(str(REAL))
        if dbc is not None:
            text = text.replace("@DATA@", dbc(data).parent.as_posix())
        text = text.replace(
            'dbc = "../', f'dbc = "{(ROOT / config).parent.as_posix()}/../'
        )
        path = tmp_path / Path(config).name
        path.write_text(text, encoding="utf-8")
        found = replay_log(
            *load_vehicle(path),
            next(data.glob(log)),
            dict.fromkeys(without, ""),
            forecast=False,
        )
        columns = found.results.columns
        return columns["flags"].astype(np.int64), columns

    return replay


@pytest.mark.real
@needs_recordings
@pytest.mark.parametrize(
    ("config", "log", "without"),
    [
        ("config/subaru_wrx_sti.toml", "subaru-wrx-sti-candump/*.log", ()),
        (
            "config/toyota_rav4.toml",
            "toyota-rav4-comma2k19/*.log",
            ("can1",),
        ),
        (
            "tests/real/tesla_model3.toml",
            "tesla-model3-trackmode/*03-05*.csv",
            (),
        ),
        (
            "tests/real/tesla_model3.toml",
            "tesla-model3-trackmode/*03-10*.csv",
            (),
        ),
    ],
    ids=["subaru", "toyota", "tesla-03-05", "tesla-03-10"],
)
def test_sound_recordings_raise_nothing(
    flags_of: Callable[..., Any], config: str, log: str, without: tuple[str]
) -> None:
    """A road car in the hills, under assistance, and on a race track."""
    flags, _ = flags_of(config, log, *without)
    missing = SETTINGS | FLAGS["pressure_missing"] | 15 << 7

    found = int(np.bitwise_or.reduce(flags))

    assert reasons(found & ~missing) == []


@pytest.mark.real
@needs_recordings
def test_an_accelerometer_turned_round_is_found_on_a_track(
    flags_of: Callable[..., Any],
) -> None:
    """The sign taken wrong: found within a minute of hard driving."""
    section = "[signals.acceleration_longitudinal]\n"
    flags, _ = flags_of(
        "tests/real/tesla_model3.toml",
        "tesla-model3-trackmode/*03-05*.csv",
        edit=(section, f"{section}sign = -1\n"),
    )

    wrong = (flags & FLAGS["acceleration_contradicts"]) != 0
    assert 0 < int(np.argmax(wrong)) < 600
    assert wrong[-1]


@pytest.mark.real
@needs_recordings
def test_wheels_that_stand_on_a_stand_count_as_dead(
    flags_of: Callable[..., Any],
) -> None:
    """Three speeds agree; a stand is shown by the accelerometer later."""
    flags, columns = flags_of(
        "tests/real/gt86_stand.toml", "gt86-on-stand-candump/*.log"
    )
    dead = WHEEL_SUSPECT * 3

    moving = columns["speed_ms"] > 3.0
    assert set((flags[moving] & dead).tolist()) <= {0, dead}
    assert (flags[moving] & dead).sum() > 0
    assert not np.any(flags & (WHEEL_SUSPECT << 2 | WHEEL_SUSPECT << 3))


@pytest.mark.real
@needs_recordings
@pytest.mark.parametrize("log", ["NewMotor*.log", "PostMichigan*.log"])
def test_dead_wheels_of_a_formula_car_are_found(
    flags_of: Callable[..., Any], tmp_path: Path, log: str
) -> None:
    """Both front wheels read 0 throughout: found at the first move."""

    def mended(data: Path) -> Path:
        text = (data / "uwfe-fsae-ev-can" / "2024CAR.dbc").read_text(
            encoding="cp1252", errors="replace"
        )
        for old, new in (
            ("VCU_Data: 6", "VCU_Data: 8"),
            ("WSBFL_BrakeTemp: 5", "WSBFL_BrakeTemp: 8"),
        ):
            text = text.replace(old, new)
        path = tmp_path / "uwfe.dbc"
        path.write_text(text, encoding="cp1252")
        return path

    flags, columns = flags_of(
        "tests/real/uwfe_fsae.toml", f"uwfe-fsae-ev-can/{log}", dbc=mended
    )

    stuck = np.flatnonzero(flags & FLAGS["stuck"])
    moving = np.flatnonzero(columns["speed_ms"] > 3.0)
    assert 0 <= stuck[0] - moving[0] < 30
    assert set((flags[stuck] >> 24 & 15).tolist()) == {3}
    assert not np.any(flags[: stuck[0]] >> 24 & 15)

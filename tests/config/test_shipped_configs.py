"""The shipped cars: the example explains itself, the real ones are real."""

import itertools
import os
import re
from pathlib import Path

import cantools
import numpy as np
import numpy.typing as npt
import pytest
from cantools.database.can import Database

from bstm_daemon.config import sections as config
from bstm_daemon.config.reading import load_config
from bstm_daemon.model.heat.feed_forward import PressureTorque

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "config"
THIRD_PARTY = ROOT / "dbc" / "third_party"
REAL = os.environ.get("BSTM_REAL_DATA")
EXAMPLE = (CONFIG / "example_vehicle.toml").read_text(encoding="utf-8")

KEYS = sorted(
    {
        key
        for model in vars(config).values()
        if isinstance(model, type)
        and issubclass(model, config.Section)
        and model not in {config.Section, config.Config}
        for key in model.model_fields
    }
)

# drum brakes: the example has none
ELSEWHERE = {"drum_brake_factor"}

Series = npt.NDArray[np.float64]

needs_recordings = pytest.mark.skipif(
    REAL is None, reason="BSTM_REAL_DATA names no folder of recordings"
)


def recording(folder: str, name: str) -> Path:
    """Return a file of the folder of recordings."""
    return Path(str(REAL)) / folder / name


def decoded(log: Path, database: Database, signals: str) -> Series:
    """Return rows of time and *signals* (MESSAGE A B) of a candump log."""
    message_name, *names = signals.split()
    message = database.get_message_by_name(message_name)
    head = f"{message.frame_id:03X}#"
    rows = []
    for line in log.read_text(encoding="ascii").splitlines():
        stamp, interface, frame = line.split()[:3]
        if interface == "can0" and frame.startswith(head):
            data = bytes.fromhex(frame.removeprefix(head))
            if len(data) == message.length:
                values = message.decode(data, decode_choices=False)
                assert isinstance(values, dict)
                rows.append(
                    [
                        float(stamp.strip("()")),
                        *(float(str(values[name])) for name in names),
                    ]
                )
    return np.array(rows)


@pytest.mark.parametrize("key", KEYS)
def test_example_explains_every_key(key: str) -> None:
    """Each key that a user may write occurs in the example."""
    assert key in ELSEWHERE or re.search(rf"\b{key}\b", EXAMPLE)


def test_example_has_a_comment_on_every_number() -> None:
    """A section's number has a comment beside or above it."""
    lines = EXAMPLE[: EXAMPLE.index("[signals.wheel_speed_fl]")].splitlines()
    bare = [
        line
        for above, line in itertools.pairwise(lines)
        if re.match(r"\w+ = ", line)
        and "#" not in line
        and not re.match(r"#|\w+ = ", above)
    ]

    assert bare == []


@pytest.mark.parametrize(
    "name", ["example_vehicle", "subaru_wrx_sti", "toyota_rav4"]
)
def test_front_share_is_that_of_the_brakes(name: str) -> None:
    """Feed-Back splits the brake force the way Feed-Forward forms it."""
    car = load_config(CONFIG / f"{name}.toml")
    torque = {
        corner.name: PressureTorque.of_corner(corner).torque_per_pressure_nm_pa
        for corner in car.corner
    }

    front = (torque["FL"] + torque["FR"]) / sum(torque.values())

    assert front == pytest.approx(car.vehicle.front_share, abs=0.01)


def test_example_is_the_thesis_car() -> None:
    """Front 35 %, rear 15 % a corner, 400 Pa of pressure per N of force."""
    car = load_config(CONFIG / "example_vehicle.toml")
    force_per_pa = {
        corner.name: PressureTorque.of_corner(corner).torque_per_pressure_nm_pa
        / car.vehicle.wheel_radius_m
        for corner in car.corner
    }
    total = sum(force_per_pa.values())

    assert force_per_pa["FL"] / total == pytest.approx(0.35, abs=0.002)
    assert force_per_pa["RR"] / total == pytest.approx(0.15, abs=0.002)
    assert 1 / total == pytest.approx(400.0, rel=0.1)


@pytest.mark.parametrize("folder", ["subaru_wrx_sti", "toyota_rav4"])
def test_third_party_files_have_origin_and_licence(folder: str) -> None:
    """What is copied says from where and under which terms."""
    assert "https://github.com/" in (
        THIRD_PARTY / folder / "README.md"
    ).read_text(encoding="utf-8")
    assert (THIRD_PARTY / folder / "LICENSE").stat().st_size > 0


@needs_recordings
@pytest.mark.parametrize(
    ("copy", "folder"),
    [
        ("subaru_wrx_sti/sample_can_spec.dbc", "subaru-wrx-sti-candump"),
        (
            "toyota_rav4/toyota_new_mc_pt_generated.dbc",
            "toyota-rav4-comma2k19",
        ),
    ],
)
def test_third_party_dbc_is_unchanged(copy: str, folder: str) -> None:
    """The DBC is byte for byte the one that came with the recording."""
    original = recording(folder, Path(copy).name)

    assert (THIRD_PARTY / copy).read_bytes() == original.read_bytes()


@needs_recordings
@pytest.mark.parametrize(
    ("name", "log", "speed", "correlation"),
    [
        (
            "subaru_wrx_sti",
            "subaru-wrx-sti-candump/can_sample.log",
            "ID_D4 WS_FL WS_RR",
            0.95,
        ),
        # hilly road: the accelerometer sees the grade as well
        (
            "toyota_rav4",
            "toyota-rav4-comma2k19/rav4_bus0_bus1.converted.candump.log",
            "WHEEL_SPEEDS WHEEL_SPEED_FL WHEEL_SPEED_RR",
            0.75,
        ),
    ],
)
def test_acceleration_has_sign_and_scale_of_the_wheels(
    name: str, log: str, speed: str, correlation: float
) -> None:
    """As configured, the accelerometer follows the change of wheel speed."""
    car = load_config(CONFIG / f"{name}.toml")
    database = cantools.database.load_file(
        CONFIG / car.bus[0].dbc, strict=car.bus[0].strict
    )
    assert isinstance(database, Database)
    signal = car.signals["acceleration_longitudinal"]
    path = recording(*log.split("/"))
    wheels = decoded(path, database, speed)
    wheel_si = 1 / 3.6 if car.signals["wheel_speed_fl"].unit == "km/h" else 1.0
    raw = decoded(path, database, f"{signal.message} {signal.signal}")
    grid_s = np.arange(wheels[0, 0] + 1, wheels[-1, 0] - 1, 0.02)
    half_second = np.full(25, 1 / 25)

    def smooth(times: Series, values: Series) -> Series:
        on_grid = np.interp(grid_s, times, values)
        return np.convolve(on_grid, half_second, "same")

    speed_ms = smooth(wheels[:, 0], wheels[:, 1:].mean(axis=1) * wheel_si)
    configured = signal.sign * (raw[:, 1] * signal.scale + signal.offset)
    # below 3 m/s the wheel sensors drop out
    moving = speed_ms > 3.0
    moving[:100] = moving[-100:] = False
    sensed = smooth(raw[:, 0], configured)[moving]
    from_wheels = np.gradient(speed_ms, 0.02)[moving]
    slope = np.polyfit(sensed, from_wheels, 1)[0]

    assert np.corrcoef(sensed, from_wheels)[0, 1] > correlation
    assert slope == pytest.approx(1.0, abs=0.15)

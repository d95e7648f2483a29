"""The exported model is the model, bit for bit (FMPy runs it)."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
import zipfile
from array import array
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.matching.tunables import Target
from bstm_daemon.channels import CHANNELS
from bstm_daemon.cli.main import main
from bstm_daemon.errors import UsageError
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.estimator.estimator import STEP_US, Estimator
from bstm_daemon.exchange.fmu import compiler_of, write_fmu
from bstm_daemon.exchange.responses import responses
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.roles import ROLE_INDEX

from ..fmu_slave import PLATFORM, STEP_S, drive, model_of, rows_of  # noqa: TID252

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.config.sections import Config

ROOT = Path(__file__).resolve().parents[2]
NODES = ("disc", "pad_front", "pad_back", "backplate", "fluid")
STEPS = 1200
VERSIONS = [2, 3]


def marched(config: Config, rows: np.ndarray) -> np.ndarray:
    """Return the temperatures of NODES after each row, by the Python model."""
    program = compile_corner(config, config.corner[0])
    start_k = config.vehicle.ambient_c + 273.15
    batch = Batch([program], start_k)
    flat = batch.march(array("d", rows.ravel()), len(rows), STEP_US * 1e-6)
    names = program.state_names
    wide = len(names) + batch.sources
    states = np.array(flat).reshape(len(rows), wide)
    return states[:, [names.index(node) for node in NODES]]


def stepped(
    slave: Any, inputs: dict[str, np.ndarray], hold: int
) -> np.ndarray:
    """Return the same of an FMU, with steps of *hold* steps of the grid."""
    found = []
    for i in range(0, len(inputs["speed_ms"]), hold):
        slave.set_all({name: values[i] for name, values in inputs.items()})
        slave.step(round(hold * STEP_S, 9))
        found.append(slave.get(*(f"{node}_k" for node in NODES)))
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fmi"),
    [
        *(("FL", 3), ("car", 2)),
        pytest.param("FL", 2, marks=pytest.mark.full),
        # nothing else of .ci/run compiles it
        pytest.param("car", 3, marks=pytest.mark.full),
    ],
)
def test_fmpy_finds_no_problem(
    fmu_file: Callable[[str, int], Path], name: str, fmi: int
) -> None:
    validation = pytest.importorskip("fmpy.validation")

    assert validation.validate_fmu(str(fmu_file(name, fmi))) == []


@pytest.mark.slow
@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize(("seed", "hold"), [(1, 1), (2, 2), (3, 20)])
def test_temperatures_of_a_corner_equal_those_of_python_bit_for_bit(
    opened: Any, config: Config, fmi: int, seed: int, hold: int
) -> None:
    inputs = drive(seed, STEPS)

    found = stepped(opened("FL", fmi), inputs, hold)

    expected = marched(config, rows_of(inputs, hold))[hold - 1 :: hold]
    assert expected[:, 0].max() > 360.0
    assert np.array_equal(found, expected)


@pytest.mark.slow
def test_inputs_are_those_that_the_network_uses(
    fmu_file: Callable[[str, int], Path],
) -> None:
    fmpy = pytest.importorskip("fmpy")
    description = fmpy.read_model_description(str(fmu_file("FL", 2)))

    inputs = [
        v.name for v in description.modelVariables if v.causality == "input"
    ]
    assert inputs == ["speed_ms", "brake_on", "ambient_k", "brake_power_w"]


@pytest.mark.slow
def test_a_step_off_the_grid_keeps_the_grid_and_is_reported(
    opened: Any, config: Config
) -> None:
    slave = opened("FL")
    rows = rows_of(drive(1, 6), 1)
    # 0.03 s of the first and 0.02 s of the second make the first step
    values = [(20.0, 1e4), (10.0, 2e4), (10.0, 2e4)]
    power = (0.03 * 1e4 + 0.02 * 2e4) / 0.05
    speed = (0.03 * 20.0 + 0.02 * 10.0) / 0.05

    for v, p in values:
        slave.set(speed_ms=v, brake_power_w=p, brake_on=1.0, ambient_k=288.0)
        slave.step(0.03)

    first = rows[:1].copy()
    for name, value in (
        *(("speed_ms", speed), ("brake_power_w", power)),
        *(("brake_on", 1.0), ("ambient_k", 288.0)),
    ):
        first[0, CHANNELS.index(name)] = value
    found = slave.get("disc_k", "grid_time_s")
    assert found[0] == pytest.approx(marched(config, first)[0, 0], abs=1e-9)
    assert found[1] == 0.05
    assert sum("no multiple" in text for text in slave.messages) == 1


@pytest.mark.slow
@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_saved_state_gives_the_same_bits_again(
    opened: Any, fmi: int
) -> None:
    slave = opened("FL", fmi)
    inputs = drive(1, 400)
    half = {name: values[:200] for name, values in inputs.items()}
    rest = {name: values[200:] for name, values in inputs.items()}
    stepped(slave, half, 1)

    saved = slave.fmu.getFMUState()
    at_s = slave.time_s
    data = slave.fmu.serializeFMUState(saved)
    once = stepped(slave, rest, 1)
    slave.fmu.setFMUState(saved)
    slave.time_s = at_s
    again = stepped(slave, rest, 1)
    other = opened("FL", fmi)
    other.fmu.setFMUState(other.fmu.deserializeFMUState(data))
    other.time_s = at_s
    third = stepped(other, rest, 1)
    slave.fmu.freeFMUState(saved)

    assert np.array_equal(once, again)
    assert np.array_equal(once, third)


@pytest.mark.slow
def test_instances_are_independent(opened: Any) -> None:
    one, other, alone = opened("FL"), opened("FL"), opened("FL")
    first, second = drive(1, 100), drive(2, 100)
    expected = stepped(alone, first, 1)

    found = []
    for i in range(100):
        for slave, inputs in ((one, first), (other, second)):
            slave.set_all({name: v[i] for name, v in inputs.items()})
            slave.step()
        found.append(one.get(*(f"{node}_k" for node in NODES)))

    assert np.array_equal(np.array(found), expected)
    assert one.get("disc_k") != other.get("disc_k")


@pytest.mark.slow
def test_a_tunable_does_what_the_configuration_does(
    opened: Any, config: Config
) -> None:
    values = {
        "thermal.disc_mass_correction_factor": 0.8,
        "thermal.disc_emissivity": 0.3,
        "thermal.pad_backplate_thermal_resistance_m2k_w": 2e-3,
        "thermal.heat_partition_correction_factor": 1.4,
    }
    inputs = drive(1, 600)
    slave = opened("FL")

    slave.set_all(values)
    found = stepped(slave, inputs, 1)

    changed = Target(config, ("FL",)).changed(values).config
    expected = marched(changed, rows_of(inputs, 1))
    nominal = marched(config, rows_of(inputs, 1))
    assert np.abs(expected - nominal).max() > 20.0
    assert np.abs(found - expected).max() < 1e-6


@pytest.mark.slow
def test_tunables_have_unit_bounds_and_meaning(
    fmu_file: Callable[[str, int], Path],
) -> None:
    fmpy = pytest.importorskip("fmpy")
    description = fmpy.read_model_description(str(fmu_file("FL", 2)))

    found = {
        v.name: v
        for v in description.modelVariables
        if v.causality == "parameter"
    }
    one = found["thermal.fluid_caliper_thermal_capacity_j_k"]
    assert (one.unit, float(one.min), float(one.max)) == ("J/K", 400.0, 8000.0)
    assert one.description == "fluid and caliper as one lump (Table 4.1)"
    assert all(v.description and v.min and v.max for v in found.values())


def test_all_tunables_of_table_4_1_but_one_are_responses(
    config: Config,
) -> None:
    keys = {one.key for one in responses(config, "FL")}

    # only both emissivities together show between disc and pads
    assert "thermal.pad_emissivity" not in keys
    assert len([k for k in keys if k.startswith("thermal.")]) >= 8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("thermal.disc_emissivity", 1.5, "out of its bounds"),
        ("speed_ms", float("nan"), "not finite"),
        ("grid_time_s", 1.0, "can not be set"),
    ],
)
def test_a_wrong_value_is_refused(
    opened: Any, name: str, value: float, reason: str
) -> None:
    slave = opened("FL")

    with pytest.raises(Exception, match=r"status 3|[Ee]rror"):
        slave.set_all({name: value})

    assert any(reason in text for text in slave.messages)


def car_samples(steps: int) -> dict[str, np.ndarray]:
    """Return values of roles at each step of a drive with two stops."""
    time_s = np.arange(steps) * STEP_S
    decel = np.where(
        (time_s % 20.0 > 12.0) & (time_s % 20.0 < 17.0), 3.0, -1.0
    )
    decel[time_s % 20.0 >= 17.0] = 0.0
    speed = np.maximum(5.0 - np.cumsum(decel) * STEP_S, 0.5)
    pressed = decel > 0.0
    noise = np.random.default_rng(1).normal(0.0, 1.0, (3, steps))
    pressure = np.where(pressed, 25e5, 0.0) + 2e3 * np.abs(noise[0])
    return {
        **{f"wheel_speed_{c}": speed for c in ("fl", "fr", "rl", "rr")},
        "vehicle_speed": speed,
        "primary_pressure": pressure,
        "secondary_pressure": pressure,
        "acceleration_longitudinal": -decel + 0.02 * noise[1],
        "powertrain_torque": np.where(pressed, 0.0, 900.0) + noise[2],
        "ambient_temperature": np.full(steps, 290.0),
        "brake_switch": pressed.astype(float),
        "ignition": np.ones(steps),
    }


# on every run test_fmu_drives compares a car's bits on a recorded drive
@pytest.mark.slow
@pytest.mark.full
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("hold", [1, 2, 20])
def test_temperatures_of_the_car_equal_those_of_the_estimator(
    opened: Any, vehicle: Any, fmi: int, hold: int
) -> None:
    config, signal_map = vehicle
    samples = car_samples(800)
    slave = opened("car", fmi)
    model = model_of(config, signal_map, "car")
    names = [v.name for v in model.variables if v.causality == "input"]
    held = {v.name: v.start for v in model.variables if v.name in names}
    corners = [c.name for c in config.disc_corners()]
    outputs = [f"{c}.{node}_k" for c in corners for node in NODES]
    estimator = Estimator(
        config, present_roles(signal_map), history_known=True
    )
    for i in range(0, 800, hold):
        held |= {name: values[i] for name, values in samples.items()}
        slave.set_all(held)
        slave.step(round(hold * STEP_S, 9))
        for k in range(i, i + hold):
            at_us = k * 50_000
            numbers = [ROLE_INDEX[name] for name in names]
            estimator.advance(
                array("q", [at_us] * len(names) + [at_us + 50_000]),
                array("i", [*numbers, TICK]),
                array("d", [*(held[name] for name in names), 0.0]),
            )
        expected = [
            estimator.state(c)[node] for c in corners for node in NODES
        ]
        assert slave.get(*outputs) == expected, i

    assert max(expected) > 320.0


@pytest.mark.parametrize(
    "platforms",
    [
        (),
        # two compilations
        pytest.param((PLATFORM,), marks=(pytest.mark.slow, pytest.mark.full)),
    ],
)
def test_the_same_model_gives_the_same_bytes(
    vehicle: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    platforms: Sequence[str],
) -> None:
    """Years later, too."""
    model = model_of(*vehicle, "FL")
    one, again = tmp_path / "one.fmu", tmp_path / "again.fmu"

    write_fmu(model, one, 2, platforms)
    monkeypatch.setattr(time, "time", lambda: 2e9)
    write_fmu(model, again, 2, platforms)

    assert one.read_bytes() == again.read_bytes()


def test_the_command_writes_sources_without_a_compiler(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "RR.fmu"
    car = str(ROOT / "config" / "example_vehicle.toml")

    code = main(
        [
            *("fmu", "export", "-c", car, "--corner", "RR", "-o", str(out)),
            *("--platform", "", "--fmi", "3"),
        ]
    )

    assert code == 0
    assert "brake_power_w" in capsys.readouterr().out
    with zipfile.ZipFile(out) as archive:
        names = set(archive.namelist())
    assert {"sources/march.c", "sources/network.h", "sources/fmi3.c"} <= names
    assert "sources/sample_pass.c" not in names
    assert not any(name.startswith("binaries") for name in names)


def test_an_unknown_platform_is_refused() -> None:
    with pytest.raises(UsageError, match="allowed are linux64"):
        compiler_of("amiga")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("platform", "compiler", "binary"),
    [
        (
            "aarch64-linux",
            "aarch64-linux-gnu-gcc",
            "aarch64-linux/bstm_car.so",
        ),
        ("win64", "x86_64-w64-mingw32-gcc", "x86_64-windows/bstm_car.dll"),
    ],
)
def test_other_platforms_are_cross_compiled(
    vehicle: Any, tmp_path: Path, platform: str, compiler: str, binary: str
) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")

    write_fmu(model_of(*vehicle, "car"), tmp_path / "x.fmu", 3, [platform])

    with zipfile.ZipFile(tmp_path / "x.fmu") as archive:
        start = archive.read(f"binaries/{binary}")[:4]
    assert start in {b"\x7fELF", b"MZ\x90\x00"}


def driven(
    fmu: Path, fmi: int, folder: Path, build: list[str], run: list[str]
) -> str:
    """Build a driver with the standard's headers, run it, return its text."""
    fmpy = pytest.importorskip("fmpy")
    headers = Path(fmpy.__file__).parent / "c-code"
    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(folder)
    sources = sorted((folder / "sources").glob("*.c"))
    driver = ROOT / "tests" / "exchange" / f"fmi{fmi}_driver.c"
    subprocess.run(
        [
            *(*build, "-ffp-contract=off", "-std=gnu99", "-I", str(headers)),
            *("-I", str(folder / "sources"), str(driver)),
            *(*map(str, sources), "-lm", "-o", str(folder / "driver.exe")),
        ],
        check=True,
    )
    done = subprocess.run(
        [*run, str(folder / "driver.exe")],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"WINEDEBUG": "-all", "WINEPREFIX": str(folder)},
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.split()
    assert lines[:2] == ["2000", "steps"]
    return " ".join(lines[2:])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "fmi"),
    [
        ("FL", 2),
        *(
            pytest.param(*one, marks=pytest.mark.full)
            for one in (("FL", 3), ("car", 2), ("car", 3))
        ),
    ],
)
def test_the_sources_are_clean_with_standard_headers_and_sanitizers(
    fmu_file: Callable[[str, int], Path], tmp_path: Path, name: str, fmi: int
) -> None:
    """Two instances are stepped in turn, states saved and restored."""
    build = [
        *("cc", "-g", "-O0", "-fsanitize=address,undefined"),
        "-fno-sanitize-recover=all",
    ]

    assert driven(fmu_file(name, fmi), fmi, tmp_path, build, [])


WINE = shutil.which("wine64") or "/usr/lib/wine/wine64"


@pytest.mark.slow
@pytest.mark.full
@pytest.mark.parametrize(
    ("build", "run"),
    [
        (["aarch64-linux-gnu-gcc", "-static", "-O3"], ["qemu-aarch64-static"]),
        (["x86_64-w64-mingw32-gcc", "-O3"], [WINE]),
    ],
    ids=["aarch64", "windows"],
)
@pytest.mark.parametrize("name", ["FL", "car"])
def test_other_machines_give_the_same_bits(
    fmu_file: Callable[[str, int], Path],
    tmp_path: Path,
    name: str,
    build: list[str],
    run: list[str],
) -> None:
    missing = [p for p in (build[0], run[0]) if shutil.which(p) is None]
    if missing:
        pytest.skip(f"{missing[0]} is not installed")
    (tmp_path / "here").mkdir()
    (tmp_path / "there").mkdir()
    fmu = fmu_file(name, 3)

    here = driven(fmu, 3, tmp_path / "here", ["cc", "-O3"], [])
    there = driven(fmu, 3, tmp_path / "there", build, run)

    if name == "FL":
        assert there == here
    else:
        # the last bit of exp is the platform's
        found = np.array([float(x) for x in there.split()])
        expected = np.array([float(x) for x in here.split()])
        assert np.abs(found - expected).max() < 1e-6

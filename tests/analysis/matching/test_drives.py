"""Logs as drives: inputs, thermocouples, and where they begin."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.matching.drives import (
    GRID_S,
    Drive,
    Thermocouple,
    drive_of,
    log_events,
    read_drive,
    read_drives,
)
from bstm_daemon.analysis.matching.march import (
    initial_temperatures,
    march,
)
from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.errors import LogError, UsageError
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.simulation import SimulatedDrive, simulate
from bstm_daemon.simulation.drives import parse_drive
from bstm_daemon.simulation.recorder import (
    START_STAMP_S,
    Encoder,
    write_candump,
)
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "config" / "example_vehicle.toml"

SHORT = """
[drive]
name = "short"
description = "two stops and a soak"
ambient_c = 25.0
start_c = 60.0
propulsion = "engine"
thermocouple_logger = true

[[segment]]
repeat = 2

[[segment.segment]]
speed_kmh = 80.0
rate_ms2 = 2.5
gear = 3
duration_s = 10.0

[[segment.segment]]
speed_kmh = 0.0
rate_ms2 = 5.0
gear = 0

[[segment]]
parked = true
ignition = false
duration_s = 400.0
"""


@pytest.fixture(scope="module")
def driven() -> SimulatedDrive:
    return simulate(parse_drive(SHORT, "short.toml"), sensors="n1", seed=4)


@pytest.fixture(scope="module")
def log(
    driven: SimulatedDrive, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("drives") / "short.log"
    encoder = Encoder(ROOT / "dbc" / "example_vehicle.dbc")
    write_candump(path, driven, encoder)
    return path


@pytest.fixture(scope="module")
def drive(log: Path) -> Drive:
    config, signal_map = load_vehicle(EXAMPLE)
    return read_drive(log, config, signal_map, estimates=True)


def test_no_brake_energy_is_lost_on_the_coarser_grid(
    drive: Drive, driven: SimulatedDrive
) -> None:
    found = drive.channel("FL", "brake_power_w").sum() * GRID_S

    true = driven.brake_energy_j[-1, 0]
    assert found == pytest.approx(true, rel=0.03)


def test_thermocouples_keep_their_own_times(
    drive: Drive, driven: SimulatedDrive
) -> None:
    couple = drive.measured["FL"]["disc"]
    log_s = couple.time_s + drive.start_s - START_STAMP_S

    true = np.interp(log_s, driven.slow_time_s, driven.truth["FL.disc"])
    off = couple.temperature_k - true
    # white noise of n1, 0.5 K; a second late in a stop would be 20 K
    assert np.std(off) < 1.5
    assert set(drive.measured) == {"FL", "FR"}


def test_the_air_of_a_sleeping_bus_is_the_last_one(drive: Drive) -> None:
    air = drive.channel("FL", "ambient_k")

    assert air[20:] == pytest.approx(25.0 + KELVIN_OFFSET)


def test_the_estimator_begins_as_measured(drive: Drive) -> None:
    assert drive.estimates is not None
    columns = drive.estimates.columns

    for node in ("disc", "pad_front", "pad_back", "fluid"):
        assert columns[f"FL.{node}_c"][0] == pytest.approx(60.0, abs=1.5)


def test_the_coarse_grid_is_the_estimator_within_half_a_kelvin(
    drive: Drive,
) -> None:
    config, _ = load_vehicle(EXAMPLE)
    assert drive.estimates is not None
    program = compile_corner(config, config.corner[0])
    initial = initial_temperatures(program, drive, "FL")

    found = march([program], drive, "FL", initial)

    columns = drive.estimates.columns
    for node, limit in (("disc", 0.5), ("pad_back", 0.2), ("fluid", 0.2)):
        fine = np.interp(
            drive.time_s, columns["time_s"], columns[f"FL.{node}_c"]
        )
        coarse = found[node][:, 0] - KELVIN_OFFSET
        assert np.abs(coarse - fine)[4:].max() < limit, node


def test_a_forced_node_follows_and_is_free_in_gaps(
    drive: Drive, config: Config
) -> None:
    program = compile_corner(config, config.corner[0])
    initial = initial_temperatures(program, drive, "FL")
    series = np.full(len(drive), 400.0)
    series[100:] = np.nan

    found = march([program], drive, "FL", initial, {"fluid": series})

    assert found["fluid"][:100, 0] == pytest.approx(400.0)
    assert np.all(np.diff(found["fluid"][100:, 0]) < 0.0)


def test_variants_have_their_own_begin_and_series(
    drive: Drive, config: Config
) -> None:
    """Side by side they are what each is alone, bit for bit."""
    program = compile_corner(config, config.corner[0])
    begin = initial_temperatures(program, drive, "FL")
    begins = [begin, {node: k + 30.0 for node, k in begin.items()}]
    disc = np.linspace([300.0, 350.0], [500.0, 400.0], len(drive))

    both = march([program] * 2, drive, "FL", begins, {"disc": disc})

    for i, own in enumerate(begins):
        alone = march([program], drive, "FL", own, {"disc": disc[:, i]})
        assert np.array_equal(both["fluid"][:, i], alone["fluid"][:, 0])
    assert np.ptp(both["fluid"][-1]) > 1.0


def test_a_gap_of_a_thermocouple_is_not_bridged() -> None:
    couple = Thermocouple(
        np.array([0.0, 1.0, 60.0, 61.0]), np.array([300.0, 301, 360, 361])
    )

    found = couple.at(np.array([0.5, 30.0, 60.5, 90.0]))

    assert found[[0, 2]] == pytest.approx([300.5, 360.5])
    assert np.isnan(found[[1, 3]]).all()


def test_a_kept_record_is_its_segments_in_order(
    drive: Drive, log: Path, tmp_path: Path
) -> None:
    lines = log.read_bytes().splitlines(keepends=True)
    half = len(lines) // 2
    for name, part in (("1", lines[:half]), ("2", lines[half:])):
        with gzip.open(tmp_path / f"{name}.log.gz", "wb") as stream:
            stream.writelines(part)

    found = read_drive(tmp_path, *load_vehicle(EXAMPLE))

    assert np.array_equal(found.inputs, drive.inputs, equal_nan=True)
    assert found.start_s == drive.start_s


def test_a_part_begins_where_it_is_cut(drive: Drive) -> None:
    """Its name, its stamps, its thermocouples and its inputs."""
    part = drive.part(40, 100)

    assert part.name == "short.log from 20 to 50 s"
    assert part.start_s == drive.start_s + 20.0
    assert np.array_equal(part.inputs, drive.inputs[40:100], equal_nan=True)
    assert np.array_equal(part.speed_ms, drive.speed_ms[40:100])
    whole, cut = (one.measured["FL"]["disc"] for one in (drive, part))
    inside = (whole.time_s >= 20.0) & (whole.time_s <= 50.0)
    assert cut.time_s == pytest.approx(whole.time_s[inside] - 20.0)
    assert cut.temperature_k.tolist() == whole.temperature_k[inside].tolist()
    assert drive.part(0, len(drive)) is drive


@pytest.mark.slow
def test_drives_are_read_in_order_each_once(log: Path, tmp_path: Path) -> None:
    config, signal_map = load_vehicle(EXAMPLE)
    later = tmp_path / "later.log"
    later.write_bytes(log.read_bytes())
    logs = [log, later]
    shown: list[float] = []

    found = read_drives(logs, config, signal_map, progress=shown.append)

    # fused heat: what all of them taught is there from the first one on
    one, two = found
    assert (one.name, two.name) == ("short.log", "later.log")
    assert shown.count(1.0) == 4
    once = read_drive(log, config, signal_map)
    assert once.learned is not None
    assert one.learned != once.learned

    heat = config.heat.model_copy(update={"mode": "ff"})
    plain = config.model_copy(update={"heat": heat})
    one, two = read_drives(logs, plain, signal_map)
    assert np.array_equal(one.inputs, two.inputs, equal_nan=True)


def test_all_parts_of_a_log_are_taken(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, signal_map = load_vehicle(EXAMPLE)
    whole = [*log_events(log, signal_map)]
    shown: list[float] = []
    (events,) = whole
    cuts = [slice(0, 0), slice(0, 500), slice(500, None)]
    parts = [
        Events(events.time_us[cut], events.role[cut], events.value[cut])
        for cut in cuts
    ]
    monkeypatch.setattr(EventLog, "events", lambda _: iter(parts))

    found = [*log_events(log, signal_map, None, shown.append)]

    assert [len(one) for one in found] == [0, 500, len(events) - 500]
    assert len(shown) == 3
    by_parts = drive_of("a", of(config, signal_map), iter(parts))
    at_once = drive_of("a", of(config, signal_map), iter(whole))
    assert by_parts.start_s == at_once.start_s
    assert at_once.start_s == pytest.approx(START_STAMP_S, abs=0.2)
    assert np.array_equal(by_parts.inputs, at_once.inputs, equal_nan=True)


def of(config: Config, signal_map: SignalMap) -> Estimator:
    return Estimator(config, present_roles(signal_map))


def test_what_is_no_drive_is_refused_by_name(log: Path) -> None:
    config, signal_map = load_vehicle(EXAMPLE)
    (events,) = log_events(log, signal_map)
    stamps_us = events.time_us.copy()
    stamps_us[len(stamps_us) // 2 :] -= 100_000_000

    with pytest.raises(LogError, match=r"^back: its clock jumps; split the"):
        drive_of(
            *("back", of(config, signal_map)),
            [Events(stamps_us, events.role, events.value)],
        )
    with pytest.raises(LogError, match=r"^nothing: too short$"):
        drive_of("nothing", of(config, signal_map), [])


def test_a_folder_without_segments_is_no_record(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no segment of a record"):
        read_drive(tmp_path, *load_vehicle(EXAMPLE))


def test_a_measured_disc_is_no_heat(log: Path) -> None:
    config, signal_map = load_vehicle(EXAMPLE)
    heat = config.heat.model_copy(update={"mode": "measured"})

    with pytest.raises(UsageError, match="choose another mode"):
        read_drive(log, config.model_copy(update={"heat": heat}), signal_map)

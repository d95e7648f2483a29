"""Files: whole or not at all, the same every time."""

import csv
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import cast

import cantools
import numpy as np
import pytest
from cantools.database.can import Database

from bstm_daemon.errors import ConfigError, FileAccessError
from bstm_daemon.simulation import SimulatedDrive
from bstm_daemon.simulation import recorder as recorder_module
from bstm_daemon.simulation.recorder import (
    LOGGER_SIGNALS,
    VEHICLE_SIGNALS,
    Encoder,
    Stream,
    frames,
    in_order,
    write_candump,
    write_truth,
)
from bstm_daemon.units import UNITS

DATABASE = Path(__file__).parents[2] / "dbc" / "example_vehicle.dbc"


def example_database() -> Database:
    """Return the example car's DBC as cantools loads it."""
    database = cantools.database.load_file(DATABASE, strict=True)
    assert isinstance(database, Database)
    return database


def test_cantools_reads_the_roles_back(
    short: SimulatedDrive, encoder: Encoder
) -> None:
    database = example_database()
    read = defaultdict(list)
    for stamp_s, frame_id, data in frames(short, encoder, 0.0):
        message = database.get_message_by_frame_id(frame_id)
        assert len(data) == message.length
        decoded = cast(
            "dict[str, float]", message.decode(data, decode_choices=False)
        )
        for name, value in decoded.items():
            read[message.name, name].append((stamp_s, value))

    for table, sources, step_s in (
        (VEHICLE_SIGNALS, short.roles, 0.01),
        (LOGGER_SIGNALS, short.temperatures, 1.0),
    ):
        for message_name, signals in table.items():
            message = database.get_message_by_name(message_name)
            for name, role in signals.items():
                signal = message.get_signal_by_name(name)
                unit = UNITS[signal.unit or "1"]
                times, values = np.array(read[message_name, name]).T
                si = values * unit.factor + unit.offset
                # the sample in force at the stamp: 1 Hz rows start at 1 s
                first = 0.0 if step_s < 1 else step_s
                row = np.floor((times - first) / step_s + 1e-6).astype(int)
                truth = sources[role][np.maximum(row, 0)]
                tolerance = 0.5001 * signal.scale * unit.factor
                np.testing.assert_allclose(si, truth, atol=tolerance)


def test_frames_come_in_order_at_their_cycle_times(
    short: SimulatedDrive, encoder: Encoder
) -> None:
    database = example_database()
    stamps = defaultdict(list)
    last = 0.0
    for stamp_s, frame_id, _ in frames(short, encoder, 0.0):
        assert stamp_s >= last
        last = stamp_s
        stamps[frame_id].append(stamp_s)

    assert set(stamps) == {m.frame_id for m in database.messages}
    for frame_id, sent in stamps.items():
        message = database.get_message_by_frame_id(frame_id)
        np.testing.assert_allclose(
            np.diff(sent), (message.cycle_time or 0) / 1000, atol=1e-9
        )
    # staggered: no two messages at the same instant
    first = sorted(sent[0] for sent in stamps.values())
    assert min(np.diff(first)) > 1e-3


def test_car_falls_silent_with_its_ignition(
    short: SimulatedDrive, encoder: Encoder
) -> None:
    off_s = short.time_s[np.flatnonzero(~short.bus_on)[0]]
    last = {
        frame_id: stamp_s
        for stamp_s, frame_id, _ in frames(short, encoder, 0.0)
    }

    assert 0 < off_s < short.time_s[-1] - 5
    for frame_id, stamp_s in last.items():
        if frame_id < 0x6A0:
            assert stamp_s < off_s
        else:
            assert stamp_s > short.time_s[-1] - 1.1


def test_value_beyond_its_range_is_sent_at_the_limit(
    short: SimulatedDrive, encoder: Encoder
) -> None:
    hot = {
        role: np.full_like(values, 3000.0)
        for role, values in short.temperatures.items()
    }
    message = example_database().get_message_by_name("ThermocouplesA_FL")
    hot_drive = replace(short, temperatures=hot)
    sent = [
        cast("dict[str, float]", message.decode(data))
        for _, frame_id, data in frames(hot_drive, encoder)
        if frame_id == message.frame_id
    ]

    assert len(sent) > 20
    assert {value for frame in sent for value in frame.values()} == {1500.0}


def edited(tmp_path: Path, old: str, new: str) -> Path:
    """Return the example DBC with *old* replaced by *new*."""
    text = DATABASE.read_text(encoding="cp1252")
    assert old in text
    path = tmp_path / "other.dbc"
    path.write_text(text.replace(old, new), encoding="cp1252")
    return path


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("416 WheelSpeeds", "416 Speeds", "no message 'WheelSpeeds'"),
        ("SG_ YawRate", "SG_ Yaw", "'Inertial': no signal 'YawRate'"),
        ("0|16@1- (0.05", "7|16@0- (0.05", "is not Intel byte order"),
        (
            'BA_ "GenMsgCycleTime" BO_ 416 20;\n',
            "",
            "'WheelSpeeds': no GenMsgCycleTime",
        ),
        ('VERSION "1.0"', "VERSION", "other.dbc"),
    ],
)
def test_unfit_dbc_is_named(
    tmp_path: Path, old: str, new: str, problem: str
) -> None:
    path = edited(tmp_path, old, new)
    if "SG_ Yaw" in new:
        path.write_text(
            path.read_text(encoding="cp1252").replace(
                "CM_ SG_ 432 YawRate", "CM_ SG_ 432 Yaw"
            ),
            encoding="cp1252",
        )

    with pytest.raises(ConfigError, match=problem):
        Encoder(path)


def test_log_holds_every_frame(
    tmp_path: Path, short: SimulatedDrive, encoder: Encoder
) -> None:
    path = tmp_path / "short.log"

    count = write_candump(path, short, encoder, channel="vcan1")

    lines = path.read_text(encoding="ascii").splitlines()
    sent = list(frames(short, encoder))
    assert count == len(lines) == len(sent)
    for line, (stamp_s, frame_id, data) in zip(lines, sent, strict=True):
        stamp, channel, frame = line.split()
        assert float(stamp.strip("()")) == pytest.approx(stamp_s, abs=1e-6)
        assert len(stamp) == len("(1700000000.000000)")
        assert channel == "vcan1"
        assert frame == f"{frame_id:03X}#{data.hex().upper()}"


def test_log_is_the_same_every_time(
    tmp_path: Path, short: SimulatedDrive, encoder: Encoder
) -> None:
    for name in ("a.log", "b.log"):
        write_candump(tmp_path / name, short, encoder)

    a, b = ((tmp_path / n).read_bytes() for n in ("a.log", "b.log"))
    assert a == b
    assert a.startswith(b"(1700000000.000000) can0 110#")


@pytest.mark.parametrize("broken", [KeyboardInterrupt, ValueError])
def test_interrupted_log_leaves_nothing_and_keeps_the_old(
    tmp_path: Path,
    short: SimulatedDrive,
    encoder: Encoder,
    monkeypatch: pytest.MonkeyPatch,
    broken: type[BaseException],
) -> None:
    path = tmp_path / "short.log"
    path.write_text("old")

    def cut(streams: list[Stream]) -> Iterator[tuple[int, int, bytes]]:
        for index, item in enumerate(in_order(streams)):
            if index == 100:
                raise broken
            yield item

    monkeypatch.setattr(recorder_module, "in_order", cut)
    with pytest.raises(broken):
        write_candump(path, short, encoder)

    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_unwritable_place_is_named(
    tmp_path: Path, short: SimulatedDrive, encoder: Encoder
) -> None:
    path = tmp_path / "none" / "short.log"

    with pytest.raises(FileAccessError, match=r"none/short\.log"):
        write_candump(path, short, encoder)
    with pytest.raises(FileAccessError, match=r"none/short\.log"):
        write_truth(path, short)


def test_folder_in_the_way_is_named(
    tmp_path: Path, short: SimulatedDrive
) -> None:
    path = tmp_path / "truth.csv"
    path.mkdir()

    with pytest.raises(FileAccessError, match=r"truth\.csv"):
        write_truth(path, short)

    assert list(tmp_path.iterdir()) == [path]


def test_truth_has_a_row_a_second(
    tmp_path: Path, short: SimulatedDrive
) -> None:
    path = tmp_path / "truth.csv"

    write_truth(path, short)

    with path.open(encoding="ascii", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(short.slow_time_s)
    np.testing.assert_allclose(
        [float(row["FL.disc_c"]) for row in rows],
        short.truth["FL.disc"] - 273.15,
        rtol=1e-8,
    )
    np.testing.assert_allclose(
        [float(row["RR.brake_energy_j"]) for row in rows],
        short.brake_energy_j[:, 3],
        rtol=1e-8,
    )

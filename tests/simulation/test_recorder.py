"""Files: whole or not at all, the same every time."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.errors import FileAccessError
from bstm_daemon.simulation import SimulatedDrive
from bstm_daemon.simulation import recorder as recorder_module
from bstm_daemon.simulation.frames import Encoder, Stream, frames, in_order
from bstm_daemon.simulation.recorder import write_candump, write_truth


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

"""Logs looked at through a DBC: which interface, which frames, what values."""

from collections.abc import Callable
from pathlib import Path

import pytest
from cantools.database.can import Database

from bstm_daemon.analysis.setup.name_rules import name_matches
from bstm_daemon.analysis.setup.recording import Recording, read_recording
from bstm_daemon.errors import LogError

Maker = Callable[..., Database]
Reader = Callable[..., Recording]

SPEEDS = ["WS_FL m/s", "WS_FR m/s"]


@pytest.fixture
def read(tmp_path: Path, make_database: Maker) -> Reader:
    """Return a reader of logs given as texts."""

    def read(*texts: str) -> Recording:
        database = make_database(SPEEDS, ["GEAR"])
        logs = []
        for number, text in enumerate(texts):
            logs.append(tmp_path / f"{number}.log")
            logs[-1].write_text(text)
        return read_recording(logs, database, name_matches(database))

    return read


def frame(time_s: float, can_id: str, data: str, interface: str = "a") -> str:
    return f"({time_s:.3f}) {interface} {can_id}#{data}\n"


def test_values_and_times(read: Reader) -> None:
    recording = read(
        frame(5.0, "064", "01020000" * 2) + frame(5.5, "064", "03040000" * 2)
    )

    left = recording.samples["M0", "WS_FL"]
    assert left.value.tolist() == [1.0, 3.0]
    assert left.time_s.tolist() == [0.0, 0.5]
    assert left.rate_hz == 2.0
    assert recording.samples["M0", "WS_FR"].value.tolist() == [2.0, 4.0]
    assert ("M1", "GEAR") not in recording.samples
    assert recording.duration_s == 0.5


def test_logs_are_laid_end_to_end(read: Reader) -> None:
    """Whatever their clocks say, and with a gap that is no sample rate."""
    one = frame(100.0, "064", "00" * 8) + frame(101.0, "064", "00" * 8)
    other = frame(7.0, "064", "01" * 8) + frame(8.0, "064", "01" * 8)

    recording = read(one, other)

    left = recording.samples["M0", "WS_FL"]
    assert left.time_s.tolist() == [0.0, 1.0, 11.0, 12.0]
    assert left.rate_hz == 1.0
    assert recording.duration_s == 2.0


def test_the_interface_that_fits_is_taken(read: Reader) -> None:
    recording = read(
        frame(1.0, "064", "00" * 8, "b")
        + frame(1.0, "7AB", "00", "b")
        + frame(1.1, "064", "00" * 8)
        + frame(1.2, "064", "00" * 8)
        + frame(1.2, "00000064", "00" * 8)
    )

    assert recording.interface == "a"
    assert recording.others == {"b": (2, 1)}
    assert recording.unknown == ["00000064"]
    assert len(recording.samples["M0", "WS_FL"].value) == 2


def test_longer_frames_are_read_and_named(
    tmp_path: Path, make_database: Maker
) -> None:
    database = make_database(SPEEDS)
    database.messages[0].length = 4
    log = tmp_path / "a.log"
    log.write_text(frame(1.0, "064", "0502000000000000"))

    recording = read_recording([log], database, name_matches(database))

    assert recording.lengths == {"M0": 8}
    assert recording.samples["M0", "WS_FL"].value.tolist() == [5.0]


def test_shorter_frames_give_nothing(read: Reader) -> None:
    recording = read(frame(1.0, "064", "05") + frame(1.0, "065", "00" * 8))

    assert recording.lengths == {}
    assert set(recording.samples) == {("M1", "GEAR")}


def test_a_log_without_the_dbcs_ids(read: Reader) -> None:
    with pytest.raises(LogError, match="no frame has an id of the DBC"):
        read(frame(1.0, "7AB", "00"))

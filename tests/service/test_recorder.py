"""Recorded frames come back, bounds hold, a bad disk costs frames only."""

import gzip
import os
import re
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.bus.live import link
from bstm_daemon.bus.logs.candump_line import ERROR_FLAG
from bstm_daemon.bus.opening import open_log
from bstm_daemon.bus.signals.extraction import FD_LENGTHS
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.config.service import RecordConfig
from bstm_daemon.service.record_store import KEPT, RecordStore
from bstm_daemon.service.recorder import Recorder, RecordOutcome

Frame = tuple[int, int, bool, bytes, int]
"""Bus, id, extended, data, stamp [us]."""
Make = Callable[..., Recorder]

NOON_US = 1_795_262_400_000_000
"""2026-11-21T12:00:00Z."""
SECOND_US = 1_000_000
CHANNELS = ["can0", "can1"]
WAIT_S = 60.0


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Make]:
    """Return a function that starts a recorder in ``record``."""
    made = []

    def started(**changes: Any) -> Recorder:
        config = RecordConfig(enabled=True, **changes)
        recorder = Recorder(config, tmp_path / "record", CHANNELS)
        made.append(recorder)
        return recorder

    yield started
    for recorder in made:
        recorder.close()


def segments(folder: Path) -> list[Path]:
    """Return the segments in *folder*, in the order of writing."""
    return sorted(
        folder.glob("*.log.gz"), key=lambda path: path.name.rsplit("-")[-1]
    )


def frames_of(paths: list[Path]) -> list[Frame]:
    """Read *paths* as a replay does."""
    found: list[Frame] = []
    for path in paths:
        reader = open_log(path)
        for chunk in reader.chunks():
            found += [
                (
                    CHANNELS.index(reader.interfaces[channel]),
                    can_id,
                    extended,
                    data[:length].tobytes(),
                    time_us,
                )
                for channel, can_id, extended, data, length, time_us in zip(
                    chunk.channel.tolist(),
                    chunk.can_id.tolist(),
                    chunk.extended.tolist(),
                    chunk.data,
                    chunk.length.tolist(),
                    chunk.time_us.tolist(),
                    strict=True,
                )
            ]
        assert not reader.truncated
        assert reader.refused[RejectReason.MALFORMED] == 0
    return found


def record(
    recorder: Recorder,
    bus: int,
    can_id: int,
    extended: bool,  # noqa: FBT001
    data: bytes | memoryview,
    stamp_us: int,
    *,
    is_error: bool = False,
    is_remote: bool = False,
) -> None:
    """Record a frame of *bus*."""
    kind = is_error, is_remote
    frame = link.Frame(0, can_id, extended, bytes(data), *kind)
    recorder.frame(bus, frame, stamp_us)


def record_seconds(recorder: Recorder, first: int, last: int) -> None:
    """Record a frame a second, from NOON + *first* s to before *last*."""
    for second in range(first, last):
        data = second.to_bytes(8, "big")
        record(recorder, 0, 0x123, False, data, NOON_US + second * SECOND_US)
        assert recorder.wait(WAIT_S)


def seconds_of(paths: list[Path]) -> list[int]:
    """Return which of those frames *paths* have."""
    return [int.from_bytes(data, "big") for *_, data, _ in frames_of(paths)]


FRAMES = st.lists(
    st.tuples(
        st.integers(0, 1),
        st.one_of(
            st.tuples(st.integers(0, 0x7FF), st.just(False)),
            st.tuples(st.integers(0, 0x1FFFFFFF), st.just(True)),
        ),
        st.sampled_from(FD_LENGTHS).flatmap(
            lambda size: st.binary(min_size=size, max_size=size)
        ),
        st.integers(0, 3 * SECOND_US),
    ),
    min_size=1,
    max_size=40,
)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(drawn=FRAMES, segment_s=st.sampled_from([1.0, 2.5, 60.0]))
def test_what_is_recorded_is_read_back(
    tmp_path_factory: pytest.TempPathFactory,
    drawn: list[tuple[int, tuple[int, bool], bytes, int]],
    segment_s: float,
) -> None:
    """Any id, any length, CAN FD, to the microsecond, in order."""
    folder = tmp_path_factory.mktemp("record")
    config = RecordConfig(segment_s=segment_s)
    recorder = Recorder(config, folder, CHANNELS)
    frames = []
    stamp_us = NOON_US
    for bus, (can_id, extended), data, later_us in drawn:
        stamp_us += later_us
        frames.append((bus, can_id, extended, data, stamp_us))
        record(recorder, *frames[-1])
        assert recorder.wait(WAIT_S)

    outcome = recorder.close()

    assert outcome.frames == len(frames)
    assert (outcome.lost_frames, outcome.failures) == (0, 0)
    paths = segments(folder)
    assert len(paths) == outcome.segments
    assert frames_of(paths) == frames
    for path in paths:
        stamps = [frame[-1] for frame in frames_of([path])]
        assert stamps[-1] - stamps[0] < segment_s * SECOND_US


def test_the_text_is_that_of_candump(make: Make, tmp_path: Path) -> None:
    """What canutils' canplayer takes."""
    recorder = make()
    record(recorder, 0, 0x12, False, b"\xab\x01", NOON_US + 5)
    record(recorder, 1, 0x12, True, memoryview(b""), NOON_US + 6)
    record(recorder, 1, 0x7FF, False, bytes(12), NOON_US + 7)
    record(recorder, 0, 0x100, False, b"", NOON_US + 9, is_remote=True)
    record(recorder, 0, 0x4, False, bytes(8), NOON_US + 10, is_error=True)
    record(recorder, 0, 0x4, False, b"\2", NOON_US + 11)
    recorder.close()

    (path,) = segments(tmp_path / "record")
    assert path.name == "20261121T120000-000005Z-000000.log.gz"
    assert gzip.decompress(path.read_bytes()).decode() == (
        "(1795262400.000005) can0 012#AB01\n"
        "(1795262400.000006) can1 00000012#\n"
        f"(1795262400.000007) can1 7FF##0{'00' * 12}\n"
        "(1795262400.000009) can0 100#R\n"
        "(1795262400.000010) can0 20000004#0000000000000000\n"
        "(1795262400.000011) can0 004#02\n"
    )


def test_error_and_remote_frames_are_told_by_the_reader(
    make: Make, tmp_path: Path
) -> None:
    """A replay refuses them as the live service does."""
    recorder = make()
    record(recorder, 0, 1, False, bytes(8), NOON_US, is_error=True)
    record(recorder, 0, ERROR_FLAG | 1, True, bytes(8), NOON_US, is_error=True)
    record(recorder, 0, 0x100, True, b"", NOON_US, is_remote=True)
    record(recorder, 0, 0x100, True, b"", NOON_US)
    recorder.close()

    reader = open_log(segments(tmp_path / "record")[0])
    assert sum(len(chunk) for chunk in reader.chunks()) == 1
    assert reader.refused == Counter(
        {RejectReason.ERROR_FRAME: 2, RejectReason.REMOTE_FRAME: 1}
    )


def test_a_channel_that_no_log_can_hold_gets_another_name(
    tmp_path: Path,
) -> None:
    names = ["can0", "my bus", "can0", ""]
    recorder = Recorder(RecordConfig(), tmp_path, names)
    for bus in range(4):
        record(recorder, bus, 1, False, b"", NOON_US)
    recorder.close()

    reader = open_log(segments(tmp_path)[0])
    assert sum(len(chunk) for chunk in reader.chunks()) == 4
    assert reader.interfaces == ["can0", "bus1", "bus2", "bus3"]


def test_a_segment_lasts_segment_s(make: Make, tmp_path: Path) -> None:
    recorder = make(segment_s=10)
    record_seconds(recorder, 0, 25)
    recorder.close()

    assert [seconds_of([path]) for path in segments(tmp_path / "record")] == [
        list(range(10)),
        list(range(10, 20)),
        list(range(20, 25)),
    ]


def test_a_small_step_back_makes_no_segment(
    make: Make, tmp_path: Path
) -> None:
    """Buses are drained one after the other; a set clock is another thing."""
    recorder = make(segment_s=10)
    for offset_us in (0, 9_000, 4_000, -1_000, -3600 * SECOND_US, 0):
        record(recorder, 0, 1, False, b"", NOON_US + offset_us)
    recorder.close()

    paths = segments(tmp_path / "record")
    assert [len(frames_of([path])) for path in paths] == [4, 1, 1]


def test_a_silent_bus_is_written(make: Make, tmp_path: Path) -> None:
    recorder = make(segment_s=10)
    record_seconds(recorder, 0, 3)

    recorder.tick(NOON_US + 9 * SECOND_US)
    assert recorder.wait(WAIT_S)
    assert recorder.outcome().segments == 0
    recorder.tick(NOON_US + 10 * SECOND_US)
    assert recorder.wait(WAIT_S)

    assert seconds_of(segments(tmp_path / "record")) == [0, 1, 2]


def noise(recorder: Recorder, first: int, count: int) -> None:
    """Record *count* frames, 10 ms apart, that hardly shrink."""
    for number in range(first, first + count):
        data = os.urandom(8)
        record(recorder, 0, 0x123, False, data, NOON_US + number * 10_000)
        if number % 100 == 0:
            assert recorder.wait(WAIT_S)


def size_of(paths: list[Path]) -> int:
    return sum(path.stat().st_size for path in paths)


def test_the_ring_keeps_its_bound_and_the_newest(
    make: Make, tmp_path: Path
) -> None:
    recorder = make(ring_bytes=2**16)
    noise(recorder, 0, 12_000)
    outcome = recorder.close()

    paths = segments(tmp_path / "record")
    assert 2**15 < size_of(paths) <= 2**16
    assert outcome.lost_frames == 0
    found = frames_of(paths)
    assert found[-1][-1] == NOON_US + 11_999 * 10_000
    stamps = [frame[-1] for frame in found]
    assert all(b - a == 10_000 for a, b in pairwise(stamps))
    assert len(found) < 12_000


@settings(max_examples=15, deadline=None)
@given(
    sizes=st.lists(st.integers(1, 30_000), min_size=1, max_size=12),
    ring=st.integers(2**16, 2**17),
    kept=st.integers(2**16, 2**17),
    keeps=st.sets(st.integers(0, 11)),
)
def test_neither_bound_is_ever_passed(
    tmp_path_factory: pytest.TempPathFactory,
    sizes: list[int],
    ring: int,
    kept: int,
    keeps: set[int],
) -> None:
    """After each step, whatever the sizes of the segments."""
    folder = tmp_path_factory.mktemp("store")
    config = RecordConfig(
        ring_bytes=ring, kept_bytes=kept, segment_s=60, before_s=90, after_s=90
    )
    store = RecordStore(config, folder)
    for number, size in enumerate(sizes):
        start_us = NOON_US + number * 60 * SECOND_US
        store.extend(store.write(start_us, os.urandom(size)))
        if number in keeps:
            store.keep(f"reason-{number % 3}", start_us)
        ring_size = size_of(segments(folder))
        kept_size = size_of(list((folder / KEPT).rglob("*.log.gz")))
        assert ring_size == store.ring_bytes <= ring
        assert kept_size == store.kept_bytes <= kept
        assert segments(folder)


def test_an_occasion_is_kept_from_before_to_after(
    make: Make, tmp_path: Path
) -> None:
    """Whole segments, those of the ring and those to come."""
    recorder = make(segment_s=10, before_s=15, after_s=20)
    record_seconds(recorder, 0, 55)
    recorder.keep("fluid boils!", NOON_US + 54 * SECOND_US)
    assert recorder.wait(WAIT_S)
    (record,) = (tmp_path / "record" / KEPT).iterdir()
    at_once = seconds_of(segments(record))
    record_seconds(recorder, 55, 120)
    recorder.close()

    assert record.name == "20261121T120054Z-fluid-boils-"
    # 39 s lies in the segment from 30 s on; the one under way is written
    assert at_once == list(range(30, 55))
    # 74 s lies in the segment from 65 s on
    assert seconds_of(segments(record)) == list(range(30, 75))
    assert seconds_of(segments(tmp_path / "record")) == list(range(120))
    assert list(record.parent.iterdir()) == [record]


def test_others_read_no_record(tmp_path: Path) -> None:
    """It tells where the car was."""
    folder = tmp_path / "record"
    store = RecordStore(RecordConfig(enabled=True), folder)
    before = os.umask(0o022)
    try:
        segment = store.write(NOON_US, b"(1795262400.000000) can0 110#00\n")
        store.keep("model", NOON_US)
    finally:
        os.umask(before)

    [kept] = (folder / KEPT).iterdir()
    modes = {
        path.relative_to(tmp_path): path.stat().st_mode & 0o777
        for path in (folder, *folder.rglob("*"))
    }
    record = Path("record")
    assert modes == {
        record: 0o750,
        record / segment.name: 0o640,
        record / KEPT: 0o750,
        record / KEPT / kept.name: 0o750,
        record / KEPT / kept.name / segment.name: 0o640,
    }


def test_the_same_reason_again_makes_the_record_longer(
    make: Make, tmp_path: Path
) -> None:
    recorder = make(segment_s=10, before_s=5, after_s=20)
    record_seconds(recorder, 0, 20)
    recorder.keep("risk", NOON_US + 19 * SECOND_US)
    record_seconds(recorder, 20, 35)
    recorder.keep("risk", NOON_US + 34 * SECOND_US)
    recorder.keep("doubt", NOON_US + 34 * SECOND_US)
    record_seconds(recorder, 35, 100)
    recorder.keep("risk", NOON_US + 99 * SECOND_US)
    recorder.close()

    kept = tmp_path / "record" / KEPT
    found = {path.name: seconds_of(segments(path)) for path in kept.iterdir()}
    assert sorted(found) == [
        "20261121T120019Z-risk",
        "20261121T120034Z-doubt",
        "20261121T120139Z-risk",
    ]
    # until 54 s: the segment from 45 s on is the last
    assert found["20261121T120019Z-risk"] == list(range(10, 55))
    assert found["20261121T120034Z-doubt"] == list(range(20, 55))


def test_the_oldest_record_makes_room(tmp_path: Path) -> None:
    """A record is dropped whole; what is open stays."""
    config = RecordConfig(
        kept_bytes=2**16, segment_s=60, before_s=60, after_s=1
    )
    store = RecordStore(config, tmp_path)
    for number, reason in enumerate(["a", "b", "c"]):
        start_us = NOON_US + number * 600 * SECOND_US
        store.extend(store.write(start_us, os.urandom(25_000)))
        store.keep(reason, start_us)

    names = sorted(path.name for path in (tmp_path / KEPT).iterdir())
    assert names == ["20261121T121000Z-b", "20261121T122000Z-c"]


def test_records_of_all_ages_share_a_segment(tmp_path: Path) -> None:
    """Each open one has it, though a closed one goes to make room."""
    config = RecordConfig(
        kept_bytes=2**16, segment_s=60, before_s=1, after_s=70
    )
    store = RecordStore(config, tmp_path)
    for number, reasons in enumerate(["x", "", "", "ab", ""]):
        start_us = NOON_US + number * 60 * SECOND_US
        store.extend(store.write(start_us, os.urandom(15_000)))
        for reason in reasons:
            store.keep(reason, start_us + 30 * SECOND_US)

    found = {
        path.name[17:]: [one.name[24:30] for one in segments(path)]
        for path in (tmp_path / KEPT).iterdir()
    }
    assert found == {"a": ["000003", "000004"], "b": ["000003", "000004"]}


def test_a_record_alone_keeps_what_is_next_to_the_occasion(
    tmp_path: Path,
) -> None:
    """Of a time that does not fit, the far past and the end are missing."""
    config = RecordConfig(
        kept_bytes=2**16, segment_s=60, before_s=600, after_s=600
    )
    store = RecordStore(config, tmp_path)
    for number in range(5):
        start_us = NOON_US + number * 60 * SECOND_US
        store.extend(store.write(start_us, os.urandom(25_000)))
    store.keep("risk", start_us)
    store.extend(store.write(start_us + 60 * SECOND_US, os.urandom(25_000)))

    (record,) = (tmp_path / KEPT).iterdir()
    numbers = [path.name.rsplit("-")[-1] for path in segments(record)]
    assert numbers == ["000003.log.gz", "000004.log.gz"]


def test_a_restart_takes_the_ring_over(make: Make, tmp_path: Path) -> None:
    """Also with a clock that is back in 1970; leftovers are removed."""
    folder = tmp_path / "record"
    recorder = make(ring_bytes=2**16)
    noise(recorder, 0, 2_000)
    recorder.keep("risk", NOON_US + 2_000 * 10_000)
    recorder.close()
    before, kept = segments(folder), list((folder / KEPT).iterdir())
    (folder / "20261121T120000-000000Z-000099.log.gz.part").write_bytes(b"x")
    (folder / "20261121T120000-000000Z-000098.log.gz").write_bytes(b"")
    (folder / "99999999T999999-000000Z-000097.log.gz").write_bytes(b"mine")
    (folder / "notes.txt").write_text("mine")

    again = make(ring_bytes=2**16)
    record(again, 0, 1, False, b"", 1_000_000)
    again.close()

    after = segments(folder)
    newest = next(path for path in after if path.name.startswith("1970"))
    assert newest.name == (f"19700101T000001-000000Z-{len(before):06d}.log.gz")
    assert list((folder / KEPT).iterdir()) == kept
    assert set(before) < set(after)
    assert not list(folder.glob("*.part"))
    assert not (folder / "20261121T120000-000000Z-000098.log.gz").exists()
    assert (folder / "99999999T999999-000000Z-000097.log.gz").exists()
    assert (folder / "notes.txt").exists()

    third = make(ring_bytes=2**16)
    noise(third, 3_000, 12_000)
    third.close()

    # written last by the old clock, so the first runs go before it
    assert not any(path.exists() for path in before)
    assert not newest.exists()


def lost(recorder: Recorder) -> RecordOutcome:
    record_seconds(recorder, 0, 25)
    recorder.keep("risk", NOON_US + 24 * SECOND_US)
    return recorder.close()


def test_a_folder_that_cannot_be_made_costs_frames_only(
    make: Make, tmp_path: Path
) -> None:
    (tmp_path / "record").write_text("a file, not a folder")

    outcome = lost(make(segment_s=10))

    assert (outcome.frames, outcome.lost_frames) == (25, 25)
    assert (outcome.segments, outcome.failures) == (0, 4)
    assert outcome.last_error is not None
    assert outcome.last_error.startswith(
        f"{tmp_path / 'record'}: not recorded"
    )


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_costs_frames_only(
    make: Make, tmp_path: Path
) -> None:
    (tmp_path / "record").mkdir(mode=0o555)

    outcome = lost(make(segment_s=10))

    assert (outcome.lost_frames, outcome.segments) == (25, 0)


def test_a_disk_that_comes_back_is_used_again(
    make: Make, tmp_path: Path
) -> None:
    """A file size limit stands for a full disk: the write itself fails."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = make(segment_s=10)
    record_seconds(recorder, 0, 5)
    recorder.tick(NOON_US + 10 * SECOND_US)
    assert recorder.wait(WAIT_S)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16, hard))
    try:
        record_seconds(recorder, 10, 15)
        recorder.tick(NOON_US + 20 * SECOND_US)
        assert recorder.wait(WAIT_S)
        full = recorder.outcome()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    record_seconds(recorder, 20, 25)
    outcome = recorder.close()

    assert (full.lost_frames, full.failures) == (5, 1)
    assert full.last_error is not None
    assert (outcome.segments, outcome.last_error) == (2, None)
    folder = tmp_path / "record"
    assert seconds_of(segments(folder)) == [*range(5), *range(20, 25)]
    assert not list(folder.glob("*.part"))


def test_a_vanished_folder_is_made_again(make: Make, tmp_path: Path) -> None:
    folder = tmp_path / "record"
    recorder = make(segment_s=10)
    record_seconds(recorder, 0, 21)
    assert recorder.wait(WAIT_S)
    shutil.rmtree(folder)

    recorder.keep("risk", NOON_US + 20 * SECOND_US)
    outcome = recorder.close()

    assert outcome.failures == 0
    assert seconds_of(segments(folder)) == [20]
    (record,) = (folder / KEPT).iterdir()
    assert seconds_of(segments(record)) == [20]


def test_too_many_segments_for_a_slow_disk_cost_the_oldest(
    make: Make, tmp_path: Path
) -> None:
    """A full pipe in place of the next file holds the writer."""
    recorder = make(segment_s=10)
    record_seconds(recorder, 0, 10)
    folder = tmp_path / "record"
    recorder.tick(NOON_US + 10 * SECOND_US)
    assert recorder.wait(WAIT_S)
    pipe = folder / "20261121T120010-000000Z-000001.log.gz.part"
    os.mkfifo(pipe)
    for _ in range(2_000):  # more than a pipe holds
        data = os.urandom(64)
        record(recorder, 0, 1, False, data, NOON_US + 10 * SECOND_US)
    recorder.tick(NOON_US + 20 * SECOND_US)
    with pipe.open("rb") as file:  # opens with the writer
        for second in range(20, 205):
            data = second.to_bytes(8, "big")
            stamp_us = NOON_US + second * SECOND_US
            record(recorder, 0, 0x123, False, data, stamp_us)
        held = recorder.outcome()
        assert gzip.decompress(file.read())
    outcome = recorder.close()

    # in the pipe: 2000; the last five are buffered, 40 before them wait
    assert (held.frames, held.segments) == (10 + 2_000 + 185, 1)
    assert held.lost_frames == 185 - 5 - 40
    # a pipe cannot be synced, so its frames are lost, too
    assert (outcome.failures, outcome.last_error) == (1, None)
    assert outcome.segments == 6
    assert outcome.lost_frames == held.lost_frames + 2_000
    assert seconds_of(segments(folder)) == [*range(10), *range(160, 205)]


def test_after_close_nothing_is_recorded(make: Make, tmp_path: Path) -> None:
    recorder = make(segment_s=10)
    record_seconds(recorder, 0, 3)
    recorder.close()
    record_seconds(recorder, 3, 15)
    recorder.keep("risk", NOON_US)

    outcome = recorder.close()

    assert (outcome.frames, outcome.lost_frames) == (15, 12)
    assert seconds_of(segments(tmp_path / "record")) == [0, 1, 2]
    assert re.fullmatch(r"2026.*", segments(tmp_path / "record")[0].name)

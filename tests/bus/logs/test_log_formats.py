"""One contract for every format of a CAN log.

The same frames are written in each format by python-can's writers (or as
text, where these cannot) and must come back as the same columns.
"""

from __future__ import annotations

import gzip
import zlib
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import can
import numpy as np
import pytest
from can.io.trc import TRCFileVersion
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bstm_daemon.bus.opening import open_log
from bstm_daemon.bus.signals.extraction import FD_LENGTHS
from bstm_daemon.bus.signals.frame_chunk import FrameChunk, join_in_file_order
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.errors import BstmError, FileAccessError, LogError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bstm_daemon.bus.logs.reader import FrameReader

START_S = 1_700_000_000.0


def frame(number: int, **changes: Any) -> can.Message:
    """Return data frame *number* of a log; a frame in 12.5 ms."""
    return can.Message(
        **{
            "timestamp": START_S + number * 0.0125,
            "arbitration_id": 0x100,
            "is_extended_id": False,
            "channel": 0,
            "data": bytes([number & 255, 1, 2]),
            **changes,
        }
    )


CLASSIC = [
    frame(0),
    frame(1, arbitration_id=0x100, is_extended_id=True),
    frame(2, arbitration_id=0x7FF, data=b""),
    frame(3, arbitration_id=0x1FFFFFFF, is_extended_id=True, data=bytes(8)),
    frame(4, channel=1, data=bytes(range(8))),
    frame(5, is_rx=False),
    frame(6, arbitration_id=0, data=b"\xff"),
]
FD = [
    frame(
        10 + place,
        is_fd=True,
        bitrate_switch=True,
        data=bytes(range(length)),
        channel=place % 2,
    )
    for place, length in enumerate(FD_LENGTHS)
]
ERROR = frame(30, is_error_frame=True, arbitration_id=0, data=b"")
REMOTE = frame(31, is_remote_frame=True, dlc=4, data=b"")


def written(path: Path, messages: list[can.Message]) -> Path:
    """Write *messages* with python-can, by the ending of *path*."""
    with can.Logger(path) as writer:
        for message in messages:
            writer.on_message_received(message)
    return path


def written_trc(path: Path, messages: list[can.Message]) -> Path:
    """Write *messages* as TRC 2.1, which python-can does for classic ones."""
    lines = [
        ";$FILEVERSION=2.1",
        ";$STARTTIME=45244.925925925926",
        ";$COLUMNS=N,O,T,B,I,d,R,L,D",
        ";   Generated for a test",
    ]
    for number, one in enumerate(messages, start=1):
        kind = "FB" if one.is_fd else "DT"
        kind = "ER" if one.is_error_frame else kind
        kind = "RR" if one.is_remote_frame else kind
        code = can.util.len2dlc(one.dlc) if one.is_fd else one.dlc
        digits = 8 if one.is_extended_id else 4
        lines.append(
            f"{number:7} {(one.timestamp - START_S) * 1e3:13.3f} {kind} "
            f"{(one.channel or 0) + 1} {one.arbitration_id:0{digits}X} "
            f"{'Rx' if one.is_rx else 'Tx'} - {code:2} "
            + " ".join(f"{byte:02X}" for byte in one.data)
        )
    path.write_text("\r\n".join(lines) + "\r\n", encoding="ascii")
    return path


@dataclass(frozen=True)
class Format:
    """A format and what it can hold."""

    ending: str
    write: Callable[[Path, list[can.Message]], Path] = written
    fd: bool = True
    channels: bool = True
    absolute: bool = True
    refused: tuple[RejectReason, ...] = (
        RejectReason.ERROR_FRAME,
        RejectReason.REMOTE_FRAME,
    )


FORMATS = [
    Format(".log"),
    Format(".asc", absolute=False),
    Format(".blf"),
    Format(".trc", written_trc),
    Format(".csv", fd=False, channels=False),
    Format(".mf4"),
]
every_format = pytest.mark.parametrize("form", FORMATS, ids=lambda f: f.ending)
TEXTS = [form for form in FORMATS if form.ending in (".asc", ".trc", ".csv")]


def read(path: Path, **options: Any) -> tuple[FrameReader, FrameChunk]:
    if path.suffix == ".mf4":
        pytest.importorskip("asammdf")
    reader = open_log(path, **options)
    return reader, join_in_file_order(list(reader.chunks()))


def expected(form: Format, messages: list[can.Message]) -> list[tuple]:
    return [
        (
            f"can{one.channel if form.channels else 0}",
            one.arbitration_id,
            one.is_extended_id,
            bytes(one.data),
        )
        for one in messages
    ]


def found(reader: FrameReader, chunk: FrameChunk) -> list[tuple]:
    return [
        (reader.interfaces[channel], can_id, extended, data[:length].tobytes())
        for channel, can_id, extended, length, data in zip(
            chunk.channel.tolist(),
            chunk.can_id.tolist(),
            chunk.extended.tolist(),
            chunk.length.tolist(),
            chunk.data,
            strict=True,
        )
    ]


@every_format
def test_frames_come_back(tmp_path: Path, form: Format) -> None:
    messages = CLASSIC + (FD if form.fd else [])
    path = form.write(tmp_path / f"a{form.ending}", messages)

    reader, chunk = read(path)

    assert found(reader, chunk) == expected(form, messages)
    assert chunk.data.shape[1] == (64 if form.fd else 8)
    behind = np.arange(chunk.data.shape[1]) >= chunk.length[:, None]
    assert not chunk.data[behind].any()
    assert [str(getattr(chunk, f.name).dtype) for f in fields(chunk)] == [
        *("int64", "int64", "int16", "uint32", "bool", "uint8", "uint8")
    ]
    start_us = round(START_S * 1e6) if form.absolute else 0
    stamps = [round(m.timestamp * 1e6 - START_S * 1e6) for m in messages]
    # TRC and MF4 store the start in units of their own
    assert np.abs(chunk.time_us - start_us - stamps).max() <= 2


@every_format
def test_frames_without_data_are_refused_by_reason(
    tmp_path: Path, form: Format
) -> None:
    messages = [frame(0), ERROR, frame(1), REMOTE, frame(2)]
    path = form.write(tmp_path / f"a{form.ending}", messages)

    reader, chunk = read(path)

    good = [messages[0], messages[2], messages[4]]
    assert found(reader, chunk) == expected(form, good)
    assert reader.refused[RejectReason.ERROR_FRAME] == 1
    assert reader.refused[RejectReason.REMOTE_FRAME] == 1
    assert reader.frames == 3
    assert reader.lines == reader.frames + sum(reader.refused.values())
    assert np.all(np.diff(chunk.line) > 0)
    assert not reader.truncated


@every_format
def test_an_extended_id_below_2048_is_not_a_standard_one(
    tmp_path: Path, form: Format
) -> None:
    path = form.write(tmp_path / f"a{form.ending}", CLASSIC[:2])

    for extended, data in ((False, b"\0\1\2"), (True, b"\1\1\2")):
        wanted = {(0x100, extended)}
        reader, chunk = read(path, wanted=lambda _, ids=wanted: ids)

        assert found(reader, chunk) == [("can0", 0x100, extended, data)]
        assert reader.refused[RejectReason.UNKNOWN_ID] == 1
        assert reader.seen == {(0, 0x100, False): 1, (0, 0x100, True): 1}


@pytest.mark.parametrize(
    "form", [f for f in FORMATS if f.channels], ids=lambda f: f.ending
)
def test_an_interface_may_be_left_out(tmp_path: Path, form: Format) -> None:
    messages = [frame(0, channel=0), frame(1, channel=1)]
    path = form.write(tmp_path / f"a{form.ending}", messages)
    wanted = {"can0": None, "can1": {(0x100, False)}}

    reader, chunk = read(path, wanted=wanted.get)

    assert found(reader, chunk) == expected(form, messages[1:])
    assert reader.refused[RejectReason.UNKNOWN_INTERFACE] == 1
    assert reader.interfaces == ["can0", "can1"]


@pytest.mark.parametrize("form", FORMATS[1:], ids=lambda f: f.ending)
def test_chunks_are_bounded_and_join(tmp_path: Path, form: Format) -> None:
    messages = [frame(n, channel=n % 2) for n in range(500)]
    path = form.write(tmp_path / f"a{form.ending}", messages)
    whole = read(path)
    reader = open_log(path)
    assert hasattr(reader, "_chunk_frames")
    reader._chunk_frames = 20

    chunks = list(reader.chunks())

    assert len(chunks) > 5
    assert max(map(len, chunks)) <= 20
    assert found(reader, join_in_file_order(chunks)) == found(*whole)
    assert getattr(reader, "share", 0.0) == 1.0


@pytest.mark.parametrize("form", FORMATS[1:5], ids=lambda f: f.ending)
def test_packed_with_gzip_is_the_same(tmp_path: Path, form: Format) -> None:
    path = form.write(tmp_path / f"a{form.ending}", CLASSIC)
    packed = tmp_path / f"a{form.ending}.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))

    assert found(*read(packed)) == found(*read(path))


@every_format
@pytest.mark.filterwarnings("ignore")
def test_a_damaged_log_is_never_a_traceback(
    tmp_path: Path, form: Format
) -> None:
    content = form.write(
        tmp_path / f"a{form.ending}", CLASSIC * 40
    ).read_bytes()
    damaged = tmp_path / f"b{form.ending}"
    rng = np.random.default_rng(2)
    # MF4 is read fifty times as slowly as any other
    for damages in range(1, 25, 6 if form.ending == ".mf4" else 1):
        junk = bytearray(content)
        for place in rng.integers(0, len(junk), damages).tolist():
            junk[place] = int(rng.integers(0, 256))
        damaged.write_bytes(junk)

        with suppress(BstmError):
            reader, chunk = read(damaged)
            assert len(chunk) == reader.frames


@pytest.mark.slow
@every_format
@pytest.mark.filterwarnings("ignore")
def test_a_log_cut_short_gives_what_is_there(
    tmp_path: Path, form: Format
) -> None:
    messages = [frame(n) for n in range(3000)]
    content = form.write(tmp_path / f"a{form.ending}", messages).read_bytes()
    cut = tmp_path / f"b{form.ending}"
    whole = expected(form, messages)
    for share in (0.3, 0.5, 0.9):
        cut.write_bytes(content[: int(len(content) * share)])
        with suppress(LogError):
            there = found(*read(cut))

            assert there == whole[: len(there)]
            assert form.ending == ".mf4" or len(there) > 100 or share < 0.9


def test_a_cut_blf_log_says_so(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    messages = [frame(n, data=rng.bytes(8)) for n in range(9000)]
    content = written(tmp_path / "a.blf", messages).read_bytes()
    path = tmp_path / "b.blf"
    path.write_bytes(content[:-1000])

    reader, chunk = read(path)

    assert reader.truncated
    assert 1000 < len(chunk) < 9000


@every_format
def test_an_empty_log_is_an_error(tmp_path: Path, form: Format) -> None:
    path = tmp_path / f"a{form.ending}"
    path.write_bytes(b"")

    with pytest.raises(LogError, match="is empty"):
        open_log(path)


@every_format
def test_a_log_without_frames_gives_none(tmp_path: Path, form: Format) -> None:
    path = form.write(tmp_path / f"a{form.ending}", [])
    if not path.stat().st_size:
        path.write_text("; nothing\n")

    _, chunk = read(path)

    assert len(chunk) == 0


@every_format
def test_a_log_that_went_away_is_a_file_error(
    tmp_path: Path, form: Format
) -> None:
    path = form.write(tmp_path / f"a{form.ending}", CLASSIC)
    reader = open_log(path)
    path.unlink()
    if form.ending == ".mf4":
        pytest.importorskip("asammdf")

    with pytest.raises(FileAccessError):
        list(reader.chunks())


ASC = """date Sat Sep 30 15:06:13.191 2017
base hex  timestamps absolute
internal events logged
// version 9.0.0
Begin Triggerblock Sat Sep 30 15:06:13.191 2017
"""
ASC_LINES = [
    ("0.5 1 100 Rx d 2 0A 0B", [b"\x0a\x0b"]),
    ("0.5 1 100 Rx d 2 0A 0B  Length = 0 BitCount = 64 ID = 256",
     [b"\x0a\x0b"]),
    ("0.5 1 100x Tx d F 0 1 2 3 4 5 6 7", [bytes(range(8))]),
    ("0.5 1 100 Rx d 2 0A", RejectReason.MALFORMED),
    ("0.5 1 100 Rx d 2 0A 0B 0C", RejectReason.MALFORMED),
    ("0.5 1 100 Rx d 2 0A GG", RejectReason.MALFORMED),
    ("0.5 1 100 Rx d 2 0A 100", RejectReason.MALFORMED),
    ("0.5 1 800 Rx d 0", RejectReason.MALFORMED),
    ("0.5 1 20000000x Rx d 0", RejectReason.MALFORMED),
    ("0.5 1 Engine Rx d 1 00", RejectReason.MALFORMED),
    ("0.5 1 100 Rx", RejectReason.MALFORMED),
    ("0.5 1 100 Rx r", RejectReason.REMOTE_FRAME),
    ("0.5 1 100 TxRq d 2 0A 0B", RejectReason.NOT_A_FRAME),
    ("0.5 1 ErrorFrame Flags = 0xe", RejectReason.ERROR_FRAME),
    ("0.5 1 Statistic: D 0 R 0 XD 0", RejectReason.NOT_A_FRAME),
    ("0.5 Start of measurement", RejectReason.NOT_A_FRAME),
    ("0.5 CANXL 1 Rx 100 0 0", RejectReason.XL_FRAME),
    ("0.5 CANFD 1 Rx 100 Engine 1 0 9 12 " + "0A " * 12 + "0 0 1000",
     [b"\x0a" * 12]),
    ("0.5 CANFD 1 Rx 100 1 0 0 0 0 0 1000 0", [b""]),
    ("0.5 CANFD 1 Rx 100 1 0 9 0 0 0 1010 0", RejectReason.REMOTE_FRAME),
    ("0.5 CANFD 1 Rx 100 1 0 9 12 0A 0B", RejectReason.MALFORMED),
    ("0.5 CANFD 1 Rx 100 1 0 8 12 " + "0A " * 12, RejectReason.MALFORMED),
    ("0.5 CANFD 1 Rx ErrorFrame", RejectReason.ERROR_FRAME),
    ("nonsense", RejectReason.MALFORMED),
    ("", RejectReason.NOT_A_FRAME),
]  # fmt: skip


@pytest.mark.parametrize("header", [ASC, ""], ids=["header", "no header"])
@pytest.mark.parametrize(("line", "gives"), ASC_LINES)
def test_asc_lines(
    tmp_path: Path, header: str, line: str, gives: list[bytes] | RejectReason
) -> None:
    path = tmp_path / "a.asc"
    path.write_text(f"{header}0.1 1 100 Rx d 0\n{line}\n0.9 1 100 Rx d 0\n")

    reader, chunk = read(path)

    refused = [gives] if isinstance(gives, RejectReason) else []
    data = [] if refused else list(gives)
    assert [one[-1] for one in found(reader, chunk)] == [b"", *data, b""]
    first = chunk.line[0] + 1
    for reason in refused:
        kept = reader.first_refused[reason]
        assert first in kept or len(kept) == 5


def test_asc_with_decimal_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.asc"
    path.write_text(
        ASC.replace("hex", "dec")
        + "0.25 2 256 Rx d 2 10 255\n0.5 2 256 Rx d 1 256\n"
    )

    reader, chunk = read(path)

    assert found(reader, chunk) == [("can1", 256, False, b"\x0a\xff")]
    assert chunk.time_us.tolist() == [250_000]


@pytest.mark.parametrize("packed", [False, True])
def test_asc_with_relative_stamps_is_the_absolute_log(
    tmp_path: Path, *, packed: bool
) -> None:
    """Each stamp counts from the line before, whatever event that has."""
    rng = np.random.default_rng(8)
    events = [
        "1 {:X} Rx d 2 0A 0B",
        "1 {:X}x Rx d 2 0A 0B",
        "CANFD 2 Rx {:X} 0 0 2 2 0A 0B 0",
        "1 ErrorFrame",
        "1 Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.0%",
        "1 100 Rx d 2 0A",
        "1 {:X} TxRq d 0",
        "?",
    ]
    steps_us = rng.integers(0, 3_000_000, 500).tolist()
    steps_us[100:400] = [1] * 300
    absolute, relative = [ASC], [ASC.replace("absolute", "relative")]
    now_us = 0
    for number, step_us in enumerate(steps_us):
        now_us += step_us
        event = events[number % len(events)].format(number)
        for lines, at_us in ((absolute, now_us), (relative, step_us)):
            seconds, micros = divmod(at_us, 1_000_000)
            lines.append(f"   {seconds}.{micros:06d} {event}\n")
    ending = ".asc.gz" if packed else ".asc"
    found_of = []
    for name, lines in (("absolute", absolute), ("relative", relative)):
        path = tmp_path / f"{name}{ending}"
        data = "".join(lines).encode()
        path.write_bytes(gzip.compress(data) if packed else data)
        reader, chunk = read(path)
        found_of.append(
            (
                chunk.time_us.tolist(),
                chunk.line.tolist(),
                found(reader, chunk),
                reader.refused,
                reader.first_refused,
            )
        )

    assert found_of[0] == found_of[1]
    assert len(found_of[0][0]) == 3 * 63
    assert found_of[0][0][-1] == sum(steps_us[:499])


def test_asc_with_relative_stamps_beyond_all_time(tmp_path: Path) -> None:
    """A stamp that no clock can have is damage, and time goes on without."""
    path = tmp_path / "a.asc"
    path.write_text(
        ASC.replace("absolute", "relative")
        + "0.25 1 1 Rx d 0\n"
        + "999999999999.9 1 2 Rx d 0\n"
        + "0.000000000001 1 3 Rx d 0\n"
        + "0.249999999999 1 4 Rx d 0\n"
    )

    reader, chunk = read(path)

    assert chunk.time_us.tolist() == [250_000, 250_000, 500_000]
    assert reader.refused[RejectReason.MALFORMED] == 1


TRC_HEADS = {
    "1.0": "",
    "1.1": ";$FILEVERSION=1.1\n;$STARTTIME=0\n",
    "1.3": ";$FILEVERSION=1.3\n;$STARTTIME=0\n",
    "2.0": ";$FILEVERSION=2.0\n;$STARTTIME=0\n;$COLUMNS=N,O,T,I,d,l,D\n",
}
TRC_LINES = [
    ("1.0", "1) 1 0100 2 0A 0B", b"\x0a\x0b"),
    ("1.0", "1) 1 0100 2 0A", RejectReason.MALFORMED),
    ("1.0", "1) 1 0100 RTR", RejectReason.MALFORMED),
    ("1.0", "1) 1 FFFFFFFF 4 00 00 00 08", RejectReason.ERROR_FRAME),
    ("1.0", "1) x 0100 2 0A 0B", RejectReason.MALFORMED),
    ("1.0", "; comment", RejectReason.NOT_A_FRAME),
    ("1.1", "1) 1.5 Rx 00000100 2 0A 0B", b"\x0a\x0b"),
    ("1.1", "1) 1.5 Rx 0100 4 RTR", RejectReason.REMOTE_FRAME),
    ("1.1", "1) 1.5 Warng FFFFFFFF 4 00 00 00 08", RejectReason.ERROR_FRAME),
    ("1.1", "1) 1.5 Rx 0800 1 00", RejectReason.MALFORMED),
    ("1.3", "1) 1.5 1 Tx 0100 - 2 0A 0B", b"\x0a\x0b"),
    ("2.0", "1 1.5 FD 0100 Rx 12 " + "0A " * 12, b"\x0a" * 12),
    ("2.0", "1 1.5 FD 0100 Rx 13 " + "0A " * 13, RejectReason.MALFORMED),
    ("2.0", "1 1.5 DT 0100 Rx 12 " + "0A " * 12, RejectReason.MALFORMED),
    ("2.0", "1 1.5 ST - Rx 4 00 00 00 08", RejectReason.NOT_A_FRAME),
    ("2.0", "1 1.5 ER - Rx 5 04 00 02 00 00", RejectReason.ERROR_FRAME),
    ("2.0", "nonsense", RejectReason.MALFORMED),
]


@pytest.mark.parametrize(("version", "line", "gives"), TRC_LINES)
def test_trc_lines(
    tmp_path: Path, version: str, line: str, gives: bytes | RejectReason
) -> None:
    path = tmp_path / "a.trc"
    path.write_text(f"{TRC_HEADS[version]}{line}\n")

    reader, chunk = read(path)

    if isinstance(gives, RejectReason):
        assert len(chunk) == 0
        assert reader.refused[gives] >= 1
    else:
        assert [one[0::3] for one in found(reader, chunk)] == [("can0", gives)]


@pytest.mark.parametrize(
    ("head", "message"),
    [
        (";$FILEVERSION=1.2\n", r"line 1: TRC version 1\.2 is not read"),
        (";$FILEVERSION=2.1\n1 1 DT 0100 Rx 0\n", "COLUMNS lack D, I, L"),
    ],
)
def test_trc_that_is_not_read(tmp_path: Path, head: str, message: str) -> None:
    path = tmp_path / "a.trc"
    path.write_text(head)

    with pytest.raises(LogError, match=message):
        read(path)


def test_trc_of_python_can(tmp_path: Path) -> None:
    for version in (TRCFileVersion.V1_0, TRCFileVersion.V2_1):
        path = tmp_path / f"{version.name}.trc"
        with can.TRCWriter(path) as writer:
            writer.file_version = version
            for message in CLASSIC:
                writer.on_message_received(message)

        reader, chunk = read(path)

        form = Format(".trc", channels=version is TRCFileVersion.V2_1)
        assert found(reader, chunk) == expected(form, CLASSIC)


def test_objects_of_a_blf_log_that_loop_are_an_error(tmp_path: Path) -> None:
    path = written(tmp_path / "a.blf", CLASSIC)
    content = path.read_bytes()
    start = content.index(b"LOBJ")
    body = bytearray(zlib.decompress(content[start + 32 :]))
    body[8:12] = bytes(4)  # the size of the first object: an endless loop
    packed = zlib.compress(body)
    header = bytearray(content[: start + 32])
    header[start + 8 : start + 12] = (32 + len(packed)).to_bytes(4, "little")
    path.write_bytes(bytes(header) + packed)

    with pytest.raises(LogError, match="an object of 0 bytes"):
        read(path)


def test_groups_of_an_mf4_log_are_merged_by_time(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    from can.io.mf4 import STD_DTYPE  # noqa: PLC0415

    mdf = asammdf.MDF(version="4.11")
    source = asammdf.Source("CAN", "", "", 2, 2)
    for bus, count in ((1, 500), (2, 30)):
        samples = np.zeros(count, STD_DTYPE)
        samples["CAN_DataFrame.ID"] = 0x100 + bus
        samples["CAN_DataFrame.BusChannel"] = bus
        samples["CAN_DataFrame.DataLength"] = 1
        samples["CAN_DataFrame.DataBytes"][:, 0] = np.arange(count) & 255
        mdf.append(
            asammdf.Signal(
                samples=samples,
                timestamps=np.arange(count) * (10.0 / count) + bus * 1e-4,
                name="CAN_DataFrame",
                source=source,
            )
        )
    path = tmp_path / "a.mf4"
    mdf.save(path)
    mdf.close()
    reader = open_log(path)
    reader._chunk_frames = 64  # type: ignore[attr-defined]

    chunk = join_in_file_order(list(reader.chunks()))

    assert np.all(np.diff(chunk.time_us) >= 0)
    assert chunk.line.tolist() == list(range(1, 531))
    assert sorted(reader.interfaces) == ["can1", "can2"]
    for bus, count in ((1, 500), (2, 30)):
        own = chunk.data[chunk.can_id == 0x100 + bus, 0]
        assert own.tolist() == [n & 255 for n in range(count)]


def test_an_mf4_file_without_bus_logging_is_named(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    mdf = asammdf.MDF(version="4.11")
    mdf.append(asammdf.Signal(np.arange(3.0), np.arange(3.0), name="speed"))
    path = tmp_path / "a.mf4"
    mdf.save(path)
    mdf.close()

    with pytest.raises(LogError, match="no bus logging"):
        read(path)


JUNK = st.one_of(
    st.sampled_from([line for line, _ in ASC_LINES]),
    st.sampled_from([line for _, line, _ in TRC_LINES]),
    st.sampled_from([line for head in TRC_HEADS.values()
                     for line in head.split("\n")]),
    st.sampled_from(["base dec", ";$STARTTIME=x", ";$COLUMNS=O,T,I,d,L,D"]),
    st.from_regex(r"[0-9.]{1,6},0x[0-9a-f]{1,9},[012],[01],0,\d,[A-Z=]{0,8}",
                  fullmatch=True),
    st.text(max_size=40),
)  # fmt: skip


@pytest.mark.parametrize("form", TEXTS, ids=lambda f: f.ending)
@settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(lines=st.lists(JUNK, min_size=1, max_size=12))
def test_any_text_is_counted_line_by_line(
    tmp_path: Path, form: Format, lines: list[str]
) -> None:
    first = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
    text = (first if form.ending == ".csv" else "") + "\n".join(lines)
    path = tmp_path / f"a{form.ending}"
    path.write_bytes(text.encode() or b"\n")

    with suppress(LogError):
        reader, chunk = read(path)

        assert reader.lines == len(chunk) + sum(reader.refused.values())

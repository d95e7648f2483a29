"""Reading candump logs: the grammar line by line, and as columns."""

import gzip
import re
import string
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.bus.logs.candump import CandumpReader
from bstm_daemon.bus.logs.candump_line import LINE_LIMIT, Frame, parse_line
from bstm_daemon.bus.logs.reader import Wanted
from bstm_daemon.bus.signals.extraction import FD_LENGTHS
from bstm_daemon.bus.signals.frame_chunk import FrameChunk, join_in_file_order
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.errors import FileAccessError, LogError
from bstm_daemon.native.loader import VARIABLE, extension


def accept_all(_interface: bytes, _can_id: int, _extended: bool) -> None:  # noqa: FBT001
    """Judge that wants every frame."""


def parsed(line: bytes) -> Frame | RejectReason:
    return parse_line(line, accept_all)


FORMS = ["lines", "compiled"]


def read(
    path: Path,
    wanted: Wanted | None = None,
    form: str | None = None,
    **options: Any,
) -> tuple:
    """Read in one of the forms, as the environment says by default."""
    with pytest.MonkeyPatch.context() as patch:
        if form == "compiled":
            patch.delenv(VARIABLE, raising=False)
            if extension() is None:
                pytest.skip("the compiled scan is not installed")
        elif form is not None:
            patch.setenv(VARIABLE, "reference")
        reader = CandumpReader(path, wanted, **options)
    chunks = list(reader.chunks())
    return reader, join_in_file_order(chunks) if chunks else None


def write(directory: Path, content: bytes, name: str = "a.log") -> Path:
    path = directory / name
    path.write_bytes(content)
    return path


FRAMES = [
    (b"(1.000000) can0 123#", 1_000_000, 0x123, False, b""),
    (b"(1.5) can0 123#1122", 1_500_000, 0x123, False, b"\x11\x22"),
    (b"(0.264000) can0 08030C02#58", 264_000, 0x08030C02, True, b"\x58"),
    (b"(1631416514.717133) can0 0D2#0000FFFF10000000", 1631416514717133,
     0x0D2, False, bytes.fromhex("0000FFFF10000000")),
    (b"(1400000000.123456789) can0 001#aB", 1400000000123456, 1, False,
     b"\xab"),
    (b"(1.000001999) can0 001#", 1_000_001, 1, False, b""),
    (b"(1234567.25) can0 001#", 1_234_567_250_000, 1, False, b""),
    (b"(12345678.25) can0 001#", 12_345_678_250_000, 1, False, b""),
    (b"(2.000000)   vcan-long_name.7     7FF#00", 2_000_000, 0x7FF, False,
     b"\0"),
    (b"(2.000000)\tcan0\t7FF#00\tR", 2_000_000, 0x7FF, False, b"\0"),
    (b"(2.000000) can0 100#00 R", 2_000_000, 0x100, False, b"\0"),
    (b"(2.000000) can0 100#00 T\r", 2_000_000, 0x100, False, b"\0"),
    (b"(2.000000) can0 00000100#00 T  ", 2_000_000, 0x100, True, b"\0"),
    (b"(2.000000) can0 100#11.22.33", 2_000_000, 0x100, False,
     b"\x11\x22\x33"),
    (b"(2.000000) can0 100#.1122.33", 2_000_000, 0x100, False,
     b"\x11\x22\x33"),
    (b"(2.000000) can0 100#0102030405060708_E", 2_000_000, 0x100, False,
     bytes(range(1, 9))),
    (b"(2.000000) can0 100##1", 2_000_000, 0x100, False, b""),
    (b"(2.000000) can0 100##A.11.22", 2_000_000, 0x100, False, b"\x11\x22"),
    (b"(2.000000) can0 100##5" + b"5A" * 64, 2_000_000, 0x100, False,
     b"\x5a" * 64),
    (b"(2.000000) can0 1FFFFFFF##0" + b"12" * 12, 2_000_000, 0x1FFFFFFF,
     True, b"\x12" * 12),
]  # fmt: skip

REFUSED = [
    (b"", RejectReason.NOT_A_FRAME),
    (b"   \r", RejectReason.NOT_A_FRAME),
    (b"# a comment", RejectReason.NOT_A_FRAME),
    (b"; a comment", RejectReason.NOT_A_FRAME),
    (
        b"DROPCOUNT: dropped 3 CAN frames on 'can0' socket (total drops 3)",
        RejectReason.NOT_A_FRAME,
    ),
    (b"(1.0) can0 20000100#0000000000000000", RejectReason.ERROR_FRAME),
    (b"(1.0) can0 20000004#0004000000000000 R", RejectReason.ERROR_FRAME),
    (b"(1.0) can0 20000040#0000000000000000", RejectReason.ERROR_FRAME),
    (b"(1.0) can0 200000A8#", RejectReason.ERROR_FRAME),
    (b"(1.0) can0 123#R", RejectReason.REMOTE_FRAME),
    (b"(1.0) can0 123#r", RejectReason.REMOTE_FRAME),
    (b"(1.0) can0 123#R8", RejectReason.REMOTE_FRAME),
    (b"(1.0) can0 00000123#R8_9", RejectReason.REMOTE_FRAME),
    (b"(1.0) can0 123#R R", RejectReason.REMOTE_FRAME),
    (b"(1.0) can0 123#R9", RejectReason.MALFORMED),
    (
        b"(1.0) can0 45123#81:00:12345678#11223344.556677",
        RejectReason.XL_FRAME,
    ),
    (
        b"(1.0) can0 45123#81:00:12345678#" + b"00" * 2048,
        RejectReason.XL_FRAME,
    ),
    (b"(1.0) can0 45123#11223344", RejectReason.MALFORMED),
    (b"(1.0) can0 123#112", RejectReason.MALFORMED),
    (b"(1.0) can0 123#112233445566778899", RejectReason.MALFORMED),
    (b"(1.0) can0 123#1122_9", RejectReason.MALFORMED),
    (b"(1.0) can0 123##A112", RejectReason.MALFORMED),
    (b"(1.0) can0 123##G11", RejectReason.MALFORMED),
    (b"(1.0) can0 123##", RejectReason.MALFORMED),
    (b"(1.0) can0 123##0" + b"00" * 9, RejectReason.MALFORMED),
    (b"(1.0) can0 123#GG", RejectReason.MALFORMED),
    (b"(1.0) can0 800#00", RejectReason.MALFORMED),
    (b"(1.0) can0 80000100#00", RejectReason.MALFORMED),
    (b"(1.0) can0 1234#00", RejectReason.MALFORMED),
    (b"(1.0) can0 123 [2] 11 22", RejectReason.MALFORMED),
    (b"(1.0) can0 123#11 X", RejectReason.MALFORMED),
    (b"(1.0) can0 123#11 R R", RejectReason.MALFORMED),
    (b"(1) can0 123#11", RejectReason.MALFORMED),
    (b"(-1.0) can0 123#11", RejectReason.MALFORMED),
    (b"(1.0)can0 123#11", RejectReason.MALFORMED),
    (b"(1.0) 123#11", RejectReason.MALFORMED),
    (b"(1631416514.71", RejectReason.MALFORMED),
    (b"1.0) can0 123#11", RejectReason.MALFORMED),
    (b"\xff\x00\xfe", RejectReason.MALFORMED),
]


@pytest.mark.parametrize(("line", "time_us", "can_id", "extended", "data"),
                         FRAMES)  # fmt: skip
def test_a_data_frame_is_read(
    *, line: bytes, time_us: int, can_id: int, extended: bool, data: bytes
) -> None:
    interface = re.split(rb"\s+", line)[1]

    assert parsed(line) == Frame(time_us, interface, can_id, extended, data)


@pytest.mark.parametrize(("line", "reason"), REFUSED)
def test_any_other_line_has_a_named_reason(
    line: bytes, reason: RejectReason
) -> None:
    assert parsed(line) is reason


@pytest.mark.parametrize("form", FORMS)
def test_every_line_of_the_grammar_in_one_log(
    tmp_path: Path, form: str
) -> None:
    lines = [row[0] for row in FRAMES + REFUSED]
    path = write(tmp_path, b"\n".join(lines))

    reader, chunk = read(path, form=form)

    assert chunk.time_us.tolist() == [row[1] for row in FRAMES]
    assert chunk.can_id.tolist() == [row[2] for row in FRAMES]
    assert chunk.extended.tolist() == [row[3] for row in FRAMES]
    assert [
        row[:n].tobytes()
        for row, n in zip(chunk.data, chunk.length, strict=True)
    ] == [row[4] for row in FRAMES]
    assert reader.lines == len(lines)
    assert sum(reader.refused.values()) == len(REFUSED)
    first_bad = reader.first_refused[RejectReason.NOT_A_FRAME][0]
    assert first_bad == len(FRAMES) + 1


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("good", "bad"),
    [(b"00000100", b"20000100"), (b"00000100", b"80000100"), (b"7FF", b"800")],
)
def test_a_line_like_one_before_may_have_no_data_id(
    tmp_path: Path, form: str, good: bytes, bad: bytes
) -> None:
    lines = [b"(%d.000000) can0 %s#00" % (n, good) for n in range(3)]
    lines.insert(2, b"(1.500000) can0 %s#00" % bad)

    reader, chunk = read(write(tmp_path, b"\n".join(lines)), form=form)

    assert chunk.time_us.tolist() == [0, 1_000_000, 2_000_000]
    assert sum(reader.refused.values()) == 1


@pytest.mark.parametrize("form", FORMS)
def test_an_unwanted_id_is_not_read_further(tmp_path: Path, form: str) -> None:
    content = b"(1.0) can0 100#XX\n(1.0) can0 200#XX\n(1.0) can1 200#00\n"
    wanted = {"can0": {(0x200, False)}, "can1": None}

    reader, chunk = read(write(tmp_path, content), wanted.get, form)

    assert len(chunk) == 0
    assert reader.refused == {
        RejectReason.UNKNOWN_ID: 1,
        RejectReason.MALFORMED: 1,
        RejectReason.UNKNOWN_INTERFACE: 1,
    }
    assert reader.seen == {
        (0, 0x100, False): 1,
        (0, 0x200, False): 1,
        (1, 0x200, False): 1,
    }


def test_a_standard_and_an_extended_id_are_two(tmp_path: Path) -> None:
    content = b"(1.0) can0 100#01\n(2.0) can0 00000100#02\n"
    path = write(tmp_path, content)

    _, standard = read(path, lambda _: {(0x100, False)})
    _, extended = read(path, lambda _: {(0x100, True)})

    assert standard.data[:, 0].tolist() == [1]
    assert extended.data[:, 0].tolist() == [2]


def test_stamps_may_run_backwards(tmp_path: Path) -> None:
    path = write(
        tmp_path, b"(5.0) a 100#\n(9999999999.999999) a 100#\n(0.1) a 100#\n"
    )

    _, chunk = read(path)

    assert chunk.time_us.tolist() == [5_000_000, 9999999999999999, 100_000]


def test_gzip_gives_the_same(tmp_path: Path) -> None:
    content = b"".join(row[0] + b"\n" for row in FRAMES) * 50
    _, plain = read(write(tmp_path, content))

    _, packed = read(write(tmp_path, gzip.compress(content), "a.log.gz"))

    assert_same_chunk(plain, packed)


def test_a_gzip_log_cut_short_gives_what_is_there(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    content = b"".join(
        b"(%d.5) can0 123#%s\n" % (i, rng.bytes(8).hex().encode())
        for i in range(20_000)
    )
    packed = gzip.compress(content)[:-60_000]

    reader, chunk = read(write(tmp_path, packed, "a.log.gz"))

    assert reader.truncated
    assert 1000 < len(chunk) < 20_000
    assert chunk.time_us.tolist() == [
        i * 1_000_000 + 500_000 for i in range(len(chunk))
    ]


def test_a_damaged_gzip_log_is_an_error(tmp_path: Path) -> None:
    packed = bytearray(gzip.compress(b"(1.0) can0 123#11\n" * 1000))
    packed[12:20] = b"\xff" * 8

    with pytest.raises(LogError, match=r"a\.log\.gz: damaged"):
        read(write(tmp_path, bytes(packed), "a.log.gz"))


def test_a_missing_log_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileAccessError, match=r"none\.log"):
        read(tmp_path / "none.log")


@pytest.mark.parametrize("form", FORMS)
def test_a_line_without_end_does_not_take_the_log_with_it(
    tmp_path: Path, form: str
) -> None:
    good = b"(1.0) can0 123#11\n"
    endless = b"x" * (5 * LINE_LIMIT) + b"\n"
    path = write(tmp_path, good + endless + good)

    reader, chunk = read(path, form=form, chunk_bytes=1024)

    assert chunk.line.tolist() == [1, 3]
    assert reader.refused == {RejectReason.MALFORMED: 1}


@pytest.mark.parametrize("chunk_bytes", [5000, 1 << 20])
def test_plain_lines_are_read_by_the_compiled_scan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_bytes: int
) -> None:
    payloads = [b"#%s" % (b"0a" * n) for n in range(9)]
    payloads += [b"##5%s" % (b"0a" * n) for n in FD_LENGTHS]
    content = b"".join(
        b"(%d.5)  can%d %s%s%s\n" % (i, i % 3, can_id, payload, end)
        for i, payload in enumerate(payloads * 30)
        for can_id in (b"1a0", b"18FF0102")
        for end in (b"", b" R", b"\tt \r")
    )
    path = write(tmp_path, content)
    monkeypatch.setattr(
        "bstm_daemon.bus.logs.candump.parse_line",
        lambda *_: pytest.fail("a line was left to Python"),
    )

    reader, chunk = read(path, form="compiled", chunk_bytes=chunk_bytes)

    assert len(chunk) == reader.lines == len(payloads) * 30 * 6
    assert reader.interfaces == ["can0", "can1", "can2"]
    assert set(chunk.length.tolist()) == set(FD_LENGTHS)
    zeros = np.arange(64) >= chunk.length[:, None]
    assert (chunk.data == np.where(zeros, 0, 0x0A)).all()


def test_more_interfaces_and_ids_than_the_scan_has_room_for(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(5)
    content = b"".join(
        b"(%d.5) %s%d %s#%02X\n"
        % (i, name, i % 90, b"%08X" % can_id if i % 7 else b"123", i % 256)
        for name in (b"can", b"c")
        for i, can_id in enumerate(rng.integers(0, 1 << 29, 1500).tolist())
    )

    assert_same_reading(write(tmp_path, content), None, chunk_bytes=9999)


def test_lines_at_the_longest_that_is_read(tmp_path: Path) -> None:
    head = b"(1.5) can0 100#11"
    long_name = b"(1.5) %s 100#11" % (b"c" * (LINE_LIMIT - 20))
    content = b"".join(
        line + b" " * (LINE_LIMIT - len(line) + more) + end
        for line in (head, long_name)
        for more in (-1, 0, 1, 7)
        for end in (b"\n", b"X\n")
    )
    late = b"".join(
        b"(1.5)%scan0 100#11\n" % (b" " * (LINE_LIMIT - 15 + more))
        for more in range(-4, 5)
    )

    assert_same_reading(write(tmp_path, late + content), None)


HEX = st.sampled_from("0123456789abcdefABCDEF")


def hex_text(digits: int) -> st.SearchStrategy[str]:
    return st.text(HEX, min_size=digits, max_size=digits)


IDS = st.one_of(
    st.sampled_from(["100", "1a0", "1A0", "7FF", "00000100", "18FF0102"]),
    st.sampled_from(["800", "20000100", "9FFFFFFF", "45123"]),
    hex_text(3),
    hex_text(8),
)
STAMPS = st.one_of(
    st.tuples(
        st.integers(1_600_000_000, 1_600_000_099),
        st.integers(0, 999_999).map("{:06d}".format),
    ),
    st.tuples(
        st.integers(0, 10**12 - 1),
        st.text(string.digits, min_size=1, max_size=9),
    ),
).map(lambda pair: f"({pair[0]}.{pair[1]})")
CLASSIC = st.integers(0, 8).flatmap(lambda n: hex_text(2 * n))
FD = st.sampled_from(FD_LENGTHS).flatmap(
    lambda n: st.tuples(HEX, hex_text(2 * n)).map(lambda p: f"#{p[0]}{p[1]}")
)
PAYLOADS = st.one_of(
    CLASSIC,
    hex_text(16),
    FD,
    st.sampled_from(["R", "r8", "R8_9", "11.22", "1122334455667788_A", "112"]),
)
GOOD = st.tuples(
    STAMPS,
    st.sampled_from([" ", "  ", " \t"]),
    st.sampled_from(["can0", "can1", "vcan10", "a)"]),
    st.sampled_from([" ", "   "]),
    IDS,
    st.just("#"),
    PAYLOADS,
    st.sampled_from(["", "", "", " R", " T", " t", "  R", " X", "\r", " R\r"]),
).map(lambda parts: "".join(parts).encode())
JUNK = st.one_of(
    st.binary(max_size=60).map(lambda raw: raw.replace(b"\n", b"")),
    st.sampled_from([row[0] for row in FRAMES + REFUSED]),
)


TEMPLATES = [
    b"(1600000000.123456) can0 1A0#0011223344556677",
    b"(1600000000.123456) can0 100#001122 R",
    b"(1600000000.123456) can0 00000100#0011223344556677",
    b"(1600000000.123456) can1 18FF0102##500112233445566778899AABB",
    b"(0.123456789) can0 1A0#0011223344556677",
]
EDGES = st.sampled_from(b"0/:@G`gAaFf9#.)( RT\r\xb0\xb9\xba\xc1\xff\x80")


@st.composite
def mutated(draw: st.DrawFn) -> bytes:
    """A line of a layout that the log has, with a few bytes changed."""
    line = bytearray(draw(st.sampled_from(TEMPLATES)))
    for _ in range(draw(st.integers(0, 3))):
        line[draw(st.integers(0, len(line) - 1))] = draw(EDGES)
    return bytes(line)


LOGS = st.tuples(
    st.lists(st.sampled_from(TEMPLATES)),
    st.lists(st.one_of(GOOD, mutated(), mutated(), JUNK), max_size=40),
    st.booleans(),
).map(lambda parts: b"\n".join(parts[0] + parts[1]) + b"\n" * parts[2])
WANTED = st.one_of(
    st.none(),
    st.fixed_dictionaries(
        {
            "can0": st.just({(0x100, False), (0x100, True), (0x1A0, False)}),
            "can1": st.sampled_from([None, set(), {(0x18FF0102, True)}]),
        }
    ).map(lambda table: table.get),
)


def assert_same_chunk(first: FrameChunk, second: FrameChunk) -> None:
    for field in fields(FrameChunk):
        one, two = getattr(first, field.name), getattr(second, field.name)
        assert one.dtype == two.dtype, field.name
        np.testing.assert_array_equal(one, two, err_msg=field.name)


def forms_here() -> list[str]:
    return FORMS if extension() is not None else FORMS[:1]


def assert_same_reading(
    path: Path, wanted: Wanted | None, **options: Any
) -> None:
    slow, slow_chunk = read(path, wanted, "lines")
    for form in forms_here()[1:]:
        fast, fast_chunk = read(path, wanted, form, **options)

        assert (fast_chunk is None) == (slow_chunk is None), form
        if slow_chunk is not None:
            assert_same_chunk(slow_chunk, fast_chunk)
        for name in (
            "interfaces",
            "lines",
            "frames",
            "refused",
            "first_refused",
            "seen",
        ):
            assert getattr(slow, name) == getattr(fast, name), (form, name)
        assert fast.lines == fast.frames + sum(fast.refused.values())


@pytest.mark.parametrize("template", TEMPLATES)
@pytest.mark.parametrize("wanted", [None, {"can0": set()}.get])
def test_any_one_byte_changed_gives_the_same(
    tmp_path: Path, template: bytes, wanted: Wanted | None
) -> None:
    changed = (
        template[:at] + bytes([byte]) + template[at + 1 :]
        for at in range(len(template))
        for byte in range(256)
        if byte != ord("\n")
    )
    path = write(tmp_path, b"\n".join((template, *changed)))

    assert_same_reading(path, wanted)


@settings(max_examples=150, deadline=None)
@given(content=LOGS, wanted=WANTED, chunk_bytes=st.sampled_from([97, 1 << 20]))
def test_any_log_gives_the_same(
    tmp_path_factory: pytest.TempPathFactory,
    content: bytes,
    wanted: Wanted | None,
    chunk_bytes: int,
) -> None:
    path = write(tmp_path_factory.getbasetemp(), content)

    assert_same_reading(path, wanted, chunk_bytes=chunk_bytes)
    reader, _ = read(path)
    assert reader.lines == content.count(b"\n") + (content[-1:] not in b"\n")

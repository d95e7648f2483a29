"""Logs as samples: formats, interfaces, and logs that give nothing."""

import gzip
from collections.abc import Callable
from pathlib import Path

import can
import pytest

from bstm_daemon.bus.opening import (
    NOT_READ,
    EventLog,
    open_log,
    resolve_interfaces,
)
from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.signals.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.errors import FileAccessError, LogError, UsageError
from bstm_daemon.roles import ROLE_INDEX

Write = Callable[..., Path]

DBC = """VERSION ""
BU_: X
BO_ 256 BRAKE: 2 X
 SG_ pressure : 7|16@0- (0.1,0) [0|0] "" X
"""
BUSES = [
    BusConfig(name="chassis", dbc="car.dbc", channel="can0"),
    BusConfig(name="body", dbc="car.dbc", channel="can1"),
]


@pytest.fixture
def signal_map(tmp_path: Path) -> SignalMap:
    (tmp_path / "car.dbc").write_text(DBC)
    signals = {
        "primary_pressure": SignalConfig(
            message="BRAKE", signal="pressure", unit="Pa"
        ),
        "secondary_pressure": SignalConfig(
            message="BRAKE", signal="pressure", unit="Pa", bus="body"
        ),
    }
    return compile_signal_map(BUSES, signals, tmp_path, 0.3)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def written(content: str | bytes, name: str = "drive.log") -> Path:
        path = tmp_path / name
        path.write_bytes(
            content if isinstance(content, bytes) else content.encode()
        )
        return path

    return written


LOG = (
    "(5.000001) can0 100#000A\n"
    "(4.000000) can1 100#0014\n"
    "(6.000000) can0 20000100#0000\n"
    "(7.000000) can0 00000100#000A\n"
    "(8.000000) can0 100#00\n"
)


def test_a_log_becomes_samples_in_file_order(
    signal_map: SignalMap, write: Write
) -> None:
    log = EventLog(write(LOG), signal_map)

    (events,) = log.events()

    assert events.time_us.tolist() == [5_000_001, 4_000_000]
    assert events.role.tolist() == [
        ROLE_INDEX["primary_pressure"],
        ROLE_INDEX["secondary_pressure"],
    ]
    assert events.value.tolist() == [1.0, 2.0]
    assert log.reader.refused == {
        RejectReason.ERROR_FRAME: 1,
        RejectReason.UNKNOWN_ID: 1,
    }
    assert log.counts == {RejectReason.WRONG_LENGTH: 1}


def test_a_log_gives_what_live_frames_give(
    signal_map: SignalMap, write: Write
) -> None:
    content = "".join(
        f"({i}.000000) can{i % 2} 100#{i * 37 % 65536:04X}\n"
        for i in range(500)
    )
    decoder = Decoder(signal_map)
    live = [
        (i * 1_000_000, *sample)
        for i in range(500)
        for sample in decoder.decode(
            i % 2,
            256,
            False,
            (i * 37 % 65536).to_bytes(2, "big"),
        )
    ]

    replayed = [
        sample
        for events in EventLog(write(content), signal_map).events()
        for sample in zip(
            events.time_us.tolist(),
            events.role.tolist(),
            events.value.tolist(),
            strict=True,
        )
    ]

    assert replayed == live


def test_a_gzip_log_is_read(signal_map: SignalMap, write: Write) -> None:
    path = write(gzip.compress(LOG.encode()), "drive.log.gz")

    assert sum(len(e) for e in EventLog(path, signal_map).events()) == 2


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("drive.log", b"", "the log is empty"),
        ("drive.blf", b"junk", r"ending \.blf but does not begin like one"),
        ("drive.MF4", b"junk", r"ending \.mf4 but does not begin like one"),
        ("drive.h5", b"junk", r"ending \.h5 but does not begin like one"),
        ("drive.mf4.gz", b"\x1f\x8bx", r"\.mf4 files packed with gzip are"),
        ("drive.pcap", b"junk", r"\.pcap files are not read: read are cand"),
        ("drive.ld", b"junk", r"\.ld files are not read, in MoTeC i2 export"),
        ("drive.dat", b"junk", r"\.dat files are not read, save it as MDF 4"),
        ("drive.xrk.gz", b"\x1f\x8bx", r"\.xrk files packed with gzip are"),
        ("drive.vbo", b"[data]\n", "signal table has no CAN frames"),
        ("drive.mat.gz", b"\x1f\x8bx", r"\.mat files are not read"),
        ("drive.csv", b"time,speed\n", "signal table has no CAN frames"),
        ("drive.csv.gz", b"\x1f\x8bx", r"csv\.gz: damaged in its first line"),
        ("drive.log", b"\x00\x01\x02", "not a text log"),
        (
            "drive.log",
            gzip.compress(b"x", mtime=0),
            r"without the ending \.gz",
        ),
        ("drive.log.gz", b"(1.0) can0", "but is no gzip file"),
    ],
)
def test_what_is_not_read_is_named(
    write: Write, name: str, content: str, message: str
) -> None:
    path = write(content, name)

    with pytest.raises(LogError, match=message) as caught:
        open_log(path)
    assert str(path) in str(caught.value)


def test_a_table_is_named_where_frames_are_expected(
    signal_map: SignalMap, write: Write
) -> None:
    path = write("time,speed\n0,1\n", "drive.csv")

    with pytest.raises(LogError, match="is a signal table, but no role"):
        EventLog(path, signal_map)


def test_a_blf_log_gives_what_a_candump_log_gives(
    signal_map: SignalMap, tmp_path: Path
) -> None:
    samples = []
    for ending in (".log", ".blf", ".asc"):
        path = tmp_path / f"a{ending}"
        with can.Logger(path) as writer:
            for number in range(100):
                writer.on_message_received(
                    can.Message(
                        timestamp=1_700_000_000 + number / 100,
                        arbitration_id=256,
                        is_extended_id=False,
                        channel=number % 2,
                        data=bytes([0, number]),
                    )
                )
        log = EventLog(path, signal_map)
        (events,) = [one for one in log.events() if len(one)]
        samples.append((events.role.tolist(), events.value.tolist()))
        assert log.share == 1.0

    assert samples[0] == samples[1] == samples[2]


def test_a_missing_log_and_a_folder_are_file_errors(tmp_path: Path) -> None:
    with pytest.raises(FileAccessError, match="No such file"):
        open_log(tmp_path / "none.log")
    with pytest.raises(FileAccessError, match="directory"):
        open_log(tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("hello\n\n", "no data frame in 2 lines .1 malformed, 1 not a frame"),
        ("(1.0) can0 20000100#00\n", "no data frame .*1 error frame"),
        (
            "(1.0) can0 101#00\n(1.0) can1 00000100#00\n",
            (
                r"none of the wanted ids: chassis 100 \(BRAKE\), body 100 "
                r"\(BRAKE\) expected, can0 101, can1 00000100 seen"
            ),
        ),
        (
            "(1.0) can0 100#00\n",
            "no sample in 1 wanted frames .1 wrong length",
        ),
    ],
)
def test_a_log_that_gives_nothing_says_why(
    signal_map: SignalMap, write: Write, content: str, message: str
) -> None:
    log = EventLog(write(content), signal_map)

    with pytest.raises(LogError, match=message):
        list(log.events())


def test_an_unresolved_interface_is_an_error(
    signal_map: SignalMap, write: Write
) -> None:
    path = write("(1.0) can7 100#000A\n")

    with pytest.raises(LogError, match=r"drive\.log: .* interface can7"):
        list(EventLog(path, signal_map).events())


def test_a_mapped_interface_is_read_as_its_bus(
    signal_map: SignalMap, write: Write
) -> None:
    path = write("(1.0) can7 100#000A\n(1.0) can0 100#000B\n")
    log = EventLog(path, signal_map, {"can7": "body", "can0": ""})

    (events,) = log.events()

    assert events.role.tolist() == [ROLE_INDEX["secondary_pressure"]]
    assert log.reader.refused == {RejectReason.UNKNOWN_INTERFACE: 1}


def test_interfaces_resolve_by_map_then_by_channel() -> None:
    numbers = resolve_interfaces(
        ["can1", "can0", "vcan3", "can9"],
        BUSES,
        {"vcan3": "chassis", "can9": "", "can1": "chassis"},
    )

    assert numbers == [0, 0, 0, NOT_READ]


def test_ignored_interfaces_need_no_map() -> None:
    """A map and a channel of that name go before."""
    buses = (
        BUSES[0].model_copy(
            update={"ignored_interfaces": ["can8", "can9", BUSES[0].channel]}
        ),
        *BUSES[1:],
    )
    names = [BUSES[0].channel, "can8", "can9"]

    numbers = resolve_interfaces(names, buses, {"can9": BUSES[1].name})

    assert numbers == [0, NOT_READ, 1]


def test_unresolved_interfaces_are_all_listed() -> None:
    with pytest.raises(LogError, match=r"interface can5, can6 .*--map can5="):
        resolve_interfaces(["can0", "can5", "can6"], BUSES, {})


def test_a_map_to_an_unknown_bus_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match=r"--map can0=engine: no .*chassis"):
        resolve_interfaces([], BUSES, {"can0": "engine"})

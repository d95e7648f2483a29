"""DBC files: what is wrong is said with file, message and signals."""

from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest

from bstm_daemon.bus.signals.columns import ChunkDecoder
from bstm_daemon.bus.signals.dbc import (
    UnusableSignalError,
    load_dbc,
    multiplexers,
    names_no_value,
    raw_signal,
    read_dbc,
)
from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.frame_chunk import FrameChunk
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.signals.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.native.loader import VARIABLE, extension
from bstm_daemon.roles import ROLE_INDEX

HEAD = 'VERSION ""\nBU_: X\n'
OVERLAP = (
    HEAD
    + "BO_ 100 ONE: 8 X\n"
    + ' SG_ a : 0|16@1+ (1,0) [0|0] "" X\n'
    + ' SG_ b : 8|16@1+ (1,0) [0|0] "" X\n'
    + "BO_ 101 TWO: 1 X\n"
    + ' SG_ c : 0|16@1+ (1,0) [0|0] "" X\n'
    + "BO_ 102 FINE: 1 X\n"
    + ' SG_ d : 0|8@1+ (1,0) [0|0] "" X\n'
)


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    return tmp_path / "car.dbc"


def problems_of(path: Path, **options: Any) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load_dbc(path, **{"strict": True, "encoding": "cp1252", **options})
    return caught.value.problems


def test_strict_lists_every_message_at_fault(dbc: Path) -> None:
    dbc.write_text(OVERLAP)

    first, second = problems_of(dbc)

    assert str(dbc) in first
    assert "message 'ONE'" in first
    assert "line 4: " in first
    assert "signals overlap: a and b" in first
    assert "strict = false" in first
    assert "line 7: message 'TWO'" in second
    assert "signals do not fit in its 1 bytes: c" in second


def test_lenient_loads_the_same_file(dbc: Path) -> None:
    dbc.write_text(OVERLAP)

    loaded = read_dbc(dbc, strict=False, encoding="cp1252")

    assert [message.name for message in loaded.database.messages] == [
        "ONE",
        "TWO",
        "FINE",
    ]
    assert [
        (one.line, one.message, one.signals) for one in loaded.warnings
    ] == [(4, "ONE", ("a", "b")), (7, "TWO", ("c",))]


def test_overlapping_signals_are_each_read_as_defined(dbc: Path) -> None:
    """A message's own codec in cantools gives other values here."""
    dbc.write_text(OVERLAP)
    message = load_dbc(dbc, strict=False, encoding="cp1252").messages[0]

    a, b = raw_signal(message, "a"), raw_signal(message, "b")

    assert (a.start, a.length, b.start, b.length) == (0, 16, 8, 16)


def test_overlapping_signals_decode_as_defined(dbc: Path) -> None:
    dbc.write_text(OVERLAP)
    signals = {
        role: SignalConfig(message="ONE", signal=name, unit="bar")
        for role, name in [
            ("primary_pressure", "a"),
            ("secondary_pressure", "b"),
        ]
    }
    bus = BusConfig(name="car", dbc=dbc.name, strict=False)
    signal_map = compile_signal_map([bus], signals, dbc.parent, 0.3)
    samples = dict(
        Decoder(signal_map).decode(
            0, 100, False, bytes.fromhex("010203") + bytes(5)
        )
    )

    assert [one.message for one in signal_map.warnings["car"]] == [
        "ONE",
        "TWO",
    ]
    assert samples == {
        ROLE_INDEX["primary_pressure"]: pytest.approx(0x0201 * 1e5),
        ROLE_INDEX["secondary_pressure"]: pytest.approx(0x0302 * 1e5),
    }


def test_signals_of_different_multiplexer_values_do_not_overlap(
    dbc: Path,
) -> None:
    dbc.write_text(
        HEAD
        + "BO_ 100 ONE: 8 X\n"
        + ' SG_ m M : 0|8@1+ (1,0) [0|0] "" X\n'
        + ' SG_ a m0 : 8|16@1+ (1,0) [0|0] "" X\n'
        + ' SG_ b m1 : 16|16@1+ (1,0) [0|0] "" X\n'
        + ' SG_ c m1 : 55|16@0+ (1,0) [0|0] "" X\n'
        + ' SG_ d m1 : 57|2@0+ (1,0) [0|0] "" X\n'
    )

    (problem,) = problems_of(dbc)

    assert "signals overlap: c and d" in problem


def test_a_syntax_error_names_line_and_message(dbc: Path) -> None:
    dbc.write_text(HEAD + "BO_ 100 ONE: 8 X\n SG_ a : 0|16@1+ (1,0 [0|0]\n")

    (problem,) = problems_of(dbc, strict=True)

    assert problem.startswith(f"{dbc}: line 4: message 'ONE': cannot be read")
    assert "SG_ a : 0|16@1+ (1,0 [0|0]" in problem


@pytest.mark.parametrize("strict", [True, False])
@pytest.mark.parametrize("text", ["", "a letter", "BO_ x\n"])
def test_what_has_no_message_is_no_dbc(
    dbc: Path, text: str, *, strict: bool
) -> None:
    dbc.write_text(text)

    assert problems_of(dbc, strict=strict)[0].startswith(f"{dbc}: not a DBC")


def test_a_missing_file_is_a_problem(dbc: Path) -> None:
    assert problems_of(dbc) == [
        f"{dbc}: cannot be read: No such file or directory"
    ]


def test_an_unknown_encoding_is_a_problem(dbc: Path) -> None:
    dbc.write_text(HEAD)

    (problem,) = problems_of(dbc, encoding="utf-9")

    assert "encoding = 'utf-9'" in problem


def test_the_encoding_is_used(dbc: Path) -> None:
    text = HEAD + 'BO_ 1 A: 8 X\n SG_ t : 0|8@1+ (1,0) [0|0] "°C" X\n'
    dbc.write_text(text, encoding="utf-8")

    database = load_dbc(dbc, strict=True, encoding="utf-8")

    assert database.messages[0].signals[0].unit == "°C"


def signal_text(layout: str, conversion: str = "(1,0)", size: int = 8) -> str:
    return (
        f"{HEAD}BO_ 100 A: {size} X\n"
        f' SG_ s : {layout} {conversion} [0|0] "" X\n'
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (signal_text("60|8@1+"), "ends at bit 68 of message 'A'"),
        (signal_text("56|9@0+"), "which has 64 bits"),
        (signal_text("0|65@1+", size=16), "has 65 bits"),
        (signal_text("0|24@1+") + "SIG_VALTYPE_ 100 s : 1;\n", "of 24 bits"),
        (signal_text("0|8@1+", "(0,5)"), "scale 0 and offset 5"),
        (signal_text("0|64@1+", "(1e300,0)"), "no usable value"),
    ],
)
def test_what_gives_no_value_is_refused(text: str, reason: str) -> None:
    database = cantools.database.load_string(text, "dbc", strict=False)

    with pytest.raises(UnusableSignalError, match=reason):
        raw_signal(database.messages[0], "s")


@pytest.mark.parametrize(
    ("layout", "limits"),
    [("0|8@1+", (0, 255)), ("0|8@1-", (-128, 127)), ("0|1@1-", (-1, 0))],
)
def test_the_limits_of_a_raw_value(
    layout: str, limits: tuple[int, int]
) -> None:
    text = signal_text(layout)
    database = cantools.database.load_string(text, "dbc")

    assert raw_signal(database.messages[0], "s").raw_limits == limits


def test_multiplexers_are_followed_to_the_root() -> None:
    text = (
        HEAD
        + "BO_ 100 A: 8 X\n"
        + ' SG_ top M : 0|4@1+ (1,0) [0|0] "" X\n'
        + ' SG_ middle m1M : 4|4@1+ (1,0) [0|0] "" X\n'
        + ' SG_ leaf m3 : 8|8@1+ (1,0) [0|0] "" X\n'
        + "SG_MUL_VAL_ 100 middle top 1-1;\n"
        + "SG_MUL_VAL_ 100 leaf middle 3-4;\n"
    )
    message = cantools.database.load_string(text, "dbc").messages[0]

    assert multiplexers(message, "top") == []
    assert multiplexers(message, "leaf") == [
        ("middle", frozenset({3, 4})),
        ("top", frozenset({1})),
    ]


def test_a_multiplexer_is_found_by_its_short_name() -> None:
    """Long names replace a signal's own name, not what it hangs on."""
    long = "Multiplexer_with_a_name_beyond_32_characters"
    text = (
        HEAD
        + "BO_ 100 A: 8 X\n"
        + f' SG_ {long[:32]} M : 0|4@1+ (1,0) [0|0] "" X\n'
        + ' SG_ leaf m3 : 8|8@1+ (1,0) [0|0] "" X\n'
        + 'BA_DEF_ SG_ "SystemSignalLongSymbol" STRING ;\n'
        + 'BA_DEF_DEF_ "SystemSignalLongSymbol" "";\n'
        + f'BA_ "SystemSignalLongSymbol" SG_ 100 {long[:32]} "{long}";\n'
    )
    message = cantools.database.load_string(text, "dbc").messages[0]

    assert multiplexers(message, "leaf") == [(long, frozenset({3}))]


def test_a_circle_of_multiplexers_ends() -> None:
    text = (
        HEAD
        + "BO_ 100 A: 8 X\n"
        + ' SG_ a m1M : 0|4@1+ (1,0) [0|0] "" X\n'
        + ' SG_ b m1M : 4|4@1+ (1,0) [0|0] "" X\n'
        + "SG_MUL_VAL_ 100 a b 1-1;\n"
        + "SG_MUL_VAL_ 100 b a 1-1;\n"
    )
    message = cantools.database.load_string(
        text, "dbc", strict=False
    ).messages[0]

    with pytest.raises(UnusableSignalError, match="circle"):
        multiplexers(message, "a")


FORMS = ["reference"] if extension() is None else ["reference", "any"]

DBC = """VERSION ""
BU_: X
BO_ 256 BRAKE: 8 X
 SG_ p1 : 0|8@1+ (1,0) [0|0] "bar" X
 SG_ p2 : 8|8@1- (1,0) [0|0] "bar" X
 SG_ pedal : 16|2@1+ (1,0) [0|0] "" X
 SG_ lamp : 18|1@1+ (1,0) [0|0] "" X

VAL_ 256 p1 254 "Error" 255 "SNA" ;
VAL_ 256 p2 255 "not available" 3 "no error" ;
VAL_ 256 pedal 0 "released" 1 "pressed" 2 "fault" 3 "Signal invalid" ;
VAL_ 256 lamp 0 "ok" 1 "fault" ;
"""
SIGNALS = {
    "primary_pressure": SignalConfig(message="BRAKE", signal="p1", unit="bar"),
    "secondary_pressure": SignalConfig(
        message="BRAKE", expression="p1 + p2", unit="bar"
    ),
    "brake_switch": SignalConfig(message="BRAKE", signal="pedal", unit="bool"),
    "abs_active": SignalConfig(message="BRAKE", signal="lamp", unit="bool"),
}


@pytest.fixture(scope="module")
def signal_map(tmp_path_factory: pytest.TempPathFactory) -> SignalMap:
    base = tmp_path_factory.mktemp("values")
    (base / "car.dbc").write_text(DBC)
    buses = [BusConfig(name="a", dbc="car.dbc", channel="can0")]
    return compile_signal_map(buses, SIGNALS, Path(base), 0.3)


@pytest.mark.parametrize(
    "name",
    [
        *("SNA", "sna", "Not available", "NOT_AVAILABLE", "NotAvailable"),
        *("notavailable", "SigNotAvail", "Signal not available", "n/a"),
        *("unavailable", "Invalid", "signal_invalid", "InvalidValue"),
        *("not valid", "Error", "ERROR", "error indicator", "Sensor fault"),
        *("SNA / error", "Invalid or not available", "FAULT", " N.A. "),
    ],
)
def test_a_name_that_says_there_is_no_value(name: str) -> None:
    assert names_no_value(name)


@pytest.mark.parametrize(
    "name",
    [
        *("", "signal", "valid", "available", "not", "No error", "no fault"),
        *("NoFault", "error free", "Fault memory full", "errors cleared"),
        *("not pressed", "terror", "snap", "NA", "default", "faultless"),
        *("not invalidated", "Error 3", "255", "normal"),
    ],
)
def test_a_name_that_tells_of_something_else(name: str) -> None:
    assert not names_no_value(name)


BAR = 1e5


@pytest.mark.parametrize(
    ("payload", "expected", "refused"),
    [
        (
            (10, 3, 0),
            {"primary_pressure": 10 * BAR, "secondary_pressure": 13 * BAR}
            | {"brake_switch": 0.0, "abs_active": 0.0},
            0,
        ),
        ((254, 3, 1), {"brake_switch": 1.0, "abs_active": 0.0}, 2),
        (
            (255, 255, 0b110),
            {"abs_active": 1.0},
            3,
        ),
        (
            (9, 255, 0b111),
            {"primary_pressure": 9 * BAR, "abs_active": 1.0},
            2,
        ),
    ],
)
def test_such_a_value_is_no_sample_in_any_form(
    signal_map: SignalMap,
    payload: tuple[int, ...],
    expected: dict[str, float],
    refused: int,
) -> None:
    data = bytes(payload).ljust(8, b"\0")
    wanted = {ROLE_INDEX[name]: value for name, value in expected.items()}
    counts = {RejectReason.NOT_AVAILABLE: refused} if refused else {}
    decoder = Decoder(signal_map)

    assert dict(decoder.decode(0, 256, False, data)) == wanted
    assert decoder.counts == counts

    chunk = FrameChunk(
        time_us=np.zeros(1, np.int64),
        line=np.ones(1, np.int64),
        channel=np.zeros(1, np.int16),
        can_id=np.array([256], np.uint32),
        extended=np.zeros(1, np.bool_),
        length=np.array([8], np.uint8),
        data=np.frombuffer(data, np.uint8)[np.newaxis],
    )
    for form in FORMS:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv(VARIABLE, form)
            events = ChunkDecoder(signal_map).decode(chunk, [0])
        found = zip(events.role.tolist(), events.value.tolist(), strict=True)
        assert dict(found) == wanted
        assert events.counts == counts

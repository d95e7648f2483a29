"""Raw values that the DBC's value table names as none, and what they do."""

from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.bus.signals.columns import ChunkDecoder
from bstm_daemon.bus.signals.dbc_values import names_no_value
from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.frame_chunk import FrameChunk
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.signals.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.native.loader import VARIABLE, extension
from bstm_daemon.roles import ROLE_INDEX

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
        *("SNA / error", "Invalid or not available", "FAULT"),
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

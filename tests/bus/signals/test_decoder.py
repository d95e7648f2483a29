"""Live frames: what is refused, and what becomes a sample."""

import math
import subprocess
import sys
from pathlib import Path

import pytest

from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.signals.signal_map import compile_signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.roles import ROLE_INDEX

DBC = """VERSION ""
BU_: X
BO_ 256 BRAKE: 8 X
 SG_ pressure : 7|16@0- (0.1,0) [0|0] "" X
 SG_ divisor : 16|8@1+ (1,0) [0|0] "" X
 SG_ state : 24|8@1+ (1,0) [0|0] "" X

VAL_ 256 state 1 "on" 0 "off" ;
"""
PRESSURE = ROLE_INDEX["primary_pressure"]
SECONDARY = ROLE_INDEX["secondary_pressure"]
SWITCH = ROLE_INDEX["brake_switch"]


@pytest.fixture
def decoder(tmp_path: Path) -> Decoder:
    (tmp_path / "car.dbc").write_text(DBC)
    signals = {
        "primary_pressure": SignalConfig(
            message="BRAKE", signal="pressure", unit="bar", min=0.0, max=200.0
        ),
        "secondary_pressure": SignalConfig(
            message="BRAKE", expression="pressure / divisor", unit="bar"
        ),
        "brake_switch": SignalConfig(
            message="BRAKE", signal="state", unit="bool"
        ),
    }
    bus = BusConfig(name="car", dbc="car.dbc")
    return Decoder(compile_signal_map([bus], signals, tmp_path, 0.3))


def payload(raw_pressure: int, divisor: int = 1, state: int = 0) -> bytes:
    return raw_pressure.to_bytes(2, "big", signed=True) + bytes(
        [divisor, state, 0, 0, 0, 0]
    )


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_a_frame_becomes_samples_in_si(decoder: Decoder, kind: type) -> None:
    data = kind(payload(1000, divisor=4, state=7))

    samples = decoder.decode(0, 256, False, data)

    assert [role for role, _ in samples] == [PRESSURE, SECONDARY, SWITCH]
    assert [value for _, value in samples] == pytest.approx([100e5, 25e5, 1.0])
    assert not decoder.counts


@pytest.mark.parametrize(
    ("frame", "flags", "reason"),
    [
        ((0, 257, False, payload(1)), {}, RejectReason.UNKNOWN_ID),
        ((0, 256, True, payload(1)), {}, RejectReason.UNKNOWN_ID),
        ((1, 256, False, payload(1)), {}, RejectReason.UNKNOWN_ID),
        ((0, 256, False, payload(1)[:7]), {}, RejectReason.WRONG_LENGTH),
        ((0, 256, False, payload(1) + b"\0"), {}, RejectReason.WRONG_LENGTH),
        ((0, 256, False, b""), {"is_remote": True}, RejectReason.REMOTE_FRAME),
        (
            (0, 256, False, payload(1)),
            {"is_error": True},
            RejectReason.ERROR_FRAME,
        ),
    ],
)
def test_a_refused_frame_gives_nothing_and_is_counted(
    decoder: Decoder,
    frame: tuple,
    flags: dict[str, bool],
    reason: RejectReason,
) -> None:
    assert list(decoder.decode(*frame, **flags)) == []
    assert decoder.counts == {reason: 1}


def test_frames_refused_whole_are_told_from_unwanted_ones(
    decoder: Decoder,
) -> None:
    decoder.decode(0, 257, False, payload(1))
    decoder.decode(0, 256, False, payload(30_000))
    assert decoder.rejected == 0

    decoder.decode(0, 256, False, payload(1)[:7])
    decoder.decode(0, 256, False, b"", is_remote=True)
    decoder.decode(0, 4, False, payload(1), is_error=True)
    assert decoder.rejected == 3


def test_limits_are_inclusive(decoder: Decoder) -> None:
    inside = [decoder.decode(0, 256, False, payload(p)) for p in (0, 2000)]
    outside = [decoder.decode(0, 256, False, payload(p)) for p in (-1, 2001)]

    assert all(samples[0][0] == PRESSURE for samples in inside)
    assert all(samples[0][0] == SECONDARY for samples in outside)
    assert decoder.counts == {RejectReason.OUT_OF_RANGE: 2}


def test_a_division_by_zero_is_no_sample(decoder: Decoder) -> None:
    samples = dict(decoder.decode(0, 256, False, payload(5, divisor=0)))

    assert set(samples) == {PRESSURE, SWITCH}
    assert decoder.counts == {RejectReason.NOT_A_NUMBER: 1}
    assert all(math.isfinite(value) for value in samples.values())


def test_the_live_path_needs_no_numpy() -> None:
    """NumPy costs the daemon memory and start-up time."""
    code = (
        "import sys\n"
        # python-can itself loads asammdf, and so NumPy, where it is installed
        "sys.modules['asammdf'] = None\n"
        "import bstm_daemon.bus.signals.decoder\n"
        "sys.exit('numpy' in sys.modules)"
    )

    assert (
        subprocess.run([sys.executable, "-c", code], check=False).returncode
        == 0
    )

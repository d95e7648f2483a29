"""Protected messages: declared, compiled, refused alike live and in logs."""

from collections import Counter
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.output.e2e import profile5_crc, protect
from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.e2e_guard import E2eGuard
from bstm_daemon.bus.signals.extraction import FrameKey
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.signals.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.config.service import E2eConfig
from bstm_daemon.errors import ConfigError

DBC = """VERSION ""
BU_: X
BO_ 256 BRAKE: 8 X
 SG_ pressure : 16|16@1+ (1,0) [0|0] "" X
BO_ 2147483904 MOTION: 12 X
 SG_ speed : 48|16@1+ (0.01,0) [0|0] "" X
BO_ 258 BODY: 2 X
 SG_ ambient : 0|8@1- (1,0) [0|0] "" X
BO_ 259 OTHER: 8 X
"""
BUSES = [
    BusConfig(name="a", dbc="car.dbc", channel="can0"),
    BusConfig(name="b", dbc="car.dbc", channel="can1"),
]
SIGNALS = {
    "primary_pressure": SignalConfig(
        message="BRAKE", signal="pressure", unit="Pa"
    ),
    "vehicle_speed": SignalConfig(
        message="MOTION", signal="speed", unit="m/s", bus="b"
    ),
    "ambient_temperature": SignalConfig(
        message="BODY", signal="ambient", unit="degC"
    ),
}
IDS = list(range(100, 116))
BRAKE = E2eConfig(message="BRAKE", profile=2, data_ids=IDS, max_delta=1)
MOTION = E2eConfig(
    message="MOTION", bus="b", profile=5, data_ids=[777], offset_bytes=2
)
BRAKE_KEY = FrameKey(0, 256, extended=False)
MOTION_KEY = FrameKey(1, 256, extended=True)

Compile = Callable[..., SignalMap]


@pytest.fixture(scope="module")
def compile_map(tmp_path_factory: pytest.TempPathFactory) -> Compile:
    base = tmp_path_factory.mktemp("guard")
    (base / "car.dbc").write_text(DBC)

    def compiled(*e2e: E2eConfig, **signals: SignalConfig) -> SignalMap:
        return compile_signal_map(
            BUSES, signals or SIGNALS, base, 0.3, e2e=e2e
        )

    return compiled


def brake(counter: int, pressure: int = 7) -> bytes:
    data = bytes(2) + pressure.to_bytes(2, "little") + bytes(4)
    return protect(data, counter, IDS)


def motion(counter: int) -> bytes:
    frame = bytearray(12)
    frame[4] = counter
    frame[2:4] = profile5_crc(frame, 777, 2).to_bytes(2, "little")
    return bytes(frame)


def verdicts(guard: E2eGuard, *counters: int) -> list[RejectReason | None]:
    return [guard.refusal(*BRAKE_KEY, brake(counter)) for counter in counters]


def test_declarations_become_frames(compile_map: Compile) -> None:
    signal_map = compile_map(BRAKE, MOTION)

    assert signal_map.protected == {BRAKE_KEY: BRAKE, MOTION_KEY: MOTION}


def test_a_frame_too_short_for_its_protection_is_a_problem(
    compile_map: Compile,
) -> None:
    change = {"profile": 5, "data_ids": [1], "offset_bytes": 6}
    config = E2eConfig(**{**BRAKE.model_dump(), **change})

    with pytest.raises(ConfigError) as caught:
        compile_map(config)

    (problem,) = caught.value.problems
    assert problem == (
        "[[e2e]] message = 'BRAKE': has 8 bytes, CRC and counter of profile 5 "
        "need 9"
    )


def test_a_wrong_role_is_the_only_problem(compile_map: Compile) -> None:
    """The message may be the one that this role was to be read from."""
    wrong = SignalConfig(message="BRAKE", signal="presure", unit="Pa")

    with pytest.raises(ConfigError) as caught:
        compile_map(BRAKE, primary_pressure=wrong)

    assert len(caught.value.problems) == 1


def test_frames_in_sequence_pass(compile_map: Compile) -> None:
    guard = E2eGuard(compile_map(BRAKE, MOTION))

    assert verdicts(guard, *(n % 16 for n in range(5, 45))) == [None] * 40
    assert {
        guard.refusal(*MOTION_KEY, motion(n % 256)) for n in range(300)
    } == {None}


def test_a_stuck_counter_is_refused(compile_map: Compile) -> None:
    assert verdicts(E2eGuard(compile_map(BRAKE)), 3, 3, 3, 4) == [
        *(
            None,
            RejectReason.REPEATED_COUNTER,
            RejectReason.REPEATED_COUNTER,
            None,
        )
    ]


def test_the_frame_after_a_jump_is_refused(compile_map: Compile) -> None:
    assert verdicts(E2eGuard(compile_map(BRAKE)), 3, 9, 10, 9, 10) == [
        *(None, RejectReason.WRONG_SEQUENCE, None),
        *(RejectReason.WRONG_SEQUENCE, None),
    ]


def test_a_damaged_frame_counts_as_lost(compile_map: Compile) -> None:
    guard = E2eGuard(
        compile_map(E2eConfig(**{**BRAKE.model_dump(), "max_delta": 2}))
    )
    damaged = bytes([brake(4)[0] ^ 1]) + brake(4)[1:]

    assert verdicts(guard, 3) == [None]
    assert guard.refusal(*BRAKE_KEY, damaged) is RejectReason.WRONG_CRC
    assert guard.refusal(*BRAKE_KEY, brake(5)[:7]) is RejectReason.WRONG_LENGTH
    assert verdicts(guard, 5) == [None]


def test_what_is_not_declared_passes(compile_map: Compile) -> None:
    guard = E2eGuard(compile_map(BRAKE))

    assert guard.refusal(0, 258, False, b"\1\2") is None
    assert guard.refusal(0, 256, True, bytes(8)) is None
    assert guard.refusal(1, 256, False, bytes(8)) is None


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_any_kind_of_buffer(compile_map: Compile, kind: type) -> None:
    guard = E2eGuard(compile_map(BRAKE, MOTION))

    assert guard.refusal(*BRAKE_KEY, kind(brake(0))) is None
    assert guard.refusal(*MOTION_KEY, kind(motion(0))) is None


FRAMES = st.lists(
    st.one_of(
        st.tuples(
            st.sampled_from(["can0", "can1"]),
            st.just("100"),
            st.integers(0, 15).map(lambda n: brake(n, pressure=n)),
        ),
        st.tuples(
            st.sampled_from(["can0", "can1"]),
            st.just("00000100"),
            st.integers(0, 255).map(motion),
        ),
        st.tuples(
            st.just("can0"),
            st.sampled_from(["100", "102"]),
            st.binary(max_size=8),
        ),
    ),
    min_size=1,
)


@given(frames=FRAMES, tail=st.integers(0, 15))
def test_a_log_loses_the_frames_that_live_loses(
    compile_map: Compile,
    tmp_path_factory: pytest.TempPathFactory,
    frames: list[tuple[str, str, bytes]],
    tail: int,
) -> None:
    """The same samples and the same counts, whatever the order."""
    signal_map = compile_map(BRAKE, MOTION)
    # an unprotected sample, so that the log is never without any
    frames = [("can0", "102", bytes([tail, 0])), *frames]
    lines = [
        f"({n}.000000) {channel} {digits}"
        f"{'##0' if len(data) > 8 else '#'}{data.hex().upper()}\n"
        for n, (channel, digits, data) in enumerate(frames)
    ]
    path = tmp_path_factory.mktemp("log") / "drive.log"
    path.write_text("".join(lines))

    log = EventLog(path, signal_map)
    replayed = [
        sample
        for events in log.events()
        for sample in zip(
            events.time_us.tolist(),
            events.role.tolist(),
            events.value.tolist(),
            strict=True,
        )
    ]

    guard, decoder = E2eGuard(signal_map), Decoder(signal_map)
    live = []
    for n, (channel, digits, data) in enumerate(frames):
        key = int(channel[-1]), int(digits, 16), len(digits) == 8
        refusal = guard.refusal(*key, data)
        if refusal is not None:
            decoder.counts[refusal] += 1
            continue
        live += [
            (n * 1_000_000, role, value)
            for role, value in decoder.decode(*key, data)
        ]
    assert replayed == live
    reader = Counter(log.reader.refused)
    assert log.counts + reader == decoder.counts

"""What tests on an interface build on: peers, time stamps, link, clock."""

import errno
import socket
import struct
import subprocess
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import can
import pytest

pytestmark = pytest.mark.vcan

FRAME = struct.Struct("=IB3x8s")
TIMESPEC = struct.Struct("@qq")
SO_TIMESTAMPNS = 35  # Python's socket module has no name for it
DEADLINE_S = 30.0

Program = Callable[[str], str]
Recorder = Callable[..., subprocess.Popen[str]]


def raw_socket(interface: str) -> socket.socket:
    """Return a raw CAN socket on *interface* with the kernel's time stamps."""
    raw = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    raw.settimeout(DEADLINE_S)
    raw.bind((interface,))
    return raw


def received(raw: socket.socket) -> tuple[int, bytes, int]:
    """Return identifier, data and the kernel's stamp (ns) of a frame."""
    text, ancillary, _, _ = raw.recvmsg(
        FRAME.size, socket.CMSG_SPACE(TIMESPEC.size)
    )
    identifier, length, data = FRAME.unpack(text)
    [(level, kind, stamp)] = ancillary
    assert (level, kind) == (socket.SOL_SOCKET, SO_TIMESTAMPNS)
    seconds, nanoseconds = TIMESPEC.unpack(stamp)
    return identifier, data[:length], seconds * 10**9 + nanoseconds


def lines(recorder: subprocess.Popen[str]) -> list[str]:
    """Return what candump has printed when it is through, without stamps."""
    printed, _ = recorder.communicate(timeout=DEADLINE_S)
    assert recorder.returncode == 0
    return [line.partition(") ")[2] for line in printed.splitlines()]


def test_candump_sees_what_cansend_sends(
    vcan0: str, program: Program, candump: Recorder
) -> None:
    recorder = candump("-L", "-n", "2", vcan0)

    subprocess.run([program("cansend"), vcan0, "123#DEADBEEF"], check=True)
    subprocess.run([program("cansend"), vcan0, "18FEBF0B#00"], check=True)

    assert lines(recorder) == ["vcan0 123#DEADBEEF", "vcan0 18FEBF0B#00"]


def test_canplayer_plays_a_log_onto_another_interface(
    vcan0: str, vcan1: str, program: Program, candump: Recorder, tmp_path: Path
) -> None:
    frames = [f"{n:03X}#{n:02X}" for n in range(1, 6)]
    log = tmp_path / "can.log"
    log.write_text(
        "".join(
            f"(1700000000.{n:02d}0000) can0 {frame}\n"
            for n, frame in enumerate(frames)
        )
    )
    recorder = candump("-L", "-n", str(len(frames)), vcan1)

    subprocess.run(
        [program("canplayer"), "-I", str(log), f"{vcan1}=can0"], check=True
    )

    assert lines(recorder) == [f"vcan1 {frame}" for frame in frames]


def test_a_raw_socket_receives_with_the_kernels_time_stamp(vcan0: str) -> None:
    with (
        closing(raw_socket(vcan0)) as sender,
        closing(raw_socket(vcan0)) as receiver,
    ):
        before_ns = time.time_ns()
        sender.send(FRAME.pack(0x321, 3, b"\1\2\3"))
        after_ns = time.time_ns()
        identifier, data, stamp_ns = received(receiver)

    assert (identifier, data) == (0x321, b"\1\2\3")
    # taken when the frame is queued, hence inside send()
    assert before_ns <= stamp_ns <= after_ns


def test_the_interfaces_are_two_buses(vcan0: str, vcan1: str) -> None:
    with (
        closing(raw_socket(vcan0)) as sender,
        closing(raw_socket(vcan1)) as other,
        closing(raw_socket(vcan0)) as same,
    ):
        sender.send(FRAME.pack(0x100, 0, b""))
        assert received(same)[0] == 0x100
        other.setblocking(False)
        with pytest.raises(BlockingIOError):
            other.recv(FRAME.size)


def test_candump_sees_what_python_can_sends(
    vcan0: str, candump: Recorder
) -> None:
    recorder = candump("-L", "-n", "1", vcan0)

    with can.Bus(interface="socketcan", channel=vcan0) as bus:
        bus.send(
            can.Message(
                arbitration_id=0x7A0, data=b"\x10\x20", is_extended_id=False
            )
        )

    assert lines(recorder) == ["vcan0 7A0#1020"]


def test_a_link_goes_down_and_up(
    vcan0: str, net_admin: None, program: Program
) -> None:
    ip = program("ip")
    with (
        closing(raw_socket(vcan0)) as sender,
        closing(raw_socket(vcan0)) as receiver,
    ):
        subprocess.run([ip, "link", "set", vcan0, "down"], check=True)
        try:
            with pytest.raises(OSError, match="down") as at_receiver:
                receiver.recv(FRAME.size)
            assert at_receiver.value.errno == errno.ENETDOWN
            for _ in range(2):  # the notice that it went down, then refusal
                with pytest.raises(OSError, match="down") as at_sender:
                    sender.send(FRAME.pack(0x100, 0, b""))
                assert at_sender.value.errno == errno.ENETDOWN
        finally:
            subprocess.run([ip, "link", "set", vcan0, "up"], check=True)

        sender.send(FRAME.pack(0x101, 0, b""))
        assert received(receiver)[0] == 0x101


def test_the_wall_clock_can_be_stepped(vcan0: str, own_clock: None) -> None:
    """Stamps jump with the wall clock; the time since boot does not."""
    step_ns = 3600 * 10**9
    with (
        closing(raw_socket(vcan0)) as sender,
        closing(raw_socket(vcan0)) as receiver,
    ):
        sender.send(FRAME.pack(0x100, 0, b""))
        *_, first_ns = received(receiver)
        boot_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)

        wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        time.clock_settime_ns(time.CLOCK_REALTIME, wall_ns - step_ns)

        sender.send(FRAME.pack(0x100, 0, b""))
        *_, second_ns = received(receiver)
        passed_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - boot_ns

    assert 0 <= passed_ns < DEADLINE_S * 1e9
    assert -step_ns < second_ns - first_ns < -step_ns + DEADLINE_S * 1e9

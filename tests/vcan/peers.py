"""The peers of the service on a bus: a car that drives, an ear that hears."""

from __future__ import annotations

import contextlib
import errno
import itertools
import socket
import struct
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

from bstm_daemon.service.clock import boot_clock_ns
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

ROOT = Path(__file__).resolve().parents[2]
DEADLINE_S = 30.0
"""For what takes milliseconds: reached only where it never comes."""

CLASSIC = struct.Struct("=IB3x8s")
TIMESPEC = struct.Struct("@qq")
FILTER = struct.Struct("=II")
FILTER_LIMIT = 512
STALL_US = 30_000
ONLY = 0xC0000000 | 0x1FFFFFFF
"""The mask of one standard id, not as a remote frame."""
SO_TIMESTAMPNS = 35  # Python's socket module has no name for it

DRIVE = """
[drive]
name = "hold"
description = "a descent of 8 % held at 72 km/h"
ambient_c = 10.0
[[segment]]
speed_kmh = 72.0
rate_ms2 = 4.0
gear = 0
grade_percent = -8.0
duration_s = 30.0
"""
SETTLED_US = 15_000_000
PERIOD_US = 10_000_000
"""Of this drive the car repeats ten seconds from here on: speed and pressure
are constant there, the front discs get 3 K/s hotter."""
THERMOCOUPLES = range(0x6A0, 0x6A4)


def wait_until(reached: Callable[[], bool], what: str) -> None:
    """Return once *reached* holds; fail with *what* if it never does."""
    deadline_s = time.monotonic() + DEADLINE_S
    while not reached():
        if time.monotonic() > deadline_s:
            pytest.fail(f"never: {what}")
        time.sleep(0.005)


class Sent(NamedTuple):
    """A frame of the car; ``boot_us`` is just before it was sent."""

    boot_us: int
    bus: int
    can_id: int
    data: bytes


class Heard(NamedTuple):
    """A frame on the bus, stamped by the kernel [ns of wall time]."""

    stamp_ns: int
    can_id: int
    data: bytes


class Car:
    """A car on a descent, its frames sent when they are due.

    ``buses`` are interfaces; ``places`` says of an id which of them it is
    sent on, by default the first. ``alter`` makes of one frame those that
    are really sent. While ``silent`` nothing is.
    """

    def __init__(
        self, buses: list[str], places: Mapping[int, int] | None = None
    ) -> None:
        self.silent = False
        self.alter: Callable[[int, bytes], Iterable[tuple[int, bytes]]] = (
            lambda can_id, data: [(can_id, data)]
        )
        self.sent: list[Sent] = []
        self.refused = 0
        """Frames that the interface did not take."""
        self._places = places or {}
        self._buses = buses
        self._sockets = [sender(bus) for bus in buses]
        self._frames = descent()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._drive)
        self._thread.start()

    def close(self) -> None:
        """Stop the car."""
        self._over.set()
        self._thread.join()
        for raw in self._sockets:
            raw.close()

    def _drive(self) -> None:
        start_s = time.monotonic()
        turn_us = 0
        while True:
            for offset_us, can_id, data in self._frames:
                due_s = start_s + (turn_us + offset_us) * 1e-6
                if self._over.wait(max(due_s - time.monotonic(), 0.0)):
                    return
                for frame in self.alter(can_id, data):
                    if not self.silent:
                        self._send(*frame)
            turn_us += PERIOD_US

    def _send(self, can_id: int, data: bytes) -> None:
        bus = self._places.get(can_id, 0)
        made = Sent(boot_clock_ns() // 1000, bus, can_id, data)
        try:
            self._sockets[bus].send(CLASSIC.pack(can_id, len(data), data))
        except OSError as error:
            self.refused += 1
            if error.errno in {errno.ENODEV, errno.ENXIO}:
                with contextlib.suppress(OSError):
                    fresh = sender(self._buses[bus])
                    self._sockets[bus].close()
                    self._sockets[bus] = fresh
        else:
            self.sent.append(made)


def stood_s(sent: Iterable[Sent]) -> float:
    """Return how long the computer stood still while a car *sent* these.

    Its frames are 4 ms apart: much more says that nothing ran.
    """
    gaps_us = (
        later.boot_us - earlier.boot_us
        for earlier, later in itertools.pairwise(sent)
    )
    return sum(gap_us for gap_us in gaps_us if gap_us > STALL_US) * 1e-6


class Ear:
    """Hears what is sent on an interface; of errors and remotes nothing."""

    def __init__(self, interface: str, low_id: int, high_id: int) -> None:
        self.frames: list[Heard] = []
        self._changed = threading.Condition()
        self._over = False
        self._ids = range(low_id, high_id)
        self._raw = socket.socket(
            socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW
        )
        self._raw.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        if len(self._ids) <= FILTER_LIMIT:  # or it takes the computer's time
            self._raw.setsockopt(
                socket.SOL_CAN_RAW,
                socket.CAN_RAW_FILTER,
                b"".join(FILTER.pack(word, ONLY) for word in self._ids),
            )
        self._raw.settimeout(0.1)
        self._raw.bind((interface,))
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def wait(
        self, count: int, can_id: int | None = None, since: int = 0
    ) -> list[Heard]:
        """Return frames *since* that index once *count* of the id came."""

        def found() -> list[Heard]:
            return [
                frame
                for frame in self.frames[since:]
                if can_id in {None, frame.can_id}
            ]

        with self._changed:
            if not self._changed.wait_for(
                lambda: len(found()) >= count, DEADLINE_S
            ):
                pytest.fail(f"only {len(found())} of {count} frames came")
            return found()

    def close(self) -> None:
        """Stop listening."""
        self._over = True
        self._thread.join()
        self._raw.close()

    def _listen(self) -> None:
        while not self._over:
            try:
                message, ancillary, _, _ = self._raw.recvmsg(
                    CLASSIC.size, socket.CMSG_SPACE(TIMESPEC.size)
                )
            except TimeoutError:
                continue
            except OSError:  # the interface went; a test that waits fails
                time.sleep(0.01)
                continue
            word, length, data = CLASSIC.unpack(message)
            if word not in self._ids:
                continue
            seconds, nanoseconds = TIMESPEC.unpack(ancillary[0][2])
            stamp_ns = seconds * 10**9 + nanoseconds
            with self._changed:
                self.frames.append(Heard(stamp_ns, word, data[:length]))
                self._changed.notify_all()


def sender(interface: str) -> socket.socket:
    """Return a socket that sends on *interface* and receives nothing."""
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    try:
        raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
        raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        raw.bind((interface,))
    except OSError:
        raw.close()
        raise
    return raw


def descent() -> list[tuple[int, int, bytes]]:
    """Return (time in the period [us], id, data) of a car's frames."""
    streams = Encoder(ROOT / "dbc" / "example_vehicle.dbc").streams(
        simulate(parse_drive(DRIVE, "hold"))
    )
    return sorted(
        (stamp_us - SETTLED_US, stream.frame_id, payload.to_bytes(8, "little"))
        for stream in streams
        if stream.frame_id not in THERMOCOUPLES
        for stamp_us, payload in zip(
            stream.stamp_us.tolist(), stream.payload.tolist(), strict=True
        )
        if SETTLED_US <= stamp_us < SETTLED_US + PERIOD_US
    )

"""A car that publishes what a test wants."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import struct
import subprocess
import sys
import termios
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyte
import pytest

from bstm_daemon.bus.output.publication import OutputFrame, Publication
from bstm_daemon.estimate import (
    NO_REASON,
    CornerEstimate,
    Estimate,
    HeatMode,
    Reason,
    State,
    Status,
    Validity,
)
from bstm_daemon.model.risk.levels import level_of_margin, published_level
from bstm_daemon.watch.board import Board

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

ID_BASE = 0x5B0
KELVIN = 273.15
STEP_US = 100_000


class Sender:
    """A daemon on a bench: publishes given temperatures [degC]."""

    def __init__(self, corners: tuple[str, ...] = ("FL", "FR")) -> None:
        """Send the frames of *corners*."""
        self.corners = corners
        self.publication = Publication(corners, ID_BASE)
        self.time_us = 0
        self.status: dict[str, Any] = {
            "state": State.RUNNING,
            "heat_mode": HeatMode.FB,
            "history_known": True,
            "compiled_kernel": True,
            "oldest_input_age_s": 0.1,
        }
        self.validity = Validity.VALID
        self.reasons: Reason = NO_REASON

    def frames(self, disc_c: float, fluid_c: float) -> list[OutputFrame]:
        """Return the frames of the next tenth of a second."""
        corner = CornerEstimate(
            disc_k=disc_c + KELVIN,
            pad_front_k=disc_c + KELVIN - 50.0,
            pad_back_k=fluid_c + KELVIN + 20.0,
            fluid_k=fluid_c + KELVIN,
            boiling_k=155.0 + KELVIN,
            validity=self.validity,
            reasons=self.reasons,
            level=published_level(
                level_of_margin(155.0 - fluid_c), self.validity
            ),
        )
        frames = self.publication.encode(
            Estimate(
                self.time_us,
                dict.fromkeys(self.corners, corner),
                Status(**self.status),
            )
        )
        self.time_us += STEP_US
        return frames

    def feed(
        self,
        board: Board,
        seconds: float,
        disc_c: float = 400.0,
        fluid_c: float = 90.0,
    ) -> int:
        """Let *board* see *seconds* of frames; return its time [us]."""
        for _ in range(round(seconds * 10)):
            now_us = self.time_us
            for frame in self.frames(disc_c, fluid_c):
                board.frame(frame.can_id, frame.data, now_us)
        return self.time_us - STEP_US


@pytest.fixture
def sender() -> Sender:
    """Return a car with two front corners."""
    return Sender()


@pytest.fixture(scope="session")
def make_sender() -> Callable[..., Sender]:
    """Return the maker of cars."""
    return Sender


@pytest.fixture
def board() -> Board:
    """Return a board that knows nothing yet."""
    return Board(ID_BASE)


ROOT = Path(__file__).parents[2]
TAKE_TERMINAL = "import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0)"
PATIENCE_S = 60.0


class Terminal:
    """A program on a terminal of its own, and what is on its screen."""

    def __init__(
        self,
        width: int,
        height: int,
        code: str,
        arguments: Sequence[object],
        env: Mapping[str, str],
    ) -> None:
        """Start Python with *code* and *arguments*."""
        self.screen = pyte.Screen(width, height)
        self._stream = pyte.ByteStream(self.screen)
        self._master, self._slave = pty.openpty()
        size = struct.pack("HHHH", height, width, 0, 0)
        fcntl.ioctl(self._slave, termios.TIOCSWINSZ, size)
        self.mode = termios.tcgetattr(self._slave)
        self.raw = b""
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-c",
                f"{TAKE_TERMINAL}\n{code}",
                *map(str, arguments),
            ],
            stdin=self._slave,
            stdout=self._slave,
            stderr=self._slave,
            start_new_session=True,
            cwd=ROOT,
            env={
                **os.environ,
                "PYTHONUTF8": "1",
                "NO_COLOR": "",
                "TERM": "xterm-256color",
                **env,
            },
        )

    @property
    def lines(self) -> list[str]:
        """The screen without blanks at the ends of lines."""
        return [line.rstrip() for line in self.screen.display]

    def until(self, text: str) -> None:
        """Read until *text* is on the screen."""
        while not any(text in line for line in self.lines):
            assert self._read(), f"no {text!r}: {self.lines}"

    def until_raw(self, part: bytes, begin: int = 0) -> int:
        """Read until *part* was written; return where it ends."""
        while (place := self.raw.find(part, begin)) < 0:
            assert self._read(), f"no {part!r}"
        return place + len(part)

    def press(self, keys: bytes) -> None:
        """Type *keys*."""
        os.write(self._master, keys)

    def ended(self) -> int:
        """Return the exit code; the terminal must be as it was."""
        code = self.process.wait(PATIENCE_S)
        while self._read(0.0):
            pass
        assert termios.tcgetattr(self._slave) == self.mode
        return code

    def close(self) -> None:
        """End the program if it still runs."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self._master)
        os.close(self._slave)

    def _read(self, patience_s: float = PATIENCE_S) -> bool:
        ready, _, _ = select.select([self._master], [], [], patience_s)
        if not ready:
            return False
        data = os.read(self._master, 65536)
        self.raw += data
        self._stream.feed(data)
        return bool(data)


@pytest.fixture
def terminal() -> Iterator[Callable[..., Terminal]]:
    """Return a starter of programs on terminals."""
    started = []

    def start(
        width: int, height: int, code: str, *arguments: object, **env: str
    ) -> Terminal:
        one = Terminal(width, height, code, arguments, env)
        started.append(one)
        return one

    yield start
    for one in started:
        one.close()

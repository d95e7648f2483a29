"""``bstm run`` as a process of its own, and what is heard of it."""

from __future__ import annotations

import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

import pytest

from bstm_daemon.service.state_file import read

from .peers import DEADLINE_S, wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence


class Forks:
    """The process of ``forks.py``, which has all modules loaded."""

    def __init__(self) -> None:
        """Start it."""
        self._channel, theirs = socket.socketpair(
            socket.AF_UNIX, socket.SOCK_SEQPACKET
        )
        number = theirs.fileno()
        self._process = subprocess.Popen(
            [
                sys.executable,
                Path(__file__).with_name("forks.py"),
                f"{number}",
            ],
            pass_fds=[number],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )
        theirs.close()

    def start(
        self,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        stderr: int,
    ) -> int:
        """Return the process id of ``bstm`` with *arguments*."""
        order = {"arguments": [*arguments], "environment": {**environment}}
        return self._ask(order, [stderr])

    def reap(self, pid: int) -> int:
        """Return how *pid* ended, once it has."""
        return self._ask({"reap": pid}, [])

    def close(self) -> None:
        """End it."""
        self._channel.close()
        self._process.wait(DEADLINE_S)

    def _ask(self, order: dict[str, Any], files: list[int]) -> int:
        socket.send_fds(self._channel, [json.dumps(order).encode()], files)
        return int(self._channel.recv(64))


class Forked:
    """A process of :class:`Forks`, to be handled like a ``Popen``."""

    COMMAND: Final = "bstm"

    def __init__(
        self,
        forks: Forks,
        arguments: Sequence[str],
        environment: Mapping[str, str],
    ) -> None:
        """Start ``bstm`` with *arguments*."""
        reader, writer = os.pipe()
        self.pid = forks.start(arguments, environment, writer)
        os.close(writer)
        self.stderr = os.fdopen(reader, encoding="utf-8", errors="replace")
        self._forks = forks
        self._file = os.pidfd_open(self.pid)
        self._code: int | None = None

    def poll(self) -> int | None:
        """Return the exit code; None while it runs."""
        return self._ended(0.0)

    def wait(self, timeout_s: float) -> int:
        """Return the exit code once there is one.

        Raises:
            TimeoutExpired: it still runs after *timeout_s*.
        """
        code = self._ended(timeout_s)
        if code is None:
            raise subprocess.TimeoutExpired(self.COMMAND, timeout_s)
        return code

    def send_signal(self, number: int) -> None:
        """Send signal *number*, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """End it at once."""
        self.send_signal(signal.SIGKILL)

    def _ended(self, timeout_s: float) -> int | None:
        if self._code is None:
            ready, _, _ = select.select([self._file], [], [], timeout_s)
            if ready:
                self._code = self._forks.reap(self.pid)
                os.close(self._file)
        return self._code


@dataclass
class Daemon:
    """A running service, and what it said so far."""

    process: Forked
    notify: socket.socket
    config: Path
    state: Path
    metrics_file: Path
    events: list[dict[str, Any]] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    other_lines: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Begin to hear it."""
        self._changed = threading.Condition()
        self._readers = [
            threading.Thread(target=self._read_log),
            threading.Thread(target=self._read_notices),
        ]
        self._ended = False
        for reader in self._readers:
            reader.start()

    def event(
        self, name: str, since: int = 0, **fields: Any
    ) -> dict[str, Any]:
        """Wait for the first event *name* with *fields*, and return it.

        *since* is an index of ``events``.
        """

        def found() -> dict[str, Any] | None:
            for event in self.events[since:]:
                if event["event"] == name and fields.items() <= event.items():
                    return event
            return None

        self._wait(lambda: found() is not None, f"event {name} {fields}")
        event = found()
        assert event is not None
        return event

    def said(self, name: str) -> list[dict[str, Any]]:
        """Return the events *name* so far."""
        return [event for event in self.events if event["event"] == name]

    def faults(self) -> set[str]:
        """Return the faults of inputs that came and are not over."""
        came = [event["fault"] for event in self.said("input_fault")]
        over = [event["fault"] for event in self.said("input_fault_over")]
        return {
            fault for fault in came if came.count(fault) > over.count(fault)
        }

    def notice(self, pattern: str, since: int = 0) -> str:
        """Wait for a notification that *pattern* is found in; return it."""

        def found() -> str | None:
            for text in self.notices[since:]:
                if re.search(pattern, text):
                    return text
            return None

        self._wait(lambda: found() is not None, f"notification {pattern}")
        text = found()
        assert text is not None
        return text

    def metric(self, series: str, reached: Callable[[float], bool]) -> float:
        """Wait until *series* has a value that is *reached*; return it."""
        values: list[float] = []

        def good() -> bool:
            values[:] = self._metric(series)
            return bool(values) and reached(values[0])

        wait_until(good, f"{series}, now {values}")
        return values[0]

    def document(self) -> dict[str, Any]:
        """Return what the state file holds, which must be whole."""
        loaded = read(self.state)
        assert loaded.problem is None
        assert loaded.document is not None
        return loaded.document

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send signal *number* and return the exit code."""
        self.process.send_signal(number)
        return self.exit_code()

    def exit_code(self) -> int:
        """Wait for the process to end by itself; return the exit code."""
        code = self.process.wait(DEADLINE_S)
        self._ended = True
        for reader in self._readers:
            reader.join()
        return code

    def close(self) -> None:
        """End it, whatever became of it."""
        if self.process.poll() is None:
            self.process.kill()
        self.exit_code()
        self.notify.close()
        self.process.stderr.close()

    def _wait(self, reached: Callable[[], bool], what: str) -> None:
        with self._changed:
            self._changed.wait_for(
                lambda: reached() or self._ended_early(), DEADLINE_S
            )
            if not reached():
                code = self.process.poll()
                said = [*self.events, *self.notices, *self.other_lines]
                text = "\n".join(map(str, said))
                pytest.fail(f"never: {what}; exit code {code}; said:\n{text}")

    def _ended_early(self) -> bool:
        return not self._readers[0].is_alive()

    def _read_log(self) -> None:
        for line in self.process.stderr:
            with self._changed:
                try:
                    self.events.append(
                        json.loads(line, parse_constant=no_constant)
                    )
                except ValueError:
                    self.other_lines.append(line)
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    def _read_notices(self) -> None:
        while True:
            try:
                text = self.notify.recv(4096).decode()
            except TimeoutError:
                if self._ended:
                    return
                continue
            with self._changed:
                self.notices.append(text)
                self._changed.notify_all()

    def _metric(self, series: str) -> list[float]:
        try:
            text = self.metrics_file.read_text(encoding="utf-8")
        except OSError:
            return []
        return [
            float(line.rpartition(" ")[2])
            for line in text.splitlines()
            if line.rpartition(" ")[0] == series
        ]


def no_constant(text: str) -> NoReturn:
    """Refuse NaN and infinities, which JSON has not."""
    raise ValueError(text)

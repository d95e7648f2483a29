"""Saves the state on a thread: a slow medium must not stall the loop."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from bstm_daemon.service.state_file import Document, encode, save

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class Outcome:
    """The outcome of the saves so far.

    ``saved_us`` is the time of the document that the file holds, None before
    the first. ``last_error`` is the reason of the newest failure until a save
    succeeds. ``running``: a document waits or is being written.
    """

    saves: int = 0
    failures: int = 0
    saved_us: int | None = None
    last_error: str | None = None
    running: bool = False


class StateWriter:
    """One thread that saves the newest document at *path*.

    A waiting document is replaced by a newer one, so a slow medium costs
    documents, never memory or time. Failures (disk full, read-only folder)
    are counted with their reason, and the next document is the next attempt.
    The thread does not delay the end of the process.
    """

    def __init__(self, path: Path) -> None:
        """Start the thread; nothing is written before the first document."""
        self._path = path
        self._changed = threading.Condition()
        self._waiting: tuple[bytes, int] | None = None
        self._closing = False
        self._outcome = Outcome()
        self._thread = threading.Thread(
            target=self._run, name="state writer", daemon=True
        )
        self._thread.start()

    def submit(self, document: Document, time_us: int) -> None:
        """Hand over *document* as it is now, at *time_us* [us].

        It is encoded here, so the caller may go on changing it. One that is
        not fit for a state file (see
        :func:`~bstm_daemon.service.state_file.encode`), or that comes after
        :meth:`close`, counts as a failure.
        """
        data, error = b"", None
        try:
            data = encode(document)
        except ValueError as reason:
            error = str(reason)
        with self._changed:
            if self._closing:
                error = "the writer is closed"
            if error is None:
                self._waiting = data, time_us
                self._outcome = replace(self._outcome, running=True)
                self._changed.notify_all()
            else:
                self._fail(error)

    def outcome(self) -> Outcome:
        """Return the outcome so far; never waits for I/O."""
        return self._outcome

    def wait(self, timeout_s: float) -> bool:
        """Wait until nothing waits or is being written; return whether so."""
        with self._changed:
            return self._changed.wait_for(
                lambda: not self._outcome.running, timeout_s
            )

    def close(self, *, timeout_s: float = 30.0) -> Outcome:
        """Save what was submitted last and end the thread.

        A medium that does not answer within *timeout_s* leaves the outcome
        ``running``. Closing again changes nothing.
        """
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(timeout_s)
        return self._outcome

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._waiting is not None or self._closing
                )
                job, self._waiting = self._waiting, None
            if job is None:
                return
            self._attempt(*job)

    def _attempt(self, data: bytes, time_us: int) -> None:
        error = None
        try:
            save(self._path, data)
        except (OSError, MemoryError) as reason:
            text = getattr(reason, "strerror", None) or str(reason)
            error = f"not saved: {text}"
        with self._changed:
            running = self._waiting is not None
            self._outcome = replace(self._outcome, running=running)
            if error is None:
                self._outcome = replace(
                    self._outcome,
                    saves=self._outcome.saves + 1,
                    saved_us=time_us,
                    last_error=None,
                )
            else:
                self._fail(error)
            self._changed.notify_all()

    def _fail(self, error: str) -> None:
        self._outcome = replace(
            self._outcome,
            failures=self._outcome.failures + 1,
            last_error=f"{self._path}: {error}",
        )

"""State saved beside the loop: a slow medium must not stall the frames."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bstm_daemon.daemon.state_file import Document, encode, save_encoded

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class Outcome:
    """What became of the documents so far.

    ``saved_number`` is the number (see :meth:`StateWriter.submit`) of the
    document that the file holds, 0 before the first. ``last_error`` is the
    reason of the newest failure until a save succeeds. ``last_duration_s``
    is how long the newest attempt took. ``running``: a document waits or is
    being written.
    """

    submitted: int = 0
    saves: int = 0
    failures: int = 0
    saved_number: int = 0
    last_error: str | None = None
    last_duration_s: float | None = None
    running: bool = False


@dataclass(frozen=True)
class _Job:
    number: int
    data: bytes


class StateWriter:
    """One thread that saves the newest document at *path*.

    A document that waits while another is being written gives way to a newer
    one, so a slow medium costs documents, never memory or time. What goes
    wrong (disk full, read-only folder) is counted with its reason, and the
    next document is the next try. The thread does not hold up the end of the
    process.
    """

    def __init__(self, path: Path) -> None:
        """Start the thread; nothing is written before the first document."""
        self._path = path
        self._changed = threading.Condition()
        self._waiting: _Job | None = None
        self._writing = False
        self._unsaved: _Job | None = None
        self._closing = False
        self._submitted = self._saves = self._failures = 0
        self._saved_number = 0
        self._last_error: str | None = None
        self._last_duration_s: float | None = None
        self._thread = threading.Thread(
            target=self._run, name="state writer", daemon=True
        )
        self._thread.start()

    def submit(self, document: Document) -> int:
        """Hand over *document* as it is now; return its number, from 1.

        It is encoded here, so the caller may go on changing it. One that is
        not fit for a state file (see
        :func:`~bstm_daemon.daemon.state_file.encode`), or that comes after
        :meth:`close`, counts as a failure.
        """
        data, error = b"", None
        try:
            data = encode(document)
        except ValueError as reason:
            error = str(reason)
        with self._changed:
            self._submitted += 1
            if self._closing:
                error = "the writer is closed"
            if error is None:
                self._waiting = _Job(self._submitted, data)
                self._changed.notify_all()
            else:
                self._failures += 1
                self._last_error = f"{self._path}: {error}"
            return self._submitted

    def outcome(self) -> Outcome:
        """Return what became of the documents so far; never waits for I/O."""
        with self._changed:
            return Outcome(
                submitted=self._submitted,
                saves=self._saves,
                failures=self._failures,
                saved_number=self._saved_number,
                last_error=self._last_error,
                last_duration_s=self._last_duration_s,
                running=self._running(),
            )

    def wait(self, timeout_s: float) -> bool:
        """Wait until nothing waits or is being written; tell if so."""
        with self._changed:
            return self._changed.wait_for(
                lambda: not self._running(), timeout_s
            )

    def close(
        self, document: Document | None = None, *, timeout_s: float = 30.0
    ) -> Outcome:
        """Save the last *document*, end the thread, tell what became of it.

        Without a new one, a submitted document that could not be saved gets
        one more try. A medium that does not answer within *timeout_s* leaves
        the outcome ``running``. Closing again changes nothing.
        """
        with self._changed:
            before = self._submitted
            closed = self._closing
        if closed:
            return self.outcome()
        if document is not None:
            self.submit(document)
        deadline_s = time.monotonic() + timeout_s
        self.wait(timeout_s)
        with self._changed:
            unsaved = self._unsaved
            if (
                unsaved is not None
                and unsaved.number <= before
                and not self._running()
            ):
                self._waiting = unsaved
            self._closing = True
            self._changed.notify_all()
        self._thread.join(max(0.0, deadline_s - time.monotonic()))
        return self.outcome()

    def _running(self) -> bool:
        return self._writing or self._waiting is not None

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(
                    lambda: self._waiting is not None or self._closing
                )
                job, self._waiting = self._waiting, None
                if job is None:
                    return
                self._writing = True
            self._attempt(job)

    def _attempt(self, job: _Job) -> None:
        begin_s = time.monotonic()
        error = None
        try:
            save_encoded(self._path, job.data)
        except (OSError, MemoryError) as reason:
            text = getattr(reason, "strerror", None) or str(reason)
            error = f"{self._path}: not saved: {text}"
        duration_s = time.monotonic() - begin_s
        with self._changed:
            self._writing = False
            self._last_duration_s = duration_s
            self._last_error = error
            if error is None:
                self._saves += 1
                self._saved_number = job.number
                self._unsaved = None
            else:
                self._failures += 1
                self._unsaved = job
            self._changed.notify_all()

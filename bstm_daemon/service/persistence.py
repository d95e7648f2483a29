"""Loads, saves and corrects the state of the running service.

It is saved on a thread: a slow medium must not stall the loop. Where the wall
clock is synchronised only after the start, the parked time is corrected then,
once.
"""

import os
import threading
from dataclasses import asdict, dataclass, replace
from math import nan
from pathlib import Path
from typing import Any, Final

from bstm_daemon.config.sections import Config
from bstm_daemon.engine import Engine
from bstm_daemon.estimator.memory import StateError
from bstm_daemon.estimator.state import keep_input_history
from bstm_daemon.service import events
from bstm_daemon.service.clock import Moment, SteadyAxis, boot_id, parked_time
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.state_file import (
    Document,
    encode,
    load,
    lock,
    save,
    set_aside,
    state_path,
)
from bstm_daemon.service.status import StateFileStatus


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


CLOCK_SET_US: Final = 1_735_689_600_000_000
"""2025-01-01; a wall clock before this is not set."""

MOVING_K_PER_S: Final = 1.0 / 60.0
"""While a node changes faster than 1 K/min, the short interval applies."""

CORRECTION_LIMIT_US: Final = 3_600_000_000
"""A clock synchronised later than this after the start corrects nothing: by
then the initial temperatures have no effect any more."""


class Persistence:
    """The state file of one running service."""

    def __init__(self, file: Path, axis: SteadyAxis, log: ServiceLog) -> None:
        """Own *file*.

        Raises:
            StateLockedError: another instance does.
        """
        self._file = file
        self._axis = axis
        self._log = log
        self._lock = lock(file)
        if self._lock.problem:
            log.emit(
                events.STATE_SAVE_FAILED,
                file=str(file),
                error=self._lock.problem,
            )
        self._writer = StateWriter(file)
        self._boot_id = boot_id()
        self._next_us = 0
        self._submitted_us: int | None = None
        self._checked: tuple[int, list[float]] | None = None
        self._failures_logged = 0
        self._start: tuple[dict[str, Any], Moment, int, int] | None = None
        """Restored document, its moment, assumed parked time [us] and start
        time [us], while a synchronised clock may still correct them."""

    def resume(self, engine: Engine, now_us: int) -> None:
        """Put the saved state, cooled since, into *engine*; save at once.

        Saving at once reveals an unwritable folder at the start, not after
        the drive. The tick before puts the state on the grid, so that a
        replay from it continues exactly as the service does.
        """
        loaded = load(self._file)
        reason = loaded.problem
        if loaded.document is not None:
            reason = self._restore(engine, loaded.document, now_us)
        if reason:
            self._log.emit(
                events.STATE_DISCARDED, file=str(self._file), reason=reason
            )
        engine.tick(now_us)
        self.save(engine, now_us)

    def _restore(
        self, engine: Engine, document: dict[str, Any], now_us: int
    ) -> str | None:
        """Restore *document*; return why that failed, None if it did not."""
        saved = Moment.saved(document)
        parked = parked_time(saved, self._moment(engine, now_us))
        try:
            restored = engine.resume(
                document, parked.us, now_us, proven=parked.exact
            )
        except StateError as error:
            aside = set_aside(self._file)
            return f"does not fit this car: {error}; {aside}"
        self._log.emit(
            events.STATE_LOADED,
            file=str(self._file),
            age_s=parked.us * 1e-6,
            exact=parked.exact,
            new_nodes=list(restored.new),
        )
        if saved and saved.wall_error_us is not None and not parked.exact:
            self._start = document, saved, parked.us, now_us
            keep_input_history(engine.estimator)
        return None

    def _moment(self, engine: Engine, at_us: int) -> Moment:
        """Return *at_us* of the axis by the clocks as they are now."""
        error_us = self._axis.wall_error_us()
        wall_us = self._axis.wall_of(at_us)
        if engine.config.state.trust_wall_clock:
            error_us = 0
        if wall_us < CLOCK_SET_US:
            error_us = None
        boot_us = self._axis.boot_of(at_us)
        return Moment(self._boot_id, boot_us, wall_us, error_us)

    def _correct(self, engine: Engine, now_us: int) -> None:
        """Correct the parked time once the wall clock is synchronised."""
        if self._start is None:
            return
        document, saved, assumed_us, start_us = self._start
        if now_us - start_us > CORRECTION_LIMIT_US:
            self._start = engine.estimator.input_history = None
            return
        parked = parked_time(saved, self._moment(engine, start_us))
        if not parked.exact:
            return
        self._start = None
        # the input history has no heat of a hole
        if parked.us <= assumed_us or engine.estimator.unseen.driven:
            engine.estimator.input_history = None
            return
        try:
            engine.correct_parked(document, parked.us)
        except StateError as error:
            self._log.emit(
                events.STATE_DISCARDED, file=str(self._file), reason=str(error)
            )
            return
        self._log.emit(
            events.PARKED_TIME_CORRECTED,
            assumed_s=assumed_us * 1e-6,
            parked_s=parked.us * 1e-6,
        )

    def reloaded(self, old: Engine, fresh: Engine) -> None:
        """Let *fresh* continue for *old*, even with an uncertain parked time.

        The input history that a correction needs is for the same corners.
        """
        if old.estimator.plan.corners == fresh.estimator.plan.corners:
            fresh.estimator.input_history = old.estimator.input_history
            fresh.estimator.unseen.driven += old.estimator.unseen.driven
        else:
            self._start = None

    def poll(self, engine: Engine, now_us: int) -> None:
        """Correct the parked time if that is possible, save if it is time."""
        self._report_failures()
        self._correct(engine, now_us)
        if now_us < self._next_us:
            return
        if self._is_moving(engine, now_us) or self._idle_over(engine, now_us):
            self.save(engine, now_us)
        else:
            interval_s = engine.config.state.interval_s
            self._next_us = now_us + round(interval_s * 1e6)

    def save(self, engine: Engine, now_us: int) -> None:
        """Pass the state to the writer."""
        self._writer.submit(self.document(engine), now_us)
        self._submitted_us = now_us
        self._next_us = now_us + round(engine.config.state.interval_s * 1e6)
        self._checked = now_us, engine.temperatures_k()

    def document(self, engine: Engine) -> dict[str, Any]:
        """Return the state with the clocks that date it."""
        document = engine.export_state()
        time_us = document["time_us"]
        if time_us is None:
            time_us = self._axis.read()
        return document | asdict(self._moment(engine, time_us))

    def status(self, now_us: int) -> StateFileStatus:
        """Return the status of the state file."""
        outcome = self._writer.outcome()
        age_s = nan
        if outcome.saved_us is not None:
            age_s = (now_us - outcome.saved_us) * 1e-6
        return StateFileStatus(outcome.saves, outcome.failures, age_s)

    def close(self, engine: Engine) -> None:
        """Save a last time, wait for it, give the lock back."""
        self._writer.submit(self.document(engine), self._axis.read())
        outcome = self._writer.close()
        self._report_failures()
        if not outcome.running:
            # a save that hangs may still write and keeps the lock
            self._lock.close()

    def _is_moving(self, engine: Engine, now_us: int) -> bool:
        """Whether a node changed by over 1 K/min since the last check."""
        now_k = engine.temperatures_k()
        before = self._checked
        self._checked = now_us, now_k
        if before is None or len(before[1]) != len(now_k):
            return True
        then_us, then_k = before
        limit_k = MOVING_K_PER_S * (now_us - then_us) * 1e-6
        return any(
            abs(a - b) > limit_k for a, b in zip(now_k, then_k, strict=True)
        )

    def _idle_over(self, engine: Engine, now_us: int) -> bool:
        idle_us = round(engine.config.state.idle_interval_s * 1e6)
        return (
            self._submitted_us is None
            or now_us - self._submitted_us >= idle_us
        )

    def _report_failures(self) -> None:
        outcome = self._writer.outcome()
        if outcome.failures > self._failures_logged:
            self._failures_logged = outcome.failures
            self._log.repeat(
                events.STATE_SAVE_FAILED,
                "save",
                self._axis.boot_of(self._axis.read()),
                file=str(self._file),
                error=outcome.last_error or "",
            )


def state_file(config: Config, base: Path, given: Path | None) -> Path:
    """Return the state file: *given*, the configured or the default one.

    Raises:
        UsageError: there is no default place.
    """
    if given is not None:
        return given
    configured = config.state.file
    return state_path(
        None if configured is None else base / configured,
        config.vehicle.id,
        os.environ,
    )

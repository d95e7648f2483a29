"""A ring of the frames that were read, as candump text.

The loop only appends text to a buffer. A full one goes to a thread that packs
and writes it (:mod:`~bstm_daemon.service.record_store`), so neither a slow
medium nor a full one holds up the frames.
"""

import re
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bstm_daemon.bus.live.link import Frame
from bstm_daemon.bus.logs.candump_line import ERROR_FLAG
from bstm_daemon.bus.signals.extraction import EXTENDED_MAX
from bstm_daemon.config.service import RecordConfig
from bstm_daemon.service.record_store import RecordStore

_MICRO: Final = 1_000_000
_CLASSIC_BYTES: Final = 8
_TEXT_LIMIT: Final = 4 * 2**20
"""Most text of a segment [byte]; 90 s of 1000 frames a second."""
_SEGMENTS_WAITING: Final = 4
_KEEPS_WAITING: Final = 64
_TOKEN: Final = re.compile(r"[!-~]+")


@dataclass(frozen=True, slots=True)
class RecordOutcome:
    """The outcome for frames and kept records so far.

    ``frames`` were taken, ``lost_frames`` of them could not be written;
    ``segments`` were written and ``failures`` counts what went wrong, of
    which ``last_error`` is the newest until a segment is written again.
    """

    frames: int = 0
    lost_frames: int = 0
    segments: int = 0
    failures: int = 0
    last_error: str | None = None


@dataclass(frozen=True, slots=True)
class _Text:
    start_us: int
    text: bytearray
    frames: int


@dataclass(frozen=True, slots=True)
class _Keep:
    reason: str
    stamp_us: int


class Recorder:
    """Records frames in *folder*, the newest ``ring_bytes`` of them.

    All methods are for the thread of the loop, and only :meth:`wait` and
    :meth:`close` wait for the disk. Failures (disk full, read-only folder)
    are counted, and the next segment is the next attempt.
    """

    def __init__(
        self, config: RecordConfig, folder: Path, channels: Sequence[str]
    ) -> None:
        """Start the thread; nothing is written before the first segment.

        *channels* has the interface name of each bus number, as in
        ``[[bus]] channel``. One that a candump log cannot hold (empty, with
        blanks, given twice) is recorded as ``bus<number>``.
        """
        self._folder = folder
        self._names = [
            name
            if _TOKEN.fullmatch(name) and channels.index(name) == number
            else f"bus{number}"
            for number, name in enumerate(channels)
        ]
        self._segment_us = round(config.segment_s * _MICRO)
        self._after_us = round(config.after_s * _MICRO)
        # even incompressible text fits four times into either bound
        self._text_limit = min(
            _TEXT_LIMIT, config.ring_bytes // 4, config.kept_bytes // 4
        )
        self._buffer = bytearray()
        self._buffered = 0
        self._start_us = 0
        self._kept_until_us: dict[str, int] = {}
        self._frames = self._lost = self._segments = self._failures = 0
        self._last_error: str | None = None
        self._store = RecordStore(config, folder)
        self._changed = threading.Condition()
        self._jobs: deque[_Text | _Keep] = deque()
        self._working = False
        self._closing = False
        self._thread = threading.Thread(
            target=self._run, name="recorder", daemon=True
        )
        self._thread.start()

    def frame(self, bus: int, frame: Frame, stamp_us: int) -> None:
        """Record one frame of bus number *bus*, stamped *stamp_us* [us].

        The stamp is wall time, 0 or more. More than 8 bytes are CAN FD; bit
        rate switch and error state of an FD frame are not recorded.
        """
        if self._buffered:
            elapsed_us = stamp_us - self._start_us
            # buses are drained in turn, so stamps may step back slightly
            if (
                not -self._segment_us < elapsed_us < self._segment_us
                or len(self._buffer) >= self._text_limit
            ):
                self._hand_over()
        if not self._buffered:
            self._start_us = stamp_us
        digits = f"{frame.can_id:0{8 if frame.extended else 3}X}"
        if frame.is_error:
            digits = f"{frame.can_id & EXTENDED_MAX | ERROR_FLAG:08X}"
        text = "R" if frame.is_remote else frame.data.hex().upper()
        if len(frame.data) > _CLASSIC_BYTES and not frame.is_remote:
            text = f"#0{text}"
        seconds, micros = divmod(stamp_us, _MICRO)
        place = f"({seconds}.{micros:06d}) {self._names[bus]}"
        self._buffer += f"{place} {digits}#{text}\n".encode()
        self._buffered += 1

    def tick(self, stamp_us: int) -> None:
        """Write a segment that is over at *stamp_us*: buses may be silent."""
        if self._buffered and (
            abs(stamp_us - self._start_us) >= self._segment_us
        ):
            self._hand_over()

    def keep(self, reason: str, stamp_us: int) -> None:
        """Keep the frames around *stamp_us* [us], for *reason*.

        From ``before_s`` before until ``after_s`` after, in whole segments;
        the current one is written at once. The same reason again meanwhile
        extends that time.
        """
        is_new = stamp_us > self._kept_until_us.get(reason, -1)
        self._kept_until_us[reason] = stamp_us + self._after_us
        if is_new:
            self._hand_over()
        with self._changed:
            keeps = sum(isinstance(job, _Keep) for job in self._jobs)
            if self._closing or keeps >= _KEEPS_WAITING:
                self._failures += 1
                return
            self._jobs.append(_Keep(reason, stamp_us))
            self._changed.notify_all()

    def outcome(self) -> RecordOutcome:
        """Return the outcome so far; never waits for I/O."""
        with self._changed:
            return RecordOutcome(
                self._frames + self._buffered,
                self._lost,
                self._segments,
                self._failures,
                self._last_error,
            )

    def wait(self, timeout_s: float) -> bool:
        """Wait until everything handed over is done; return whether it is."""
        with self._changed:
            return self._changed.wait_for(
                lambda: not (self._jobs or self._working), timeout_s
            )

    def close(self, *, timeout_s: float = 30.0) -> RecordOutcome:
        """Write the buffer, end the thread, return the outcome.

        A medium that does not answer within *timeout_s* is left alone.
        Frames that come later are lost. Closing again changes nothing.
        """
        deadline_s = time.monotonic() + timeout_s
        # the loop has ended: the last segment may wait for the disk
        self.wait(timeout_s)
        self._hand_over()
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(max(0.0, deadline_s - time.monotonic()))
        return self.outcome()

    def _hand_over(self) -> None:
        """Pass the buffer to the thread; if too many wait, drop the oldest."""
        if not self._buffered:
            return
        job = _Text(self._start_us, self._buffer, self._buffered)
        self._buffer = bytearray()
        self._buffered = 0
        with self._changed:
            self._frames += job.frames
            if self._closing:
                self._lost += job.frames
                return
            waiting = [one for one in self._jobs if isinstance(one, _Text)]
            if len(waiting) >= _SEGMENTS_WAITING:
                self._jobs.remove(waiting[0])
                self._lost += waiting[0].frames
            self._jobs.append(job)
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._jobs or self._closing)
                if not self._jobs:
                    return
                job = self._jobs.popleft()
                self._working = True
            self._attempt(job)

    def _attempt(self, job: _Text | _Keep) -> None:
        error = None
        written = False
        try:
            if isinstance(job, _Text):
                segment = self._store.write(job.start_us, job.text)
                written = True
                self._store.extend(segment)
            else:
                self._store.keep(job.reason, job.stamp_us)
        except (OSError, MemoryError) as reason:
            text = getattr(reason, "strerror", None) or str(reason)
            error = f"{self._folder}: not recorded: {text}"
        with self._changed:
            self._working = False
            if written:
                self._segments += 1
                self._last_error = None
            elif isinstance(job, _Text):
                self._lost += job.frames
            if error is not None:
                self._failures += 1
                self._last_error = error
            self._changed.notify_all()

"""The writer thread: the newest document, no queue, no exception."""

from __future__ import annotations

import math
import os
import threading
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.service.state_file import Document, encode, load, save
from bstm_daemon.service.state_writer import Outcome, StateWriter

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

LONG_S = 60.0


class SlowMedium:
    """A medium whose first sync of every save answers only when told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked = threading.Semaphore(0)
        self.answers = threading.Semaphore(0)
        self._fsync = os.fsync
        monkeypatch.setattr(os, "fsync", self._slow)

    def _slow(self, file: int) -> None:
        self.asked.release()
        assert self.answers.acquire(timeout=LONG_S)
        self._fsync(file)

    def answer(self, syncs: int) -> None:
        self.answers.release(syncs)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "folder" / "golf.state"


@pytest.fixture
def writer(path: Path) -> Iterator[StateWriter]:
    made = StateWriter(path)
    yield made
    made.close()


def test_nothing_is_written_before_the_first_document(
    path: Path, writer: StateWriter
) -> None:
    assert writer.outcome() == Outcome()
    assert writer.close() == Outcome()
    assert not path.parent.exists()


def test_documents_are_saved_and_counted(
    path: Path, writer: StateWriter
) -> None:
    for number in (1, 2, 3):
        writer.submit({"number": number}, 100 * number)
        assert writer.wait(LONG_S)
        assert load(path).document == {"number": number}

    assert writer.outcome() == Outcome(saves=3, saved_us=300)


def test_a_slow_medium_gets_the_newest_document_only(
    path: Path, writer: StateWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Submitting goes on while a sync hangs; what came between is dropped."""
    medium = SlowMedium(monkeypatch)
    writer.submit({"number": 1}, 1)
    assert medium.asked.acquire(timeout=LONG_S)

    for number in range(2, 1001):
        writer.submit({"number": number}, number)
    waiting = writer.outcome()
    assert not writer.wait(0)
    medium.answer(2)
    for _ in ("the folder", "the next file"):
        assert medium.asked.acquire(timeout=LONG_S)
    between = writer.outcome()
    medium.answer(2)
    assert writer.wait(LONG_S)

    assert (waiting.saves, waiting.running) == (0, True)
    assert (between.saves, between.saved_us) == (1, 1)
    assert between.running
    outcome = writer.outcome()
    assert (outcome.saves, outcome.saved_us) == (2, 1000)
    assert not outcome.running
    assert load(path).document == {"number": 1000}


def test_the_document_is_taken_as_it_is_at_the_call(
    path: Path, writer: StateWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop may go on with the same dict."""
    medium = SlowMedium(monkeypatch)
    writer.submit({}, 0)
    assert medium.asked.acquire(timeout=LONG_S)
    corner = {"disc_k": 300.0}
    document: Document = {"corner": corner}

    writer.submit(document, 1)
    corner["disc_k"] = math.nan
    document["more"] = 1
    medium.answer(4)
    writer.close()

    assert load(path).document == {"corner": {"disc_k": 300.0}}


def test_a_failure_is_counted_and_the_next_document_is_the_next_try(
    path: Path, writer: StateWriter
) -> None:
    path.parent.touch()  # a file where the folder should be
    for failures in (1, 2):
        writer.submit({"number": failures}, failures)
        assert writer.wait(LONG_S)
        failed = writer.outcome()
        assert (failed.saves, failed.failures) == (0, failures)
        assert failed.last_error == f"{path}: not saved: File exists"

    path.parent.unlink()
    writer.submit({"number": 3}, 3)
    assert writer.wait(LONG_S)
    outcome = writer.outcome()
    assert (outcome.saves, outcome.failures) == (1, 2)
    assert (outcome.saved_us, outcome.last_error) == (3, None)
    assert load(path).document == {"number": 3}


def test_an_unfit_document_leaves_the_last_one(
    path: Path, writer: StateWriter
) -> None:
    """A NaN in the estimator neither ends the loop nor reaches the file."""
    writer.submit({"disc_k": 300.0}, 1)
    assert writer.wait(LONG_S)

    writer.submit({"disc_k": math.nan}, 2)
    outcome = writer.close()

    assert (outcome.saves, outcome.failures) == (1, 1)
    assert outcome.saved_us == 1
    assert outcome.last_error is not None
    assert outcome.last_error.startswith(f"{path}: not a document for a sta")
    assert load(path).document == {"disc_k": 300.0}


def test_close_saves_the_last_document(
    path: Path, writer: StateWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After one that is still being written."""
    medium = SlowMedium(monkeypatch)
    writer.submit({"number": 1}, 1)
    assert medium.asked.acquire(timeout=LONG_S)
    medium.answer(4)

    writer.submit({"number": 2}, 2)
    outcome = writer.close()

    assert (outcome.saves, outcome.saved_us) == (2, 2)
    assert load(path).document == {"number": 2}
    assert not outcome.running
    assert not writer._thread.is_alive()


def test_close_reports_a_last_failure(path: Path, writer: StateWriter) -> None:
    path.parent.touch()

    writer.submit({"number": 1}, 1)
    outcome = writer.close()

    assert (outcome.saves, outcome.failures) == (0, 1)
    assert not outcome.running
    assert not writer._thread.is_alive()


def test_after_close_nothing_is_saved(path: Path, writer: StateWriter) -> None:
    writer.submit({"number": 1}, 1)
    first = writer.close()
    writer.submit({"number": 2}, 2)
    outcome = writer.close()

    assert first.failures == 0
    assert (outcome.saves, outcome.failures) == (1, 1)
    assert outcome.last_error == f"{path}: the writer is closed"
    assert load(path).document == {"number": 1}


def test_a_medium_that_never_answers_does_not_hold_up_the_end(
    path: Path, writer: StateWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Close comes back and says so; what the file held stands."""
    save(path, encode({"number": 0}))
    medium = SlowMedium(monkeypatch)
    writer.submit({"number": 1}, 1)
    assert medium.asked.acquire(timeout=LONG_S)

    writer.submit({"number": 2}, 2)
    outcome = writer.close(timeout_s=0.0)

    assert outcome.running
    assert outcome.saves == 0
    assert load(path).document == {"number": 0}
    assert writer._thread.daemon
    medium.answer(4)
    writer._thread.join(LONG_S)
    assert load(path).document == {"number": 2}

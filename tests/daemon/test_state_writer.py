"""The writer thread: the newest document, no queue, no exception."""

from __future__ import annotations

import math
import os
import threading
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.daemon.state_file import Document, encode, load, save
from bstm_daemon.daemon.state_writer import Outcome, StateWriter

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
        assert writer.submit({"number": number}) == number
        assert writer.wait(LONG_S)
        assert load(path).document == {"number": number}

    outcome = writer.outcome()
    assert outcome.last_duration_s is not None
    assert 0 < outcome.last_duration_s < LONG_S
    assert outcome == Outcome(
        submitted=3,
        saves=3,
        saved_number=3,
        last_duration_s=outcome.last_duration_s,
    )


def test_a_slow_medium_gets_the_newest_document_only(
    path: Path, writer: StateWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Submitting goes on while a sync hangs; what came between is dropped."""
    medium = SlowMedium(monkeypatch)
    writer.submit({"number": 1})
    assert medium.asked.acquire(timeout=LONG_S)

    for number in range(2, 1001):
        assert writer.submit({"number": number}) == number
    waiting = writer.outcome()
    assert not writer.wait(0)
    medium.answer(2)
    for _ in ("the folder", "the next file"):
        assert medium.asked.acquire(timeout=LONG_S)
    between = writer.outcome()
    medium.answer(2)
    assert writer.wait(LONG_S)

    assert (waiting.saves, waiting.running) == (0, True)
    assert (between.saves, between.saved_number) == (1, 1)
    assert between.running
    outcome = writer.outcome()
    assert (outcome.submitted, outcome.saves) == (1000, 2)
    assert (outcome.saved_number, outcome.running) == (1000, False)
    assert load(path).document == {"number": 1000}


def test_the_document_is_taken_as_it_is_at_the_call(
    path: Path, writer: StateWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop may go on with the same dict."""
    medium = SlowMedium(monkeypatch)
    writer.submit({})
    assert medium.asked.acquire(timeout=LONG_S)
    corner = {"disc_k": 300.0}
    document: Document = {"corner": corner}

    writer.submit(document)
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
        writer.submit({"number": failures})
        assert writer.wait(LONG_S)
        failed = writer.outcome()
        assert (failed.saves, failed.failures) == (0, failures)
        assert failed.last_error == f"{path}: not saved: File exists"
        assert failed.last_duration_s is not None

    path.parent.unlink()
    writer.submit({"number": 3})
    assert writer.wait(LONG_S)
    outcome = writer.outcome()
    assert (outcome.saves, outcome.failures) == (1, 2)
    assert (outcome.saved_number, outcome.last_error) == (3, None)
    assert load(path).document == {"number": 3}


def test_an_unfit_document_leaves_the_last_one(
    path: Path, writer: StateWriter
) -> None:
    """A NaN in the estimator neither ends the loop nor reaches the file."""
    writer.submit({"disc_k": 300.0})
    assert writer.wait(LONG_S)

    writer.submit({"disc_k": math.nan})
    outcome = writer.close()

    assert (outcome.submitted, outcome.saves, outcome.failures) == (2, 1, 1)
    assert outcome.saved_number == 1
    assert outcome.last_error is not None
    assert outcome.last_error.startswith(f"{path}: not a document for a sta")
    assert load(path).document == {"disc_k": 300.0}


def test_close_saves_the_last_document(
    path: Path, writer: StateWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After one that is still being written."""
    medium = SlowMedium(monkeypatch)
    writer.submit({"number": 1})
    assert medium.asked.acquire(timeout=LONG_S)
    medium.answer(4)

    outcome = writer.close({"number": 2})

    assert (outcome.saves, outcome.saved_number) == (2, 2)
    assert load(path).document == {"number": 2}
    assert not outcome.running
    assert not writer._thread.is_alive()


@pytest.mark.parametrize("repaired", [True, False])
def test_close_tries_an_unsaved_document_once_more(
    path: Path,
    writer: StateWriter,
    repaired: bool,  # noqa: FBT001
) -> None:
    path.parent.touch()
    writer.submit({"number": 1})
    assert writer.wait(LONG_S)
    if repaired:
        path.parent.unlink()

    outcome = writer.close()

    assert outcome.saves == repaired
    assert outcome.failures == 2 - repaired
    assert (outcome.last_error is None) == repaired
    assert not writer._thread.is_alive()


def test_the_last_document_of_close_is_tried_once(
    path: Path, writer: StateWriter
) -> None:
    path.parent.touch()

    outcome = writer.close({"number": 1})

    assert (outcome.submitted, outcome.failures) == (1, 1)


def test_after_close_nothing_is_saved(path: Path, writer: StateWriter) -> None:
    first = writer.close({"number": 1})
    writer.submit({"number": 2})
    outcome = writer.close({"number": 3})

    assert first.failures == 0
    assert (outcome.submitted, outcome.failures) == (2, 1)
    assert outcome.last_error == f"{path}: the writer is closed"
    assert load(path).document == {"number": 1}


def test_a_medium_that_never_answers_does_not_hold_up_the_end(
    path: Path, writer: StateWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Close comes back and says so; what the file held stands."""
    save(path, {"number": 0})
    medium = SlowMedium(monkeypatch)
    writer.submit({"number": 1})
    assert medium.asked.acquire(timeout=LONG_S)

    outcome = writer.close({"number": 2}, timeout_s=0.0)

    assert outcome.running
    assert outcome.saves == 0
    assert load(path).document == {"number": 0}
    assert writer._thread.daemon
    medium.answer(4)
    writer._thread.join(LONG_S)
    assert load(path).document == {"number": 2}


def test_threads_may_submit_at_once(path: Path, writer: StateWriter) -> None:
    """Every number is given once, and the file holds the highest."""
    given: dict[int, int] = {}

    def submit(thread: int) -> None:
        for count in range(50):
            value = 1000 * thread + count
            given[writer.submit({"value": value})] = value

    threads = [threading.Thread(target=submit, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(LONG_S)
    outcome = writer.close()

    assert sorted(given) == list(range(1, 201))
    assert outcome.saved_number == 200
    assert outcome.failures == 0
    assert path.read_bytes() == encode({"value": given[200]})

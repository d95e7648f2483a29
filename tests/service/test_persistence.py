"""How long the car stood, by clocks that may be wrong, and what is saved."""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.errors import StateLockedError
from bstm_daemon.service import persistence
from bstm_daemon.service.clock import SteadyAxis, boot_id
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.persistence import (
    Outcome,
    Persistence,
    StateWriter,
    state_file,
)
from bstm_daemon.service.state_file import Document, encode, load, read, save

if TYPE_CHECKING:
    from collections.abc import Iterator

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


CAR = Path(__file__).parents[2] / "config" / "example_vehicle.toml"
SECOND = 1_000_000
HOUR = 3600 * SECOND
START_US = 1_760_000_000 * SECOND
UP_US = 30 * SECOND
"""From power on to the start of the service."""
NEVER_SET_US = 60 * SECOND
"""A minute after 1970-01-01: a computer without a battery for its clock."""


class Clocks:
    """A computer's clocks, moved by the test."""

    def __init__(self) -> None:
        self.wall_us, self.boot_us = START_US, 100 * SECOND
        self.error_us: int | None = 0
        """How far the wall clock may be off; None: not synchronised."""

    def axis(self) -> SteadyAxis:
        return SteadyAxis(
            lambda: self.wall_us * 1000,
            lambda: self.boot_us * 1000,
            lambda: self.error_us,
        )

    def run(self, us: int) -> None:
        self.wall_us += us
        self.boot_us += us

    def power_cut(self, us: int, *, wall_us: int | None = None) -> None:
        """Stay off for *us*; the clock may then show *wall_us*."""
        self.wall_us = self.wall_us + us if wall_us is None else wall_us
        self.boot_us = UP_US
        self.error_us = None

    def synchronise(self, wall_us: int | None = None) -> None:
        self.wall_us = self.wall_us if wall_us is None else wall_us
        self.error_us = 0


class Lines:
    """Takes what is logged."""

    def __init__(self) -> None:
        self.said: list[tuple[str, dict[str, Any]]] = []

    def _take(self, event: str, **fields: Any) -> None:
        self.said.append((event, fields))

    debug = info = warning = error = _take

    def names(self) -> list[str]:
        return [name for name, _ in self.said]


class Box:
    """One run of the service as far as its state goes."""

    def __init__(
        self, file: Path, clocks: Clocks, *, trust: bool = False
    ) -> None:
        self.lines = Lines()
        self.clocks, self.axis = clocks, clocks.axis()
        config, signal_map = load_vehicle(CAR)
        state = config.state.model_copy(update={"trust_wall_clock": trust})
        config = config.model_copy(update={"state": state})
        self.engine = Engine(config, signal_map)
        log = ServiceLog(self.lines)
        self.persistence = Persistence(file, self.axis, log)
        self.persistence.resume(self.engine, self.axis.read())

    def pass_time(self, us: int, every_us: int = SECOND) -> None:
        for _ in range(us // every_us):
            self.clocks.run(every_us)
            now_us = self.axis.read()
            self.engine.tick(now_us)
            self.persistence.poll(self.engine, now_us)

    def disc_k(self) -> float:
        return self.engine.estimator.state("FL")["disc"]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "car.state"


@pytest.fixture(params=["same boot", "other boot"])
def another_boot(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> bool:
    if request.param == "same boot":
        return False
    monkeypatch.setattr(persistence, "boot_id", _numbered_boots())
    return True


def _numbered_boots() -> Any:
    boots: Iterator[int] = iter(range(1000))
    return lambda: f"boot {next(boots)}"


@pytest.fixture
def other_boots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every run be a boot of its own."""
    monkeypatch.setattr(persistence, "boot_id", _numbered_boots())


def hot_stop(file: Path, clocks: Clocks, *, trust: bool = False) -> None:
    """Leave a state with all brakes at 600 K."""
    box = Box(file, clocks, trust=trust)
    box.pass_time(2 * SECOND)
    for batch, _ in box.engine.estimator.batches:
        for member in range(len(batch.programs)):
            batch.settle(600.0, member)
    box.persistence.close(box.engine)


def cooled_k(file: Path, parked_us: int) -> float:
    """Return what a disc of that state has after *parked_us*."""
    config, signal_map = load_vehicle(CAR)
    engine = Engine(config, signal_map)
    document = read(file).document
    assert document is not None
    now_us = document["wall_us"] + parked_us
    engine.resume(document, parked_us, now_us)
    engine.tick(now_us)
    return engine.estimator.state("FL")["disc"]


def test_an_hour_off_cools_the_brakes(
    file: Path, *, another_boot: bool
) -> None:
    clocks = Clocks()
    hot_stop(file, clocks)
    expected_k = cooled_k(file, HOUR)
    assert expected_k < 450.0
    if another_boot:
        clocks.power_cut(HOUR)
        clocks.synchronise()
    else:
        clocks.run(HOUR)

    box = Box(file, clocks)

    assert box.disc_k() == pytest.approx(expected_k, abs=0.1)
    assert box.lines.names()[0] == "state_loaded"
    assert box.lines.said[0][1]["age_s"] == pytest.approx(3600.0, abs=0.1)
    assert box.lines.said[0][1]["exact"]
    box.persistence.close(box.engine)


def test_within_a_boot_nobody_can_set_the_parked_time(file: Path) -> None:
    if boot_id() is None:
        pytest.skip("this system does not name its boots")
    clocks = Clocks()
    hot_stop(file, clocks)
    expected_k = cooled_k(file, HOUR)
    clocks.run(HOUR)
    clocks.wall_us -= 24 * HOUR

    box = Box(file, clocks)

    assert box.disc_k() == pytest.approx(expected_k, abs=0.1)
    box.persistence.close(box.engine)


@pytest.mark.slow
@pytest.mark.usefixtures("other_boots")
def test_a_clock_synchronised_late_corrects_once(file: Path) -> None:
    clocks = Clocks()
    hot_stop(file, clocks)
    hot_k = cooled_k(file, UP_US)
    expected_k = cooled_k(file, 2 * HOUR + 120 * SECOND)
    true_us = clocks.wall_us + 2 * HOUR
    clocks.power_cut(0, wall_us=NEVER_SET_US)
    box = Box(file, clocks)
    assert box.disc_k() == pytest.approx(hot_k, abs=0.1)
    assert box.lines.said[0][1]["age_s"] == 30.0
    assert not box.lines.said[0][1]["exact"]
    box.pass_time(120 * SECOND)

    clocks.synchronise(true_us + 120 * SECOND)
    now_us = box.axis.read()
    assert box.axis.steps == 1
    box.persistence.poll(box.engine, now_us)
    box.engine.tick(now_us + 100_000)

    assert box.disc_k() == pytest.approx(expected_k, abs=0.1)
    said = [f for name, f in box.lines.said if name == "parked_time_corrected"]
    assert len(said) == 1
    assert said[0]["assumed_s"] == 30.0
    assert said[0]["parked_s"] == pytest.approx(7200.0, abs=0.1)
    assert box.engine.estimate is not None
    assert box.engine.estimate.status.clock_jump

    clocks.synchronise(clocks.wall_us + HOUR)
    before_k = box.disc_k()
    box.persistence.poll(box.engine, box.axis.read())
    assert box.disc_k() == before_k
    box.persistence.close(box.engine)


@pytest.mark.usefixtures("other_boots")
@pytest.mark.parametrize("driven", [0, 1])
def test_a_car_that_drove_while_away_was_not_parked(
    file: Path, driven: int
) -> None:
    """Its heat is not in the history that a correction marches again.

    Until the time is known, hot brakes are degraded.
    """
    clocks = Clocks()
    hot_stop(file, clocks)
    true_us = clocks.wall_us + 2 * HOUR
    clocks.power_cut(0, wall_us=NEVER_SET_US)
    box = Box(file, clocks)
    box.engine.estimator.unseen.driven = driven
    held = box.engine.estimator.trust.export()["_held_s"]
    before_k = box.disc_k()

    clocks.synchronise(true_us)
    box.persistence.poll(box.engine, box.axis.read())

    corrected = "parked_time_corrected" in box.lines.names()
    assert corrected is not bool(driven)
    assert (box.disc_k() < before_k - 50.0) is corrected
    now = box.engine.estimator.trust.export()["_held_s"]
    assert (now["FL"] < held["FL"] - HOUR * 1e-6) is corrected
    box.persistence.close(box.engine)


@pytest.mark.usefixtures("other_boots")
def test_a_save_by_a_clock_that_was_late_is_not_dated_anew(
    file: Path,
) -> None:
    """Days late at the save, off for five minutes, then set right."""
    clocks = Clocks()
    clocks.error_us = None
    hot_stop(file, clocks)
    clocks.power_cut(300 * SECOND)
    box = Box(file, clocks)
    before_k = box.disc_k()

    clocks.synchronise(clocks.wall_us + 72 * HOUR)
    box.persistence.poll(box.engine, box.axis.read())

    assert box.disc_k() == before_k
    assert before_k > 590.0
    assert "parked_time_corrected" not in box.lines.names()
    box.persistence.close(box.engine)


@pytest.mark.usefixtures("other_boots")
def test_neither_a_wrong_step_nor_a_small_one_is_the_correction(
    file: Path,
) -> None:
    clocks = Clocks()
    hot_stop(file, clocks)
    true_us = clocks.wall_us + 600 * SECOND
    expected_k = cooled_k(file, 600 * SECOND)
    clocks.power_cut(0)
    box = Box(file, clocks)
    before_k = box.disc_k()

    for step_us in (20_000, 72 * HOUR, -72 * HOUR):
        clocks.wall_us += step_us
        box.persistence.poll(box.engine, box.axis.read())
        assert box.disc_k() == before_k
    assert box.axis.steps == 3
    clocks.synchronise(true_us)
    box.persistence.poll(box.engine, box.axis.read())

    assert box.disc_k() == pytest.approx(expected_k, abs=0.1)
    box.persistence.close(box.engine)


@pytest.mark.usefixtures("other_boots")
@pytest.mark.parametrize("wall_us", [START_US - HOUR, START_US + HOUR])
def test_a_clock_that_nothing_vouches_for_keeps_the_brakes_hot(
    file: Path, wall_us: int
) -> None:
    clocks = Clocks()
    hot_stop(file, clocks)
    expected_k = cooled_k(file, UP_US)
    clocks.power_cut(HOUR, wall_us=wall_us)

    box = Box(file, clocks)

    assert box.disc_k() == pytest.approx(expected_k, abs=0.1)
    assert box.disc_k() > 570.0
    box.persistence.close(box.engine)


@pytest.mark.usefixtures("other_boots")
@pytest.mark.parametrize("wall_us", [None, NEVER_SET_US])
def test_a_clock_with_a_battery_may_be_trusted(
    file: Path, wall_us: int | None
) -> None:
    """But not before 2025: then the battery was empty."""
    clocks = Clocks()
    clocks.error_us = None
    hot_stop(file, clocks, trust=True)
    expected_k = cooled_k(file, HOUR if wall_us is None else UP_US)
    clocks.power_cut(HOUR, wall_us=wall_us)

    box = Box(file, clocks, trust=True)

    assert box.disc_k() == pytest.approx(expected_k, abs=0.1)
    box.persistence.close(box.engine)


@pytest.mark.usefixtures("other_boots")
def test_after_an_hour_nothing_is_corrected(file: Path) -> None:
    clocks = Clocks()
    hot_stop(file, clocks)
    clocks.power_cut(HOUR, wall_us=NEVER_SET_US)
    box = Box(file, clocks)
    assert box.engine.estimator.input_history is not None

    clocks.run(HOUR + SECOND)
    box.persistence.poll(box.engine, box.axis.read())

    assert box.engine.estimator.input_history is None
    box.persistence.close(box.engine)


@pytest.mark.slow
def test_saves_often_while_hot_and_seldom_at_rest(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clocks = Clocks()
    hot_stop(file, clocks)
    clocks.run(SECOND)
    box = Box(file, clocks)
    submitted: list[int] = []
    submit = box.persistence._writer.submit

    def counted(document: dict[str, Any], time_us: int) -> None:
        submitted.append(time_us)
        submit(document, time_us)

    monkeypatch.setattr(box.persistence._writer, "submit", counted)

    box.pass_time(60 * SECOND)
    while_hot = len(submitted)
    for batch, _ in box.engine.estimator.batches:
        for member in range(len(batch.programs)):
            batch.settle(283.15, member)
    box.pass_time(20 * SECOND)
    rest = len(submitted)
    box.pass_time(600 * SECOND)

    assert while_hot == 6
    assert len(submitted) - rest == 2
    box.persistence.close(box.engine)


def test_a_state_of_another_car_is_set_aside(file: Path) -> None:
    clocks = Clocks()
    hot_stop(file, clocks)
    document = read(file).document
    assert document is not None
    save(file, encode(document | {"vehicle_id": "another"}))

    box = Box(file, clocks)
    box.persistence.close(box.engine)

    (name, fields) = box.lines.said[0]
    assert name == "state_discarded"
    assert "another" in fields["reason"]
    aside = list(file.parent.glob("car.state.bad-*"))
    assert [read(path).document for path in aside] == [
        document | {"vehicle_id": "another"}
    ]


def whole_numbers(value: Any, path: tuple[Any, ...] = ()) -> Iterator[Any]:
    """Yield where in *value* whole numbers are."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from whole_numbers(inner, (*path, key))
    elif isinstance(value, list):
        for index in {0, len(value) - 1} if value else ():
            yield from whole_numbers(value[index], (*path, index))
    elif isinstance(value, int) and not isinstance(value, bool):
        yield path


def altered(document: dict[str, Any], path: tuple[Any, ...], to: int) -> bytes:
    """Return the file of *document* with *to* at *path*, checksum right."""
    copy = json.loads(json.dumps(document))
    inner = copy
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = to
    body = json.dumps(copy).encode()
    digest = hashlib.blake2s(body).hexdigest()
    return f"bstm-state 1 {digest} {len(body)}\n".encode() + body


@pytest.mark.parametrize(
    ("number", "every"),
    [
        *((10**30, 8), (2**63 - 1, 8)),
        pytest.param(2**63 - 1, 1, marks=pytest.mark.slow),
    ],
)
def test_an_absurd_number_ends_no_start(
    file: Path, number: int, every: int
) -> None:
    """Wherever it stands, beneath a checksum that is right."""
    clocks = Clocks()
    hot_stop(file, clocks)
    clocks.run(SECOND)
    document = read(file).document
    assert document is not None
    places = list(whole_numbers(document))
    assert len(places) > 8
    for place in places[::every]:
        file.write_bytes(altered(document, place, number))

        box = Box(file, clocks)

        assert 200.0 < box.disc_k() < 1000.0, place
        event, fields = box.lines.said[0]
        if number >= 2**63:
            assert event == "state_discarded", place
            assert "beyond 64 bits" in fields["reason"]
        box.persistence.close(box.engine)


def test_a_second_instance_is_refused(file: Path) -> None:
    box = Box(file, Clocks())

    with pytest.raises(StateLockedError, match=r"car\.state"):
        Box(file, Clocks())

    box.persistence.close(box.engine)
    again = Box(file, Clocks())
    again.persistence.close(again.engine)


def test_where_the_state_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, _ = load_vehicle(CAR)
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    given = tmp_path / "given"

    assert state_file(config, tmp_path, given) == given
    default = state_file(config, tmp_path, None)
    assert default == tmp_path / "example-vehicle.state"
    named = config.model_copy(
        update={"state": config.state.model_copy(update={"file": "s/x"})}
    )
    assert state_file(named, tmp_path, None) == tmp_path / "s" / "x"

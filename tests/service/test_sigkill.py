"""SIGKILL while saving: the state file survives any instant of it.

A child process, which is this file run as a program, saves documents in a
tight interval and reports each number it submitted and the number whose save
it knows completed. ``BSTM_SIGKILLS`` sets how often the slow test kills it.

SIGKILL takes the process, not the page cache: that the bytes are on the
medium in time is the order of the syncs, which ``test_state_file.py`` holds.
"""

from __future__ import annotations

import os
import random
import re
import select
import signal
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from bstm_daemon.service.persistence import StateWriter
from bstm_daemon.service.state_file import encode, load, lock, save

KILLS = int(os.environ.get("BSTM_SIGKILLS", "5"))
INTERVAL_S = 0.02
LEFTOVER = re.compile(r"\.golf\.state\.tmp-[a-z0-9_]{8}")


def document(number: int) -> dict[str, Any]:
    """Make a document of 1 to 80 kB that betrays a mixture of two."""
    return {
        "number": number,
        "values": [number + 0.1] * (50 + 97 * number % 4000),
        "again": number,
    }


def start(path: Path, task: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, __file__, str(path), task],
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize(
    "kills", [1, pytest.param(KILLS, marks=pytest.mark.slow)]
)
def test_the_file_survives_sigkill_at_random_instants(
    tmp_path: Path, kills: int
) -> None:
    """Whole each time, and never older than what was reported as saved."""
    path = tmp_path / "golf.state"
    chance = random.Random(20240229)  # noqa: S311
    for _ in range(kills):
        with start(path, "save") as child:
            assert child.stdout is not None
            first = child.stdout.readline()
            assert first == "locked\n"
            lines = [
                child.stdout.readline() for _ in range(chance.randint(1, 8))
            ]
            select.select([], [], [], chance.uniform(0.0, 3e-3))
            child.kill()
            lines += child.stdout.readlines()
        assert child.returncode == -signal.SIGKILL

        complete = [line.split() for line in lines if line.endswith("\n")]
        completed = max(int(saved) for _, saved in complete)
        submitted = max(int(number) for number, _ in complete)
        found = {entry.name for entry in tmp_path.iterdir()}
        rest = found - {"golf.state", "golf.state.lock"}
        assert len(rest) <= 1
        assert all(LEFTOVER.fullmatch(name) for name in rest)

        loaded = load(path)
        assert loaded.problem is None
        if loaded.document is None:
            assert completed == 0
        else:
            number = loaded.document["number"]
            # one more may be under way that no line tells of yet
            assert completed <= number <= submitted + 1
            assert loaded.document == document(number)


@pytest.mark.slow
@pytest.mark.parametrize("had_one", [True, False])
def test_the_file_survives_a_kill_before_every_step_of_a_save(
    tmp_path: Path,
    had_one: bool,  # noqa: FBT001
) -> None:
    """The random kills' counterpart: each instant that differs, once."""
    path = tmp_path / "golf.state"
    old = document(1) if had_one else None
    seen = []
    for step in range(100):
        path.unlink(missing_ok=True)
        if old is not None:
            save(path, encode(old))
        with start(path, f"die-{step}") as child:
            assert child.stdout is not None
            reported = child.stdout.read()
        loaded = load(path)
        assert loaded.problem is None
        assert loaded.document in (old, document(2))
        seen.append(loaded.document)
        if child.returncode == 0:
            assert reported == "saved\n"
            break
        assert child.returncode == -signal.SIGKILL
    # open and sync of the file, the renaming, open and sync of the folder
    assert len(seen) == 6
    assert seen == [old] * 3 + [document(2)] * 3

    lock(path).close()
    assert {entry.name for entry in tmp_path.iterdir()} == {
        "golf.state",
        "golf.state.lock",
    }


def save_for_ever(path: Path) -> None:
    """Go on from the number in the file, as a daemon would."""
    with closing(lock(path)) as held:
        if held.problem:
            sys.exit(held.problem)
        loaded = load(path)
        if loaded.problem is not None:
            sys.exit(loaded.problem)
        saved = number = loaded.document["number"] if loaded.document else 0
        sys.stdout.write("locked\n")
        sys.stdout.flush()
        writer = StateWriter(path)
        while True:
            number += 1
            writer.submit(document(number), number)
            select.select([], [], [], INTERVAL_S)
            outcome = writer.outcome()
            if outcome.failures:
                sys.exit(outcome.last_error)
            saved = outcome.saved_us or saved
            sys.stdout.write(f"{number} {saved}\n")
            sys.stdout.flush()


def save_and_die(path: Path, step: int) -> None:
    """Save document 2; die before call *step* of those that matter."""
    calls = 0

    def before(call: Any) -> Any:
        def counted(*args: Any, **more: Any) -> Any:
            nonlocal calls
            if calls == step:
                os.kill(os.getpid(), signal.SIGKILL)
            calls += 1
            return call(*args, **more)

        return counted

    tempfile.mkstemp = before(tempfile.mkstemp)
    os.fsync = before(os.fsync)
    Path.replace = before(Path.replace)  # type: ignore[method-assign]
    real_open = os.open

    def folder_open(place: Any, flags: int, *args: Any, **more: Any) -> int:
        call = real_open
        if flags & os.O_DIRECTORY:
            call = before(real_open)
        return call(place, flags, *args, **more)

    os.open = folder_open  # type: ignore[assignment]
    save(path, encode(document(2)))
    sys.stdout.write("saved\n")


def test_the_documents_differ_in_size() -> None:
    """So that some are written in one call and some in many."""
    sizes = {len(str(document(number))) for number in range(50)}

    assert min(sizes) < 2000
    assert max(sizes) > 20000


if __name__ == "__main__":
    FILE, TASK = Path(sys.argv[1]), sys.argv[2]
    if TASK == "save":
        save_for_ever(FILE)
    else:
        save_and_die(FILE, int(TASK.removeprefix("die-")))

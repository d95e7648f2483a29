"""The rig itself: what it hands back, and what it leaves alone."""

import fcntl
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

RIG = Path(__file__).resolve().parent
TIMED_OUT = 124
FAILED = 125


@pytest.fixture(scope="module")
def possible() -> None:
    """Skip where the rig is not possible; fail if it is required to be."""
    probe = subprocess.run(
        [sys.executable, RIG / "possible.py"],
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if probe.returncode:
        if os.environ.get("BSTM_RIG") == "required":
            pytest.fail(f"rig not possible: {probe.stdout}")
        pytest.skip(f"rig not possible: {probe.stdout}")


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run ``vcan_run.py``."""
    return subprocess.run(
        [sys.executable, RIG / "vcan_run.py", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )


def test_code_output_environment_and_directory_pass_through(
    possible: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RIG_TEST", "a 'quoted' $value")
    monkeypatch.chdir(tmp_path)

    done = run("sh", "-c", 'pwd; echo "$RIG_TEST"; echo bad >&2; exit 7')

    assert done.returncode == 7
    assert done.stdout == f"{tmp_path}\na 'quoted' $value\n"
    assert done.stderr == "bad\n"


def test_much_output_comes_whole_and_the_callers_pipe_stays_blocking(
    possible: None,
) -> None:
    read_end, write_end = os.pipe()
    with (
        ThreadPoolExecutor() as pool,  # left last, when the writer is closed
        open(read_end, "rb") as reader,  # noqa: PTH123
        open(write_end, "wb") as writer,  # noqa: PTH123
    ):
        expected = b"".join(b"%d\n" % n for n in range(1, 100001))
        text = pool.submit(reader.read, len(expected))
        done = subprocess.run(
            [sys.executable, RIG / "vcan_run.py", "seq", "100000"],
            stdout=writer,
            check=False,
        )
        flags = fcntl.fcntl(writer, fcntl.F_GETFL)
        writer.close()

        assert done.returncode == 0
        assert text.result() == expected
        assert not flags & os.O_NONBLOCK


@pytest.mark.full  # it waits
def test_what_takes_too_long_is_ended(possible: None) -> None:
    done = run("-t", "25", "sh", "-c", "echo begun; sleep 1000")
    assert done.returncode == TIMED_OUT
    assert done.stdout == "begun\n"
    assert "stopped after 25 s" in done.stderr


def test_only_a_writable_directory_keeps_what_is_written(
    possible: None, tmp_path: Path
) -> None:
    kept, other = tmp_path / "kept", tmp_path / "other"
    kept.mkdir()
    other.mkdir()

    done = run("-w", kept, "touch", kept / "file", other / "file")

    assert done.returncode == 0, done.stderr
    assert (kept / "file").exists()
    assert not (other / "file").exists()


def test_a_share_that_is_not_there_is_refused(tmp_path: Path) -> None:
    done = run("-w", tmp_path / "missing", "true")
    assert done.returncode == FAILED
    assert "missing" in done.stderr

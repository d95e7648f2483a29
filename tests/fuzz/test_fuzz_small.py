"""A small part of the fuzzing, and that it notices what it is there for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("fuzz_logs.py")

DEFECTS = {
    "an exception escapes": (
        "parse = fuzz_logs.CandumpReader._parse\n"
        "def broken(self, *text):\n"
        "    chunk = parse(self, *text)\n"
        "    if self.frames > 50:\n"
        "        raise IndexError\n"
        "    return chunk\n"
        "fuzz_logs.CandumpReader._parse = broken\n"
    ),
    "an unwanted frame is not counted": (
        "refused = fuzz_logs.CandumpReader.refuse\n"
        "def broken(self, reason, line):\n"
        "    if reason is not fuzz_logs.RejectReason.UNKNOWN_INTERFACE:\n"
        "        refused(self, reason, line)\n"
        "fuzz_logs.CandumpReader.refuse = broken\n"
    ),
    "a row is lost": (
        "events = fuzz_logs.TableReader._events\n"
        "def broken(self, chunk):\n"
        "    self.lines -= 1\n"
        "    return events(self, chunk)\n"
        "fuzz_logs.TableReader._events = broken\n"
    ),
}

WORDS = {
    "an exception escapes": "IndexError",
    "an unwanted frame is not counted": "Defect: ",
    "a row is lost": "Defect: ",
}


def fuzz(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", *arguments, "--out", str(folder)],
        check=False,
        capture_output=True,
        text=True,
        timeout=300,
        cwd=SCRIPT.parent,
    )


@pytest.mark.parametrize(
    "thousands", [1, pytest.param(10, marks=pytest.mark.slow)]
)
def test_a_small_part_passes(tmp_path: Path, thousands: int) -> None:
    lines, rows = 2000 * thousands, 200 * thousands
    counts = ("--lines", str(lines), "--rows", str(rows))

    done = fuzz(tmp_path, str(SCRIPT), *counts)

    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith(f"{lines + rows} passed\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "defect",
    [
        "an exception escapes",
        *(
            pytest.param(one, marks=pytest.mark.slow)
            for one in DEFECTS
            if one != "an exception escapes"
        ),
    ],
)
def test_a_defect_is_found_and_its_input_kept(
    tmp_path: Path, defect: str
) -> None:
    code = (
        f"import sys, fuzz_logs\n{DEFECTS[defect]}sys.exit(fuzz_logs.main())\n"
    )

    done = fuzz(tmp_path, "-c", code, "--lines", "200", "--rows", "20")

    assert done.returncode == 1, done.stdout + done.stderr
    (kept,) = tmp_path.iterdir()
    assert kept.name in done.stdout
    assert WORDS[defect] in done.stdout
    assert kept.read_bytes().count(b"\n") > 20

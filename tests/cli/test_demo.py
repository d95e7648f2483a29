"""``bstm demo``: the whole of it, as a newcomer runs it."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path


def test_folder_that_can_not_be_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """74 before anything is simulated."""
    (tmp_path / "file").touch()

    assert main(["demo", "-o", str(tmp_path / "file")]) == 74
    out, err = capsys.readouterr()
    assert out == ""
    assert "cannot be created" in err


@pytest.mark.slow
def test_demo(tmp_path: Path) -> None:
    """A table of what the bus showed, a report, estimates near the truth."""
    result = subprocess.run(
        [sys.executable, "-m", "bstm_daemon.cli.main", "demo"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=600,
    )

    assert result.stderr == ""
    rows = re.findall(
        r"^ +(\d+) min +(driving|parked) +(.*)$", result.stdout, re.MULTILINE
    )
    assert [int(row[0]) for row in rows] == list(range(0, 41, 5))
    assert {row[1] for row in rows} == {"driving", "parked"}
    values = [[float(cell) for cell in row[2].split()] for row in rows]
    assert {len(row) for row in values} == {8}
    assert max(row[0] for row in values) > 450.0
    peaks = re.findall(
        r"[FR]L +([\d.]+) / +([\d.]+) degC +at +([\d.]+) / +([\d.]+) min",
        result.stdout,
    )
    assert len(peaks) == 2
    for estimated, true, at_min, true_at_min in peaks:
        assert float(estimated) == pytest.approx(float(true), abs=5.0)
        assert float(at_min) == pytest.approx(float(true_at_min), abs=2.0)
    folder = tmp_path / "bstm-demo"
    assert {p.name for p in folder.iterdir()} == {
        "report.html",
        "estimates.csv",
    }
    page = (folder / "report.html").read_text(encoding="utf-8")
    # the plotting library's own code, in the page, holds addresses as text
    markup = re.sub(r"<script[^>]*>.*?</script>", "", page, flags=re.DOTALL)
    assert len(markup) < len(page) / 10
    assert not re.search(r"https?://|@import", markup)
    assert not re.search(r"<script[^>]+src|<link[^>]+href", page)
    with (folder / "estimates.csv").open(newline="") as file:
        assert sum(1 for _ in csv.reader(file)) >= 24_000

"""The README's blocks, run in their order as a reader would run them.

The marked ones are run elsewhere: ``demo`` and ``tests`` by ``.ci/run``, which
makes their environments, ``live`` by ``tests/watch/test_live_demo.py`` on a
terminal, ``vehicle`` by the suite on a real vcan.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(
    r"^(<!-- (\w+) -->\n)?```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE
)
MARKS = ["demo", "live", "tests", "vehicle"]


def blocks() -> list[tuple[str, str]]:
    """Return mark, or nothing, and text of each block."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    return [(mark, text) for _, mark, text in BLOCK.findall(readme)]


def test_every_marked_block_is_there_once() -> None:
    assert [mark for mark, _ in blocks() if mark] == MARKS


@pytest.mark.slow
def test_the_blocks_run_in_their_order(tmp_path: Path) -> None:
    """Exit code 0 each; the reader's own files are a car and a drive."""
    for folder in ("config", "dbc"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"

    def run(text: str) -> str:
        done = subprocess.run(
            ["bash", "-euo", "pipefail", "-c", text],
            cwd=tmp_path,
            env=os.environ | {"PATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, (text, done.stdout, done.stderr)
        return done.stdout

    example = (tmp_path / "config/example_vehicle.toml").read_text("utf-8")
    (tmp_path / "car.toml").write_text(example.replace("../dbc/", "dbc/"))
    run("bstm simulate rich -o drive.log")

    outputs = [run(text) for mark, text in blocks() if not mark]

    assert (tmp_path / "results/pass.estimates.parquet").exists()
    named = next(text for text in outputs if "gap_conduction" in text)
    strength = re.search(r"strength ([\d.]+) \+- ([\d.]+)", named)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert strength is not None
    assert " ± ".join(strength.groups()) in readme

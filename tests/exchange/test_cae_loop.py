"""The loop of docs/exchange.md, run as it stands there."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "exchange.md").read_text(encoding="utf-8")


def looped(folder: Path, config: str) -> tuple[float, float]:
    """Return disc and pad [degC] that the document's loop prints."""
    pads, loop = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    (folder / "pads.py").write_text(pads, encoding="utf-8")
    (folder / "loop.py").write_text(loop, encoding="utf-8")
    (folder / "own.toml").write_text(config, encoding="utf-8")
    done = ""
    for command in (
        [
            *("-m", "bstm_daemon.cli.main", "fmu", "export"),
            *("-c", "own.toml", "--corner", "FL", "-o", "FL.fmu"),
        ],
        ["-W", "ignore", "loop.py"],
    ):
        done = subprocess.run(
            [sys.executable, *command],
            cwd=folder,
            env={"PYTHONPATH": f"{folder}:{ROOT}", "PATH": "/usr/bin:/bin"},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
    disc, pads_c = re.findall(r"([-\d.]+) degC", done)
    return float(disc), float(pads_c)


@pytest.mark.slow
@pytest.mark.full
def test_a_pad_of_ones_own_runs_in_a_loop(tmp_path: Path) -> None:
    pytest.importorskip("fmpy", reason="FMPy is not installed (extra fmu)")
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    car = ROOT / "config" / "example_vehicle.toml"
    dbc = (ROOT / "dbc" / "example_vehicle.dbc").as_posix()
    shipped = re.sub(
        r'dbc = "[^"]*"', f'dbc = "{dbc}"', car.read_text(encoding="utf-8")
    )
    own = shipped.replace('model = "slabs"', 'model = "pads:two_lumps"', 1)
    assert own != shipped

    disc, pads = looped(tmp_path, own)
    usual_disc, usual_pads = looped(tmp_path, shipped)

    assert 100.0 < disc < 400.0
    assert disc == pytest.approx(usual_disc, abs=40.0)
    assert abs(pads - usual_pads) > 2.0

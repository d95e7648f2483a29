"""The functions of the package, and their page and notebook as printed."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bstm_daemon
from bstm_daemon import load_config, replay, simulate
from bstm_daemon.errors import ConfigError, LogError, UsageError

ROOT = Path(__file__).parents[1]
CAR = ROOT / "config" / "example_vehicle.toml"
DRIVE = """
[drive]
name = "stop"
description = "one stop"
ambient_c = 20.0

[[segment]]
speed_kmh = 80.0
rate_ms2 = 2.0

[[segment]]
speed_kmh = 0.0
rate_ms2 = 4.0

[[segment]]
speed_kmh = 0.0
duration_s = 20.0
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder like a checkout, and make it the current one."""
    for name in ("config", "dbc"):
        shutil.copytree(ROOT / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def blocks() -> list[str]:
    """Return the blocks of Python of the page."""
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    return re.findall(
        r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE
    )


def test_a_drive_from_simulation_to_table(tmp_path: Path) -> None:
    """One stop from 80 km/h, 0.54 MJ: the front discs rise by some 30 K."""
    (tmp_path / "stop.toml").write_text(DRIVE, encoding="utf-8")
    log = tmp_path / "stop.log"
    drive = simulate(tmp_path / "stop.toml", log=log)
    vehicle = load_config(CAR)

    table = replay(str(log), vehicle, start="cold", every_s=0.5)

    assert vehicle.config.vehicle.id == "example-vehicle"
    risen_k = (
        drive.truth["FL.disc_mean"].max() - drive.truth["FL.disc_mean"][0]
    )
    assert 20.0 < risen_k < 60.0
    disc_c = table.columns["FL.disc_c"]
    assert disc_c.max() - disc_c[0] == pytest.approx(risen_k, abs=6.0)
    assert (table.columns["time_s"][1:3] % 0.5 < 1e-6).all()


def test_errors_are_those_of_the_commands(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="did you mean 'simalp'"):
        simulate("simlap")
    with pytest.raises(UsageError, match="did you mean 'hub_conduction'"):
        simulate("simalp", effects={"hub_conductio": 1.0})
    (tmp_path / "car.toml").write_text("[vehicel]\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="did you mean 'vehicle'"):
        load_config(tmp_path / "car.toml")
    (tmp_path / "a.log").write_text("", encoding="utf-8")
    with pytest.raises(LogError, match="empty"):
        replay(tmp_path / "a.log", load_config(CAR))


def test_names_of_the_package() -> None:
    for name in bstm_daemon.__all__:
        assert getattr(bstm_daemon, name)
    with pytest.raises(AttributeError, match="no attribute 'replya'"):
        bstm_daemon.replya  # noqa: B018


@pytest.mark.slow
def test_nothing_is_loaded_before_it_is_used() -> None:
    """``replay`` is a room as well: both of its callables are one."""
    code = (
        "import sys, bstm_daemon\n"
        "assert not {'numpy', 'pydantic', 'can'} & set(sys.modules)\n"
        "import bstm_daemon.replay\n"
        "assert 'bstm_daemon.api' not in sys.modules\n"
        "from bstm_daemon import replay\n"
        "try: replay('no.log', None)\n"
        "except AttributeError as error: print(error)\n"
        "from bstm_daemon.replay.columns import stream_log\n"
    )

    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
    )

    assert done.stderr == ""
    assert "'config'" in done.stdout


@pytest.mark.full
@pytest.mark.slow
def test_the_blocks_of_the_page_run(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scope: dict[str, object] = {}
    for block in blocks():
        exec(block, scope)  # noqa: S102  (the page's own code)

    out = capsys.readouterr().out
    estimated, true = re.findall(r"(\d+) degC", out)
    assert abs(int(estimated) - int(true)) <= 30
    assert "('FL', 'FR') ('gap_conduction',)" in out


@pytest.mark.slow
def test_the_notebook_runs(folder: Path) -> None:
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient").NotebookClient
    source = ROOT / "docs" / "first_replay.ipynb"
    book = nbformat.read(source, as_version=4)

    client(
        book,
        timeout=300,
        kernel_name="python3",
        resources={"metadata": {"path": str(folder)}},
    ).execute()

    outputs = [
        cell.outputs[0].data["text/plain"]
        for cell in book.cells
        if cell.cell_type == "code"
    ]
    assert outputs[0].endswith("'example-vehicle')")
    peaks = dict(re.findall(r"'(\w+)': \(([\d.]+),", outputs[1]))
    assert float(peaks["estimated"]) == pytest.approx(
        float(peaks["true"]), abs=5.0
    )
    saved = json.loads(source.read_text(encoding="utf-8"))
    assert all(not cell.get("outputs") for cell in saved["cells"])

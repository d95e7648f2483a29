"""Metrics that can not be written now are written later, and end nothing."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import urllib.request
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.config.service import MetricsConfig
from bstm_daemon.files import shipped_file
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.metrics_output import MetricsOutput
from bstm_daemon.service.status import ServiceStatus

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

EXAMPLE = shipped_file("config/example_vehicle.toml")
STATUS = ServiceStatus(version="1.2.3", compiled_kernel=True)
INTERVAL_US = 5_000_000


class Lines:
    """Takes what is logged."""

    def __init__(self) -> None:
        self.errors: list[str] = []

    def _take(self, event: str, **fields: Any) -> None:
        assert event == "metrics_failed"
        self.errors.append(fields["error"])

    debug = info = warning = error = _take


@pytest.fixture
def lines() -> Lines:
    return Lines()


def config(file: str) -> MetricsConfig:
    return MetricsConfig(
        enabled=True, file=file, interval_s=INTERVAL_US * 1e-6
    )


def page(port: int) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics") as got:
        text: str = got.read().decode()
    return text


@pytest.fixture
def taken() -> Iterator[socket.socket]:
    """Return a socket that has a port."""
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        yield other


@pytest.mark.slow
def test_a_port_that_is_taken_is_waited_for(
    tmp_path: Path, lines: Lines, taken: socket.socket
) -> None:
    """The file is written meanwhile."""
    port = taken.getsockname()[1]
    file = tmp_path / "bstm.prom"
    output = MetricsOutput(ServiceLog(lines), port)
    output.begin(config(str(file)), tmp_path)

    output.update(STATUS, 0)
    assert len(lines.errors) == 1
    assert f"--metrics-port {port}" in lines.errors[0]
    assert "bstm_" in file.read_text("utf-8")

    taken.close()
    output.update(STATUS, INTERVAL_US)
    assert page(port) == file.read_text("utf-8")
    output.close()
    assert not file.exists()
    with pytest.raises(OSError, match="refused"):
        page(port)


def test_a_folder_that_comes_later(tmp_path: Path, lines: Lines) -> None:
    file = tmp_path / "run" / "bstm.prom"
    output = MetricsOutput(ServiceLog(lines), None)
    output.begin(config(str(file)), tmp_path)
    output.update(STATUS, 0)
    assert str(file) in lines.errors[0]

    file.parent.mkdir()
    output.update(STATUS, INTERVAL_US - 1)
    assert not file.exists()
    output.update(STATUS, INTERVAL_US)
    assert file.exists()
    assert len(lines.errors) == 1
    output.close()


def test_another_file_after_a_reload(tmp_path: Path, lines: Lines) -> None:
    """What nobody renews any more is not left to be read."""
    first, second = tmp_path / "a.prom", tmp_path / "b.prom"
    output = MetricsOutput(ServiceLog(lines), None)
    output.begin(config(str(first)), tmp_path)
    output.update(STATUS, 0)
    output.begin(config(str(first)), tmp_path)
    assert first.exists()

    output.begin(config(str(second)), tmp_path)
    assert not first.exists()
    output.update(STATUS, INTERVAL_US)
    assert second.exists()
    output.close()
    assert not lines.errors


def test_the_file_is_whole_and_readable_for_all(
    tmp_path: Path, lines: Lines
) -> None:
    path = tmp_path / "bstm.prom"
    path.write_text("old")
    output = MetricsOutput(ServiceLog(lines), None)
    output.begin(config("bstm.prom"), tmp_path)
    mask = os.umask(0o077)
    try:
        output.update(STATUS, 0)
    finally:
        os.umask(mask)

    assert 'version="1.2.3"' in path.read_text("utf-8")
    assert path.stat().st_mode & 0o777 == 0o644
    assert [found.name for found in tmp_path.iterdir()] == ["bstm.prom"]


def test_a_default_file_in_the_runtime_directory(
    tmp_path: Path, lines: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RUNTIME_DIRECTORY", f"{tmp_path}:/elsewhere")
    output = MetricsOutput(ServiceLog(lines), None)
    output.begin(MetricsConfig(), tmp_path)
    output.update(STATUS, 0)
    assert list(tmp_path.iterdir()) == []

    output.begin(MetricsConfig(enabled=True), tmp_path)
    output.update(STATUS, 0)
    assert (tmp_path / "bstm.prom").exists()


@pytest.mark.parametrize("asked_by", ["[metrics]", "--metrics-port"])
def test_metrics_without_their_package_are_refused_at_the_start(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    asked_by: str,
) -> None:
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    text = EXAMPLE.read_text("utf-8").replace(
        "../dbc", f"{EXAMPLE.parents[1]}/dbc"
    )
    path = tmp_path / "car.toml"
    arguments = ["run", "-c", str(path), "--state", str(tmp_path / "state")]
    if asked_by == "[metrics]":
        head, section, tail = text.partition("[metrics]")
        text = head + section + tail.replace("= false", "= true", 1)
    else:
        arguments += ["--metrics-port", "0"]
    path.write_text(text, "utf-8")

    assert main(arguments) == 2

    (line,) = capsys.readouterr().err.splitlines()
    assert asked_by in line
    assert "pip install 'bstm-daemon[metrics]'" in line


@pytest.mark.slow
def test_without_metrics_their_package_is_not_loaded() -> None:
    code = (
        "import sys; from pathlib import Path\n"
        "import bstm_daemon.service.service\n"
        "from bstm_daemon.config.service import MetricsConfig\n"
        "from bstm_daemon.service.metrics_output import MetricsOutput\n"
        "output = MetricsOutput(None, None)\n"
        "output.begin(MetricsConfig(), Path())\n"
        "output.update(None, 0)\n"
        "print([m for m in sys.modules if m.startswith('prometheus')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
    )

    assert done.stdout == "[]\n"

"""Metrics that can not be written now are written later, and end nothing."""

from __future__ import annotations

import socket
import urllib.request
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.daemon.events import ServiceLog
from bstm_daemon.daemon.metrics_output import MetricsOutput
from bstm_daemon.daemon.monitor import BusOverride, build_monitor
from bstm_daemon.daemon.status import ServiceStatus

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bstm_daemon.daemon.monitor import Monitor

ROOT = Path(__file__).parents[2]
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


def monitor(folder: Path, file: Path) -> Monitor:
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    text = text.replace('"../dbc/', f'"{ROOT}/dbc/')
    head, metrics, tail = text.partition("[metrics]")
    path = folder / "car.toml"
    given = f'\nfile = "{file}"\ninterval_s = {INTERVAL_US * 1e-6}\n'
    rest = tail[tail.index("\n[") :] if "\n[" in tail else ""
    path.write_text(head + metrics + given + rest, "utf-8")
    return build_monitor(path, BusOverride())


def page(port: int) -> str:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics") as got:
        text: str = got.read().decode()
    return text


@pytest.fixture
def taken() -> Iterator[socket.socket]:
    """Return a socket that has a port."""
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        yield other


def test_a_port_that_is_taken_is_waited_for(
    tmp_path: Path, lines: Lines, taken: socket.socket
) -> None:
    """The file is written meanwhile."""
    port = taken.getsockname()[1]
    file = tmp_path / "bstm.prom"
    output = MetricsOutput(ServiceLog(lines), port)
    output.begin(monitor(tmp_path, file))

    output.renew(STATUS, 0)
    assert len(lines.errors) == 1
    assert f"--metrics-port {port}" in lines.errors[0]
    assert "bstm_" in file.read_text("utf-8")

    taken.close()
    output.renew(STATUS, INTERVAL_US)
    assert page(port) == file.read_text("utf-8")
    output.close()
    assert not file.exists()
    with pytest.raises(OSError, match="refused"):
        page(port)


def test_a_folder_that_comes_later(tmp_path: Path, lines: Lines) -> None:
    file = tmp_path / "run" / "bstm.prom"
    output = MetricsOutput(ServiceLog(lines), None)
    output.begin(monitor(tmp_path, file))
    output.renew(STATUS, 0)
    assert str(file) in lines.errors[0]

    file.parent.mkdir()
    output.renew(STATUS, INTERVAL_US - 1)
    assert not file.exists()
    output.renew(STATUS, INTERVAL_US)
    assert file.exists()
    assert len(lines.errors) == 1
    output.close()


def test_another_file_after_a_reload(tmp_path: Path, lines: Lines) -> None:
    """What nobody renews any more is not left to be read."""
    first, second = tmp_path / "a.prom", tmp_path / "b.prom"
    output = MetricsOutput(ServiceLog(lines), None)
    output.begin(monitor(tmp_path, first))
    output.renew(STATUS, 0)
    output.begin(monitor(tmp_path, first))
    assert first.exists()

    output.begin(monitor(tmp_path, second))
    assert not first.exists()
    output.renew(STATUS, INTERVAL_US)
    assert second.exists()
    output.close()
    assert not lines.errors

"""``bstm demo --live`` on a real terminal: three processes that end as one."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.cli import demo
from bstm_daemon.cli.main import main
from bstm_daemon.service.state_file import lock

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Terminal

# a script's background starts what ignores Ctrl-C
MAIN = """
import signal
import sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
from bstm_daemon.cli import demo
from bstm_daemon.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
LEAVE = b"\x1b[?25h\x1b[?1049l"
DISC_C = re.compile(r"disc +(\d+\.\d)")


@pytest.fixture
def multicast() -> None:
    """Skip where the machine routes no multicast at all."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        try:
            probe.sendto(b"", (demo.GROUP, 9))
        except OSError as error:
            if error.errno != errno.ENETUNREACH:
                raise
            pytest.skip("no route for multicast")


def processes_of(session: int) -> dict[int, str]:
    """Return the command lines of the terminal's *session* by process."""
    found = {}
    for process in Path("/proc").glob("[0-9]*"):
        try:
            *_, state = (process / "stat").read_text().rpartition(") ")
            if int(state.split()[3]) == session:
                command = (process / "cmdline").read_text()
                found[int(process.name)] = command
        except OSError:
            continue
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "key",
    [
        pytest.param(b"\x03", id="control-c"),
        pytest.param(b"q", id="q", marks=pytest.mark.full),
    ],
)
def test_the_display_shows_a_brake_that_gets_hot(
    terminal: Callable[..., Terminal],
    multicast: None,
    tmp_path: Path,
    key: bytes,
) -> None:
    """The car pulls out cold; its first hairpin is seconds away."""
    started = terminal(100, 30, MAIN, "demo", "--live", "-o", tmp_path)
    started.until("q leaves")
    shown: list[float] = []
    while not shown or shown[-1] < 14.0:
        assert started._read(), started.lines
        shown += [
            float(found[1])
            for line in started.lines
            if (found := DISC_C.match(line))
        ]

    session = started.process.pid
    others = processes_of(session)
    assert others.pop(session)
    service, display = sorted(others)
    assert "\0run\0" in others[service]
    assert shown[0] < 12.0
    assert any("running" in line for line in started.lines), started.lines
    if key != b"q":
        # as where the machine has no time for it
        os.kill(display, signal.SIGSTOP)
    started.press(key)
    if key != b"q":
        deadline_s = time.monotonic() + 60.0
        while processes_of(session).get(service):
            assert time.monotonic() < deadline_s, others[service]
            time.sleep(0.01)
        time.sleep(0.1)
        os.kill(display, signal.SIGCONT)

    assert started.ended() == 0
    assert started.raw.endswith(LEAVE)
    assert not processes_of(session)
    log = (tmp_path / "live.log").read_text(encoding="utf-8")
    assert '"event": "service_stopping"' in log
    assert '"level": "error"' not in log


@pytest.mark.slow
def test_the_display_may_be_a_page(multicast: None, tmp_path: Path) -> None:
    """Its browser is a program that ends at once."""
    demo = subprocess.Popen(
        [
            sys.executable,
            "-c",
            MAIN,
            "demo",
            "--live",
            "--view",
            "-o",
            tmp_path,
        ],
        env={**os.environ, "BROWSER": "true"},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert demo.stdout is not None
    found = re.search(r"http\S+", demo.stdout.readline())
    assert found is not None
    discs: list[float] = []
    with urllib.request.urlopen(f"{found[0]}events", timeout=60.0) as events:  # noqa: S310
        while not discs or discs[-1] < 14.0:
            line = events.readline()
            if line.startswith(b"data: "):
                record = json.loads(line[6:])["record"]
                discs += [record["corners"]["FL"]["disc_c"]] if record else []
    assert discs[0] < 12.0
    # a service manager ends the first process alone
    demo.terminate()
    assert demo.wait(60.0) == 0
    demo.stdout.close()
    log = (tmp_path / "live.log").read_text(encoding="utf-8")
    assert '"event": "service_stopping"' in log


@pytest.mark.slow
def test_a_service_that_ends_is_reported(
    multicast: None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    state = tmp_path / "state"
    held = lock(state)
    monkeypatch.setattr(demo, "_parked_overnight", lambda _: state)

    assert main(["demo", "--live", "-o", str(tmp_path)]) == 1
    held.close()

    err = capsys.readouterr().err
    assert err.startswith("bstm: demo --live: the service ended: ")
    assert str(state) in err


@pytest.mark.parametrize("package", ["msgpack", "rich"])
def test_an_absent_package_is_named_at_once(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    package: str,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)

    assert main(["demo", "--live", "-o", str(tmp_path / "new")]) == 2
    assert f"needs the package '{package}'" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_a_machine_without_multicast_is_told_what_helps(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """An address of no group can not be joined."""
    monkeypatch.setattr(demo, "GROUP", "127.0.0.1")

    assert main(["demo", "--live", "-o", str(tmp_path)]) == 1
    assert "ip route add 239.0.0.0/8 dev lo" in capsys.readouterr().err

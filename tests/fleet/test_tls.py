"""A cluster with TLS: workers in network namespaces and folders of their own.

The certificates are made by the commands of ``docs/fleet.md``.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ROOT = Path(__file__).parents[2]
DEADLINE_S = 120.0
PORT = 18786

pytestmark = pytest.mark.slow


def certificates(folder: Path) -> list[str]:
    """Make them in *folder*; return the options of Dask's commands."""
    text = (ROOT / "docs" / "fleet.md").read_text("utf-8")
    block = re.search(r"<!-- tls -->\n```sh\n(.*?)```", text, re.DOTALL)
    assert block is not None
    subprocess.run(
        ["bash", "-euc", block[1]], cwd=folder, check=True, capture_output=True
    )
    return [
        *("--tls-ca-file", str(folder / "ca.pem")),
        *("--tls-cert", str(folder / "node.pem")),
        *("--tls-key", str(folder / "node.key")),
    ]


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


@pytest.fixture
def namespaces() -> Iterator[list[tuple[str, str, str]]]:
    """Give name, own address and this side's address of two namespaces."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root")
    found = [
        (f"bstmfleet{i}", f"10.213.{i}.2", f"10.213.{i}.1") for i in (1, 2)
    ]
    with ExitStack() as stack:
        for i, (name, own, here) in enumerate(found):
            try:
                ip("netns", "add", name)
                stack.callback(ip, "netns", "del", name)
                link, inner = f"bstmf{i}", f"bstmn{i}"
                ip("link", "add", link, "type", "veth", "peer", "name", inner)
                ip("link", "set", inner, "netns", name)
                ip("addr", "add", f"{here}/24", "dev", link)
                ip("link", "set", link, "up")
                for part in (
                    ("addr", "add", f"{own}/24", "dev", inner),
                    ("link", "set", inner, "up"),
                    ("link", "set", "lo", "up"),
                ):
                    ip("-n", name, *part)
            except (OSError, subprocess.CalledProcessError) as error:
                pytest.skip(f"no network namespaces here: {error}")
        yield found


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Give a starter of modules, each in a folder of its own."""
    running = []
    with ExitStack() as stack:

        def starter(
            name: str, *command: str, inside: tuple[str, ...] = ()
        ) -> subprocess.Popen[bytes]:
            folder = tmp_path / name
            folder.mkdir()
            log = stack.enter_context((folder / "log.txt").open("ab"))
            process = subprocess.Popen(
                [*inside, sys.executable, "-m", *command],
                stdout=log,
                stderr=log,
                cwd=folder,
                env=os.environ | {"PYTHONPATH": str(ROOT)},
            )
            running.append(process)
            return process

        yield starter
        for process in running:
            process.send_signal(signal.SIGKILL)
            process.wait()


def wait_for_port(host: str) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while time.monotonic() < end_s:
        with suppress(OSError), socket.create_connection((host, PORT), 1.0):
            return
        time.sleep(0.1)
    pytest.fail(f"nobody listens at {host}")


def test_two_workers_in_namespaces_of_their_own(
    make_fleet: Callable[..., Any],
    namespaces: list[tuple[str, str, str]],
    start: Callable[..., subprocess.Popen[bytes]],
    tmp_path: Path,
) -> None:
    """They share the work; who has no certificate gets no answer."""
    fleet = make_fleet(6, range(2))
    fleet.plan()
    for car in range(6):
        fleet.replay(f"car{car}")
    expected = fleet.files()
    fleet.lake.root.rename(tmp_path / "reference")
    fleet.plan()
    tls = certificates(tmp_path)
    start(
        *("scheduler", "distributed.cli.dask_scheduler", "--protocol", "tls"),
        *("--port", str(PORT), "--no-dashboard", *tls),
    )
    for name, own, here in namespaces:
        wait_for_port(here)
        start(
            *(name, "distributed.cli.dask_worker", f"tls://{here}:{PORT}"),
            *("--host", own, "--nthreads", "1", "--no-nanny"),
            *("--no-dashboard", *tls),
            inside=("ip", "netns", "exec", name),
        )
    here = namespaces[0][2]
    replay = (
        *("bstm_daemon.cli.main", "fleet", "replay", str(fleet.lake.root)),
        *("--no-forecast", "--scheduler", f"tls://{here}:{PORT}"),
    )
    own = ("--tls-ca", tls[1], "--tls-cert", tls[3], "--tls-key", tls[5])

    stranger = start("stranger", *replay)
    code = stranger.wait(DEADLINE_S)

    assert code != 0
    assert fleet.files() == {}
    client = start("client", *replay, *own)
    assert client.wait(DEADLINE_S) == 0
    assert fleet.files() == expected

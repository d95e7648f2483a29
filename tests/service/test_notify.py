"""sd_notify against a real datagram socket."""

from __future__ import annotations

import os
import socket
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.service.notify import Notifier

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture(params=["path", "abstract"])
def manager(
    request: pytest.FixtureRequest, tmp_path: Path
) -> Iterator[tuple[socket.socket, str]]:
    """Give the service manager's end and its address."""
    address = str(tmp_path / "notify")
    if request.param == "abstract":
        address = f"@bstm-test-{os.getpid()}-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(address.replace("@", "\0", 1))
        end.setblocking(False)
        yield end, address


def test_the_messages_of_the_protocol(
    manager: tuple[socket.socket, str],
) -> None:
    """One datagram a call, as sd_notify(3) spells them."""
    end, address = manager
    notifier = Notifier.from_environment({"NOTIFY_SOCKET": address})

    notifier.ready()
    notifier.status("recording 2 buses, 431 frames/s")
    notifier.watchdog()
    notifier.stopping()

    assert notifier.enabled
    assert notifier.problem is None
    messages = [end.recv(5000) for _ in range(4)]
    assert messages == [
        b"READY=1",
        b"STATUS=recording 2 buses, 431 frames/s",
        b"WATCHDOG=1",
        b"STOPPING=1",
    ]
    with pytest.raises(BlockingIOError):
        end.recv(5000)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ""),
        ("a\nREADY=1", "a READY=1"),
        ("a\r\n\0\x85\u2028b", "a     b"),
        ("700 °C", "700 °C"),
        ("\udcff", " "),
        ("é" * 5000, "é" * 1000),
        ("🛞" * 5000, "🛞" * 1000),
    ],
)
def test_a_status_is_one_short_line(
    tmp_path: Path, text: str, expected: str
) -> None:
    """It can smuggle in no other assignment and is never dropped."""
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(address)
        end.setblocking(False)
        Notifier(address).status(text)
        message = end.recv(5000)

    assert message.decode() == f"STATUS={expected}"
    assert len(message) <= 4096


def everything(notifier: Notifier) -> None:
    notifier.ready()
    notifier.status("x")
    notifier.watchdog()
    notifier.stopping()


@pytest.mark.parametrize("environ", [{}, {"NOTIFY_SOCKET": ""}])
def test_without_the_variable_all_is_silent(environ: dict[str, str]) -> None:
    """Nobody watches then either."""
    notifier = Notifier.from_environment(
        environ | {"WATCHDOG_USEC": "30000000"}
    )

    everything(notifier)

    assert not notifier.enabled
    assert notifier.problem is None
    assert notifier.watchdog_interval_s is None


def test_children_do_not_inherit_the_variables() -> None:
    environ = {
        "NOTIFY_SOCKET": "/none",
        "WATCHDOG_USEC": "1000000",
        "WATCHDOG_PID": str(os.getpid()),
        "PATH": "/bin",
    }

    Notifier.from_environment(environ)

    assert environ == {"PATH": "/bin"}


@pytest.mark.parametrize(
    ("environ", "expected_s"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "30000000"}, 15.0),
        ({"WATCHDOG_USEC": "1"}, 5e-7),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "own"}, 1.5),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": ""}, 1.5),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "3000000", "WATCHDOG_PID": "x"}, None),
        ({"WATCHDOG_PID": "own"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "-5"}, None),
        ({"WATCHDOG_USEC": "1e6"}, None),
        ({"WATCHDOG_USEC": "\u0663"}, None),
        ({"WATCHDOG_USEC": "9" * 5000}, None),
    ],
)
def test_half_the_time_the_watchdog_allows(
    environ: dict[str, str], expected_s: float | None
) -> None:
    """If it watches this process."""
    if environ.get("WATCHDOG_PID") == "own":
        environ = environ | {"WATCHDOG_PID": str(os.getpid())}
    notifier = Notifier.from_environment(environ | {"NOTIFY_SOCKET": "/none"})

    assert notifier.watchdog_interval_s == expected_s


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("none", "No such file or directory"),
        ("file", "Connection refused"),
        ("x" * 200, "AF_UNIX path too long"),
    ],
)
def test_nobody_listens(tmp_path: Path, name: str, reason: str) -> None:
    """Nothing is raised; the problem says what was not delivered."""
    (tmp_path / "file").touch()
    notifier = Notifier(str(tmp_path / name))

    everything(notifier)

    assert notifier.problem == (
        f"STOPPING not sent to the service manager: {reason}"
    )


@pytest.mark.parametrize("address", ["notify", "vsock:2:1234"])
def test_an_address_of_another_kind(address: str) -> None:
    notifier = Notifier(address, 1.0)

    everything(notifier)

    assert not notifier.enabled
    assert notifier.watchdog_interval_s is None
    assert notifier.problem is not None
    assert notifier.problem.startswith(f"NOTIFY_SOCKET={address}: neither")


def test_a_busy_service_manager_does_not_stall_the_loop(
    tmp_path: Path,
) -> None:
    """A full queue drops a sign of life; the next one gets through."""
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(address)
        end.setblocking(False)
        notifier = Notifier(address)
        sent = 0
        while notifier.problem is None:
            notifier.watchdog()
            sent += 1
            assert sent < 10**5
        assert notifier.problem == (
            "WATCHDOG not sent to the service manager: "
            "Resource temporarily unavailable"
        )

        end.recv(100)
        notifier.watchdog()
        assert notifier.problem is None


def test_the_socket_may_come_back(tmp_path: Path) -> None:
    """A service manager that was restarted is found again."""
    address = tmp_path / "notify"
    notifier = Notifier(str(address))
    notifier.watchdog()
    assert notifier.problem is not None

    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(str(address))
        end.setblocking(False)
        notifier.watchdog()
        assert end.recv(100) == b"WATCHDOG=1"
    assert notifier.problem is None

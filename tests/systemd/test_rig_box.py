"""What tests of a unit build on: a real systemd, watchdog, sandbox, CAN."""

import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

pytestmark = [pytest.mark.systemd, pytest.mark.full]

DEADLINE_S = 30.0
FIRST_DYNAMIC_USER = 61184
SERVICE = Path(__file__).with_name("echo_service.py")

UNIT = """
[Unit]
BindsTo=sys-subsystem-net-devices-vcan0.device
After=sys-subsystem-net-devices-vcan0.device
StartLimitIntervalSec=0

[Service]
Type=notify
ExecStart={interpreter} -B {service}
Restart=on-failure
RestartSec=100ms
WatchdogSec=3s
DynamicUser=yes
ProtectHome=yes
CapabilityBoundingSet=
RestrictAddressFamilies=AF_CAN AF_UNIX
"""

Echo = Any  # conftest's Unit: test files are no package to import it from


@pytest.fixture
def echo(install: Callable[[str, str], Echo], interpreter: str) -> Echo:
    """Return the started echo service."""
    text = UNIT.format(interpreter=interpreter, service=SERVICE)
    unit = install("echo.service", text)
    unit.control("start")
    return unit


@pytest.fixture
def bus(echo: Echo) -> Iterator[can.BusABC]:
    """Return a peer on the service's bus."""
    with can.Bus(interface="socketcan", channel="vcan0") as bus:
        yield bus


def frame(identifier: int) -> can.Message:
    return can.Message(arbitration_id=identifier, is_extended_id=False)


def answer(bus: can.BusABC, identifier: int) -> int | None:
    """Send a frame; return the identifier of the next one on the bus."""
    bus.send(frame(identifier))
    message = bus.recv(DEADLINE_S)
    return None if message is None else message.arbitration_id


def test_systemd_runs_and_nothing_has_failed(box: None) -> None:
    listed = subprocess.run(
        ["systemctl", "--failed", "--plain", "--no-legend"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert listed.stdout == ""


def test_start_waits_until_the_service_is_ready(
    echo: Echo, bus: can.BusABC
) -> None:
    assert echo.property("ActiveState") == "active"
    assert echo.property("StatusText") == "listening"
    assert answer(bus, 0x123) == 0x124


def test_the_sandbox_holds(echo: Echo) -> None:
    status = Path("/proc", echo.property("MainPID"), "status").read_text()
    fields = dict(line.split(":", 1) for line in status.splitlines())
    assert int(fields["Uid"].split()[0]) >= FIRST_DYNAMIC_USER
    assert int(fields["CapBnd"], 16) == 0
    assert int(fields["Seccomp"]) == 2


def test_a_crash_is_followed_by_a_restart(echo: Echo, bus: can.BusABC) -> None:
    bus.send(frame(0x600))
    echo.wait_for("NRestarts", "1")
    echo.wait_for("ActiveState", "active")
    assert answer(bus, 0x200) == 0x201


def test_the_watchdog_ends_a_hang(echo: Echo, bus: can.BusABC) -> None:
    bus.send(frame(0x601))
    echo.wait_for("NRestarts", "1")
    assert "Watchdog timeout" in echo.journal()
    echo.wait_for("ActiveState", "active")
    assert answer(bus, 0x200) == 0x201


def test_a_stop_is_clean(echo: Echo) -> None:
    echo.control("stop")
    assert echo.property("Result") == "success"


def test_the_service_goes_with_its_interface(echo: Echo) -> None:
    """Last of all: the interface is another one afterwards."""
    subprocess.run(["ip", "link", "del", "vcan0"], check=True)
    try:
        echo.wait_for("ActiveState", "inactive")
    finally:
        for rest in (["add", "vcan0", "type", "vcan"], ["set", "vcan0", "up"]):
            subprocess.run(["ip", "link", *rest], check=True)
    echo.control("start")
    assert echo.property("ActiveState") == "active"

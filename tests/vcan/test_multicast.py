"""The portable path: CAN frames over UDP multicast, as python-can has it.

In the rig only, where the network is the guest's own.
"""

from __future__ import annotations

import os
import subprocess
import threading
from typing import TYPE_CHECKING

import can
import pytest

from .peers import DEADLINE_S, descent

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from .daemon_process import Daemon

pytestmark = pytest.mark.vcan

GROUP = "239.74.163.2"
BASE = 0x5B0
OWN = range(BASE, BASE + 20)
FRAMES = 9


@pytest.fixture
def group(net_admin: None, program: Callable[[str], str]) -> Iterator[str]:
    """Return a multicast group that stays within the guest."""
    pytest.importorskip("msgpack", reason="python-can[multicast]")
    if os.environ.get("BSTM_RIG") != "required":
        pytest.skip("needs a network of its own: in the rig only")
    ip = program("ip")
    route = ["239.0.0.0/8", "dev", "lo"]
    subprocess.run([ip, "link", "set", "lo", "up"], check=True)
    subprocess.run([ip, "route", "replace", *route], check=True)
    yield GROUP
    subprocess.run([ip, "route", "del", *route], check=True)


def test_a_service_on_a_multicast_group(
    daemon: Callable[..., Daemon], group: str
) -> None:
    """It hears the car, is heard, and takes nothing of its own for input."""
    with can.Bus(
        interface="udp_multicast",
        channel=group,
        can_filters=[
            {"can_id": can_id, "can_mask": 0x7FF, "extended": False}
            for can_id in OWN
        ],
    ) as peer:
        running = daemon(
            {"bus.interface": "udp_multicast", "bus.channel": group}
        )
        running.event("bus_up", channel=group)
        over = threading.Event()

        def drive() -> None:
            begin_us = 0
            while True:
                for at_us, can_id, data in descent():
                    if over.wait(max(at_us - begin_us, 0) * 1e-6):
                        return
                    begin_us = at_us
                    peer.send(
                        can.Message(
                            arbitration_id=can_id,
                            data=data,
                            is_extended_id=False,
                        )
                    )
                begin_us = 0

        driver = threading.Thread(target=drive)
        driver.start()
        try:
            running.notice("STATUS=degraded.* disc F[LR] 1[1-9]")
            heard: set[int] = set()
            while len(heard) < FRAMES:
                heard.add(message_of(peer).arbitration_id)
        finally:
            over.set()
            driver.join()
        # for seconds by now, while every frame of its own came back
        assert not running.said("foreign_frame")
        assert running.end() == 0


def message_of(bus: can.BusABC) -> can.Message:
    """Return the next message on *bus*."""
    message = bus.recv(DEADLINE_S)
    assert message is not None
    return message

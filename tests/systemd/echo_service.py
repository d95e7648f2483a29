"""A small Type=notify service: answers frame N on vcan0 with frame N + 1.

0x600 makes it crash, 0x601 makes it hang.
"""

import os
import signal
import socket
import time

import can

CRASH, HANG = 0x600, 0x601


def main() -> None:
    """Answer frames and feed the watchdog until SIGTERM."""
    address = os.environ["NOTIFY_SOCKET"].replace("@", "\0", 1)
    supervisor = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    supervisor.connect(address)
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
    with supervisor, can.Bus(interface="socketcan", channel="vcan0") as bus:
        supervisor.send(b"READY=1\nSTATUS=listening")
        while not stopped:
            supervisor.send(b"WATCHDOG=1")
            try:
                message = bus.recv(0.2)
            except can.CanOperationError:  # no interface: SIGTERM follows
                time.sleep(0.2)
                continue
            if message is None:
                continue
            if message.arbitration_id == CRASH:
                os.abort()
            if message.arbitration_id == HANG:
                signal.pause()
            message.arbitration_id += 1
            bus.send(message)
        supervisor.send(b"STOPPING=1")


main()

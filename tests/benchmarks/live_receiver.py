"""Receive frames for a while and tell the CPU time: a program of its own.

``live_receiver.py ours|peer FD SECONDS``. From the socket to samples: of us
the intake and the engine of the service without its ticks, so that nothing is
marched; of the peer python-can's Notifier on its own SocketCAN reading, with a
listener that decodes the wanted ids by cantools.
"""

from __future__ import annotations

import json
import socket
import sys
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import can
from can.interfaces.socketcan import SocketcanBus
from live_link import PairLink
from traffic import example_database

from bstm_daemon.bus.live.frame_records import FrameRecords
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.files import shipped_file
from bstm_daemon.service.clock import SteadyAxis
from bstm_daemon.service.intake import GUARD_US, Intake
from bstm_daemon.service.wake import SignalWaiter

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.bus.signals.signal_map import SignalMap

EXAMPLE = "config/example_vehicle.toml"


def ours(end: socket.socket, seconds: float) -> tuple[float, int]:
    """Return the CPU seconds and the number of samples."""
    config, signal_map = load_vehicle(shipped_file(EXAMPLE))
    engine = Engine(config, signal_map)
    axis = SteadyAxis()
    link = PairLink(end, config.bus[0], signal_map.wanted(0))
    link.open()
    intake = Intake([link], axis)
    drain_us = round(config.daemon.drain_s * 1e6)
    _ready()
    with SignalWaiter() as waiter:
        begin_s = time.process_time()
        deadline_us = axis.read()
        end_us = deadline_us + round(seconds * 1e6)
        while deadline_us < end_us:
            waiter.wait((deadline_us - axis.now_us) * 1e-6)
            _, arrivals = intake.read(axis.read())
            index, count = 0, len(arrivals)
            while index < count:
                if isinstance(arrivals, FrameRecords):
                    index = engine.frames(arrivals, index)
                    if index == count:
                        break
                time_us, bus, frame = arrivals[index]
                engine.frame(
                    bus,
                    frame.can_id,
                    frame.extended,
                    frame.data,
                    time_us,
                    is_error=frame.is_error,
                    is_remote=frame.is_remote,
                )
                index += 1
            line = (axis.read() - GUARD_US) // drain_us + 1
            deadline_us = line * drain_us + GUARD_US
        spent_s = time.process_time() - begin_s
    return spent_s, len(engine._values)


class PairBus(SocketcanBus):
    """python-can's SocketCAN bus on *end* instead of an interface."""

    def __init__(self, end: socket.socket) -> None:
        """Take *end*, which stamps as python-can asks a CAN socket to."""
        self.channel = "can0"
        self.channel_info = "socket pair"
        self.socket = end
        self._is_filtered = False
        self._bcm_sockets = {}
        end.setsockopt(
            socket.SOL_SOCKET,
            can.interfaces.socketcan.constants.SO_TIMESTAMPNS,
            1,
        )
        can.BusABC.__init__(self, channel=self.channel)

    def _apply_filters(self, filters: Any) -> None:
        """None are asked for."""


class Decoding(can.Listener):
    """Keeps the wanted signals of every frame, as its user would."""

    def __init__(self, signal_map: SignalMap) -> None:
        self.samples: list[tuple[float, int, Any]] = []
        database = example_database()
        self._wanted: dict[int, tuple[Callable[..., Any], list[Any]]] = {}
        for key, plan in signal_map.messages.items():
            message = database.get_message_by_frame_id(key.can_id)
            self._wanted[key.can_id] = (
                message.decode,
                [
                    (plan.signals[output.index].name, output.role)
                    for output in plan.outputs
                ],
            )

    def on_message_received(self, msg: can.Message) -> None:
        """Decode *msg* if it is wanted."""
        found = self._wanted.get(msg.arbitration_id)
        if found is None:
            return
        decode, names = found
        values = decode(msg.data, decode_choices=False)
        stamp_s = msg.timestamp
        keep = self.samples.append
        for name, role in names:
            keep((stamp_s, role, values[name]))


def peer(end: socket.socket, seconds: float) -> tuple[float, int]:
    """Return the CPU seconds and the number of samples."""
    listener = Decoding(load_vehicle(shipped_file(EXAMPLE))[1])
    bus = PairBus(end)
    _ready()
    begin_s = time.process_time()
    notifier = can.Notifier(bus, [listener])
    time.sleep(seconds)
    spent_s = time.process_time() - begin_s
    notifier.stop()
    with suppress(OSError):
        bus.shutdown()
    return spent_s, len(listener.samples)


def _ready() -> None:
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.readline()


def main() -> None:
    """Receive as the command line says."""
    who, place, seconds = sys.argv[1:]
    receive = {"ours": ours, "peer": peer}[who]
    end = socket.socket(fileno=int(place))
    spent_s, samples = receive(end, float(seconds))
    sys.stdout.write(json.dumps({"cpu_s": spent_s, "samples": samples}) + "\n")


if __name__ == "__main__":
    main()

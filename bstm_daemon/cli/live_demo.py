"""``bstm demo --live``: car, service and display, each a process of its own.

They share one virtual bus, CAN over UDP multicast, and one terminal, which the
display takes. A hop limit of 0 keeps every frame on this machine.
"""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import can

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.errors import BstmError, require_packages
from bstm_daemon.files import make_folder, shipped_file
from bstm_daemon.service.state_file import encode, save
from bstm_daemon.simulation import SimulatedDrive, load_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, frames

INTERFACE: Final = "udp_multicast"
GROUP: Final = "239.74.163.2"
"""Of the range that no router forwards (RFC 2365)."""

CYCLE_S: Final = 0.005
_PAGE: Final = ("view", "--open", "--listen", "127.0.0.1:0")

PATIENCE_S: Final = 3.0
"""A process that was asked to end by the terminal itself needs less."""


def run_live(folder: Path, drive: str, *, page: bool = False) -> int:
    """Show *drive* live until the user leaves; the service's log in *folder*.

    With *page* the display is one in the browser.

    Raises:
        MissingExtraError: msgpack or rich is absent.
        FileAccessError: *folder* can not be made.
        BstmError: there is no multicast here, or the service ended.
    """
    purpose = "demo --live"
    shown = "tornado" if page else "rich"
    require_packages("msgpack", shown, extra="all", purpose=purpose)
    make_folder(folder)
    log = folder / "live.log"
    driven = simulate(load_drive(drive))
    options = {"port": _free_port(), "hop_limit": 0}
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    # bstm as it is started by hand, with python-can's options of the bus
    command = [sys.executable, "-m", "bstm_daemon.cli.main"]
    env = os.environ | {"CAN_CONFIG": json.dumps(options)}
    with (
        TemporaryDirectory(prefix="bstm-live-") as scratch,
        log.open("wb") as to_log,
        _bus(options) as bus,
    ):
        car = _configuration(Path(scratch))
        state = _parked_overnight(car)
        service = subprocess.Popen(  # noqa: S603  (our own program)
            [*command, "run", "-c", car, "--state", state],
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=to_log,
            stderr=to_log,
        )
        display = subprocess.Popen(  # noqa: S603
            [*command, *(_PAGE if page else ["watch"]), "-c", car], env=env
        )
        try:
            with suppress(KeyboardInterrupt):
                _drive(driven, bus, (service, display))
            ended = service.poll()
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            is_alive = service.poll() is None
            # first: who ends this does not always wait
            service.terminate()
            # the display gives the terminal back before it ends
            with suppress(subprocess.TimeoutExpired):
                display.wait(PATIENCE_S if is_alive else 0.0)
            display.terminate()
            for process in (display, service):
                process.wait()
    if ended:
        *_, last = ["", *log.read_text("utf-8", "replace").splitlines()]
        msg = f"demo --live: the service ended: {last} ({log})"
        raise BstmError(msg)
    return display.returncode


def _drive(
    driven: SimulatedDrive,
    bus: can.BusABC,
    others: tuple[subprocess.Popen[bytes], ...],
) -> None:
    """Send the frames of *driven* at their times, until one of *others* ends.

    After the last frame the car's bus sleeps.
    """
    encoder = Encoder(shipped_file("dbc/example_vehicle.dbc"))
    start_s = time.monotonic()
    pending = frames(driven, encoder, 0.0)
    frame = next(pending, None)
    while all(process.poll() is None for process in others):
        now_s = time.monotonic() - start_s
        while frame is not None and frame.stamp_s <= now_s:
            bus.send(
                can.Message(
                    arbitration_id=frame.frame_id,
                    is_extended_id=False,
                    data=frame.data,
                )
            )
            frame = next(pending, None)
        time.sleep(CYCLE_S)


@contextmanager
def _bus(options: dict[str, Any]) -> Iterator[can.BusABC]:
    """Open the car's end of the bus.

    Raises:
        BstmError: it can not be opened, or takes no frames.
    """
    try:
        with can.Bus(interface=INTERFACE, channel=GROUP, **options) as bus:
            yield bus
    except can.CanError as error:
        msg = (
            f"demo --live: no UDP multicast on this machine "
            f"({error.__cause__ or error}); as root: "
            "ip route add 239.0.0.0/8 dev lo"
        )
        raise BstmError(msg) from error


def _configuration(folder: Path) -> Path:
    """Write the example car on the virtual bus, with what it publishes."""
    source = shipped_file("config/example_vehicle.toml")
    text = source.read_text(encoding="utf-8")
    for old, new in (
        (r'"\.\./dbc/', f'"{source.parents[1].as_posix()}/dbc/'),
        (r'(\[\[bus\]\][^[]*?interface = )"socketcan"', rf'\1"{INTERFACE}"'),
        (r'(\[\[bus\]\][^[]*?channel = )"can0"', rf'\1"{GROUP}"'),
        (r"(\[publish\][^[]*?enabled = )false", r"\1true"),
        (r'# (socket = )"[^"]*"', r'\1"feed.sock"'),
    ):
        text = re.sub(old, new, text)
    target = folder / source.name
    target.write_text(text, encoding="utf-8")
    return target


def _parked_overnight(car: Path) -> Path:
    """Write the state that a service saves once the brakes are cold."""
    engine = Engine(*load_vehicle(car), history_known=True)
    engine.tick(time.time_ns() // 1000)
    target = car.with_name("state")
    save(target, encode(engine.export_state()))
    return target


def _free_port() -> int:
    """Return a port for this demo alone: a group hears all of its port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port: int = probe.getsockname()[1]
        return port

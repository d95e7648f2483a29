"""``bstm demo``: a descent and a hot soak in CAN frames, time-warped.

The simulated car sends its frames to the monitor, whose published frames a
display reads. With ``--live`` car, service and display are each a process of
its own: they share one virtual bus, CAN over UDP multicast, and one terminal,
which the display takes. A hop limit of 0 keeps every frame on this machine.
"""

import argparse
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
from math import isnan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import can

from bstm_daemon.cli.arguments import add_out, option
from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.errors import BstmError, UsageError, require_packages
from bstm_daemon.files import ensure_writable, make_folder, shipped_file
from bstm_daemon.replay.results import (
    Collector,
    Results,
    ResultsBuilder,
    csv_file,
)
from bstm_daemon.report.drive_curves import DriveCurves
from bstm_daemon.report.drive_statistics import DriveStatistics, summary_table
from bstm_daemon.report.replay_page import ReplayFacts, replay_page
from bstm_daemon.report.shell import require_page_packages, write_page
from bstm_daemon.service.state_file import encode, save
from bstm_daemon.simulation import SimulatedDrive, load_drive, simulate
from bstm_daemon.simulation.recorder import START_STAMP_S, Encoder, frames
from bstm_daemon.watch.board import Board

DRIVE = "alpine-descent"
END_S = 40 * 60
"""The fluid's peak is behind; the rest of the hour of parking only cools."""

TICK_US = 1_000_000
"""What is published does not depend on it: each frame has its own time."""

START = "start cold: the car stood overnight (bstm replay --start cold)"
ROW_S = 300
SHOWN = ("FL", "RL")
COLUMNS = {
    "disc": ("Temperatures", "Disc"),
    "pad": ("Temperatures", "PadBack"),
    "fluid": ("Temperatures", "Fluid"),
    "margin": ("Risk", "Margin"),
}
"""Frame and signal of a corner by the heading of its column."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``bstm demo``."""
    add_out(parser, "folder for report and table (default: bstm-demo)", "DIR")
    option(
        parser,
        "--live",
        "at the car's own pace instead: simulated car, service and display as "
        "three processes on a virtual bus, until Ctrl-C or q",
    )
    option(
        parser, "--view", "with --live: the display is a page in the browser"
    )


def run(args: argparse.Namespace) -> int:
    """Simulate, listen, publish, display, report."""
    folder = args.out or Path("bstm-demo")
    if args.view and not args.live:
        msg = "--view shows the live demo: give --live --view"
        raise UsageError(msg)
    if args.live:
        return run_live(folder, DRIVE, page=args.view)
    make_folder(folder)
    ensure_writable(folder / "report.html")
    require_page_packages()
    config_path = shipped_file("config/example_vehicle.toml")
    config, signal_map = load_vehicle(config_path)
    drive = load_drive(DRIVE)
    print(
        f"the first {END_S // 60} min of a simulated drive: "
        f"{drive.drive.description}"
    )
    driven = simulate(drive)
    display = Board(config.publish.id_base)
    print(START)
    engine = Engine(config, signal_map, history_known=True)
    rows, statistics, curves = Collector(), DriveStatistics(), DriveCurves()
    print(_heading())
    with csv_file(folder / "estimates.csv") as table:
        builder = ResultsBuilder(
            engine.estimator, [rows, statistics, curves, table]
        )
        _drive(driven, engine, builder, display)
        builder.finish()
    print()
    print(summary_table(statistics.summary()))
    print(_against_truth(rows.results(), driven))
    facts = ReplayFacts(
        title=f"bstm demo: {DRIVE}",
        log=f"simulated drive {DRIVE}",
        vehicle_id=config.vehicle.id,
        configuration=config_path.name,
        heat_mode=config.heat.mode,
        refused={str(k): n for k, n in engine.decoder.counts.items()},
        counts=engine.estimator.counts,
        compiled=engine.estimator.compiled,
        warnings=("Simulated data: no car was driven.", START),
    )
    page = replay_page(statistics.summary(), curves, facts)
    write_page(folder / "report.html", page)
    print(f"report: {folder / 'report.html'}")
    print(f"table:  {folder / 'estimates.csv'}")
    return 0


def _drive(
    driven: SimulatedDrive,
    engine: Engine,
    builder: ResultsBuilder,
    display: Board,
) -> None:
    """Run the three parties through the drive, as fast as they go."""
    encoder = Encoder(shipped_file("dbc/example_vehicle.dbc"))
    start_us = round(START_STAMP_S * 1e6)
    end_us = start_us + END_S * 1_000_000
    pending = iter(frames(driven, encoder))
    frame = next(pending, None)
    next_row_us = start_us
    with Progress("demo") as progress:
        for now_us in range(start_us, end_us + TICK_US, TICK_US):
            while frame is not None and frame.stamp_s * 1e6 < now_us:
                stamp_us = round(frame.stamp_s * 1e6)
                engine.frame(0, frame.frame_id, False, frame.data, stamp_us)
                frame = next(pending, None)
            for _, out in engine.tick(now_us):
                display.frame(out.can_id, out.data, now_us)
            builder.add(engine.blocks, engine.risks)
            values = _shown(display)
            if now_us >= next_row_us and not any(map(isnan, values)):
                moving = driven.course.speed_ms[
                    min((now_us - start_us) // 10_000, len(driven.time_s) - 1)
                ]
                minutes = (now_us - start_us) / 60e6
                what = "driving" if moving > 0 else "parked"
                cells = " ".join(f"{value:9.0f}" for value in values)
                print(f"{minutes:5.0f} min  {what:8} {cells}")
                next_row_us += ROW_S * 1_000_000
            progress.show((now_us - start_us) / (end_us - start_us))


def _against_truth(results: Results, driven: SimulatedDrive) -> str:
    """The estimate's fluid peak beside the simulated car's own."""
    lines = ["fluid peak, estimated from CAN / simulated truth:"]
    time_s = results.columns["time_s"] - START_STAMP_S
    for corner in SHOWN:
        fluid = results.columns[f"{corner}.fluid_c"]
        real = driven.truth[f"{corner}.fluid"] - 273.15
        at, real_at = int(fluid.argmax()), int(real.argmax())
        lines.append(
            f"  {corner}  {fluid[at]:5.1f} / {real[real_at]:5.1f} degC  at "
            f"{time_s[at] / 60:4.1f} / {driven.slow_time_s[real_at] / 60:4.1f}"
            f" min"
        )
    return "\n".join(lines)


def _heading() -> str:
    columns = " ".join(
        f"{corner + ' ' + name:>9}" for corner in SHOWN for name in COLUMNS
    )
    return (
        f"{'':20}{columns}\n(degC as published on the bus; pad = back of the "
        f"pad; margin = K to boiling with wet fluid)"
    )


def _shown(display: Board) -> list[float]:
    """Return the values of a row, NaN for what was not published yet."""
    return [
        display.value(f"BSTM_{corner}_{frame}", signal)
        for corner in SHOWN
        for frame, signal in COLUMNS.values()
    ]


INTERFACE: Final = "udp_multicast"
GROUP: Final = "239.74.163.2"
"""Of the range that no router forwards (RFC 2365)."""

CYCLE_S: Final = 0.005
_PAGE: Final = ("view", "--open", "--listen", "127.0.0.1:0")

PATIENCE_S: Final = 60.0
"""The terminal asked the display to end; a busy machine may take its time."""


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
        signal.signal(number, lambda *_: sys.exit(0))
    # a script's background starts what ignores it; service and display do not
    signal.signal(signal.SIGINT, signal.default_int_handler)
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
        ended, patience_s = None, 0.0
        try:
            _send(driven, bus, (service, display))
            ended = service.poll()
        except KeyboardInterrupt:
            # the terminal's: service and display had it too
            patience_s = PATIENCE_S
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            # first: who ends this does not always wait
            service.terminate()
            # the display gives the terminal back before it ends
            with suppress(subprocess.TimeoutExpired):
                display.wait(patience_s)
            display.terminate()
            for process in (display, service):
                process.wait()
    if ended:
        *_, last = ["", *log.read_text("utf-8", "replace").splitlines()]
        msg = f"demo --live: the service ended: {last} ({log})"
        raise BstmError(msg)
    return display.returncode


def _send(
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

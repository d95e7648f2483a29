"""``bstm demo``: a descent and a hot soak in CAN frames, time-warped.

The simulated car sends its frames to the monitor, whose published frames a
display reads.
"""

from __future__ import annotations

import argparse
from math import isnan
from pathlib import Path

from bstm_daemon.cli.arguments import add_out, option
from bstm_daemon.cli.live_demo import run_live
from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.errors import UsageError
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

"""``bstm demo``: a descent and a hot soak on an embedded bus, time-warped.

Three parties share a virtual bus, as they would share a wire: the simulated
car sends its frames, the monitor listens and publishes, and a display reads
what was published. The display knows only ``dbc/bstm.dbc``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import can
import cantools

from bstm_daemon import __version__
from bstm_daemon.cli.arguments import add_out
from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.files import ensure_writable, make_folder
from bstm_daemon.report.page import ReportFacts, write_replay_report
from bstm_daemon.report.screen import summary_table
from bstm_daemon.report.tally import DriveTally
from bstm_daemon.report.traces import DriveCurves
from bstm_daemon.results import Collector, Results, ResultsBuilder, csv_file
from bstm_daemon.shipped import shipped_file
from bstm_daemon.simulation import SimulatedDrive, load_drive, simulate
from bstm_daemon.simulation.frames import START_STAMP_S, Encoder, frames

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

CHANNEL = "bstm-demo"
DRIVE = "alpine-descent"
TICK_US = 50_000
"""The estimator's own step: a shorter tick would only cost time here."""

ROW_S = 300
SHOWN = ("FL", "FR")


@dataclass
class Display:
    """What a display knows: the last frame of each name."""

    database: Any
    seen: dict[str, dict[str, Any]] = field(default_factory=dict)
    rows: list[str] = field(default_factory=list)

    def show(self, message: can.Message) -> None:
        """Take a published frame."""
        known = self.database.get_message_by_frame_id(message.arbitration_id)
        self.seen[known.name] = known.decode(message.data)

    def complete(self) -> bool:
        """Whether every frame that the table shows has been seen."""
        kinds = ("Temperatures", "Risk")
        return all(
            f"BSTM_{corner}_{kind}" in self.seen
            for corner in SHOWN
            for kind in kinds
        )

    def row(self, minutes: float, what: str) -> str:
        """One line of the table on screen."""
        cells = [f"{minutes:5.0f} min  {what:8}"]
        for corner in SHOWN:
            frame = self.seen.get(f"BSTM_{corner}_Temperatures", {})
            risk = self.seen.get(f"BSTM_{corner}_Risk", {})
            cells += [
                _cell(frame.get("Disc")),
                _cell(frame.get("PadBack")),
                _cell(frame.get("Fluid")),
                _cell(risk.get("Margin")),
            ]
        return " ".join(cells)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``bstm demo``."""
    add_out(parser, "folder for report and table (default: bstm-demo)", "DIR")


def run(args: argparse.Namespace) -> int:
    """Simulate, listen, publish, display, report."""
    folder = args.out or Path("bstm-demo")
    make_folder(folder)
    ensure_writable(folder / "report.html")
    config_path = shipped_file("config/example_vehicle.toml")
    config, signal_map = load_vehicle(config_path)
    print(f"simulated drive: {load_drive(DRIVE).drive.description}")
    driven = simulate(load_drive(DRIVE))
    display = Display(
        cantools.database.load_file(shipped_file("dbc/bstm.dbc"))
    )
    # the simulated car stood overnight: its brakes are as cold as the air
    engine = Engine(config, signal_map, history_known=True)
    rows, tally, curves = Collector(), DriveTally(), DriveCurves()
    print(_heading())
    with (
        csv_file(folder / "estimates.csv") as table,
        _bus() as car,
        _bus() as monitor,
        _bus() as screen,
    ):
        builder = ResultsBuilder(
            engine.estimator, [rows, tally, curves, table]
        )
        _drive(driven, engine, builder, display, (car, monitor, screen))
        builder.finish()
    print()
    print(summary_table(tally.summary()))
    print(_against_truth(rows.results(), driven))
    facts = ReportFacts(
        title=f"bstm demo: {DRIVE}",
        logs=(f"simulated drive {DRIVE}",),
        vehicle_id=config.vehicle.id,
        configuration=config_path.name,
        heat_mode=config.heat.mode,
        lines=0,
        frames=0,
        refused={str(k): n for k, n in engine.decoder.counts.items()},
        counts=engine.estimator.counts,
        kernel="compiled" if engine.estimator.compiled else "pure Python",
        version=__version__,
        warnings=("Simulated data: no car was driven.",),
    )
    write_replay_report(folder / "report.html", tally.summary(), curves, facts)
    print(f"report: {folder / 'report.html'}")
    print(f"table:  {folder / 'estimates.csv'}")
    return 0


def _drive(
    driven: SimulatedDrive,
    engine: Engine,
    builder: ResultsBuilder,
    display: Display,
    buses: tuple[can.BusABC, can.BusABC, can.BusABC],
) -> None:
    """Run the three parties through the drive, as fast as they go."""
    car, monitor, screen = buses
    encoder = Encoder(shipped_file("dbc/example_vehicle.dbc"))
    start_us = round(START_STAMP_S * 1e6)
    end_us = start_us + round(len(driven.time_s) * 1e4)
    pending = iter(frames(driven, encoder))
    frame = next(pending, None)
    next_row_us = start_us
    with Progress("demo") as progress:
        for now_us in range(start_us, end_us + TICK_US, TICK_US):
            while frame is not None and frame.stamp_s * 1e6 < now_us:
                car.send(
                    can.Message(
                        timestamp=frame.stamp_s,
                        arbitration_id=frame.frame_id,
                        is_extended_id=False,
                        data=frame.data,
                    )
                )
                frame = next(pending, None)
            for message in _drained(monitor):
                engine.frame(
                    0,
                    message.arbitration_id,
                    message.is_extended_id,
                    message.data,
                    round(message.timestamp * 1e6),
                    is_error=message.is_error_frame,
                    is_remote=message.is_remote_frame,
                )
            for published in engine.tick(now_us):
                out = published.frame
                monitor.send(
                    can.Message(
                        timestamp=published.time_us * 1e-6,
                        arbitration_id=out.can_id,
                        is_extended_id=out.extended,
                        data=out.data,
                    )
                )
            builder.add(engine.blocks, engine.risks)
            for message in _drained(screen):
                if message.arbitration_id in engine.publication.ids:
                    display.show(message)
            for _ in _drained(car):
                pass
            if now_us >= next_row_us and display.complete():
                moving = driven.course.speed_ms[
                    min((now_us - start_us) // 10_000, len(driven.time_s) - 1)
                ]
                minutes = (now_us - start_us) / 60e6
                print(
                    display.row(minutes, "driving" if moving > 0 else "parked")
                )
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
        f"{corner + ' ' + name:>7}"
        for corner in SHOWN
        for name in ("disc", "pad", "fluid", "left")
    )
    return (
        f"{'':20}{columns}\n(degC as published on the bus; pad = back of the "
        f"pad; left = K to the wet boiling point)"
    )


def _cell(value: object) -> str:
    return f"{value:7.0f}" if isinstance(value, int | float) else f"{'-':>7}"


def _bus() -> can.BusABC:
    return can.Bus(
        interface="virtual", channel=CHANNEL, preserve_timestamps=True
    )


def _drained(bus: can.BusABC) -> Iterator[can.Message]:
    while (message := bus.recv(timeout=0)) is not None:
        yield message

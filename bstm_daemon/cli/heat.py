"""``bstm heat``: the brake heat of recorded drives by every source."""

import argparse
from pathlib import Path
from typing import Final

from bstm_daemon.analysis.identify import heat_comparison
from bstm_daemon.analysis.identify.driving import driving_of
from bstm_daemon.analysis.quality.recording import read_recording
from bstm_daemon.cli.log_command import LogCommand, add_log_arguments
from bstm_daemon.cli.progress import Progress
from bstm_daemon.config.heat import heat_mode_problems
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError
from bstm_daemon.replay.columns import stream_log
from bstm_daemon.replay.results import Collector, Part, Results
from bstm_daemon.report.heat import heat_json, heat_page, heat_text

FUSED: Final = "fused"

READ: Final = 0.1
"""Share of the work that is reading the log for its motion."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the logs and where results go."""
    add_log_arguments(parser, "recorded drive; several are shown side by side")


def run(args: argparse.Namespace) -> int:
    """Compare the sources in every log, print and write the result."""
    command = LogCommand.opened(args)
    drives = []
    for log in args.logs:
        heat, friction = _compared(command, log)
        print(command.heading(log))
        print(heat_text(heat, friction))
        drives.append((log.name, heat, friction))
    for line in command.written(
        lambda: {
            "logs": [
                {"file": str(log), **heat_json(heat, friction)}
                for log, (_, heat, friction) in zip(
                    args.logs, drives, strict=True
                )
            ]
        },
        lambda subtitle: heat_page(drives, subtitle),
        indent=None,
    ):
        print(line)
    return 0


def _compared(
    command: LogCommand, log: Path
) -> tuple[heat_comparison.HeatComparison, heat_comparison.StopFriction]:
    config, signal_map = command.config, command.signal_map
    overrides = dict(command.args.map)
    fused = _fused(config)
    cars = [config]
    if fused is not None and fused is not config:
        cars.append(fused)
    found: list[Results] = []
    with Progress(f"heat {log.name}") as progress:
        recording = read_recording(
            [log], signal_map, overrides, progress.part(0.0, READ)
        )
        driving = driving_of(log.name, recording, config, signal_map)
        share = (1.0 - READ) / len(cars)
        for car in cars:
            begin = READ + len(found) * share
            # no validity and no forecast: neither is shown
            rows = Collector(Part.NONE)
            stream_log(
                *(car, signal_map, log, [rows]),
                overrides=overrides,
                progress=progress.part(begin, begin + share),
            )
            found.append(rows.results())
    heat = heat_comparison.compare_heat(
        found[0], driving, config, None if fused is None else found[-1]
    )
    if not heat.power_w:
        why = "; ".join(heat.absent.values())
        msg = f"{log}: no source of brake heat: {why}"
        raise LogError(msg)
    return heat, heat_comparison.stop_friction(driving, config, heat)


def _fused(config: Config) -> Config | None:
    """Return *config* in the mode ``fused``, None where there is none."""
    if config.heat.mode == FUSED:
        return config
    heat = config.heat.model_copy(update={"mode": FUSED})
    if any(heat_mode_problems(heat, config.corner, config.signals.keys())):
        return None
    return config.model_copy(update={"heat": heat})

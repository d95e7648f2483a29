"""The estimator against the simulated car's true temperatures.

Log in, estimates out, as a user would do it; the two share no physics code.
The example car is matched to the simulated one on `simalp` and a drive at
several speeds, so `alpine-descent` is the drive that it has not seen.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from physics import DRIVES, NODES, stop_s
from side_by_side import Outcome, Table

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.files import shipped_file
from bstm_daemon.replay.columns import stream_log
from bstm_daemon.replay.results import Collector
from bstm_daemon.simulation import SimulatedDrive, load_drive, simulate
from bstm_daemon.simulation.recorder import (
    START_STAMP_S,
    Encoder,
    write_candump,
)
from bstm_daemon.units import KELVIN_OFFSET

CORNERS = ("FL", "RL")


def run(*, full: bool) -> Outcome:
    """Compare both drives (quick: ``simalp``), front and rear."""
    outcome = Outcome(
        "Estimator against truth",
        "Example car, Feed-Forward, on the log of the simulated car (preset "
        "plain, start known to both); truth once a second. Front and rear "
        "left; RMS and largest error over drive and soak.",
    )
    errors, peaks = [], []
    for name in DRIVES if full else DRIVES[:1]:
        driven = simulate(load_drive(name))
        columns = estimates(driven)
        for corner in CORNERS:
            here = f"{name}, {corner}"
            apart = {
                node: columns[f"{corner}.{node}_c"]
                + KELVIN_OFFSET
                - driven.truth[f"{corner}.{node}"]
                for node in NODES
            }
            errors.append(
                (
                    here,
                    *(
                        f"{np.sqrt((e**2).mean()):.1f} / {np.abs(e).max():.1f}"
                        for e in apart.values()
                    ),
                )
            )
            truth = driven.truth[f"{corner}.fluid"] - KELVIN_OFFSET
            fluid = columns[f"{corner}.fluid_c"]
            found, real = (
                float(driven.slow_time_s[series.argmax()])
                for series in (fluid, truth)
            )
            peaks.append(
                (
                    here,
                    f"{truth.max():.1f}",
                    f"{fluid.max():.1f}",
                    f"{fluid.max() - truth.max():+.1f}",
                    f"{(real - stop_s(driven)) / 60:.1f}",
                    f"{(found - real) / 60:+.1f}",
                )
            )
    outcome.tables = [
        Table(
            "Error, RMS / largest, K",
            ("drive, corner", *(node.replace("_", " ") for node in NODES)),
            tuple(errors),
        ),
        Table(
            "Peak of the fluid",
            (
                *("drive, corner", "truth, degC", "estimate, degC"),
                *("error, K", "min after the stop", "error, min"),
            ),
            tuple(peaks),
        ),
    ]
    return outcome


def estimates(driven: SimulatedDrive) -> dict[str, np.ndarray]:
    """Return the estimates of *driven*'s log at the times of its truth."""
    config, signal_map = load_vehicle(
        shipped_file("config/example_vehicle.toml")
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.log"
        encoder = Encoder(shipped_file("dbc/example_vehicle.dbc"))
        write_candump(path, driven, encoder)
        rows = Collector()
        stream_log(config, signal_map, path, [rows])
    columns = rows.results().columns
    at_s = columns["time_s"] - START_STAMP_S
    return {
        f"{corner}.{node}_c": np.interp(
            driven.slow_time_s, at_s, columns[f"{corner}.{node}_c"]
        )
        for corner in CORNERS
        for node in NODES
    }

"""How well the numbers are solved: steps, cells and energy.

Of the estimator's network and of the simulated car, each against itself at a
finer resolution. Nothing here says that a model is right.
"""

from __future__ import annotations

import sys
from array import array
from dataclasses import dataclass
from itertools import pairwise
from math import log2
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from side_by_side import Outcome, Table, three_digits

from bstm_daemon.channels import CHANNELS
from bstm_daemon.config.reading import load_config
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.files import shipped_file
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.simulation import Mesh, load_drive, simulate
from bstm_daemon.simulation.profile import SAMPLE_S
from bstm_daemon.simulation.simulate import DEFAULT_RESOLUTION, Resolution
from bstm_daemon.units import KELVIN_OFFSET

sys.path.append(str(Path(__file__).parents[1]))
from energy_ledger import read_ledger
from finer_mesh import with_half_cells

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy.typing as npt

    from bstm_daemon.config.sections import Config, CornerConfig
    from bstm_daemon.model.thermal.program import Program
    from bstm_daemon.simulation import SimulatedDrive

    Series = npt.NDArray[np.floating[Any]]

AMBIENT_K = 283.15
FINE_S = 0.0025
EVERY_S = 10.0
NODES = ("disc", "pad_front", "pad_back", "fluid")
DRIVES = ("simalp", "alpine-descent")


def run(*, full: bool) -> Outcome:
    """Measure errors of steps and cells, energy residuals and bands."""
    outcome = Outcome(
        "Numerical accuracy",
        "Largest difference in K to the same model at a finer resolution, "
        "at any time. Order: binary logarithm of the quotient of two errors, "
        "per halving of the step or cell.",
    )
    _kernel(outcome, full=full)
    _reality(outcome, full=full)
    return outcome


@dataclass(frozen=True)
class Case:
    """Power [W] and speed [m/s] over ``duration_s``, vectorised in time."""

    name: str
    duration_s: float
    power_w: Callable[[Series], Series]
    speed_ms: Callable[[Series], Series]

    def inputs(self, step_s: float) -> tuple[array[float], int]:
        """Return [steps, 1, channels]: means over each step, and steps."""
        count = round(self.duration_s / FINE_S)
        at_s = (np.arange(count) + 0.5) * FINE_S
        per_step = round(step_s / FINE_S)
        power = self.power_w(at_s).reshape(-1, per_step).mean(axis=1)
        speed = self.speed_ms(at_s).reshape(-1, per_step).mean(axis=1)
        rows = np.full((len(power), len(CHANNELS)), np.nan)
        for channel, values in (
            ("speed_ms", speed),
            ("brake_power_w", power),
            ("brake_on", (power > 0.0).astype(float)),
            ("ambient_k", AMBIENT_K),
            ("pressure_pa", 0.0),
            ("wetness", 0.0),
            ("brake_energy_ff_j", 0.0),
            ("brake_energy_fb_j", 0.0),
        ):
            rows[:, CHANNELS.index(channel)] = values
        flat = array("d")
        flat.frombytes(rows.tobytes())
        return flat, len(power)


DESCENT = Case(
    "drag of 1500 s at 6 kW, soak of 3600 s",
    5100.0,
    lambda t: np.where(t < 1500.0, 6000.0, 0.0),
    lambda t: np.where(t < 1500.0, 10.0, 0.0),
)
STOPS = Case(
    "stops from 27 m/s in 10 s, every 90 s",
    1800.0,
    lambda t: np.where(
        (t % 90.0 > 60.0) & (t % 90.0 < 70.0),
        54_000.0 * (70.0 - t % 90.0) / 10.0,
        0.0,
    ),
    lambda t: np.interp(
        t % 90.0, [0.0, 20.0, 60.0, 70.0, 90.0], [0.0, 27.0, 27.0, 0.0, 0.0]
    ),
)


def _kernel(outcome: Outcome, *, full: bool) -> None:
    config = load_config(shipped_file("config/example_vehicle.toml"))
    corner = config.disc_corners()[0]
    program = compile_corner(config, corner)
    steps = (0.4, 0.2, 0.1, 0.05, 0.025) if full else (0.2, 0.1, 0.05)
    for case in (DESCENT, STOPS):
        exact = march(program, case, FINE_S)
        errors = {
            f"{step:g} s": _apart(march(program, case, step), exact)
            for step in steps
        }
        outcome.tables.append(
            error_table(f"Estimator, step: {case.name}", "step", errors)
        )
    _slabs(outcome, config, corner)
    rows = []
    for case in (DESCENT, STOPS):
        batch = _batch(program)
        start = array("d", batch.state)
        inputs, count = case.inputs(0.05)
        batch.march(inputs, count, 0.05, output_every=count)
        ledger = read_ledger(program, batch.ledger, start, batch.state)
        rows.append(
            (
                case.name,
                f"{ledger.generated / 1e6:.2f}",
                f"{abs(ledger.residual) / ledger.generated:.1e}",
            )
        )
    outcome.tables.append(
        Table(
            "Estimator, energy at a step of 0.05 s",
            ("case", "generated, MJ", "residual / generated"),
            tuple(rows),
        )
    )


def _slabs(outcome: Outcome, config: Config, corner: CornerConfig) -> None:
    pad = corner.pad
    assert pad is not None

    def with_slabs(count: int) -> Program:
        finer = pad.model_copy(update={"slabs": count})
        return compile_corner(config, corner.model_copy(update={"pad": finer}))

    for case in (DESCENT, STOPS):
        exact = march(with_slabs(60), case, 0.05)
        errors = {
            f"{count}": _apart(march(with_slabs(count), case, 0.05), exact)
            for count in (5, 10, 20)
        }
        title = f"Estimator, slabs of the pad (usual {pad.slabs}) against 60"
        outcome.tables.append(
            error_table(f"{title}: {case.name}", "slabs", errors)
        )


def march(program: Program, case: Case, step_s: float) -> dict[str, Series]:
    """Return :data:`NODES` [K] every 10 s."""
    inputs, steps = case.inputs(step_s)
    batch = _batch(program)
    every = round(EVERY_S / step_s)
    out = np.array(batch.march(inputs, steps, step_s, every, every))
    table = out.reshape(-1, batch.width + batch.sources)
    names = program.state_names
    return {node: table[:, names.index(node)] for node in NODES}


def _batch(program: Program) -> Batch:
    return Batch([program], AMBIENT_K, kernel=load_kernel("compiled"))


def _apart(
    one: Mapping[str, Series], two: Mapping[str, Series]
) -> dict[str, float]:
    return {
        name: float(np.abs(series - two[name]).max())
        for name, series in one.items()
    }


def error_table(
    title: str, what: str, errors: Mapping[str, Mapping[str, float]]
) -> Table:
    """Return errors by resolution, with the order from row to row."""
    nodes = list(next(iter(errors.values())))
    rows = [
        (name, *(three_digits(found[node]) for node in nodes), "")
        for name, found in errors.items()
    ]
    for number, (one, two) in enumerate(pairwise(errors.values()), start=1):
        orders = [
            f"{log2(one[node] / two[node]):.1f}"
            for node in nodes
            if min(one[node], two[node]) > 0.0
        ]
        rows[number] = (*rows[number][:-1], " ".join(orders))
    return Table(title, (what, *nodes, "order"), tuple(rows))


def _reality(outcome: Outcome, *, full: bool) -> None:
    usual = DEFAULT_RESOLUTION
    bands, residuals = [], []
    for name in DRIVES if full else DRIVES[:1]:
        drive = load_drive(name)

        def nodes(resolution: Resolution) -> dict[str, Series]:
            return nodes_of(simulate(drive, resolution=resolution))  # noqa: B023

        exact = nodes(Resolution(Mesh(), 0.05, 0.1))
        errors = {
            f"{step:g} / {soak:g} s": _apart(
                nodes(Resolution(Mesh(), step, soak)), exact
            )
            for step, soak in ((1.0, 2.0), (0.5, 1.0), (0.25, 0.5))
        }
        outcome.tables.append(
            error_table(
                "Reality, step driving / parked against 0.05 / 0.1 s (usual "
                f"{usual.step_s:g} / {usual.soak_step_s:g} s): {name}",
                "step",
                errors,
            )
        )
        twice = with_half_cells(Mesh())
        finest = nodes(Resolution(with_half_cells(twice)))
        meshes = {"usual cells": Mesh(), "half the cells' size": twice}
        driven = {
            label: simulate(drive, resolution=Resolution(mesh))
            for label, mesh in meshes.items()
        }
        outcome.tables.append(
            error_table(
                f"Reality, cells against a quarter of their size: {name}",
                "cells",
                {
                    label: _apart(nodes_of(found), finest)
                    for label, found in driven.items()
                },
            )
        )
        plain = driven["usual cells"]
        bands.append(band_row(plain))
        residuals.append((name, f"{np.abs(plain.balance_residual).max():.1e}"))
    outcome.tables += [
        Table(
            "Reality, energy",
            ("drive", "residual / energy, worst corner"),
            tuple(residuals),
        ),
        Table(
            "Reality, front left brake of the nominal car, preset plain; "
            "bands of simalp in the last row",
            (
                *("drive", "disc at the stop, degC", "pad back, degC"),
                *("fluid peak, degC", "min after the stop"),
            ),
            (
                *bands,
                ("band", "450 to 700", "150 to 300", "110 to 180", "8 to 20"),
            ),
        ),
    ]


def nodes_of(driven: SimulatedDrive) -> dict[str, Series]:
    """Return the true :data:`NODES` [K] of the front left brake."""
    return {node: driven.truth[f"FL.{node}"] for node in NODES}


def stop_s(driven: SimulatedDrive) -> float:
    """Return when the car stands for good."""
    moving = np.flatnonzero(driven.course.speed_ms > 0)
    return float(moving[-1] + 1) * SAMPLE_S


def band_row(driven: SimulatedDrive) -> tuple[str, ...]:
    """Return what the bands of the reality are about, as text."""
    at = int(stop_s(driven))
    truth = nodes_of(driven)
    fluid = truth["fluid"]
    return (
        driven.drive.drive.name,
        f"{truth['disc'][at] - KELVIN_OFFSET:.0f}",
        f"{truth['pad_back'][at] - KELVIN_OFFSET:.0f}",
        f"{fluid.max() - KELVIN_OFFSET:.1f}",
        f"{(driven.slow_time_s[fluid.argmax()] - stop_s(driven)) / 60:.1f}",
    )

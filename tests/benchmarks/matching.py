"""The joint refinement against SciPy on a model that runs row by row.

Twelve values over four hours of drives, both front corners. What SciPy would
take is counted and scaled: its number of model runs, taken with the same
residuals, times one run of the pure-Python step, taken on ten minutes.
"""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Final

import numpy as np
from population import MATCHED_ON, Setting, driven, front
from scipy.optimize import least_squares
from side_by_side import Goal, Outcome, Table

from bstm_daemon.analysis.matching.drives import GRID_S, flat
from bstm_daemon.analysis.matching.march import initial_temperatures
from bstm_daemon.analysis.matching.problem import Problem, whole_drives
from bstm_daemon.analysis.matching.refine import refine
from bstm_daemon.analysis.matching.tunables import REFINED
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.model.thermal.kernel import Batch

if TYPE_CHECKING:
    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.refine import Refinement
    from bstm_daemon.analysis.matching.tunables import Target

DRIVES: Final = (*MATCHED_ON, "cooldown")
LIMIT_S: Final = 20.0
SLICE_S: Final = 600.0


def run(*, full: bool) -> Outcome:
    """Time the refinement; quick: one drive of an hour and a half."""
    setting = Setting("thesis", "plain", "known")
    names = DRIVES if full else DRIVES[:1]
    drives = [driven(0, name, setting).drive for name in names]
    hours = sum(drive.duration_s for drive in drives) / 3600.0
    target = front(setting.config())
    wall, cpu, fit = _refined(target, drives)
    runs, cost_ratio = _scipy(target, drives, fit)
    row_s = _row_by_row(target, drives[0]) * sum(map(len, drives)) * 2.0
    return Outcome(
        "Joint refinement",
        f"{len(REFINED)} values, {hours:.1f} h of drives, corners FL and FR, "
        "three rounds with the noise learned between them. SciPy: "
        "least_squares (trf, two-point) with the last round's noise, its "
        "runs counted on the compiled model and timed on the pure-Python "
        "one, row by row at the same steps.",
        [
            Goal(
                "SciPy row by row over this, CPU",
                runs * row_s / cpu,
                50.0 if full else 20.0,
                0.5,
            ),
            # of wall time the load of the machine decides
            Goal(
                f"{LIMIT_S:g} s over CPU time, per 4 h",
                LIMIT_S / (cpu * 4.0 / max(hours, 1.0)),
                1.0,
                0.5,
            ),
        ],
        [
            Table(
                "Time, s",
                ("", "wall", "CPU", "model runs"),
                (
                    (
                        "this",
                        f"{wall:.1f}",
                        f"{cpu:.1f}",
                        str(fit.evaluations),
                    ),
                    (
                        "SciPy on the Python model, scaled",
                        "-",
                        f"{runs * row_s:.0f}",
                        str(runs),
                    ),
                ),
            ),
            Table(
                "Cost at the end",
                ("SciPy over this",),
                ((f"{cost_ratio:.4f}",),),
            ),
        ],
    )


def _refined(
    target: Target, drives: list[Drive]
) -> tuple[float, float, Refinement]:
    wall, cpu = time.perf_counter(), os.times()
    fit = refine(target, drives, REFINED)
    spent = os.times()
    return (
        time.perf_counter() - wall,
        spent.user + spent.system - cpu.user - cpu.system,
        fit,
    )


def _scipy(
    target: Target, drives: list[Drive], fit: Refinement
) -> tuple[int, float]:
    """Return the model runs of SciPy and its cost over that of *fit*."""
    runs, terms = whole_drives(target, drives)
    problem = Problem(target, drives, REFINED, runs, terms, fit.noise)
    count = 0

    def residuals(x: np.ndarray) -> np.ndarray:
        nonlocal count
        count += 1
        return problem(x[None])[0]

    inside = np.clip(problem.start, problem.lower + 1e-6, problem.upper - 1e-6)
    found = least_squares(
        residuals,
        inside,
        bounds=(problem.lower, problem.upper),
        diff_step=1e-3,
        ftol=1e-3,
        xtol=1e-2,
    )
    own = residuals(np.log([fit.values[key] for key in REFINED]))
    return count - 1, float(found.cost / (0.5 * own @ own))


def _row_by_row(target: Target, drive: Drive) -> float:
    """Return the CPU seconds of a step of the pure-Python model."""
    program = compile_corner(target.config, target.corner)
    initial = initial_temperatures(program, drive, "FL")
    steps = round(SLICE_S / GRID_S)
    batch = Batch([program], 0.0, [0], None, 1)
    for i, temperature_k in enumerate(initial.values()):
        batch.state[i] = temperature_k
    rows = flat(drive.inputs[:steps, drive.corners.index("FL")])
    before = time.process_time()
    batch.march(rows, steps, GRID_S)
    return (time.process_time() - before) / steps

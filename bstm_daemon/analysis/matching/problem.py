"""Model less measurement over all drives and corners, whitened."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.march import (
    FREE,
    Forced,
    initial_temperatures,
    march,
)
from bstm_daemon.analysis.matching.tunables import TUNABLES, Target
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.estimator.corner_model import compile_corner

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.analysis.statistics.series import Column, Indices, Mask
    from bstm_daemon.model.thermal.program import Program

POINT_S: Final = 5.0
"""Least time between two points that count; thermocouples cohere longer."""

MOST_POINTS: Final = 400
"""Of one thermocouple over one drive."""

FIRST: Final[dict[str, SensorNoise]] = {
    "disc": SensorNoise(2.0, 8.0, 0.0, 2.0, quick_s=3.0),
    "pad_front": SensorNoise(2.0, 8.0, 0.0, 3.0, quick_s=3.0),
    "pad_back": SensorNoise(1.0, 3.0, 0.0, 1.5, quick_s=3.0),
    "fluid": SensorNoise(1.0, 1.5, 0.0, 0.7, quick_s=3.0),
}
"""Before residuals are known, by node; the spread of two thermocouples in one
disc reaches 20 K (thesis section 3.2)."""

OTHER: Final = SensorNoise(1.0, 5.0, 0.0, 3.0, quick_s=3.0)
"""Of any other node."""

NODE_OF: Final = {"disc_2": "disc"}
"""Thermocouple to node, where the names differ."""


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """One thermocouple over one drive, (n,) each.

    ``steps`` are the indices of the drive's steps that count.
    """

    drive: int
    corner: str
    couple: str
    steps: Indices
    time_s: Column
    measured_k: Column
    slope_k_s: Column

    @property
    def node(self) -> str:
        """The node that it measures."""
        return NODE_OF.get(self.couple, self.couple)


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One march: a drive of one corner, nodes forced, where it starts."""

    drive: int
    corner: str
    initial_k: Mapping[str, float]
    forced: Forced = FREE


class Problem:
    """Residuals of *keys* of a target over drives, for the minimiser.

    The last residuals are those of the priors.
    """

    def __init__(
        self,
        target: Target,
        drives: Sequence[Drive],
        keys: Sequence[str],
        runs: Sequence[Run],
        terms: Sequence[Term],
        noise: Mapping[str, SensorNoise],
    ) -> None:
        """Take what to march and to compare.

        Args:
            target: the corners and their configuration.
            drives: the drives.
            keys: the tunables.
            runs: one for each drive and corner of *terms*.
            terms: what counts.
            noise: by node; else :data:`FIRST`.
        """
        self.target = target
        self.drives = drives
        self.keys = tuple(keys)
        self.runs = tuple(runs)
        self.terms = tuple(terms)
        tunables = [TUNABLES[key] for key in keys]
        self.start = np.log([target.value(one) for one in tunables])
        bounds = np.array([one.bounds() for one in tunables]).reshape(-1, 2)
        self.lower, self.upper = bounds[:, 0], bounds[:, 1]
        self.prior = np.array([one.prior for one in tunables])
        self.set_noise(noise)

    def set_noise(self, noise: Mapping[str, SensorNoise]) -> None:
        """Whiten with *noise* from now on."""
        self.noise = {
            term.node: noise.get(term.node) or FIRST.get(term.node, OTHER)
            for term in self.terms
        }
        self._whiteners = [
            self.noise[term.node].whitener(term.time_s, term.slope_k_s)
            for term in self.terms
        ]

    def values(self, x: Column) -> dict[str, float]:
        """Return the parameters at *x* by key."""
        return dict(zip(self.keys, np.exp(x).tolist(), strict=True))

    def __call__(self, points: Column) -> Column:
        """Return the residuals at *points* (k, p), (k, n)."""
        kelvin = self.residuals_k(points)
        white = [
            # not by BLAS: for so little its threads cost more than they do
            np.einsum("ij,jk->ki", whitener, apart)
            for whitener, apart in zip(self._whiteners, kelvin, strict=True)
        ]
        white.append((points - self.start) / self.prior)
        return np.concatenate(white, axis=1)

    def residuals_k(self, points: Column) -> list[Column]:
        """Return model less measurement [K] by term, (n, k) each."""
        programs = self.programs(points)
        found = {}
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            marches = [
                pool.submit(self._march, r, programs) for r in self.runs
            ]
            for run, result in zip(self.runs, marches, strict=True):
                found[run.drive, run.corner] = result.result()
        return [
            found[term.drive, term.corner][term.node][term.steps]
            - term.measured_k[:, None]
            for term in self.terms
        ]

    def programs(self, points: Column) -> list[Program]:
        """Return the compiled model at *points* (k, p)."""
        return [
            compile_corner(changed.config, changed.corner)
            for changed in (
                self.target.changed(self.values(point)) for point in points
            )
        ]

    def _march(
        self, run: Run, programs: Sequence[Program]
    ) -> dict[str, Column]:
        return march(
            programs,
            self.drives[run.drive],
            run.corner,
            run.initial_k,
            run.forced,
        )


def whole_drives(
    target: Target, drives: Sequence[Drive]
) -> tuple[list[Run], list[Term]]:
    """Return every drive of the target's corners, nothing forced."""
    program = compile_corner(target.config, target.corner)
    nodes = {node.name for node in program.network.nodes}
    runs, terms = [], []
    for index, drive in enumerate(drives):
        for corner in target.corners:
            own = [
                term
                for couple in drive.measured.get(corner, {})
                if NODE_OF.get(couple, couple) in nodes
                and (term := term_of(drives, index, corner, couple))
            ]
            if own:
                initial = initial_temperatures(program, drive, corner)
                runs.append(Run(index, corner, initial))
                terms += own
    return runs, terms


def term_of(
    drives: Sequence[Drive],
    index: int,
    corner: str,
    couple: str,
    within: Mask | None = None,
) -> Term | None:
    """Return what counts of a thermocouple, None where nothing does.

    *within* (steps,) masks the drive's steps.
    """
    drive = drives[index]
    every = ceil(max(POINT_S, drive.duration_s / MOST_POINTS) / GRID_S)
    steps = np.arange(every - 1, len(drive), every)
    if within is not None:
        steps = steps[within[steps]]
    time_s = drive.time_s[steps]
    thermocouple = drive.measured[corner][couple]
    measured = thermocouple.at(time_s)
    known = np.isfinite(measured)
    if np.count_nonzero(known) < 3:
        return None
    slope = np.gradient(measured[known], time_s[known])
    return Term(
        index,
        corner,
        couple,
        steps[known],
        time_s[known],
        measured[known],
        slope,
    )

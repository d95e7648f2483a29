"""Model less measurement over all drives and corners, whitened."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.march import initial_temperatures, march
from bstm_daemon.analysis.matching.tunables import SIDES, TUNABLES
from bstm_daemon.analysis.statistics.student import as_normal
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.estimator.corner_model import compile_corner

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.analysis.matching.tunables import Target
    from bstm_daemon.analysis.statistics.series import Column, Indices, Mask

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


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One node over one drive, (n,) each; ``couples`` are (corner, name).

    ``steps`` are the indices of the drive's steps that count, ``rise_k`` is
    above the air.
    """

    drive: int
    node: str
    couples: tuple[tuple[str, str], ...]
    steps: Indices
    time_s: Column
    measured_k: Column
    slope_k_s: Column
    rise_k: Column

    @property
    def corner(self) -> str:
        """The corner of the first thermocouple."""
        return self.couples[0][0]


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """One march: a drive of one corner, nodes forced, where it starts."""

    drive: int
    corner: str
    initial_k: Mapping[str, float]
    forced: Mapping[str, Column] | None = None


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
        terms: Sequence[Series],
        noise: Mapping[str, SensorNoise] | None,
    ) -> None:
        """Take what to march and to compare.

        Args:
            target: the corners and their configuration.
            drives: the drives.
            keys: the tunables.
            runs: one for each drive and corner of *terms*.
            terms: what counts.
            noise: by node; else :data:`FIRST`. None whitens nothing.
        """
        self.target = target
        self.drives = drives
        self.keys = tuple(keys)
        self.runs = tuple(runs)
        self.terms = tuple(terms)
        self._tunables = [target.tunable(key) for key in keys]
        self.start = np.log([target.value(one) for one in self._tunables])
        bounds = [one.bounds() for one in self._tunables]
        self.lower, self.upper = np.array(bounds).reshape(-1, 2).T
        self.prior = np.array([one.prior for one in self._tunables])
        if noise is not None:
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

    def rewhitened(
        self, white: Column, noise: Mapping[str, SensorNoise]
    ) -> Column:
        """Return *white* (n, k), the residuals or their derivatives, anew.

        With *noise* from now on; without the residuals of the priors.
        """
        before = self._whiteners
        self.set_noise(noise)
        parts = np.split(white, np.cumsum([len(one) for one in before])[:-1])
        return np.concatenate(
            [
                after @ np.linalg.solve(old, part)
                for after, old, part in zip(
                    self._whiteners, before, parts, strict=True
                )
            ]
        )

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
        return np.concatenate([*white, self.of_priors(points)], axis=1)

    def of_priors(self, points: Column) -> Column:
        """Return the residuals of the priors at *points* (k, p), (k, p)."""
        deviations = ((points - self.start) / self.prior).T
        return np.transpose(
            [
                as_normal(of, one.freedom)
                for one, of in zip(self._tunables, deviations, strict=True)
            ]
        )

    def residuals_k(self, points: Column) -> list[Column]:
        """Return model less measurement [K] by term, (n, k) each."""
        targets = [self.target.changed(self.values(one)) for one in points]
        # sides that are alike have one program
        names = list(dict.fromkeys(run.corner for run in self.runs))
        own = names if SIDES.keys() & set(self.keys) else names[:1]
        programs = {
            name: [
                compile_corner(one.config, one.of(name).corner)
                for one in targets
            ]
            for name in own
        }
        found = {}
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for run in self.runs:
                found[run.drive, run.corner] = pool.submit(
                    march,
                    programs.get(run.corner, programs[names[0]]),
                    self.drives[run.drive],
                    run.corner,
                    run.initial_k,
                    run.forced,
                    power_w(self.drives[run.drive], run.corner, targets),
                )
        return [
            found[term.drive, term.corner].result()[term.node][term.steps]
            - term.measured_k[:, None]
            for term in self.terms
        ]


def power_w(
    drive: Drive, corner: str, targets: Sequence[Target]
) -> Column | None:
    """Return the brake power of *corner* for each of *targets*, (steps, k).

    None: that of the drive's inputs, whatever the target.
    """
    by = drive.power_by.get(corner)
    if by is None:
        return None
    return by.at([one.value(TUNABLES[by.key]) for one in targets])


def whole_drives(
    target: Target,
    drives: Sequence[Drive],
    *,
    point_s: float = POINT_S,
    most_points: int = MOST_POINTS,
) -> tuple[list[Run], list[Series]]:
    """Return every drive of the target's corners, nothing forced."""
    program = compile_corner(target.config, target.corner)
    nodes = {node.name for node in program.network.nodes}
    runs, terms = [], []
    for index, drive in enumerate(drives):
        for corner in target.corners:
            own = [
                one
                for couple, node in drive.couples(corner, nodes)
                if (
                    one := series_of(
                        *(drive, index, node, ((corner, couple),)),
                        point_s=point_s,
                        most_points=most_points,
                    )
                )
            ]
            if own:
                initial = initial_temperatures(program, drive, corner)
                runs.append(Run(index, corner, initial))
                terms += own
    return runs, terms


def series_of(  # noqa: PLR0913
    drive: Drive,
    index: int,
    node: str,
    couples: Sequence[tuple[str, str]],
    *,
    within: Mask | None = None,
    point_s: float = POINT_S,
    most_points: int = MOST_POINTS,
) -> Series | None:
    """Return what counts of a node, None where nothing does.

    Args:
        drive: the drive, the one of number *index*.
        index: its number.
        node: of the model.
        couples: corner and name of its thermocouples; their mean counts.
        within: masks the drive's steps, (steps,).
        point_s: least time between two points.
        most_points: at most so many.
    """
    every = ceil(max(point_s, drive.duration_s / most_points) / GRID_S)
    steps = np.arange(every - 1, len(drive), every)
    if within is not None:
        steps = steps[within[steps]]
    time_s = drive.time_s[steps]
    read = np.array(
        [drive.measured[corner][name].at(time_s) for corner, name in couples]
    )
    known = np.isfinite(read).all(axis=0)
    if np.count_nonzero(known) < 3:
        return None
    measured = read[:, known].mean(axis=0)
    air = drive.channel(couples[0][0], "ambient_k")[steps[known]]
    return Series(
        index,
        node,
        tuple(couples),
        steps[known],
        time_s[known],
        measured,
        np.gradient(measured, time_s[known]),
        measured - air,
    )

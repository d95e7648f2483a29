"""The simplest rival of the model: a disc of one node, or a disc and its hat.

    dT/dt     = k H - (a + b v) (T - T_air) - g (T - T_hat)
    dT_hat/dt = h (T - T_hat)

with g = h = 0 for one node. H is pressure times speed or, without a pressure,
the loss of kinetic energy max(-(dv/dt + c v^2) v, 0) where the car decelerates
by more than 2 m/s2. The constants are fitted by least squares to the measured
disc, computed from its first reading alone. Nothing of the configuration is
used: a model that errs more explains nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.statistics.levenberg_marquardt import minimise
from bstm_daemon.analysis.statistics.series import Column, rms

MARGIN_K: Final = 1.0
"""A model loses from so much on: less is the noise of a thermocouple."""

BRAKING_MS2: Final = 2.0
K_STARTS: Final = {
    "pressure": (3e-8, 1e-7, 3e-7, 1e-6),
    "motion": (0.03, 0.1, 0.3, 1.0),
}
RATES: Final = (1e-3, 3e-3, 1e-2)
STARTS: Final = {"a": RATES, "b": (1e-4, 3e-4, 1e-3), "c": (3e-4, 1e-3, 3e-3)}
"""The fit begins at the best of all combinations; g and h begin as a does."""

RANGE: Final = (1e-10, 10.0)
"""Of every constant: no more than a guard of the arithmetic."""

CONVERGED: Final = 1e-6
ITERATIONS: Final = 30
DAMPINGS: Final = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 30.0)
"""k, b and c trade against each other along a narrow valley."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """A disc fitted to the drives named ``drives``.

    ``values`` has its constants by name: k in K/(Pa m) where ``heat`` is
    "pressure" and in K s2/m2 where it is "motion", a, g, h in 1/s, b, c in
    1/m. ``rms_k`` is the error on the drives it was fitted to.
    """

    corner: str
    heat: str
    values: Mapping[str, float]
    drives: tuple[str, ...]
    rms_k: float

    @property
    def title(self) -> str:
        """The form in words."""
        return "disc and hat" if "g" in self.values else "disc of one node"

    def rms_on(self, drives: Sequence[Drive]) -> float:
        """Return the error on *drives* [K], nan where nothing is measured."""
        sets = {name: np.array([x]) for name, x in self.values.items()}
        runs = _runs(drives, self.corner, self.heat)
        errors = [run.errors_k(sets) for run in runs]
        return rms(np.concatenate(errors)) if errors else np.nan


def bearable_k(baseline_k: float) -> float:
    """Return the largest error that does not lose to *baseline_k* [K]."""
    return baseline_k + MARGIN_K


def baselines(drives: Sequence[Drive]) -> dict[str, list[Baseline]]:
    """Fit every corner's disc to *drives*: of one node, then disc and hat.

    A corner without a thermocouple at its disc is not in the result.
    """
    found = {}
    for corner in dict.fromkeys(name for d in drives for name in d.corners):
        pressed = [d.channel(corner, "pressure_pa").any() for d in drives]
        heat = "pressure" if all(pressed) else "motion"
        runs = _runs(drives, corner, heat)
        if runs:
            one = _fitted(runs)
            found[corner] = [one, _fitted(runs, one)]
    return found


def _runs(drives: Sequence[Drive], corner: str, heat: str) -> list[_Run]:
    """Return those of *drives* with more than one reading of the disc."""
    found = []
    for drive in drives:
        for name in list(drive.couples(corner, ("disc",)))[:1]:
            reading_k = drive.measured[corner][name[0]].at(drive.time_s)
            if np.isfinite(reading_k).sum() > 1:
                found.append(_Run(drive, corner, heat, reading_k))
    return found


class _Run:
    """One drive of a corner, computed with many sets of constants at once."""

    def __init__(
        self, drive: Drive, corner: str, heat: str, reading_k: Column
    ) -> None:
        """Take what *heat* is formed from, and the readings, (steps,)."""
        self.name, self.corner, self.form = drive.name, corner, heat
        first = int(np.isfinite(reading_k).argmax())
        after = slice(first + 1, None)
        self.start_k = float(reading_k[first])
        self.known = np.isfinite(reading_k[after])
        self.reading_k = reading_k[after, None][self.known]
        mean_ms = drive.channel(corner, "speed_ms")
        self.speed_ms = mean_ms[after, None]
        self.air_k = drive.channel(corner, "ambient_k")[after, None]
        self.pressure_pa = drive.channel(corner, "pressure_pa")[after, None]
        # means over half a second blur where braking begins and ends
        fine = len(drive.speed_ms) == len(drive)
        speed_ms = drive.speed_ms if fine else mean_ms[:, None]
        rate = np.gradient(speed_ms.ravel(), GRID_S / speed_ms.shape[1])
        rate = rate.reshape(speed_ms.shape)[after]
        self.braked = np.flatnonzero((rate < -BRAKING_MS2).any(axis=1))
        self.braked_ms = speed_ms[after][self.braked, :, None]
        self.braked_rate = rate[self.braked, :, None]

    def heat(self, sets: Mapping[str, Column]) -> Column:
        """Return k H [K/s], (steps, sets)."""
        if self.form == "pressure":
            return sets["k"] * (self.pressure_pa * self.speed_ms)
        v, rate = self.braked_ms, self.braked_rate
        lost = np.maximum(-(rate + sets["c"] * v**2) * v, 0.0)
        lost *= rate < -BRAKING_MS2
        heat = np.zeros((len(self.speed_ms), len(sets["k"])))
        heat[self.braked] = sets["k"] * lost.mean(axis=1)
        return heat

    def errors_k(self, sets: Mapping[str, Column]) -> Column:
        """Return computed minus measured at the readings, (n, sets).

        A step is the exact exponential for its mean inputs, an affine map of
        disc and hat. The maps of a block are joined first, of all blocks at
        once: as exact as step after step, and much faster.
        """
        rate = sets["a"] + sets["b"] * self.speed_ms
        goal = self.air_k + self.heat(sets) / rate
        g, h = (sets.get(name, np.zeros_like(sets["k"])) for name in "gh")
        half, apart = 0.5 * (rate + g + h), 0.5 * (rate + g - h)
        root = np.sqrt(apart**2 + g * h)
        slow = np.exp(-(half - root) * GRID_S)
        fast = np.exp(-(half + root) * GRID_S)
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / root
        own = odd * apart
        matrix = np.array([[even - own, odd * g], [odd * h, even + own]])
        offset = goal * (1.0 - matrix.sum(axis=1))
        steps, count = goal.shape
        width = max(int(np.sqrt(steps)), 1)
        blocks = -(-steps // width)
        at = np.minimum(np.arange(blocks * width), steps - 1)
        matrix = matrix[..., at, :].reshape(2, 2, blocks, width, count)
        offset = offset[..., at, :].reshape(2, blocks, width, count)
        for i in range(1, width):
            last, before = matrix[..., i, :], matrix[..., i - 1, :]
            offset[..., i, :] += (last * offset[..., i - 1, :]).sum(axis=1)
            matrix[..., i, :] = (last[:, :, None] * before).sum(axis=1)
        disc = np.empty((blocks, width, count))
        state = np.full((2, 1, count), self.start_k)
        for i in range(blocks):
            found = (matrix[:, :, i] * state).sum(axis=1) + offset[:, i]
            disc[i], state = found[0], found[:, -1:]
        return disc.reshape(-1, count)[:steps][self.known] - self.reading_k


def _fitted(runs: Sequence[_Run], one: Baseline | None = None) -> Baseline:
    """Fit one node or, beginning at *one*, disc and hat."""
    heat = runs[0].form
    names = "kab" if heat == "pressure" else "kabc"
    starts = [K_STARTS[heat], *(STARTS[name] for name in names[1:])]
    if one is not None:
        starts = [(value,) for value in one.values.values()]
        names, starts = names + "gh", [*starts, RATES, RATES]

    def residuals(points: Column) -> Column:
        sets = dict(zip(names, np.exp(points.T), strict=True))
        return np.concatenate([run.errors_k(sets) for run in runs]).T

    points = np.log(list(product(*starts)))
    costs = (residuals(points) ** 2).sum(axis=1)
    lower, upper = np.log(np.full((len(names), 2), RANGE)).T
    solution = minimise(
        *(residuals, points[np.argmin(costs)], lower, upper),
        converged=CONVERGED,
        iterations=ITERATIONS,
        dampings=DAMPINGS,
    )
    return Baseline(
        *(runs[0].corner, heat),
        dict(zip(names, np.exp(solution.x).tolist(), strict=True)),
        tuple(run.name for run in runs),
        rms(solution.residuals),
    )

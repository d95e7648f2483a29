"""The simplest rival of the model: a disc of one node, or a disc and its hat.

    dT/dt     = k H - (a + b v) (T - T_air) - g (T - T_hat)
    dT_hat/dt = h (T - T_hat)

with g = 0 for one node. H is pressure times speed, or the loss of kinetic
energy, max(-(dv/dt + c v^2) v, 0), while the car decelerates. The constants
are fitted by least squares to the measured disc, computed from its first
reading alone. Nothing of the configuration is used: neither mass nor friction
nor brake power. A model that errs more than this explains nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.matching.drives import GRID_S
from bstm_daemon.analysis.statistics.levenberg_marquardt import minimise
from bstm_daemon.analysis.statistics.series import rms

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.statistics.series import Column, Mask

    Where = Callable[[Drive], Mask]

BRAKING_MS2: Final = 2.0
"""By motion, the brake is on where the car decelerates by more."""

UNITS: Final = {"a": "1/s", "b": "1/m", "c": "1/m", "g": "1/s", "h": "1/s"}
HEAT_UNITS: Final = {"pressure": "K/(Pa m)", "motion": "K s2/m2"}
"""Unit of k by what the heat is formed from."""

BOUNDS: Final = {
    "a": (1e-6, 1.0),
    "b": (1e-8, 0.1),
    "c": (1e-6, 0.02),
    "g": (1e-5, 1.0),
    "h": (1e-5, 1.0),
}
FIRST_K: Final = {"pressure": 1e-7, "motion": 0.1}

STARTS: Final = {
    "a": (1e-3, 3e-3, 1e-2),
    "b": (1e-4, 3e-4, 1e-3),
    "c": (3e-4, 1e-3, 3e-3),
}
HAT_STARTS: Final = {"g": (1e-3, 3e-3, 1e-2), "h": (1e-3, 3e-3, 1e-2)}
"""The fit begins at the best combination of these."""

K_REACH: Final = 4.6
"""k has no bounds of its own; its logarithm may move so far from the best at
the start."""

CONVERGED: Final = 1e-6
ITERATIONS: Final = 30
DAMPINGS: Final = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 30.0)
"""k, the drag c and the cooling b trade against each other along a narrow
valley: it takes finer steps of the damping than a thermal model."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """A disc fitted to the drives named ``drives``.

    ``heat`` is "pressure" or "motion", ``values`` has the constants by name,
    ``rms_k`` is the error on the drives it was fitted to.
    """

    corner: str
    heat: str
    values: Mapping[str, float]
    drives: tuple[str, ...]
    rms_k: float

    @property
    def title(self) -> str:
        """The form in words."""
        nodes = "disc and hat" if "g" in self.values else "disc of one node"
        return f"{nodes}, heat from {self.heat}"

    @property
    def constants(self) -> str:
        """The constants with their units."""
        units = {"k": HEAT_UNITS[self.heat], **UNITS}
        return ", ".join(
            f"{name} {value:.3g} {units[name]}"
            for name, value in self.values.items()
        )

    def disc_k(self, drive: Drive) -> Column:
        """Return the disc of *drive*, (steps,), nan before its first reading.

        Raises:
            ValueError: the corner's disc has no reading.
        """
        run = _Run(drive, self.corner, self.heat)
        sets = {name: np.array([x]) for name, x in self.values.items()}
        found = np.full(len(drive), np.nan)
        found[run.first :] = run.march(sets)[:, 0]
        return found

    def rms_on(
        self, drives: Sequence[Drive], where: Where | None = None
    ) -> float:
        """Return the error on *drives* [K], nan where nothing is measured.

        Args:
            drives: need not be those it was fitted to.
            where: the steps that count, (steps,); else all.
        """
        errors = []
        for drive in with_disc(drives, self.corner):
            error = self.disc_k(drive) - measured_disc_k(drive, self.corner)
            errors.append(error if where is None else error[where(drive)])
        error = np.concatenate(errors or [np.zeros(0)])
        error = error[np.isfinite(error)]
        return rms(error) if len(error) else np.nan


def baselines(
    drives: Sequence[Drive], where: Where | None = None
) -> dict[str, tuple[Baseline, Baseline]]:
    """Fit every corner's disc to *drives*: of one node, then disc and hat.

    Where a pressure is known the heat is formed from it or from the motion,
    whichever leaves the smaller error.

    Args:
        drives: of one car.
        where: the steps whose readings count, (steps,); else all. A drive is
            computed from its first reading in any case.

    Returns:
        By corner. A corner without a thermocouple at its disc is not in it.
    """
    found = {}
    for corner in dict.fromkeys(
        name for one in drives for name in one.corners
    ):
        own = with_disc(drives, corner)
        if own:
            pressed = any(
                one.channel(corner, "pressure_pa").any() for one in own
            )
            fits = [
                _fitted([_Run(one, corner, heat, where) for one in own])
                for heat in ("motion", *["pressure"][:pressed])
            ]
            one = min(fits, key=lambda fit: fit.rms_k)
            runs = [_Run(each, corner, one.heat, where) for each in own]
            found[corner] = (one, _fitted(runs, one))
    return found


def with_disc(drives: Sequence[Drive], corner: str) -> list[Drive]:
    """Return those of *drives* with a reading of the disc of *corner*."""
    return [
        drive
        for drive in drives
        if np.isfinite(measured_disc_k(drive, corner)).any()
    ]


def measured_disc_k(drive: Drive, corner: str) -> Column:
    """Return the measured disc, (steps,), nan where it is not measured."""
    couples = drive.measured.get(corner, {})
    couple = couples.get("disc", couples.get("disc_2"))
    if couple is None:
        return np.full(len(drive), np.nan)
    time_s = drive.time_s
    found = couple.at(time_s)
    found[time_s < couple.time_s[0]] = np.nan
    return found


class _Run:
    """One drive of a corner, to be computed with many sets of constants."""

    def __init__(
        self,
        drive: Drive,
        corner: str,
        heat: str,
        where: Where | None = None,
    ) -> None:
        """Take what *heat* is formed from, and the readings."""
        self.name, self.corner, self.form = drive.name, corner, heat
        reading = measured_disc_k(drive, corner)
        known = np.flatnonzero(np.isfinite(reading))
        if not len(known):
            msg = f"{drive.name}: no reading of the disc of {corner}"
            raise ValueError(msg)
        self.first = int(known[0])
        after = slice(self.first + 1, None)
        self.start_k = float(reading[self.first])
        counts = np.isfinite(reading)
        if where is not None:
            counts &= where(drive)
        self.counts = counts[after]
        self.reading_k = reading[after, None][self.counts]
        mean_ms = drive.channel(corner, "speed_ms")
        self.speed_ms = mean_ms[after, None]
        self.air_k = drive.channel(corner, "ambient_k")[after, None]
        self.pressure_pa = drive.channel(corner, "pressure_pa")[after, None]
        # a mean over half a second blurs where braking begins and ends
        speed = drive.speed_ms if len(drive.speed_ms) else mean_ms[:, None]
        step_s = GRID_S / speed.shape[1]
        flat = np.append(speed.ravel(), speed[-1, -1])
        rate = np.gradient(flat, step_s)[:-1].reshape(speed.shape)
        rate, speed = rate[after], speed[after]
        self.braked = np.flatnonzero((rate < -BRAKING_MS2).any(axis=1))
        self.braked_rate = rate[self.braked, :, None]
        self.braked_ms = speed[self.braked, :, None]

    def heat(self, sets: Mapping[str, Column]) -> Column:
        """Return k H [K/s], (steps, sets)."""
        if self.form == "pressure":
            return sets["k"] * (self.pressure_pa * self.speed_ms)
        speed, rate = self.braked_ms, self.braked_rate
        lost = np.maximum(-(rate + sets["c"] * speed**2) * speed, 0.0)
        lost[(rate >= -BRAKING_MS2)[..., 0]] = 0.0
        heat = np.zeros((len(self.speed_ms), len(sets["k"])))
        heat[self.braked] = sets["k"] * lost.mean(axis=1)
        return heat

    def errors(self, sets: Mapping[str, Column]) -> Column:
        """Return computed minus measured at the readings, (n, sets)."""
        return self.march(sets)[1:][self.counts] - self.reading_k

    def march(self, sets: Mapping[str, Column]) -> Column:
        """Return the disc from its first reading on, (1 + steps, sets) [K].

        Exact for inputs that are constant within a step. A step is an affine
        map of disc and hat: those of a block are joined first, of all blocks
        at once, which is as exact and much faster than step after step.
        """
        none = np.zeros_like(sets["k"])
        rate = sets["a"] + sets["b"] * self.speed_ms
        goal = self.air_k + self.heat(sets) / rate
        steps, count = goal.shape
        matrix, offset = _steps(
            *(rate, sets.get("g", none), sets.get("h", none), goal)
        )
        width = max(int(np.sqrt(steps)), 1)
        blocks = -(-steps // width)
        at = np.minimum(np.arange(blocks * width), steps - 1)
        matrix = matrix[..., at, :].reshape(2, 2, blocks, width, count)
        offset = offset[..., at, :].reshape(2, blocks, width, count)
        for i in range(1, width):
            own, before = matrix[..., i, :], matrix[..., i - 1, :]
            offset[..., i, :] += (own * offset[..., i - 1, :]).sum(axis=1)
            matrix[..., i, :] = (own[:, :, None] * before).sum(axis=1)
        disc = np.empty((blocks, width, count))
        state = np.full((2, 1, count), self.start_k)
        for i in range(blocks):
            found = (matrix[:, :, i] * state).sum(axis=1) + offset[:, i]
            disc[i], state = found[0], found[:, -1:]
        start = np.full((1, count), self.start_k)
        return np.concatenate((start, disc.reshape(-1, count)[:steps]))


def _steps(
    rate: Column, g: Column, h: Column, goal: Column
) -> tuple[Column, Column]:
    """Return each step as an affine map of disc and hat.

    Args:
        rate: of the disc's cooling, (n, sets) [1/s].
        g: flow to the hat by the disc's capacity, (sets,) [1/s].
        h: the same by the hat's capacity, (sets,) [1/s].
        goal: where both settle, (n, sets) [K].

    Returns:
        The exponential of the step's matrix, (2, 2, n, sets), and the offset,
        (2, n, sets).
    """
    half = 0.5 * (rate + g + h)
    apart = 0.5 * (rate + g - h)
    root = np.sqrt(apart**2 + g * h)
    slow = np.exp(-(half - root) * GRID_S)
    fast = np.exp(-(half + root) * GRID_S)
    even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / root
    matrix = np.array(
        [[even - odd * apart, odd * g], [odd * h, even + odd * apart]]
    )
    return matrix, goal * (1.0 - matrix.sum(axis=1))


def _fitted(runs: Sequence[_Run], one: Baseline | None = None) -> Baseline:
    """Fit one node or, beginning at *one*, disc and hat."""
    form = runs[0].form
    names = ["k", "a", "b", *(["c"] if form == "motion" else [])]
    starts: dict[str, tuple[float, ...]] = {
        name: STARTS[name] for name in names[1:]
    }
    if one is not None:
        starts = {
            **{name: (one.values[name],) for name in starts},
            **HAT_STARTS,
        }
        names = ["k", *starts]

    def residuals(points: Column) -> Column:
        sets = dict(zip(names, np.exp(points.T), strict=True))
        return np.concatenate([run.errors(sets) for run in runs]).T

    axes = np.meshgrid(*(np.log(values) for values in starts.values()))
    others = np.column_stack([axis.ravel() for axis in axes])
    # the disc is linear in k: two values of it give the best one
    first_k = FIRST_K[form]
    once, twice = (
        residuals(np.insert(others, 0, np.log(n * first_k), axis=1))
        for n in (1, 2)
    )
    slope = twice - once
    square = np.maximum((slope**2).sum(axis=1), 1e-30)
    more = np.clip(-(once * slope).sum(axis=1) / square, -0.999, 1e3)
    left = ((once + more[:, None] * slope) ** 2).sum(axis=1)
    points = np.insert(others, 0, np.log(first_k * (1.0 + more)), axis=1)
    k = points[np.argmin(left), 0]
    bounds = np.log([BOUNDS[name] for name in names[1:]])
    solution = minimise(
        residuals,
        points[np.argmin(left)],
        np.append(k - K_REACH, bounds[:, 0]),
        np.append(k + K_REACH, bounds[:, 1]),
        converged=CONVERGED,
        iterations=ITERATIONS,
        dampings=DAMPINGS,
    )
    return Baseline(
        runs[0].corner,
        form,
        dict(zip(names, np.exp(solution.x).tolist(), strict=True)),
        tuple(run.name for run in runs),
        rms(solution.residuals),
    )

"""Learned parameters of the car: states, covariances and Kalman updates.

The pure-Python form of ``native/heat/learned.c``; both do the same operations
in the same order.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isclose, isfinite, log, sqrt
from typing import TYPE_CHECKING, Annotated, Final

from bstm_daemon.model.heat.observer_rules import (
    CAUTION,
    FORM_LIMIT,
    MAX_STATE,
    MIN_STATE,
    P0_STD,
    PITCH,
    REFERENCE_PRESSURE_PA,
    REFERENCE_SPEED_MS,
    ROLLING_STD,
    Q,
)
from bstm_daemon.native.layout import Length, pack, unpack

if TYPE_CHECKING:
    from collections.abc import Sequence

MOTION: Final = ("mass_ratio", "bias", "drag_ratio", "gain")
"""Configured over actual mass; bias of the accelerometer less g f_r [m/s2];
actual over configured drag, times ``mass_ratio``; measured over actual change
of speed, less 1 (body pitch, scale)."""

FRICTION: Final = ("level", "speed", "pressure", "drift")
"""ln of friction over Feed-Forward's: at 10 m/s and 10 bar; exponents of
speed and of pressure; drift within minutes (temperature, bedding)."""

MASS, BIAS, DRAG, GAIN = range(len(MOTION))
LEVEL, SPEED, PRESSURE, DRIFT = range(len(MOTION), len(MOTION + FRICTION))
FIRST_FRICTION: Final = len(MOTION)
STATES: Final = len(MOTION + FRICTION)

LEARNED_NAMES: Final = (
    *(MOTION + FRICTION),
    *(f"{a}_{b}" for a in MOTION + FRICTION for b in MOTION + FRICTION),
    "rolling",
    "rolling_variance",
)
"""The numbers of :class:`Learned` as the state file names them."""

NO_FRICTION: Final = (0.0,) * len(FRICTION)


@dataclass(slots=True)
class Learned:
    """States x with their covariance, row by row.

    ``rolling_error`` is the error of the configured g f_r [m/s2], which only
    the height of the road shows; ``rolling_var`` its variance.
    """

    x: Annotated[list[float], Length("STATES", STATES)]
    cov: Annotated[list[float], Length("STATES * STATES", STATES * STATES)]
    rolling_error: float
    rolling_var: float

    @classmethod
    def of(cls, numbers: Sequence[float]) -> Learned:
        """Take *numbers*, as :data:`LEARNED_NAMES` has them."""
        return unpack(cls, iter(()), iter(numbers))

    def numbers(self) -> list[float]:
        """Return the numbers, as :data:`LEARNED_NAMES` has them."""
        found: list[float] = []
        pack(self, [], found)
        return found

    def copy(self) -> Learned:
        """Return an independent copy."""
        return Learned(
            self.x[:], self.cov[:], self.rolling_error, self.rolling_var
        )

    def begin(self, rolling: float) -> None:
        """Reset to the prior; *rolling* is the configured g f_r [m/s2]."""
        self.x = [0.0] * STATES
        self.cov = [0.0] * (STATES * STATES)
        self.x[MASS] = self.x[DRAG] = 1.0
        self.x[BIAS] = -rolling
        self.x[GAIN] = PITCH
        for i in range(STATES):
            self.cov[i * STATES + i] = P0_STD[i] * P0_STD[i]
        self.rolling_error = 0.0
        self.rolling_var = ROLLING_STD * ROLLING_STD

    def friction(
        self, speed: float, pressure_pa: float
    ) -> tuple[float, float]:
        """Ln of the friction over Feed-Forward's, and its variance."""
        h = friction_row(speed, pressure_pa)
        prior_var = 0.0
        for i in range(FIRST_FRICTION, STATES):
            prior_var += h[i] * h[i] * (P0_STD[i] * P0_STD[i])
        variance = quadratic(self.cov, h)
        return product(self.x, h), published_variance(variance, prior_var)

    def update(
        self, first: int, h: Sequence[float], innovation: float, noise: float
    ) -> None:
        """Make one Kalman update of the states from *first* on; bounded.

        Those before *first* are considered, not changed (Schmidt).

        Args:
            first: the first state to change.
            h: row of the measurement, per state.
            innovation: measured less predicted.
            noise: variance of the measurement.
        """
        cov = self.cov
        ph = []
        for i in range(STATES):
            row = 0.0
            for j in range(STATES):
                row += cov[i * STATES + j] * h[j]
            ph.append(row)
        innovation_var = noise
        for i in range(STATES):
            innovation_var += h[i] * ph[i]
        gain = []
        for i in range(STATES):
            gain.append(0.0 if i < first else ph[i] / innovation_var)
            x = self.x[i] + gain[i] * innovation
            self.x[i] = clipped(x, MIN_STATE[i], MAX_STATE[i])
        for i in range(STATES):
            for j in range(STATES):
                cov[i * STATES + j] -= (
                    gain[i] * ph[j]
                    + ph[i] * gain[j]
                    - gain[i] * innovation_var * gain[j]
                )

    def add_process_noise(self, first: int, last: int, seconds: float) -> None:
        """Add process noise to the variances, up to those of the prior."""
        for i in range(first, last):
            own = i * STATES + i
            if self.cov[own] < P0_STD[i] * P0_STD[i]:
                self.cov[own] += Q[i] * Q[i] * seconds

    def plausible(self) -> bool:
        """Whether all states are finite and all variances positive."""
        total = 0.0
        for number in self.numbers():
            total += number
        return (
            isfinite(total)
            and all(self.cov[i * STATES + i] > 0.0 for i in range(STATES))
            and self.rolling_var > 0.0
        )


def published_variance(variance: float, prior_var: float) -> float:
    """Return a filter's variance as it is published with the heat.

    *prior_var* is that of the prior: a variance close to it is published
    unchanged, a small one times :data:`~.observer_rules.CAUTION`.
    """
    unlearned = min(variance / prior_var, 1.0)
    return variance * (CAUTION + (1.0 - CAUTION) * unlearned)


def clipped(value: float, low: float, high: float) -> float:
    """Return *value*, not below *low* and not above *high*."""
    if value < low:
        return low
    return min(value, high)


def friction_row(speed: float, pressure_pa: float) -> list[float]:
    """Return the measurement row of ln friction, an entry per state."""
    v = max(speed, 1.0)
    p = max(pressure_pa, 5e4)
    h = [0.0] * STATES
    h[LEVEL] = h[DRIFT] = 1.0
    h[SPEED] = clipped(log(v / REFERENCE_SPEED_MS), -FORM_LIMIT, FORM_LIMIT)
    h[PRESSURE] = clipped(
        log(p / REFERENCE_PRESSURE_PA), -FORM_LIMIT, FORM_LIMIT
    )
    return h


def quadratic(cov: Sequence[float], h: Sequence[float]) -> float:
    """Return h^T cov h."""
    total = 0.0
    for i in range(STATES):
        row = 0.0
        for j in range(STATES):
            row += cov[i * STATES + j] * h[j]
        total += h[i] * row
    return total


def product(x: Sequence[float], h: Sequence[float]) -> float:
    """Return h^T x."""
    total = 0.0
    for i in range(STATES):
        total += h[i] * x[i]
    return total


def learned_fault(learned: Sequence[float]) -> str | None:
    """Return why *learned* is not a possible result, or None.

    *learned* as :data:`LEARNED_NAMES` has it: in bounds, the covariance
    symmetric, positive definite and no larger than the prior.
    """
    if len(learned) != len(LEARNED_NAMES):
        return f"{len(learned)} numbers instead of {len(LEARNED_NAMES)}"
    if not all(map(isfinite, learned)):
        return "not finite"
    known = Learned.of(learned)
    for i, name in enumerate(MOTION + FRICTION):
        if not MIN_STATE[i] <= known.x[i] <= MAX_STATE[i]:
            return f"{name} = {known.x[i]:g} is out of bounds"
    for i, name in enumerate(MOTION + FRICTION):
        if not 0.0 < known.cov[i * STATES + i] <= 1.1 * P0_STD[i] * P0_STD[i]:
            return f"the variance of {name} is out of bounds"
    if not 0.0 < known.rolling_var <= 1.1 * ROLLING_STD * ROLLING_STD:
        return "the variance of rolling is out of bounds"
    cov = [known.cov[STATES * i : STATES * (i + 1)] for i in range(STATES)]
    return None if _positive(cov) else "no positive definite covariance"


def _positive(matrix: Sequence[Sequence[float]]) -> bool:
    """Whether *matrix* is symmetric and has a Cholesky factor."""
    factor: list[list[float]] = []
    for i, row in enumerate(matrix):
        own: list[float] = []
        for j in range(i + 1):
            if not isclose(row[j], matrix[j][i], rel_tol=1e-6, abs_tol=1e-15):
                return False
            above = own if j == i else factor[j]
            left = row[j] - sum(
                a * b for a, b in zip(own, above, strict=False)
            )
            if j < i:
                own.append(left / factor[j][j])
            elif left > 0.0:
                own.append(sqrt(left))
            else:
                return False
        factor.append(own)
    return True

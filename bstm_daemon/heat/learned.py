"""What is learned of the car: states, covariances, and how they change.

The pure-Python form of the filters in ``_observer.c``.
"""

from __future__ import annotations

from math import isfinite, log, sqrt
from typing import TYPE_CHECKING, Final

from bstm_daemon.heat import observer_rules as rules
from bstm_daemon.heat.observer_layout import MOTION, STATES

if TYPE_CHECKING:
    from collections.abc import Sequence

MASS, BIAS, DRAG, GAIN = range(len(MOTION))
LEVEL, SPEED, PRESSURE, DRIFT = range(len(MOTION), STATES)

NO_FRICTION: Final = (0.0,) * (STATES - len(MOTION))


class Learned:
    """States with their covariance, and the error of g f_r."""

    def __init__(self, rotating: float, numbers: Sequence[float]) -> None:
        """Unpack *numbers*; *rotating* is J / R^2 over the mass."""
        self.rotating = rotating
        self.unpack(numbers)

    def unpack(self, numbers: Sequence[float]) -> None:
        """Take *numbers*, as LEARNED_NAMES has them."""
        self.x = list(numbers[:STATES])
        self.cov = list(numbers[STATES : STATES + STATES * STATES])
        self.rolling_error, self.rolling_var = numbers[-2:]

    def packed(self) -> list[float]:
        """Return the numbers, as LEARNED_NAMES has them."""
        return [*self.x, *self.cov, self.rolling_error, self.rolling_var]

    def begin(self, rolling: float) -> None:
        """Begin anew; *rolling* is the configured g f_r [m/s2]."""
        self.x = [0.0] * STATES
        self.cov = [0.0] * (STATES * STATES)
        self.x[MASS] = self.x[DRAG] = 1.0
        self.x[BIAS] = -rolling
        self.x[GAIN] = rules.PITCH
        for i in range(STATES):
            self.cov[i * STATES + i] = rules.SD[i] * rules.SD[i]
        self.rolling_error = 0.0
        self.rolling_var = rules.ROLLING_SD * rules.ROLLING_SD

    def braking(
        self, felt: float, push: float, drag: float, rate: float
    ) -> tuple[float, float]:
        """Deceleration by the brakes [m/s2] and its standard deviation.

        Times the mass it is the force; the mass's error is not in it.
        """
        h = [push - self.rotating * rate, 1.0, -drag, rate, *NO_FRICTION]
        spread = sqrt(quadratic(self.cov, h))
        return product(self.x, h) - felt, spread

    def friction(
        self, speed: float, pressure_pa: float
    ) -> tuple[float, float]:
        """Ln of the friction over Feed-Forward's, and its variance."""
        h = forms(speed, pressure_pa)
        first = 0.0
        for i in range(len(MOTION), STATES):
            first += h[i] * h[i] * (rules.SD[i] * rules.SD[i])
        variance = quadratic(self.cov, h)
        return product(self.x, h), published_variance(variance, first)

    def update(
        self, first: int, h: Sequence[float], apart: float, noise: float
    ) -> None:
        """One Kalman update of the states from *first* on; bounded."""
        cov = self.cov
        across = []
        for i in range(STATES):
            row = 0.0
            for j in range(STATES):
                row += cov[i * STATES + j] * h[j]
            across.append(row)
        spread = noise
        for i in range(STATES):
            spread += h[i] * across[i]
        gain = []
        for i in range(STATES):
            gain.append(0.0 if i < first else across[i] / spread)
            x = self.x[i] + gain[i] * apart
            self.x[i] = clipped(x, rules.LOW[i], rules.HIGH[i])
        for i in range(STATES):
            for j in range(STATES):
                cov[i * STATES + j] -= (
                    gain[i] * across[j]
                    + across[i] * gain[j]
                    - gain[i] * spread * gain[j]
                )

    def walk(self, first: int, last: int, seconds: float) -> None:
        """Let variances grow, not beyond what they began with."""
        for i in range(first, last):
            own = i * STATES + i
            if self.cov[own] < rules.SD[i] * rules.SD[i]:
                self.cov[own] += rules.WALK[i] * rules.WALK[i] * seconds

    def sound(self) -> bool:
        """Whether everything is a number and has a variance."""
        total = 0.0
        for number in self.packed():
            total += number
        return (
            isfinite(total)
            and all(self.cov[i * STATES + i] > 0.0 for i in range(STATES))
            and self.rolling_var > 0.0
        )


def published_variance(variance: float, first: float) -> float:
    """Return a filter's variance as the heat has it.

    *first* is that before anything was learned: as long as little is, the
    variance is published as it is, and :data:`~.observer_rules.CAUTION` of
    it in the end.
    """
    unlearned = min(variance / first, 1.0)
    return variance * (rules.CAUTION + (1.0 - rules.CAUTION) * unlearned)


def clipped(value: float, low: float, high: float) -> float:
    """Return *value*, not below *low* and not above *high*."""
    if value < low:
        return low
    return min(value, high)


def forms(speed: float, pressure_pa: float) -> list[float]:
    """Return by how much each state counts in ln of the friction."""
    v = max(speed, 1.0)
    p = max(pressure_pa, 5e4)
    h = [0.0] * STATES
    h[LEVEL] = h[DRIFT] = 1.0
    h[SPEED] = clipped(
        log(v / rules.REFERENCE_SPEED_MS), -rules.FORM_LIMIT, rules.FORM_LIMIT
    )
    h[PRESSURE] = clipped(
        log(p / rules.REFERENCE_PRESSURE_PA),
        -rules.FORM_LIMIT,
        rules.FORM_LIMIT,
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

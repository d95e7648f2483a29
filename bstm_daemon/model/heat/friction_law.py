"""Friction law mu(T, p, v) of a brake, relative to its nominal friction.

A factor each for the temperature between disc and pads, the pressure and the
sliding speed, as tables on fixed grids, so that the pass over samples
(``native/heat/sample_pass.c``) looks them up in a few operations. Effects 1 to
3 of the catalogue are such laws.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

LAW_POINTS: Final = 81
"""Points of each table."""

TEMPERATURE_FROM_K: Final = 200.0
TEMPERATURE_STEP_K: Final = 20.0
PRESSURE_STEP_PA: Final = 2.5e5
SPEED_STEP_MS: Final = 1.0
"""Grids: 200 to 1800 K, 0 to 200 bar, 0 to 80 m/s; constant outside."""

_ONES: Final = (1.0,) * LAW_POINTS


@dataclass(frozen=True, slots=True)
class FrictionLaw:
    """Tables of the three factors; the nominal friction has only ones."""

    temperature: tuple[float, ...] = _ONES
    pressure: tuple[float, ...] = _ONES
    speed: tuple[float, ...] = _ONES

    def __post_init__(self) -> None:
        """Check the tables.

        Raises:
            ValueError: a table of another length, or with a factor that is
                not finite and positive.
        """
        for table in (self.temperature, self.pressure, self.speed):
            if len(table) != LAW_POINTS:
                msg = f"a friction table needs {LAW_POINTS} points"
                raise ValueError(msg)
            if not all(isfinite(f) and f > 0.0 for f in table):
                msg = "a friction factor must be finite and above 0"
                raise ValueError(msg)

    @classmethod
    def of(
        cls,
        *,
        temperature_k: Callable[[float], float] | None = None,
        pressure_pa: Callable[[float], float] | None = None,
        speed_ms: Callable[[float], float] | None = None,
    ) -> FrictionLaw:
        """Return the law with these factors, 1 where none is given."""
        return cls(
            _tabled(temperature_k, TEMPERATURE_FROM_K, TEMPERATURE_STEP_K),
            _tabled(pressure_pa, 0.0, PRESSURE_STEP_PA),
            _tabled(speed_ms, 0.0, SPEED_STEP_MS),
        )

    def times(self, other: FrictionLaw) -> FrictionLaw:
        """Return the law with the factors of both."""
        return FrictionLaw(
            _product(self.temperature, other.temperature),
            _product(self.pressure, other.pressure),
            _product(self.speed, other.speed),
        )

    @property
    def nominal(self) -> bool:
        """Whether the friction is the nominal one everywhere."""
        return self == FrictionLaw()

    def numbers(self) -> list[float]:
        """Return the tables as the pass has them: T, p, v."""
        return [*self.temperature, *self.pressure, *self.speed]


def friction_factor(
    law: Sequence[float],
    temperature_k: float,
    pressure_pa: float,
    speed_ms: float,
) -> float:
    """Return mu over its nominal value.

    Args:
        law: :meth:`FrictionLaw.numbers`.
        temperature_k: between disc and pads; 0 where it is not known, no
            factor then.
        pressure_pa: in the caliper.
        speed_ms: of the wheel's circumference.
    """
    factor = _look_up(
        law, LAW_POINTS, pressure_pa * (1.0 / PRESSURE_STEP_PA)
    ) * _look_up(law, 2 * LAW_POINTS, speed_ms * (1.0 / SPEED_STEP_MS))
    if temperature_k > 0.0:
        position = (temperature_k - TEMPERATURE_FROM_K) * (
            1.0 / TEMPERATURE_STEP_K
        )
        factor *= _look_up(law, 0, position)
    return factor


def _look_up(law: Sequence[float], first: int, position: float) -> float:
    """Linear between the points, constant outside."""
    position = min(max(position, 0.0), LAW_POINTS - 1.0)
    index = min(int(position), LAW_POINTS - 2)
    left, right = law[first + index], law[first + index + 1]
    return left + (position - index) * (right - left)


def _tabled(
    factor: Callable[[float], float] | None, first: float, step: float
) -> tuple[float, ...]:
    if factor is None:
        return _ONES
    return tuple(factor(first + i * step) for i in range(LAW_POINTS))


def _product(
    left: Sequence[float], right: Sequence[float]
) -> tuple[float, ...]:
    return tuple(a * b for a, b in zip(left, right, strict=True))

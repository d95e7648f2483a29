"""Look-up tables on a uniform grid, the only functions a network holds.

A uniform grid makes a look-up one multiplication and one linear
interpolation, the same few operations in C and in Python. Outside its range
a table keeps its end value.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil, isfinite

GRID_LIMIT = 1025
"""Most points that :meth:`Table.from_points` spends on hitting each point."""

RESAMPLED_POINTS = 257
"""Points of a table whose breakpoints fit no uniform grid."""


@dataclass(frozen=True, slots=True)
class Table:
    """Values at ``x0 + i * dx``, linear between them, constant outside.

    ``values`` holds at least two finite numbers; ``dx`` is positive.
    """

    x0: float
    dx: float
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse what the kernel could not look up.

        Raises:
            ValueError: fewer than two points, a step that is not positive,
                or a value that is not finite.
        """
        if len(self.values) < 2:
            msg = "a table needs at least two values"
            raise ValueError(msg)
        if not (self.dx > 0 and isfinite(self.dx) and isfinite(self.x0)):
            msg = f"a table needs a positive, finite step, not {self.dx}"
            raise ValueError(msg)
        if not all(map(isfinite, self.values)):
            msg = "a table holds a value that is not finite"
            raise ValueError(msg)

    def __call__(self, x: float) -> float:
        """Look *x* up, with the kernel's own order of operations."""
        last = len(self.values) - 1
        position = (x - self.x0) * (1.0 / self.dx)
        if not position > 0.0:
            position = 0.0
        position = min(position, float(last))
        index = min(int(position), last - 1)
        left = self.values[index]
        right = self.values[index + 1]
        return left + (position - index) * (right - left)

    @property
    def x1(self) -> float:
        """The last grid point."""
        return self.x0 + self.dx * (len(self.values) - 1)

    @classmethod
    def from_points(cls, x: Sequence[float], y: Sequence[float]) -> Table:
        """Table through the points (*x*, *y*), *x* rising.

        Exact at every point where a uniform grid of at most
        :data:`GRID_LIMIT` points hits them all, else resampled to
        :data:`RESAMPLED_POINTS`.
        """
        if len(x) != len(y) or len(x) < 2:
            msg = (
                f"{len(x)} x and {len(y)} y values: need the same, at least 2"
            )
            raise ValueError(msg)
        if any(b <= a for a, b in pairwise(x)):
            msg = "x values must rise"
            raise ValueError(msg)
        return cls._interpolated(x, y, _cells_through(tuple(x)))

    @classmethod
    def from_function(
        cls,
        function: Callable[[float], float],
        x0: float,
        x1: float,
        points: int = RESAMPLED_POINTS,
    ) -> Table:
        """Sample *function* at *points* places from *x0* to *x1*."""
        dx = (x1 - x0) / (points - 1)
        return cls(x0, dx, tuple(function(x0 + i * dx) for i in range(points)))

    @classmethod
    def _interpolated(
        cls, x: Sequence[float], y: Sequence[float], cells: int
    ) -> Table:
        dx = (x[-1] - x[0]) / cells
        values = []
        segment = 0
        for i in range(cells + 1):
            # rounding must not push a grid point past the breakpoint it hits
            at = min(x[0] + i * dx, x[-1])
            while segment < len(x) - 2 and at >= x[segment + 1] - 1e-9 * dx:
                segment += 1
            run = x[segment + 1] - x[segment]
            weight = (at - x[segment]) / run
            if abs(weight) < 1e-9 / cells:
                weight = 0.0
            values.append(y[segment] + weight * (y[segment + 1] - y[segment]))
        return cls(x[0], dx, tuple(values))

    def continued(
        self, function: Callable[[float], float], x1: float
    ) -> Table:
        """Go on with *function* of x to *x1* or just beyond it.

        Not a bit moves up to the last point that is there.
        """
        more = max(ceil((x1 - self.x1) / self.dx), 0)
        count = len(self.values)
        beyond = (
            function(self.x0 + (count + i) * self.dx) for i in range(more)
        )
        return Table(self.x0, self.dx, (*self.values, *beyond))

    def times(self, other: Table) -> Table:
        """Pointwise product with *other*, on the finer of the two grids.

        Returns:
            A table over the union of both ranges.
        """
        x0, x1 = min(self.x0, other.x0), max(self.x1, other.x1)
        cells = round((x1 - x0) / min(self.dx, other.dx))
        points = min(max(cells, 1), GRID_LIMIT - 1) + 1
        return Table.from_function(
            lambda x: self(x) * other(x), x0, x1, points
        )

    def scaled(self, factor: float) -> Table:
        """Every value multiplied by *factor*."""
        return Table(self.x0, self.dx, tuple(factor * v for v in self.values))

    def integral(self, x: float) -> float:
        """Exact integral of the interpolant from ``x0`` to *x*."""
        if x <= self.x0:
            return (x - self.x0) * self.values[0]
        total = 0.0
        last = len(self.values) - 1
        if x >= self.x1:
            inner = sum(self.values) - 0.5 * (self.values[0] + self.values[-1])
            return inner * self.dx + (x - self.x1) * self.values[-1]
        index = min(int((x - self.x0) / self.dx), last - 1)
        total = (
            sum(self.values[: index + 1])
            - 0.5 * (self.values[0] + self.values[index])
        ) * self.dx
        left = self.x0 + index * self.dx
        return total + 0.5 * (self.values[index] + self(x)) * (x - left)


@lru_cache(maxsize=64)
def _cells_through(x: tuple[float, ...]) -> int:
    """Cells of the coarsest uniform grid that hits every *x*.

    Kept, as matching builds the same few tables thousands of times.
    """
    span = x[-1] - x[0]
    for cells in range(len(x) - 1, GRID_LIMIT):
        positions = [(point - x[0]) / span * cells for point in x]
        if all(abs(p - round(p)) < 1e-9 * cells for p in positions):
            return cells
    return RESAMPLED_POINTS - 1

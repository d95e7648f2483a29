"""Measuring side by side, and what a benchmark hands to its reader.

Absolute seconds say little about a program: they move by a factor of two
with the load of the machine. So every work is done in turn with what it is
compared to, round after round, in CPU time of this process, and a goal is
set on ratios only.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from statistics import median
from time import process_time
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

LOADED: Final = 0.5
"""Tolerance of goals in time: a loaded machine is half as fast."""


@dataclass(frozen=True, slots=True)
class Goal:
    """A ratio that must be reached.

    ``tolerance`` is the part of ``at_least`` that may be missing before the
    benchmark fails.
    """

    name: str
    ratio: float
    at_least: float
    tolerance: float

    @property
    def reached(self) -> bool:
        """Whether the ratio is as high as it has to be."""
        return self.ratio >= self.at_least * (1.0 - self.tolerance)


@dataclass(frozen=True, slots=True)
class Table:
    """A table as text; ``rows`` as wide as ``header``."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(slots=True)
class Outcome:
    """What one benchmark found; ``about`` says what was done."""

    title: str
    about: str
    goals: list[Goal] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)

    def as_data(self) -> dict[str, Any]:
        """Return the outcome as what JSON knows."""
        return asdict(self)


@dataclass(frozen=True, slots=True)
class Work:
    """Something to be timed: a call that gets ``units`` of work done."""

    call: Callable[[], object]
    units: float = 1.0


@dataclass(frozen=True, slots=True)
class Timings:
    """CPU seconds per unit of each work, one a round."""

    seconds: Mapping[str, list[float]]

    def median(self, name: str) -> float:
        """Return the median CPU seconds per unit of the work *name*."""
        return median(self.seconds[name])

    def best(self, name: str) -> float:
        """Return the fewest CPU seconds per unit of the work *name*."""
        return min(self.seconds[name])

    def ratio(self, slow: str, fast: str) -> float:
        """Return the median over the rounds of *slow* over *fast*."""
        pairs = zip(self.seconds[slow], self.seconds[fast], strict=True)
        return median(a / b for a, b in pairs)


def take_turns(works: Mapping[str, Work], rounds: int) -> Timings:
    """Time *works* in turn, in an order that turns from round to round."""
    names = list(works)
    seconds: dict[str, list[float]] = {name: [] for name in names}
    for number in range(rounds):
        first = number % len(names)
        for name in names[first:] + names[:first]:
            before = process_time()
            works[name].call()
            spent = process_time() - before
            seconds[name].append(spent / works[name].units)
    return Timings(seconds)


def three_digits(value: float) -> str:
    """Return *value* with three significant digits, tiny ones as a power."""
    if value == 0.0:
        return "0"
    if abs(value) < 1e-3:
        return f"{value:.1e}"
    digits = 2
    while digits > 0 and abs(value) >= 10.0 ** (3 - digits):
        digits -= 1
    while abs(value) < 10.0 ** (2 - digits):
        digits += 1
    return f"{value:.{digits}f}"

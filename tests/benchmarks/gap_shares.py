"""Shares of cases with their intervals, and figures that have a goal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from gap_judge import Result


@dataclass(frozen=True, slots=True)
class Share:
    """Hits among cases."""

    hits: float
    count: int

    def __post_init__(self) -> None:
        """Refuse what no share can be: a figure that is counted wrongly."""
        if not 0.0 <= self.hits <= self.count + 1e-9:
            msg = f"{self.hits} of {self.count} is no share"
            raise ValueError(msg)

    @property
    def value(self) -> float:
        """The share, nan of nothing."""
        return self.hits / self.count if self.count else float("nan")

    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval of Wilson."""
        z, n, p = 1.96, self.count, self.value
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        half /= 1 + z * z / n
        return max(middle - half, 0.0), min(middle + half, 1.0)

    def __str__(self) -> str:
        """Return it in percent with its interval."""
        if not self.count:
            return "no cases"
        low, high = self.interval()
        return (
            f"{100 * self.value:.1f} % ({100 * low:.1f} to {100 * high:.1f})"
        )


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure with its goal; ``at_most`` turns the goal round."""

    name: str
    share: Share
    goal: float | None = None
    floor: float | None = None
    at_most: bool = False

    @property
    def met(self) -> str:
        """Whether the goal is met: in words.

        Met is what the whole interval says, reached what the share does.
        """
        if self.goal is None or not self.share.count:
            return "-"
        low, high = self.share.interval()
        if self._reaches(high if self.at_most else low, self.goal):
            return "met"
        if self._reaches(self.share.value, self.goal):
            return "reached, too few cases to be certain"
        if self.floor is not None and self._reaches(
            self.share.value, self.floor
        ):
            return "floor reached"
        return "not met"

    def _reaches(self, value: float, level: float) -> bool:
        return value <= level if self.at_most else value >= level

    def row(self) -> tuple[str, ...]:
        """Return it as a row of a table."""
        sign = "<=" if self.at_most else ">="
        goal = "-" if self.goal is None else f"{sign} {100 * self.goal:g} %"
        return (
            self.name,
            str(self.share.count),
            str(self.share),
            goal,
            self.met,
        )


HEADER: Final = ("figure", "cases", "found", "goal", "")


def share(results: Sequence[Result], hit: Callable[[Result], float]) -> Share:
    """Return the share of *results* that *hit*."""
    return Share(float(sum(hit(one) for one in results)), len(results))

"""What is known of one corner's peaks if it parks, with or without a march.

The members are marched only where no level would be sure without; each march
bounds later ones, and between the forecasts higher ones are made for that.
"""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.forecast.ceiling import MARGIN_K, Ceilings
from bstm_daemon.forecast.march import (
    HORIZON_S,
    LATER_STEPS,
    NEAR_STEPS,
    Conditions,
    Job,
)
from bstm_daemon.model.risk.levels import PROBABILITIES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.forecast.march import Course
    from bstm_daemon.forecast.members import Ensemble, Heat
    from bstm_daemon.model.risk.vaporisation import Boiling
    from bstm_daemon.native.loader import Kernel

FACTORS: Final = 3.0, 2.0, 1.5, 1.2, 1.1, 1.05, 1.02
OFFSET_K: Final = 0.3
AIR_OFFSET_K: Final = 0.2
"""A ceiling for later forecasts is above the rises of now by the largest of
the factors that is of use and by an offset, so that it lasts."""

ROOM: Final = 0.15
"""A node is above the air by this share of what is left to boiling, at least:
behind a hot disc the cold ones warm many times over within a minute."""

CLOSE: Final = FACTORS[-2:]
"""Those where vapour is likely: it tells when it is safe, too."""


UNSPREAD: Final = 1.3
"""What the highest of all members is above them, about."""


class Start(NamedTuple):
    """What a corner's forecast starts from.

    ``state``: nodes [K] and memories now; ``duty``: what acts on it if the
    drive goes on; ``factor`` widens the spread.
    """

    state: Sequence[float]
    duty: Conditions
    factor: float
    boiling: Boiling

    def parks_as(self, other: Start) -> bool:
        """Whether a parked corner goes on as from *other*."""
        return (
            self.factor == other.factor
            and self.duty.ambient_k == other.duty.ambient_k
            and self.state == other.state
        )


class Range(NamedTuple):
    """Peaks of a corner that parks, each member's lowest and highest [K].

    ``safe_in_s`` is at most as given, infinite where nothing is known.
    """

    least_k: list[float]
    most_k: list[float]
    safe_in_s: float = inf


NOTHING_K: Final = [0.0]
"""A temperature that says nothing."""


class CornerMarch:
    """Makes the marches of one corner's forecasts if it parks."""

    def __init__(self, ensemble: Ensemble, kernel: Kernel | None) -> None:
        """Make those of *ensemble*; *kernel* None runs the reference."""
        self.ensemble, self._kernel = ensemble, kernel
        self._ceilings = Ceilings(ensemble)
        self._boiling: Boiling | None = None
        self._raising: tuple[Heat, Boiling, Job, float] | None = None
        self._excess = 1.0
        """Rise of the last ceiling over the one that was expected of it."""
        self.raised_us: int | None = None
        """When the last ceiling above a march was begun."""

    def range_k(self, start: Start, *, is_present: bool) -> Range:
        """Return what is known of the peaks from *start* without a march.

        Nothing if the corner's network is no longer that of the members.
        """
        ensemble, ceilings = self.ensemble, self._ceilings
        heat, boiling = self._heat(start), start.boiling
        if not (is_present and ceilings.is_ordered):
            least_k, _ = ensemble.range_k(heat)
            return Range(least_k, [inf] * ensemble.count)
        if boiling is not self._boiling:
            # it was safe by another fluid
            ceilings.clear()
            self._boiling = boiling
        found = ceilings.lowest(heat, boiling.lowest_k)
        if found is not None and found.top_k <= boiling.lowest_k:
            return Range(NOTHING_K * ensemble.count, found.peaks_k, 0.0)
        least_k, most_k = ensemble.range_k(heat)
        if found is None:
            return Range(least_k, most_k)
        # a nan of the first stays
        most_k = [*map(min, most_k, found.peaks_k)]
        return Range(least_k, most_k, found.safe_in_s)

    def on_duty_k(self, start: Start, *, is_present: bool) -> float:
        """Return what no fluid exceeds on the duty of *start*, no march."""
        if not is_present:
            return inf
        return self._ceilings.on_duty_k(
            self._heat(start), start.duty.power_w, HORIZON_S
        )

    def begin(self, start: Start) -> Job:
        """Return a march of the members from *start*, parked."""
        return self._begin(start.state, start.duty.ambient_k, start.factor)

    def keep(
        self, start: Start, peaks_k: Sequence[float], safe_in_s: float
    ) -> None:
        """Let a march from *start* with *peaks_k* bound later ones.

        *safe_in_s* is its time until vapour is unlikely.
        """
        self._ceilings.keep(self._heat(start), peaks_k, safe_in_s)

    def raise_ceiling(
        self,
        start: Start,
        peaks_k: Sequence[float],
        is_of_use: Callable[[float], bool] | None,
    ) -> bool:
        """Begin a ceiling for later forecasts; return whether it has begun.

        Args:
            start: of the march.
            peaks_k: that it found, or their bounds.
            is_of_use: tells of a probability of vapour; None for the lowest
                ceiling that lasts a while, of whatever probability.
        """
        if self._raising is not None or not self._ceilings.is_ordered:
            return False
        ensemble, boiling = self.ensemble, start.boiling
        air_k = start.duty.ambient_k
        above_k = AIR_OFFSET_K + OFFSET_K + MARGIN_K + air_k
        is_likely = not boiling.mean_probability(peaks_k) < PROBABILITIES[0]
        for factor in CLOSE if is_likely else FACTORS:
            rises = factor * self._excess
            expected_k = [above_k + rises * (one - air_k) for one in peaks_k]
            probability = boiling.mean_probability(expected_k)
            if is_of_use is not None and is_of_use(probability):
                break
        else:
            if is_of_use is not None:
                return False
        heat, least_k = self._heat(start), 0.0
        if probability == 0.0:
            # there is room: no spread is left that might not be covered
            heat = ensemble.highest(heat)
            least_k = ROOM * (boiling.lowest_k - heat.ambient_k)
            factor = max(factor / UNSPREAD, FACTORS[-1])
        higher_k = heat.ambient_k + AIR_OFFSET_K
        state = [
            higher_k + OFFSET_K + max(factor * one, least_k)
            for one in heat.rises_k
        ] + [*start.state[ensemble.nodes :]]
        self._raising = (
            ensemble.heat(state, higher_k, heat.factor),
            boiling,
            self._begin(state, higher_k, heat.factor),
            (max(expected_k) - air_k) / self._excess,
        )
        return True

    def work_ahead(self, steps: int) -> bool:
        """March at most *steps* of a ceiling; return whether there was one."""
        if self._raising is None:
            return False
        heat, boiling, job, expected_rise_k = self._raising
        course = marched(job, steps, boiling)
        if course is not None:
            peaks_k, safe_in_s = found_by(course, boiling)
            rise_k = max(peaks_k) - heat.ambient_k
            self._excess = max(1.0, rise_k / expected_rise_k)
            if boiling is self._boiling:
                self._ceilings.keep(heat, peaks_k, safe_in_s)
            self._raising = None
        return True

    def _begin(
        self, state: Sequence[float], air_k: float, factor: float
    ) -> Job:
        return Job.of_members(
            *(self.ensemble, self._kernel, state),
            *(Conditions(air_k), NEAR_STEPS),
            factor=factor,
        )

    def _heat(self, start: Start) -> Heat:
        return self.ensemble.heat(
            start.state, start.duty.ambient_k, start.factor
        )


def marched(job: Job, steps: int, boiling: Boiling) -> Course | None:
    """March at most *steps* of *job*; return its course once complete.

    It ends at the horizon if vapour is unlikely by then.
    """
    left = job.advance(steps)
    if not job.finished:
        return None
    course = job.course()
    if len(course.times_s) > len(NEAR_STEPS) + 1 or course.is_over(
        boiling, PROBABILITIES[0]
    ):
        return course
    job.extend(LATER_STEPS)
    return marched(job, left, boiling)


def found_by(course: Course, boiling: Boiling) -> tuple[list[float], float]:
    """Return the peaks [K] of a complete *course* and when it is safe [s]."""
    peaks_k = course.peaks_k(HORIZON_S)
    if (
        course.times_s[-1] <= HORIZON_S
        and boiling.mean_probability(peaks_k) < PROBABILITIES[0]
    ):
        # so is each point of it
        return peaks_k, 0.0
    return peaks_k, course.safe_in_s(boiling, PROBABILITIES[0])

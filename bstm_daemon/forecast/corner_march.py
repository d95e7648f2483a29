"""Marches of one corner's forecast: of its members only where it matters.

Where no ceiling proves that vapour is unlikely the members are marched, else
the estimate alone is, in as many portions. A new ceiling is computed between
the forecasts.
"""

from __future__ import annotations

from functools import partial
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.forecast.ceiling import Ceilings
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
    HORIZON_S,
    PARKED_STEPS,
    Conditions,
    Job,
)
from bstm_daemon.model.risk.levels import PROBABILITIES, RELEASE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.forecast.ceiling import Ceiling
    from bstm_daemon.forecast.march import Course
    from bstm_daemon.forecast.members import Ensemble
    from bstm_daemon.model.risk.vaporisation import Boiling
    from bstm_daemon.model.thermal.program import Program
    from bstm_daemon.native.loader import Kernel

UNLIKELY: Final = RELEASE * PROBABILITIES[0]
"""Probability of vapour below which no level is raised nor stays raised."""


class Start(NamedTuple):
    """What a corner's forecast starts from.

    ``state``: nodes [K] and memories now; ``duty``: what acts on it if the
    drive goes on; ``factor`` widens the spread.
    """

    state: Sequence[float]
    duty: Conditions
    factor: float
    boiling: Boiling


class CornerMarch:
    """Makes the marches of one corner's forecasts."""

    def __init__(self, ensemble: Ensemble, kernel: Kernel | None) -> None:
        """Make those of *ensemble*; *kernel* None runs the reference."""
        self.ensemble, self._kernel = ensemble, kernel
        self._ceilings = Ceilings(ensemble, kernel)
        self._raising: tuple[Ceiling, Job] | None = None

    def of(self, program: Program) -> CornerMarch:
        """Return that of the same members for *program*; itself if it is."""
        if program is self.ensemble.program:
            return self
        return CornerMarch(self.ensemble.of(program), self._kernel)

    def bound_k(self, start: Start, program: Program) -> float:
        """Return what no member's fluid exceeds parked [K]; else infinite.

        So it is if *program* is not that of the members any more.
        """
        if program is not self.ensemble.program:
            return inf
        return self._ceilings.peak_k(
            start.state, start.duty.ambient_k, start.factor
        )

    def begin_parked(self, start: Start, *, alone: bool) -> Job:
        """Return a march from *start*, parked, of the estimate *alone*."""
        return self._begun(
            start, Conditions(start.duty.ambient_k), PARKED_STEPS, alone=alone
        )

    def begin_duty(self, start: Start) -> Job:
        """Return a march on duty from *start*.

        It is of the estimate alone where vapour is not likely; no level
        follows from it.
        """
        begun = partial(self._begun, start, start.duty, DUTY_STEPS)
        if self._kernel is None:
            # no publication has the time to look ahead
            return begun(alone=False)
        alone, air_k = begun(alone=True), start.duty.ambient_k
        alone.advance(len(DUTY_STEPS))
        rise_k = alone.course().peak(HORIZON_S)[0] - air_k
        peak_k = air_k + self.ensemble.widest_rise(start.factor) * rise_k
        unlikely = start.boiling.probability(peak_k) < PROBABILITIES[1]
        return alone if unlikely else begun(alone=False)

    def _begun(
        self,
        start: Start,
        conditions: Conditions,
        steps: Sequence[float],
        *,
        alone: bool,
    ) -> Job:
        return Job(
            self.ensemble.alone if alone else self.ensemble,
            self._kernel,
            start.state,
            conditions,
            steps,
            factor=start.factor,
        )

    def raise_ceiling(self, start: Start, parked: Course) -> None:
        """Begin a ceiling for later forecasts, if members were marched.

        Args:
            start: of the march.
            parked: its course.
        """
        if self._raising is None and len(parked.fluid_k) > 1:
            self._raising = self._ceilings.higher(
                start.state,
                start.duty.ambient_k,
                start.factor,
                peak_k=max(parked.peaks_k(HORIZON_S)),
                limit_k=start.boiling.quantile(UNLIKELY),
            )

    def work_ahead(self, steps: int) -> bool:
        """March at most *steps* of a ceiling; return whether there was one."""
        if self._raising is None:
            return False
        ceiling, job = self._raising
        job.advance(steps)
        if job.finished:
            self._ceilings.accept(ceiling, job)
            self._raising = None
        return True

"""Marches of one corner's forecast: of its members only where they may boil.

Where no ceiling proves that the members stay below boiling they are marched,
else the estimate alone is, in as many portions. A new ceiling is computed
between the forecasts.
"""

from __future__ import annotations

from functools import partial
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.forecast.ceiling import Ceiling
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
    HORIZON_S,
    PARKED_STEPS,
    Conditions,
    Job,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.forecast.march import Course
    from bstm_daemon.forecast.members import Ensemble
    from bstm_daemon.model.risk.vaporisation import Boiling
    from bstm_daemon.model.thermal.program import Program
    from bstm_daemon.native.loader import Kernel

DUTY_SPREADS: Final = 7.0
"""A member on duty rises less than the estimate does by this number of
standard deviations of the duty's heat; checked by tests, not proven. No level
follows from a duty."""


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
        self._ceiling = Ceiling(ensemble, kernel)
        self._raising: Job | None = None

    def of(self, program: Program) -> CornerMarch:
        """Return that of the same members for *program*; itself if it is."""
        if program is self.ensemble.program:
            return self
        return CornerMarch(self.ensemble.of(program), self._kernel)

    def begin(self, start: Start, *, parked: bool) -> Job:
        """Return a march from *start*, *parked* or on duty."""
        begun = partial(
            Job,
            kernel=self._kernel,
            state=start.state,
            conditions=Conditions(start.duty.ambient_k)
            if parked
            else start.duty,
            steps=PARKED_STEPS if parked else DUTY_STEPS,
            factor=start.factor,
        )
        alone, air_k = begun(self.ensemble.alone), start.duty.ambient_k
        if parked:
            peak_k = self._ceiling.peak_k(start.state, air_k, start.factor)
        elif self._kernel is None:
            # no publication has the time to look ahead
            peak_k = inf
        else:
            alone.advance(len(DUTY_STEPS))
            wider = (
                DUTY_SPREADS * start.factor * self.ensemble.spread.duty_heat
            )
            rise_k = alone.course().peak(HORIZON_S)[0] - air_k
            peak_k = air_k + (1.0 + wider) * rise_k
        safe = start.boiling.probability(peak_k) == 0.0
        return alone if safe else begun(self.ensemble)

    def raise_ceiling(self, start: Start, parked: Course) -> None:
        """Begin a ceiling for later forecasts, if members were marched.

        Args:
            start: of the march.
            parked: its course.
        """
        if self._raising is None and len(parked.fluid_k) > 1:
            self._raising = self._ceiling.higher(
                start.state,
                start.duty.ambient_k,
                start.factor,
                peak_k=max(parked.peaks_k(HORIZON_S)),
                limit_k=start.boiling.lowest_k,
            )

    def work_ahead(self, steps: int) -> bool:
        """March at most *steps* of a ceiling; return whether there was one."""
        job = self._raising
        if job is None:
            return False
        job.advance(steps)
        if job.finished:
            self._ceiling.accept(job)
            self._raising = None
        return True

"""A forecast between its begin and its end, some publications later."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bstm_daemon.forecast.march import Conditions, Course, Job
    from bstm_daemon.risk.vaporisation import Boiling


@dataclass(slots=True)
class UnderWay:
    """What a forecast started from and how far it is.

    ``states`` and the like are one a corner; ``at_stop`` tells that the car
    had just stopped. ``index`` counts corners that are done, first all of
    them parked, which is ``told`` then, then all with the duty.
    """

    time_us: int
    states: list[list[float]]
    conditions: list[Conditions]
    factors: list[float]
    boiling: Boiling
    at_stop: bool
    index: int = 0
    told: bool = False
    job: Job | None = None
    parked: list[Course] = field(default_factory=list)

    @property
    def parks(self) -> bool:
        """Whether it is about to say what comes of a stop."""
        return self.at_stop and not self.told

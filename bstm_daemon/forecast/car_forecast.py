"""The forecast of all corners of a car, in progress.

The corners are marched as they are estimated, and the members of an ensemble
of each where a level is not sure without.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isnan, nan
from typing import TYPE_CHECKING, NamedTuple

from bstm_daemon.estimate import CornerRisk
from bstm_daemon.forecast.corner_march import CornerMarch, Range, marched
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
    HORIZON_S,
    NEAR_STEPS,
    Conditions,
    Course,
    Job,
)
from bstm_daemon.forecast.members import Ensemble
from bstm_daemon.model.risk.levels import (
    PROBABILITIES,
    LevelMemory,
    published_level,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.estimate import Validity
    from bstm_daemon.forecast.corner_march import Start
    from bstm_daemon.forecast.march import Duty
    from bstm_daemon.forecast.members import Spread
    from bstm_daemon.model.risk.vaporisation import Boiling
    from bstm_daemon.model.thermal.program import Program
    from bstm_daemon.native.loader import Kernel


@dataclass(slots=True)
class Corner:
    """A corner's memory and what is published of it.

    ``march`` is of its network ``program``, the same one for corners alike.
    ``peaks_k`` are those of the members, or the estimate's for each;
    ``most_k`` is what theirs do not exceed.
    """

    name: str
    program: Program
    march: CornerMarch
    duty: Duty
    level: LevelMemory = field(default_factory=LevelMemory)
    fade: LevelMemory = field(default_factory=LevelMemory)
    now_k: list[float] = field(default_factory=list)
    peaks_k: list[float] = field(default_factory=list)
    most_k: list[float] = field(default_factory=list)
    now: float = nan
    deviation_k: float = nan
    ahead: float = nan
    parked: tuple[float, float, float] = (nan, nan, nan)
    on_duty: tuple[float, float] = (nan, nan)

    @property
    def ensemble(self) -> Ensemble:
        """The members."""
        return self.march.ensemble

    @property
    def probability(self) -> float:
        """That of vapour, now or ahead."""
        return self.now if isnan(self.ahead) else max(self.now, self.ahead)

    def forget(self) -> None:
        """Forget what was found after a gap; levels fall as usual."""
        self.peaks_k, self.most_k = [], []
        self.now = self.deviation_k = self.ahead = nan
        self.parked, self.on_duty = (nan, nan, nan), (nan, nan)

    def record(self, validity: Validity) -> CornerRisk:
        """Return what is published with an estimate of *validity*."""
        level = published_level(self.level.level, validity)
        fade = published_level(self.fade.level, validity)
        return CornerRisk(
            *(self.probability, self.now, level, level, fade),
            *(self.deviation_k, *self.parked, *self.on_duty),
        )


class Car(NamedTuple):
    """What is marched: corners, those of one structure in a group.

    ``beside`` are the corners of another course of the same car; ``programs``
    by corner; ``level`` is that of the car.
    """

    corners: list[Corner]
    beside: Sequence[Corner]
    groups: list[tuple[str, ...]]
    programs: Mapping[str, Program]
    kernel: Kernel | None
    level: LevelMemory
    members: int
    spread: Spread

    def is_present(self, corner: Corner) -> bool:
        """Whether the march of *corner* is that of its network now."""
        return corner.program is self.programs[corner.name]

    def march_of(self, program: Program) -> CornerMarch:
        """Return that of *program*, which corners and courses share."""
        for corner in self.corners:
            if corner.march.ensemble.program == program:
                return corner.march
        for corner in self.beside:
            if corner.march.ensemble.program == program:
                return CornerMarch(corner.march.ensemble, self.kernel)
        ensemble = Ensemble(program, self.members, self.spread)
        return CornerMarch(ensemble, self.kernel)

    def refit(self, corner: Corner) -> None:
        """Let *corner* have the march of its network now."""
        if not self.is_present(corner):
            corner.program = self.programs[corner.name]
            corner.march = self.march_of(corner.program)


@dataclass(slots=True)
class CarForecast:
    """A forecast of *car* in progress, spread over several publications.

    ``starts`` and ``ranges`` are one a corner; ``at_stop``: the car had just
    stopped; ``wait`` counts the publications until it is published, as many
    as if all members were marched. ``estimates`` are the marches of all
    corners as they are estimated, parked and then on duty; ``marched`` are the
    courses of the members, by place.
    """

    car: Car
    time_us: int
    starts: list[Start]
    ranges: list[Range]
    boiling: Boiling
    at_stop: bool
    wait: int
    estimates: list[Job] = field(default_factory=list)
    place: int = 0
    published: bool = False
    job: Job | None = None
    marched: dict[int, Course] = field(default_factory=dict)

    def begin_estimates(self, *, duty: bool = False) -> None:
        """Begin the marches of the estimates, parked or on *duty*.

        On duty each corner is marched with its power and without.
        """
        of = {
            corner.name: start
            for corner, start in zip(
                self.car.corners, self.starts, strict=True
            )
        }
        self.estimates = []
        for group in self.car.groups:
            lanes = [
                (name, conditions)
                for name in group
                for conditions in (
                    (of[name].duty, of[name].duty._replace(power_w=0.0))
                    if duty
                    else (Conditions(of[name].duty.ambient_k),)
                )
            ]
            self.estimates.append(
                Job.of_corners(
                    [self.car.programs[name] for name, _ in lanes],
                    self.car.kernel,
                    [of[name].state for name, _ in lanes],
                    [conditions for _, conditions in lanes],
                    DUTY_STEPS if duty else NEAR_STEPS,
                )
            )

    def march_members(self, steps: int) -> None:
        """March those of the next corner that needs it."""
        while self.place < len(self.car.corners):
            place = self.place
            corner, start = self.car.corners[place], self.starts[place]
            if self.job is None:
                if not self.car.is_present(corner):
                    # as much work as a portion: in its own publication
                    self.car.refit(corner)
                    self.wait += 1
                    return
                if self.is_sure(place):
                    self.place += 1
                    continue
                twin = self._twin(place)
                if twin is not None:
                    self.marched[place] = self.marched[twin]
                    self.ranges[place] = self.ranges[twin]
                    self.place += 1
                    continue
                self.job = corner.march.begin(start)
            course = marched(self.job, steps, self.boiling)
            if course is not None:
                self.marched[place] = course
                self.job = None
                peaks_k = course.peaks_k(HORIZON_S)
                safe_in_s = course.safe_in_s(self.boiling, PROBABILITIES[0])
                self.ranges[place] = Range(peaks_k, peaks_k, safe_in_s)
                corner.march.keep(start, course, safe_in_s)
                self.place += 1
            return

    def _twin(self, place: int) -> int | None:
        """Return a corner whose members were marched as those of *place*."""
        march, start = self.car.corners[place].march, self.starts[place]
        for twin in self.marched:
            if self.car.corners[twin].march is march and self.starts[
                twin
            ].parks_as(start):
                return twin
        return None

    def is_sure(self, place: int) -> bool:
        """Whether nothing follows from the members of corner *place*.

        Neither for its level nor for the car's, as far as others are known.
        """
        corner, boiling = self.car.corners[place], self.boiling
        own = self.ranges[place]
        most = boiling.mean_probability(own.most_k)
        if most == 0.0:
            return True
        if not (
            self._does_one_thing(corner.level, [own], most)
            and self._does_one_thing(
                self.car.level,
                self.ranges,
                boiling.mean_probability(
                    hottest([one.most_k for one in self.ranges])
                ),
            )
        ):
            return False
        # for the time until it is safe, before there is a bound of it
        return most < PROBABILITIES[0] or corner.march.raised_us is not None

    def _does_one_thing(
        self, level: LevelMemory, ranges: Sequence[Range], most: float
    ) -> bool:
        """Whether all risks of *ranges*, at *most* as given, do to *level*."""
        if level.is_sure(0.0, most):
            return True
        least_k = hottest([one.least_k for one in ranges])
        return level.is_sure(self.boiling.mean_probability(least_k), most)

    def courses(self) -> dict[str, list[Course]]:
        """Return the courses of each corner, as they are estimated."""
        found: dict[str, list[Course]] = {}
        for group, job in zip(self.car.groups, self.estimates, strict=True):
            course = job.course()
            share = len(course.fluid_k) // len(group)
            for place, series in enumerate(course.fluid_k):
                found.setdefault(group[place // share], []).append(
                    Course(course.times_s, [series])
                )
        return found


def hottest(series: Sequence[Sequence[float]]) -> list[float]:
    """Return the hottest corner of each member; *series* one a corner."""
    if len(series) == 1:
        return [*series[0]]
    return [max(values) for values in zip(*series, strict=True)]

"""The forecast of all corners of a car, in progress.

The corners are marched as they are estimated, and the members of an ensemble
of each where a level is not sure without.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isnan, nan
from typing import TYPE_CHECKING, NamedTuple

from bstm_daemon.estimate import CornerRisk, RiskLevel
from bstm_daemon.forecast.corner_march import (
    CornerMarch,
    Range,
    found_by,
    marched,
)
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
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
from bstm_daemon.model.thermal.kernel import Batch

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

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
    ``peaks_k`` are those of the members, or the estimate's for each.
    """

    name: str
    program: Program
    march: CornerMarch
    duty: Duty
    level: LevelMemory = field(default_factory=LevelMemory)
    fade: LevelMemory = field(default_factory=LevelMemory)
    now_k: list[float] = field(default_factory=list)
    peaks_k: list[float] = field(default_factory=list)
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
        self.peaks_k = []
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
    and ``spreads`` by corner; ``level`` is that of the car; ``batches`` are
    kept of corners.
    """

    corners: list[Corner]
    beside: Sequence[Corner]
    groups: list[tuple[str, ...]]
    programs: Mapping[str, Program]
    kernel: Kernel | None
    level: LevelMemory
    members: int
    spreads: Mapping[str, Spread]
    batches: dict[tuple[str, ...], Batch]

    def is_present(self, corner: Corner) -> bool:
        """Whether the march of *corner* is that of its network now."""
        return corner.program is self.programs[corner.name]

    def march_of(self, name: str) -> CornerMarch:
        """Return that of corner *name*; corners and courses share them."""
        program, spread = self.programs[name], self.spreads[name]
        for corner in self.corners:
            if corner.march.ensemble.is_of(program, spread):
                return corner.march
        for corner in self.beside:
            if corner.march.ensemble.is_of(program, spread):
                return CornerMarch(corner.march.ensemble, self.kernel)
        ensemble = Ensemble(program, self.members, spread)
        return CornerMarch(ensemble, self.kernel)

    def batch(self, corners: tuple[str, ...]) -> Batch:
        """Return the networks of *corners* now as a batch, made once."""
        programs = tuple(self.programs[name] for name in corners)
        batch = self.batches.get(corners)
        if batch is None or batch.programs != programs:
            batch = Batch(programs, 0.0, None, self.kernel)
            self.batches[corners] = batch
        return batch

    def refit(self, corner: Corner) -> None:
        """Let *corner* have the march of its network now."""
        if not self.is_present(corner):
            corner.program = self.programs[corner.name]
            corner.march = self.march_of(corner.name)


@dataclass(slots=True)
class CarForecast:
    """A forecast of *car* in progress, spread over several publications.

    ``starts`` and ``ranges`` are one a corner; ``at_stop``: the car had just
    stopped; ``wait`` counts the publications until it is published, as many
    as if all members were marched. ``estimates`` are the marches of corners
    as they are estimated, parked and then on duty, with the name of each
    lane; ``places`` are the corners whose members are still to be looked at;
    ``least_k`` is what was known before they were; ``marched`` are the courses
    of the members, by place.
    """

    car: Car
    time_us: int
    starts: list[Start]
    ranges: list[Range]
    boiling: Boiling
    at_stop: bool
    wait: int
    estimates: list[tuple[tuple[str, ...], Job]] = field(default_factory=list)
    places: list[int] = field(init=False)
    least_k: list[list[float]] = field(init=False)
    published: bool = False
    job: Job | None = None
    marched: dict[int, Course] = field(default_factory=dict)
    _most: dict[int | None, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Look at the hottest corner first: it may decide for the car."""
        self.least_k = [one.least_k for one in self.ranges]
        self.places = sorted(
            range(len(self.ranges)),
            key=lambda place: -max(self.ranges[place].most_k),
        )

    def begin_parked(self) -> None:
        """Begin the marches of all corners as they are estimated, parked."""
        self._begin_estimates(
            {
                corner.name: (start, [Conditions(start.duty.ambient_k)])
                for corner, start in self._each()
            },
            NEAR_STEPS,
        )

    def begin_duty(self) -> None:
        """Begin those on duty, each with its power and without.

        Of a corner that is out of reach of boiling nothing is marched: the
        bound is told.
        """
        within = {}
        for corner, start in self._each():
            most_k = corner.march.on_duty_k(
                start, is_present=self.car.is_present(corner)
            )
            if most_k <= self.boiling.lowest_k:
                corner.on_duty = most_k, inf
            else:
                free = start.duty._replace(power_w=0.0)
                within[corner.name] = start, [start.duty, free]
        self._begin_estimates(within, DUTY_STEPS)

    def _each(self) -> Iterator[tuple[Corner, Start]]:
        return zip(self.car.corners, self.starts, strict=True)

    def _begin_estimates(
        self,
        of: Mapping[str, tuple[Start, list[Conditions]]],
        steps: Sequence[float],
    ) -> None:
        """Begin marches of corners by name, each on its conditions."""
        self.estimates = []
        for group in self.car.groups:
            lanes = [
                (name, of[name][0].state, conditions)
                for name in group
                if name in of
                for conditions in of[name][1]
            ]
            if lanes:
                names, states, conditions = zip(*lanes, strict=True)
                batch = self.car.batch(names)
                job = Job.of_corners(batch, states, conditions, steps)
                self.estimates.append((names, job))

    @property
    def estimates_finished(self) -> bool:
        """Whether the marches of corners as they are estimated are."""
        return all(job.finished for _, job in self.estimates)

    def march_members(self, steps: int) -> None:
        """March those of the next corner that needs it."""
        while self.places:
            place = self.places[0]
            corner, start = self.car.corners[place], self.starts[place]
            if self.job is None:
                if not self.car.is_present(corner):
                    # as much work as a portion: in its own publication
                    self.car.refit(corner)
                    self.wait += 1
                    return
                if self.is_sure(place):
                    del self.places[0]
                    continue
                twin = self._twin(place)
                if twin is not None:
                    self.marched[place] = self.marched[twin]
                    self._take(place, self.ranges[twin])
                    continue
                self.job = corner.march.begin(start)
            course = marched(self.job, steps, self.boiling)
            if course is not None:
                self.marched[place] = course
                self.job = None
                peaks_k, safe_in_s = found_by(course, self.boiling)
                corner.march.keep(start, peaks_k, safe_in_s)
                self._take(place, Range(peaks_k, peaks_k, safe_in_s))
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
        corner = self.car.corners[place]
        most = self.most(place)
        if most == 0.0:
            return True
        if (
            self.car.beside
            and self.car.beside[place].level.level >= RiskLevel.HIGH
        ):
            # a message tells the time until it is safe, which is the members'
            return most < PROBABILITIES[0]
        if not (
            self._does_one_thing(corner.level, place)
            and self._does_one_thing(self.car.level, None)
        ):
            return False
        # for the time until it is safe, before there is a bound of it
        return most < PROBABILITIES[0] or corner.march.raised_us is not None

    def most(self, place: int | None) -> float:
        """Return the highest risk of corner *place*, of the car if None."""
        if place not in self._most:
            self._most[place] = self.boiling.mean_probability(
                hottest([one.most_k for one in self._ranges(place)])
            )
        return self._most[place]

    def _does_one_thing(self, level: LevelMemory, place: int | None) -> bool:
        """Whether all risks of :meth:`most`'s *place* do to *level*."""
        most = self.most(place)
        if level.is_sure(0.0, most):
            return True
        least_k = hottest([one.least_k for one in self._ranges(place)])
        return level.is_sure(self.boiling.mean_probability(least_k), most)

    def _ranges(self, place: int | None) -> list[Range]:
        return self.ranges if place is None else [self.ranges[place]]

    def _take(self, place: int, known: Range) -> None:
        """Replace what is known of corner *place*, which is then done."""
        self.ranges[place] = known
        self._most.pop(place, None)
        self._most.pop(None, None)
        self.places.remove(place)

    def courses(self) -> dict[str, list[Course]]:
        """Return the courses that were marched of corners, as estimated."""
        found: dict[str, list[Course]] = {}
        for names, job in self.estimates:
            course = job.course()
            for name, series in zip(names, course.fluid_k, strict=True):
                found.setdefault(name, []).append(
                    Course(course.times_s, [series])
                )
        return found


def hottest(series: Sequence[Sequence[float]]) -> list[float]:
    """Return the hottest corner of each member; *series* one a corner."""
    if len(series) == 1:
        return [*series[0]]
    return [*map(max, *series)]

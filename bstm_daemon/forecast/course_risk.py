"""Risk and forecast along one course of temperatures.

The course is the estimate, or the hot bound of an unknown start. Everything
happens on the grid of data time, so a recording gives the same risk as the
bus it was recorded on, to the last byte, however the stream is cut: once a
second the present risk, every :data:`GRID_US` and when the car stops a
forecast, computed in portions of half a corner a publication.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf, isnan, nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.estimate import (
    CarRisk,
    CornerRisk,
    Reason,
    RiskLevel,
    Validity,
)
from bstm_daemon.forecast.corner_march import UNLIKELY, CornerMarch, Start
from bstm_daemon.forecast.march import HORIZON_S, Duty, parked_course
from bstm_daemon.forecast.members import DEGRADED_FACTOR, Ensemble, Spread
from bstm_daemon.model.risk.levels import (
    PROBABILITIES,
    LevelMemory,
    published_level,
)
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimator.blocks import Instant
    from bstm_daemon.estimator.estimator import Estimator
    from bstm_daemon.estimator.memory import SavedState
    from bstm_daemon.forecast.fluid import FluidKnowledge
    from bstm_daemon.forecast.march import Course, Job
    from bstm_daemon.model.risk.vaporisation import Boiling

SECOND_US: Final = 1_000_000
GRID_US: Final = 10 * SECOND_US
"""Interval of the forecasts, in data time."""

PYTHON_MEMBERS: Final = 8
"""Number of members without the compiled kernel."""

PYTHON_STEPS: Final = 1
COMPILED_STEPS: Final = 50
"""Steps of an ensemble marched a publication: half a corner with the
compiled kernel; without it one, so that no publication waits."""

DROVE_MS: Final = 2.0
STOPPED_MS: Final = 0.3
"""Below this speed a car that has driven faster has stopped."""

GAP_US: Final = 2 * SECOND_US
"""After a longer gap of publications the monitor starts again."""


@dataclass(slots=True)
class _Corner:
    """A corner's memory and its forecast."""

    name: str
    march: CornerMarch
    duty: Duty
    level: LevelMemory = field(default_factory=LevelMemory)
    fade: LevelMemory = field(default_factory=LevelMemory)
    record: CornerRisk = field(default_factory=CornerRisk)
    peaks_k: list[float] = field(default_factory=list)
    ahead: float = nan
    now_k: list[float] = field(default_factory=list)

    @property
    def ensemble(self) -> Ensemble:
        """The members."""
        return self.march.ensemble


@dataclass(slots=True)
class _Forecast:
    """A forecast in progress, spread over several publications.

    ``starts`` are one a corner; ``at_stop``: the car had just stopped.
    ``bounds_k`` are, one a corner, what no member's fluid exceeds parked.
    ``index`` counts corners that are done, first all of them parked, which
    is ``published`` then, then all with the duty.
    """

    time_us: int
    starts: list[Start]
    bounds_k: list[float]
    boiling: Boiling
    at_stop: bool
    index: int = 0
    published: bool = False
    job: Job | None = None
    parked: list[Course] = field(default_factory=list)

    @property
    def is_unlikely(self) -> bool:
        """Whether vapour is unlikely at all corners, if the car parks."""
        highest_k = max(self.bounds_k, default=inf)
        return self.boiling.probability(highest_k) < UNLIKELY

    def does_alone(self, place: int) -> bool:
        """Whether no level follows from the members of corner *place*.

        Its own does not where vapour is unlikely, the car's not where that
        is so of all or each member is hotter at a corner before.
        """
        bound_k = self.bounds_k[place]
        likely = self.boiling.probability(bound_k)
        if likely == 0.0 or not likely < UNLIKELY or self.is_unlikely:
            return likely < UNLIKELY
        marched = [c.peaks_k(HORIZON_S) for c in self.parked if c.fluid_k[1:]]
        return bound_k <= min(_hottest(marched), default=-inf)


class CourseRisk:
    """Risk and forecast of one car along one course."""

    def __init__(
        self,
        config: Config,
        estimator: Estimator,
        fluid: FluidKnowledge,
        beside: CourseRisk | None = None,
    ) -> None:
        """Follow *estimator* of the car *config*, which has the *fluid*.

        *beside* is that of the estimate, if this one is of the hot bound: the
        ensembles are the same.
        """
        self._fluid = fluid
        self._is_bound = beside is not None
        self._kernel = estimator.kernel
        compiled = self._kernel is not None
        self.members = config.forecast.members if compiled else PYTHON_MEMBERS
        self._steps = COMPILED_STEPS if compiled else PYTHON_STEPS
        self._limits = [
            [c + KELVIN_OFFSET for c in config.forecast.disc_limits_c],
            [c + KELVIN_OFFSET for c in config.forecast.pad_limits_c],
        ]
        self._ambient_k = config.vehicle.ambient_c + KELVIN_OFFSET
        spread = Spread().scaled(config.forecast.uncertainty)
        self._programs = estimator.programs
        drawn = {} if beside is None else beside.ensembles()
        self._corners = [
            _Corner(
                name,
                CornerMarch(
                    drawn.get(name) or Ensemble(program, self.members, spread),
                    self._kernel,
                ),
                Duty(program),
            )
            for name in estimator.layout.corners
            if (program := estimator.programs.get(name)) is not None
        ]
        self._level = LevelMemory()
        self._forecast: _Forecast | None = None
        self._forecast_us: int | None = None
        self._last_us: int | None = None
        self._drove = False
        self._stopped = False
        self._car = CarRisk(members=self.members)
        self._ahead = nan
        self.away = nan
        """Probability that vapour formed while the computer was off."""
        self._last_published: (
            tuple[tuple[CarRisk, tuple[Validity, ...]], CarRisk] | None
        ) = None

    def peaks_k(self) -> dict[str, tuple[float, ...]]:
        """Return each corner's peaks [K] if the car parks, one a member.

        They are of the last forecast, empty before the first; members of
        one number belong together.
        """
        return {c.name: tuple(c.peaks_k) for c in self._corners}

    def ensembles(self) -> dict[str, Ensemble]:
        """Return the ensemble of each corner."""
        return {c.name: c.ensemble for c in self._corners}

    def advance(
        self, instant: Instant, share: int = 1, *, duty: bool = True
    ) -> CarRisk:
        """Return the risk at *instant*, the next publication.

        Args:
            instant: the publication.
            share: divides the part of a forecast that is computed.
            duty: whether it goes on to what comes if the duty continues.
        """
        time_us = instant.time_us
        if self._last_us is None or not (
            0 < time_us - self._last_us <= GAP_US
        ):
            self._begin_anew()
        self._last_us = time_us
        speed_ms = instant.vehicle("speed_ms")
        stopped = self._drove and speed_ms < STOPPED_MS
        self._drove = (self._drove and not stopped) or speed_ms > DROVE_MS
        whole = time_us % SECOND_US == 0
        first = self._forecast is None and self._forecast_us is None
        if whole or first:
            self._update_now(instant)
        due = self._forecast is None and time_us % GRID_US == 0
        self._stopped = self._stopped or stopped
        running = self._forecast
        # the result of an earlier stop is published first: in slow traffic
        # and pure Python there would otherwise be no forecast
        waits = running is not None and (
            running.at_stop and not running.published
        )
        at_stop = self._stopped and not waits
        if at_stop or due or first:
            self._begin(instant, at_stop=at_stop)
        steps = max(self._steps // share, 1)
        if self._forecast is not None:
            self._work(self._forecast, steps, duty=duty)
        else:
            any(corner.march.work_ahead(steps) for corner in self._corners)
        return self._published(instant)

    def _begin_anew(self) -> None:
        """Drop the forecast after a gap; levels fall as usual."""
        self._forecast, self._forecast_us = None, None
        self._ahead, self._stopped = nan, False
        for corner in self._corners:
            corner.duty.restart()
            corner.peaks_k, corner.ahead = [], nan
            corner.record = CornerRisk()

    def _update_now(self, instant: Instant) -> None:
        """Update the present risk."""
        boiling = self._fluid.boiling(instant.time_us)
        for corner in self._corners:
            name, time_us = corner.name, instant.time_us
            corner.duty.add(instant, name)
            state = instant.state(name, hottest=self._is_bound)
            deviation_k = corner.ensemble.fluid_deviation_k(
                state["fluid"],
                instant.channel(name, "ambient_k"),
                self._factor(instant, name),
            )
            top_k = state["fluid"] + deviation_k * corner.ensemble.top_draw
            if boiling.probability(top_k) == 0.0:
                corner.now_k, now = [top_k] * self.members, 0.0
            else:
                corner.now_k = [
                    state["fluid"] + deviation_k * draw
                    for draw in corner.ensemble.now_draws
                ]
                now = boiling.mean_probability(corner.now_k)
            probability = (
                now if isnan(corner.ahead) else max(now, corner.ahead)
            )
            corner.level.by_probability(probability, time_us)
            corner.fade.by_temperatures(
                (state["disc"], state["pad_front"]), self._limits, time_us
            )
            corner.record = replace(
                corner.record,
                fluid_deviation_k=deviation_k,
                probability_now=now,
                probability=probability,
            )
        self._update_car(boiling, instant.time_us)

    def _update_car(self, boiling: Boiling, time_us: int) -> None:
        now = boiling.mean_probability(
            _hottest([c.now_k for c in self._corners])
        )
        probability = now if isnan(self._ahead) else max(now, self._ahead)
        self._level.by_probability(probability, time_us)
        self._car = CarRisk(
            probability=probability,
            probability_now=now,
            boiling_k=boiling.quantile(0.5),
            boiling_low_k=boiling.quantile(0.01),
            water_percent=self._fluid.water.median_percent,
            forecast_us=self._forecast_us,
            members=self.members,
            corners={c.name: c.record for c in self._corners},
        )

    def _factor(self, instant: Instant, corner: str) -> float:
        """Return how much less certain *corner* is than a valid estimate."""
        # the bound is as high already as the start may make it
        is_bounded = (
            self._is_bound and instant.reasons(corner) is Reason.START_UNKNOWN
        )
        is_valid = instant.validity(corner) is Validity.VALID
        return 1.0 if is_valid or is_bounded else DEGRADED_FACTOR

    def _begin(self, instant: Instant, *, at_stop: bool) -> None:
        self._stopped = self._stopped and not at_stop
        boiling = self._fluid.boiling(instant.time_us)
        starts = [
            Start(
                [*instant.state(c.name, hottest=self._is_bound).values()],
                c.duty.conditions(instant.channel(c.name, "ambient_k")),
                self._factor(instant, c.name),
                boiling,
            )
            for c in self._corners
        ]
        bounds_k = [
            c.march.bound_k(start, self._programs[c.name])
            for c, start in zip(self._corners, starts, strict=True)
        ]
        self._forecast = _Forecast(
            instant.time_us, starts, bounds_k, boiling, at_stop
        )

    def _work(self, forecast: _Forecast, steps: int, *, duty: bool) -> None:
        """Compute one publication's portion of *forecast*."""
        count = len(self._corners)
        if forecast.index == count and not forecast.published:
            self._commit(forecast)
            if not duty:
                self._forecast = None
            return
        place = forecast.index % count
        corner = self._corners[place]
        parked = forecast.index < count
        start = forecast.starts[place]
        if forecast.job is None:
            march = corner.march.of(self._programs[corner.name])
            if march is not corner.march:
                # as much work as a portion of forecast: in its own publication
                corner.march = march
                forecast.bounds_k[place] = inf
                return
            if parked:
                alone = forecast.does_alone(place)
                forecast.job = march.begin_parked(start, alone=alone)
            else:
                forecast.job = march.begin_duty(start)
        forecast.job.advance(steps)
        if not forecast.job.finished:
            return
        course = forecast.job.course()
        forecast.job = None
        forecast.index += 1
        if parked:
            corner.march.raise_ceiling(start, course)
            forecast.parked.append(course)
        else:
            self._commit_duty(forecast, corner, course)
        if forecast.index == 2 * count:
            self._forecast = None

    def _commit(self, forecast: _Forecast) -> None:
        """Publish the forecast if the car parks."""
        forecast.published = True
        boiling = forecast.boiling
        self._forecast_us = forecast.time_us
        for corner, course, bound_k in zip(
            self._corners, forecast.parked, forecast.bounds_k, strict=True
        ):
            peaks_k = course.peaks_k(HORIZON_S)
            if len(peaks_k) == 1:
                # the estimate alone stands for each of its members
                corner.peaks_k = peaks_k * self.members
                corner.ahead = boiling.probability(bound_k)
            else:
                corner.peaks_k = peaks_k
                corner.ahead = boiling.mean_probability(peaks_k)
            peak_k, peak_in_s = course.peak(HORIZON_S)
            corner.record = replace(
                corner.record,
                probability=max(corner.ahead, corner.record.probability_now),
                peak_k=peak_k,
                peak_in_s=peak_in_s,
                safe_in_s=course.safe_in_s(boiling, PROBABILITIES[0]),
            )
            corner.level.by_probability(
                corner.record.probability, forecast.time_us
            )
        hottest_k = _hottest([c.peaks_k for c in self._corners])
        # a bound may be above what the estimate alone says; a nan stays
        self._ahead = max(
            [
                boiling.mean_probability(hottest_k),
                *(c.ahead for c in self._corners),
            ]
        )
        self._update_car(boiling, forecast.time_us)

    def _commit_duty(
        self, forecast: _Forecast, corner: _Corner, course: Course
    ) -> None:
        """Publish the forecast of *corner* if its duty continues."""
        corner.record = replace(
            corner.record,
            duty_peak_k=course.peak(HORIZON_S)[0],
            duty_in_s=course.reached_in_s(forecast.boiling, PROBABILITIES[1]),
        )
        corners = {c.name: c.record for c in self._corners}
        self._car = replace(self._car, corners=corners)

    def _published(self, instant: Instant) -> CarRisk:
        """Return the record with levels as the estimate allows them.

        The same object as long as nothing changes.
        """
        codes = tuple(instant.validity(c.name) for c in self._corners)
        if self._last_published is not None:
            (car, of), published = self._last_published
            if car is self._car and of == codes:
                return published
        corners = {}
        for corner, code in zip(self._corners, codes, strict=True):
            level = published_level(corner.level.level, code)
            corners[corner.name] = replace(
                corner.record,
                level=level,
                sure_level=level,
                fade=published_level(corner.fade.level, code),
            )
        worst = max(codes, default=Validity.INVALID)
        level = published_level(self._level.level, worst)
        if level is RiskLevel.UNKNOWN:
            # one corner without an estimate does not hide a raised level
            raised = [
                c.level
                for c in corners.values()
                if c.level not in {RiskLevel.NORMAL, RiskLevel.UNKNOWN}
            ]
            level = max(raised, default=RiskLevel.UNKNOWN)
        published = replace(self._car, level=level, corners=corners)
        self._last_published = (self._car, codes), published
        return published

    def look_back(
        self, saved: SavedState, parked_s: float, now_us: int
    ) -> None:
        """Compute the probability of vapour while the computer was off."""
        states = saved.corners
        if self._is_bound:
            states = states | saved.start_bound
        ambient_k = saved.ambient_k
        if ambient_k is None:
            ambient_k = self._ambient_k
        boiling = self._fluid.boiling(now_us)
        series = []
        for corner in self._corners:
            program = self._programs[corner.name]
            values = states.get(corner.name, {})
            if not values.keys() >= set(program.state_names):
                continue
            state = [values[key] for key in program.state_names]
            corner.march = corner.march.of(program)
            course = parked_course(
                corner.ensemble, self._kernel, state, ambient_k, factor=1.0
            )
            peaks = course.peaks_k(parked_s)
            corner.level.by_probability(
                boiling.mean_probability(peaks), now_us
            )
            series.append(peaks)
        self.away = boiling.mean_probability(_hottest(series))
        self._level.by_probability(self.away, now_us)

    def memories(self) -> dict[str, LevelMemory]:
        """Return the levels that go over a restart, by name."""
        found = {"car": self._level}
        for corner in self._corners:
            found[f"{corner.name}.fluid"] = corner.level
            found[f"{corner.name}.fade"] = corner.fade
        return found


def _hottest(series: Sequence[Sequence[float]]) -> list[float]:
    """Return the hottest corner of each member; *series* one a corner."""
    return [max(values) for values in zip(*series, strict=True)]

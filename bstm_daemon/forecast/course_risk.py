"""Risk and forecast along one course of temperatures.

The course is the estimate, or the hot bound of an unknown start. Everything
happens on the grid of data time, so a recording gives the same risk as the
bus it was recorded on, to the last byte, however the stream is cut: once a
second the present risk, every :data:`GRID_US` and when the car stops a
forecast, computed in portions of half a corner a publication.
"""

from __future__ import annotations

from math import isnan, nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.estimate import CarRisk, Reason, RiskLevel, Validity
from bstm_daemon.estimator.blocks import validity_of
from bstm_daemon.forecast.car_forecast import Car, CarForecast, Corner, hottest
from bstm_daemon.forecast.corner_march import NOTHING_K, Start
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
    HORIZON_S,
    PARKED_STEPS,
    Duty,
    DutyCourse,
    parked_course,
)
from bstm_daemon.forecast.members import DEGRADED_FACTOR, Spread
from bstm_daemon.model.risk.levels import (
    PROBABILITIES,
    LevelMemory,
    published_level,
)
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimator.blocks import Block, Instant
    from bstm_daemon.estimator.estimator import Estimator
    from bstm_daemon.estimator.memory import SavedState
    from bstm_daemon.forecast.corner_march import CornerMarch
    from bstm_daemon.forecast.fluid import FluidKnowledge
    from bstm_daemon.forecast.march import Course
    from bstm_daemon.model.risk.vaporisation import Boiling

SECOND_US: Final = 1_000_000
GRID_US: Final = 10 * SECOND_US
"""Interval of the forecasts, in data time."""

PYTHON_MEMBERS: Final = 8
"""Number of members without the compiled kernel."""

PYTHON_STEPS: Final = 1
COMPILED_STEPS: Final = 50
"""Steps of an ensemble marched a publication: half a corner with the
compiled kernel; without it one, so that no publication waits. Corners as
they are estimated take as much time."""

REFRESH_US: Final = 120 * SECOND_US
"""Interval at which the members of a hot bound are marched, as long as vapour
is likely, where no level needs it: to know when it is safe."""

DROVE_MS: Final = 2.0
STOPPED_MS: Final = 0.3
"""Below this speed a car that has driven faster has stopped."""

GAP_US: Final = 2 * SECOND_US
"""After a longer gap of publications the monitor starts again."""


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

        *beside* is that of the estimate, if this one is of the hot bound:
        ensembles and duty are the same. It is to be advanced before.
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
        self._programs = estimator.programs
        of_estimate = {} if beside is None else beside.corners()
        self._corners: list[Corner] = []
        self._level = LevelMemory()
        self._marched = Car(
            *(self._corners, [*of_estimate.values()]),
            # corners of one structure are marched together
            [group.corners for group in estimator.layout.groups],
            self._programs,
            self._kernel,
            self._level,
            self.members,
            {
                one: Spread().scaled(config.uncertainty_of(one))
                for one in estimator.programs
            },
            {},
        )
        for name in estimator.layout.corners:
            if (program := estimator.programs.get(name)) is not None:
                other = of_estimate.get(name)
                duty = Duty(program) if other is None else other.duty
                march = self._marched.march_of(name)
                self._corners.append(Corner(name, program, march, duty))
        self._forecast: CarForecast | None = None
        self._forecast_us: int | None = None
        self._last_us: int | None = None
        self._drove = False
        self._stopped = False
        self._car = CarRisk(members=self.members)
        self._ahead = nan
        self.away = nan
        """Probability that vapour formed while the computer was off."""
        self._block: Block | None = None
        self._codes: tuple[int, ...] = ()
        """The corners' validity at the last publication; that of all of
        ``_block`` is ``_codes_of``."""
        self._codes_of: list[tuple[int, ...]] = []
        self._speeds_ms: Sequence[float] = ()
        self._published: CarRisk | None = None
        self._raising: list[CornerMarch] = []

    def peaks_k(self) -> dict[str, tuple[float, ...]]:
        """Return each corner's peaks [K] if the car parks, one a member.

        They are of the last forecast, empty before the first; members of
        one number belong together.
        """
        return {c.name: tuple(c.peaks_k) for c in self._corners}

    def corners(self) -> dict[str, Corner]:
        """Return the memory of each corner."""
        return {corner.name: corner for corner in self._corners}

    def advance(
        self, instant: Instant, share: int = 1, *, duty: bool = True
    ) -> CarRisk:
        """Return the risk at *instant*, the next publication.

        Args:
            instant: the publication.
            share: divides the part of a forecast that is computed.
            duty: whether it goes on to what comes if the duty continues.
        """
        block, i = instant
        time_us = block.times_us[i]
        if self._last_us is None or not (
            0 < time_us - self._last_us <= GAP_US
        ):
            self._begin_anew()
        self._last_us = time_us
        if block is not self._block:
            self._look_at(block)
        speed_ms = self._speeds_ms[i]
        stopped = self._drove and speed_ms < STOPPED_MS
        self._drove = (self._drove and not stopped) or speed_ms > DROVE_MS
        first = self._forecast is None and self._forecast_us is None
        if time_us % SECOND_US == 0 or first:
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
        steps = max(self._steps // share, 1)
        if at_stop or due or first:
            self._begin(instant, steps, at_stop=at_stop)
        if self._forecast is not None:
            self._work(self._forecast, steps, duty=duty)
        elif self._raising and not self._raising[0].work_ahead(steps):
            del self._raising[0]
        codes = self._codes_of[i]
        if self._published is None or codes != self._codes:
            self._codes = codes
            self._published = self._record([*map(validity_of, codes)])
        return self._published

    def _look_at(self, block: Block) -> None:
        """Take what each publication of *block* asks for, once."""
        of = [block.validity[corner.name] for corner in self._corners]
        self._block, self._codes_of = block, [*zip(*of, strict=True)]
        self._speeds_ms = block.each("speed_ms")

    def _begin_anew(self) -> None:
        """Drop the forecast after a gap; levels fall as usual."""
        self._forecast, self._forecast_us = None, None
        self._ahead, self._stopped = nan, False
        self._published = None
        for corner in self._corners:
            corner.forget()
            if not self._is_bound:
                corner.duty.restart()

    def _update_now(self, instant: Instant) -> None:
        """Update the present risk."""
        boiling = self._fluid.boiling(instant.time_us)
        # corners of an axle are mostly alike
        found: dict[tuple[float, float], tuple[list[float], float]] = {}
        for corner in self._corners:
            name, time_us = corner.name, instant.time_us
            if not self._is_bound:
                corner.duty.add(instant, name)
            disc_k, front_k, _, fluid_k = instant.shown_k(
                name, hottest=self._is_bound
            )
            deviation_k = corner.ensemble.fluid_deviation_k(
                fluid_k,
                instant.channel(name, "ambient_k"),
                self._factor(instant, name),
            )
            if (fluid_k, deviation_k) not in found:
                found[fluid_k, deviation_k] = corner.ensemble.now(
                    fluid_k, deviation_k, boiling
                )
            corner.now_k, corner.now = found[fluid_k, deviation_k]
            corner.deviation_k = deviation_k
            corner.level.by_probability(corner.probability, time_us)
            corner.fade.by_temperatures(
                (disc_k, front_k), self._limits, time_us
            )
        self._update_car(boiling, instant.time_us)

    def _update_car(self, boiling: Boiling, time_us: int) -> None:
        now = self._now(boiling)
        probability = now if isnan(self._ahead) else max(now, self._ahead)
        self._level.by_probability(probability, time_us)
        self._car = CarRisk(
            probability,
            now,
            RiskLevel.UNKNOWN,
            boiling.quantile(0.5),
            boiling.quantile(0.01),
            self._fluid.water.median_percent,
            self._forecast_us,
            self.members,
        )
        self._published = None

    def _now(self, boiling: Boiling) -> float:
        """Return the mean over the draws with the hottest corner of each.

        A corner is linear in the draw: one that is the hottest at both ends
        is so for all of them.
        """
        ends = self._corners[0].ensemble.draw_ends if self._corners else ()
        for one in self._corners:
            if all(
                one.now_k[end] >= other.now_k[end]
                for other in self._corners
                for end in ends
            ):
                return one.now
        return boiling.mean_probability(
            hottest([corner.now_k for corner in self._corners])
        )

    def _factor(self, instant: Instant, corner: str) -> float:
        """Return how much less certain *corner* is than a valid estimate."""
        # the bound is as high already as the start may make it
        is_bounded = (
            self._is_bound and instant.reasons(corner) is Reason.START_UNKNOWN
        )
        is_valid = instant.validity(corner) is Validity.VALID
        return 1.0 if is_valid or is_bounded else DEGRADED_FACTOR

    def _begin(self, instant: Instant, steps: int, *, at_stop: bool) -> None:
        self._stopped = self._stopped and not at_stop
        boiling = self._fluid.boiling(instant.time_us)
        starts = []
        for corner in self._corners:
            name = corner.name
            width = len(corner.ensemble.program.state_names)
            output = instant.output(name, hottest=self._is_bound)
            air_k = instant.channel(name, "ambient_k")
            duty = corner.duty.conditions(air_k)
            factor = self._factor(instant, name)
            starts.append(Start(output[:width], duty, factor, boiling))
        ranges = [
            corner.march.range_k(
                start, is_present=self._marched.is_present(corner)
            )
            for corner, start in zip(self._corners, starts, strict=True)
        ]
        if not self._is_bound:
            # of what is published itself the members count, or is no vapour
            ranges = [
                one._replace(least_k=NOTHING_K * self.members)
                if instant.start_known(corner.name)
                else one
                for corner, one in zip(self._corners, ranges, strict=True)
            ]
        self._forecast = CarForecast(
            *(self._marched, instant.time_us, starts, ranges, boiling),
            at_stop=at_stop,
            wait=self._portions(PARKED_STEPS, steps),
        )
        self._forecast.begin_parked()

    def _work(self, forecast: CarForecast, steps: int, *, duty: bool) -> None:
        """Compute one publication's portion of *forecast*."""
        forecast.wait -= 1
        for _, job in forecast.estimates:
            job.advance(max(steps * self.members // job.lanes, 1))
        if not forecast.published:
            forecast.march_members(steps)
            if (
                forecast.wait < 0
                and not forecast.places
                and forecast.estimates_finished
            ):
                self._commit(forecast)
                forecast.wait = self._portions(DUTY_STEPS, steps)
                if duty:
                    forecast.begin_duty()
                else:
                    self._forecast = None
            return
        if forecast.estimates_finished:
            if forecast.estimates:
                self._commit_duty(forecast)
                forecast.estimates = []
            if forecast.wait <= 0:
                self._forecast = None

    def _portions(self, march: Sequence[float], steps: int) -> int:
        """Return how many publications the members of all corners take."""
        return len(self._corners) * -(-len(march) // steps)

    def _commit(self, forecast: CarForecast) -> None:
        """Publish the forecast if the car parks."""
        forecast.published = True
        boiling = forecast.boiling
        self._forecast_us = forecast.time_us
        estimates = forecast.courses()
        for place, corner in enumerate(self._corners):
            course = forecast.marched.get(place)
            known = forecast.ranges[place]
            corner.ahead = forecast.most(place)
            if course is None:
                # the estimate alone stands for each of its members
                (course,) = estimates[corner.name]
                corner.peaks_k = course.peaks_k(HORIZON_S) * self.members
            else:
                corner.peaks_k = known.most_k
            unlikely = corner.ahead < PROBABILITIES[0]
            corner.parked = (
                *course.peak(HORIZON_S),
                0.0 if unlikely else known.safe_in_s,
            )
            corner.level.by_probability(corner.probability, forecast.time_us)
            self._raise_ceiling(forecast, place)
        # a bound may be above what the estimate alone says; a nan stays
        self._ahead = forecast.most(None)
        self._update_car(boiling, forecast.time_us)

    def _raise_ceiling(self, forecast: CarForecast, place: int) -> None:
        """Let later forecasts do without a march of corner *place*.

        As long as it may be, or at times to know when it will be safe.
        """
        corner, time_us = self._corners[place], forecast.time_us

        leasts = [
            (level, forecast.boiling.mean_probability(least_k))
            for level, least_k in (
                (corner.level, forecast.least_k[place]),
                (self._level, hottest(forecast.least_k)),
            )
        ]

        def is_of_use(probability: float) -> bool:
            # the car may have another, hotter corner
            return all(
                level.is_sure(least, max(least, probability))
                for level, least in leasts
            )

        of = forecast.starts[place], forecast.ranges[place].most_k
        raised_us = corner.march.raised_us
        if (
            place in forecast.marched
            and corner.march.raise_ceiling(*of, is_of_use)
        ) or (
            self._is_bound
            and not corner.ahead < PROBABILITIES[0]
            and (raised_us is None or time_us - raised_us >= REFRESH_US)
            and corner.march.raise_ceiling(*of, None)
        ):
            corner.march.raised_us = time_us
            self._raising.append(corner.march)

    def _commit_duty(self, forecast: CarForecast) -> None:
        """Publish the forecast if the duty continues."""
        lanes = forecast.courses()
        for corner, start in zip(self._corners, forecast.starts, strict=True):
            if corner.name in lanes:
                corner.on_duty = _on_duty(corner, start, *lanes[corner.name])
        self._published = None

    def _record(self, codes: list[Validity]) -> CarRisk:
        """Return the record with levels as the estimate allows them."""
        corners = {
            corner.name: corner.record(code)
            for corner, code in zip(self._corners, codes, strict=True)
        }
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
        return self._car._replace(level=level, corners=corners)

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
            self._marched.refit(corner)
            course = parked_course(
                corner.ensemble, self._kernel, state, ambient_k, factor=1.0
            )
            peaks = course.peaks_k(parked_s)
            corner.level.by_probability(
                boiling.mean_probability(peaks), now_us
            )
            series.append(peaks)
        self.away = boiling.mean_probability(hottest(series))
        self._level.by_probability(self.away, now_us)

    def memories(self) -> dict[str, LevelMemory]:
        """Return the levels that go over a restart, by name."""
        found = {"car": self._level}
        for corner in self._corners:
            found[f"{corner.name}.fluid"] = corner.level
            found[f"{corner.name}.fade"] = corner.fade
        return found


def _on_duty(
    corner: Corner, start: Start, braked: Course, free: Course
) -> tuple[float, float]:
    """Return peak [K] and time to vapour [s] of a duty from *start*.

    *braked* is the estimate's course and *free* that without its power.
    """
    with_k, without_k = braked.fluid_k[0], free.fluid_k[0]

    def std_k(place: int) -> float:
        return corner.ensemble.duty_deviation_k(
            without_k[place] - start.duty.ambient_k,
            with_k[place] - without_k[place],
            start.factor,
        )

    course = DutyCourse(braked.times_s, with_k, std_k)
    return (
        braked.peak(HORIZON_S)[0],
        course.reached_in_s(
            start.boiling, corner.ensemble.now_draws, PROBABILITIES[1]
        ),
    )

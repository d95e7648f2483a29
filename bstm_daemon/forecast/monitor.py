"""Risk monitor: risk and forecast at each publication, live and in replay.

:class:`RiskMonitor` takes the estimator's blocks and gives a
:class:`CarRisk` a publication. Everything in it happens on the grid of data
time, so a recording gives the same risk as the bus it was recorded on, to
the last byte, however the stream is cut: once a second the present risk,
every :data:`GRID_US` and when the car stops a forecast, computed in portions
of half a corner a publication.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isnan, nan
from typing import TYPE_CHECKING, Any, Final

from pydantic import Field, ValidationError

from bstm_daemon.estimate import CarRisk, CornerRisk, RiskLevel, Validity
from bstm_daemon.estimator.memory import Int64, Saved, SavedState, checked
from bstm_daemon.forecast.fluid import (
    CHANGED_ROLE,
    WATER_ROLE,
    FluidKnowledge,
    SavedFluid,
)
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
    HORIZON_S,
    PARKED_STEPS,
    Conditions,
    Duty,
    Job,
    parked_course,
)
from bstm_daemon.forecast.members import DEGRADED_FACTOR, Ensemble, Spread
from bstm_daemon.model.risk.levels import (
    PROBABILITIES,
    LevelMemory,
    published_level,
)
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimator.blocks import Block, Instant
    from bstm_daemon.estimator.estimator import Estimator, Floats, Ints
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
compiled kernel; without it one, so that no publication waits."""

DROVE_MS: Final = 2.0
STOPPED_MS: Final = 0.3
"""Below this speed a car that has driven faster has stopped."""

FLUID_ROLES: Final = (CHANGED_ROLE, WATER_ROLE)

GAP_US: Final = 2 * SECOND_US
"""After a longer gap of publications the monitor starts again."""


class SavedRisk(Saved):
    """Result of :meth:`RiskMonitor.export`."""

    fluid: SavedFluid | None = None
    levels: dict[str, tuple[RiskLevel, Int64 | None]] = Field(
        default_factory=dict
    )

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> SavedRisk:
        """Return the one in the state *document*; empty if it is not valid."""
        try:
            return cls.model_validate(document.get("risk"))
        except ValidationError:
            return cls()


@dataclass(slots=True)
class _Corner:
    """A corner's memory and its forecast."""

    name: str
    ensemble: Ensemble
    duty: Duty
    level: LevelMemory = field(default_factory=LevelMemory)
    fade: LevelMemory = field(default_factory=LevelMemory)
    record: CornerRisk = field(default_factory=CornerRisk)
    peaks_k: list[float] = field(default_factory=list)
    ahead: float = nan
    now_k: list[float] = field(default_factory=list)


@dataclass(slots=True)
class _Forecast:
    """A forecast in progress, spread over several publications.

    ``states`` and the like are one a corner; ``at_stop``: the car had just
    stopped. ``index`` counts corners that are done, first all of them parked,
    which is ``published`` then, then all with the duty.
    """

    time_us: int
    states: list[Sequence[float]]
    conditions: list[Conditions]
    factors: list[float]
    boiling: Boiling
    at_stop: bool
    index: int = 0
    published: bool = False
    job: Job | None = None
    parked: list[Course] = field(default_factory=list)


class RiskMonitor:
    """Risk and forecast of one car."""

    def __init__(self, config: Config, estimator: Estimator) -> None:
        """Watch *estimator* of the car *config*."""
        self._kernel = load_kernel()
        compiled = self._kernel is not None
        self.members = config.forecast.members if compiled else PYTHON_MEMBERS
        self._steps = COMPILED_STEPS if compiled else PYTHON_STEPS
        self.fluid = FluidKnowledge(config.fluid)
        self._samples: list[tuple[int, int, float]] = []
        self._limits = [
            [c + KELVIN_OFFSET for c in config.forecast.disc_limits_c],
            [c + KELVIN_OFFSET for c in config.forecast.pad_limits_c],
        ]
        self._ambient_k = config.vehicle.ambient_c + KELVIN_OFFSET
        spread = Spread().scaled(config.forecast.uncertainty)
        self._programs = estimator.programs
        self._corners = [
            _Corner(
                name,
                Ensemble(program, self.members, spread),
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
            tuple[tuple[CarRisk, tuple[Validity, ...], bool], CarRisk] | None
        ) = None

    def ingest(self, times_us: Ints, roles: Ints, values: Floats) -> None:
        """Take samples that the estimator is about to get.

        Only those of the fluid matter; each holds from its stamp on.
        """
        # columns of a replay; the live service does without NumPy's 15 MiB
        if hasattr(roles, "nonzero"):
            column: Any = roles
            (picked,) = (
                (column == FLUID_ROLES[0]) | (column == FLUID_ROLES[1])
            ).nonzero()
        else:
            picked = [i for i, one in enumerate(roles) if one in FLUID_ROLES]
        self._samples += [
            (int(times_us[i]), int(roles[i]), float(values[i])) for i in picked
        ]

    def peaks_k(self) -> dict[str, tuple[float, ...]]:
        """Return each corner's peaks [K] if the car parks, one a member.

        They are of the last forecast, empty before the first; members of
        one number belong together.
        """
        return {c.name: tuple(c.peaks_k) for c in self._corners}

    def add(self, block: Block) -> list[CarRisk]:
        """Return the risk at each publication of *block*."""
        return [self._advance(block.at(i)) for i in range(len(block.times_us))]

    def _advance(self, instant: Instant) -> CarRisk:
        time_us = instant.time_us
        if self._last_us is None or not (
            0 < time_us - self._last_us <= GAP_US
        ):
            self._begin_anew()
        self._last_us = time_us
        while self._samples and self._samples[0][0] <= time_us:
            self.fluid.ingest(*self._samples.pop(0))
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
        if self._forecast is not None:
            self._work(self._forecast)
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
        boiling = self.fluid.boiling(instant.time_us)
        for corner in self._corners:
            name, time_us = corner.name, instant.time_us
            corner.duty.add(instant, name)
            state = instant.state(name)
            deviation_k = corner.ensemble.fluid_deviation_k(
                state["fluid"],
                instant.channel(name, "ambient_k"),
                _factor(instant.validity(name)),
            )
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
            water_percent=self.fluid.water.median_percent,
            forecast_us=self._forecast_us,
            members=self.members,
            corners={c.name: c.record for c in self._corners},
        )

    def _begin(self, instant: Instant, *, at_stop: bool) -> None:
        self._stopped = self._stopped and not at_stop
        names = [corner.name for corner in self._corners]
        self._forecast = _Forecast(
            instant.time_us,
            [list(instant.state(name).values()) for name in names],
            [
                c.duty.conditions(instant.channel(c.name, "ambient_k"))
                for c in self._corners
            ],
            [_factor(instant.validity(name)) for name in names],
            self.fluid.boiling(instant.time_us),
            at_stop,
        )

    def _work(self, forecast: _Forecast) -> None:
        """Compute one publication's portion of *forecast*."""
        count = len(self._corners)
        if forecast.index == count and not forecast.published:
            self._commit(forecast)
            return
        place = forecast.index % count
        corner = self._corners[place]
        parked = forecast.index < count
        if forecast.job is None:
            program = self._programs[corner.name]
            if corner.ensemble.program is not program:
                # as much work as a portion of forecast: in its own publication
                corner.ensemble = corner.ensemble.of(program)
                return
            conditions = forecast.conditions[place]
            if parked:
                conditions = Conditions(conditions.ambient_k)
            forecast.job = Job(
                corner.ensemble,
                self._kernel,
                forecast.states[place],
                conditions,
                PARKED_STEPS if parked else DUTY_STEPS,
                factor=forecast.factors[place],
            )
        forecast.job.advance(self._steps)
        if not forecast.job.finished:
            return
        course = forecast.job.course()
        forecast.job = None
        forecast.index += 1
        if parked:
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
        for corner, course in zip(self._corners, forecast.parked, strict=True):
            corner.peaks_k = course.peaks_k(HORIZON_S)
            corner.ahead = boiling.mean_probability(corner.peaks_k)
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
        self._ahead = boiling.mean_probability(
            _hottest([c.peaks_k for c in self._corners])
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
        known = instant.history_known
        codes = tuple(instant.validity(c.name) for c in self._corners)
        key = self._car, codes, known
        if self._last_published is not None:
            (car, *rest), published = self._last_published
            if car is self._car and rest == [codes, known]:
                return published
        corners = {
            corner.name: replace(
                corner.record,
                level=published_level(
                    corner.level.level, code, history_known=known
                ),
                fade=published_level(
                    corner.fade.level, code, history_known=known
                ),
            )
            for corner, code in zip(self._corners, codes, strict=True)
        }
        worst = max(codes, default=Validity.INVALID)
        level = published_level(self._level.level, worst, history_known=known)
        if level is RiskLevel.UNKNOWN:
            # one corner without an estimate does not hide a raised level
            raised = [
                c.level
                for c in corners.values()
                if c.level not in {RiskLevel.NORMAL, RiskLevel.UNKNOWN}
            ]
            level = max(raised, default=RiskLevel.UNKNOWN)
        published = replace(self._car, level=level, corners=corners)
        self._last_published = key, published
        return published

    def export(self) -> dict[str, Any]:
        """Return the memory as plain values, for the state file."""
        return {
            "fluid": self.fluid.export(),
            "levels": {
                name: [int(memory.level), memory.below_since_us]
                for name, memory in self._memories().items()
            },
        }

    def resume(
        self, document: Mapping[str, Any], parked_us: int | None, now_us: int
    ) -> None:
        """Continue from *document*, a state that the estimator has restored.

        Call it before the first publication; an unreadable risk is ignored.

        Args:
            document: the state.
            parked_us: time since the save [us], None where it is not known;
                vapour may have formed meanwhile.
            now_us: time now on the axis of the stamps [us].
        """
        saved = SavedRisk.of(document)
        if saved.fluid is not None:
            self.fluid.resume(saved.fluid)
        for name, memory in self._memories().items():
            level, since_us = saved.levels.get(name, (RiskLevel.UNKNOWN, None))
            if level is not RiskLevel.UNKNOWN:
                memory.level, memory.below_since_us = level, since_us
        if parked_us is not None and parked_us > 0:
            self.look_back(document, parked_us, now_us)

    def look_back(
        self, document: Mapping[str, Any], parked_us: int, now_us: int
    ) -> None:
        """Compute the probability of vapour while the computer was off.

        Args:
            document: the state that was saved before.
            parked_us: time since the save [us].
            now_us: time now on the axis of the stamps [us].
        """
        saved = checked(SavedState, document)
        ambient_k = saved.ambient_k
        if ambient_k is None:
            ambient_k = self._ambient_k
        boiling = self.fluid.boiling(now_us)
        series = []
        for corner in self._corners:
            program = self._programs[corner.name]
            values = saved.corners.get(corner.name, {})
            if not values.keys() >= set(program.state_names):
                continue
            state = [values[key] for key in program.state_names]
            corner.ensemble = corner.ensemble.of(program)
            course = parked_course(
                corner.ensemble, self._kernel, state, ambient_k, factor=1.0
            )
            peaks = course.peaks_k(parked_us * 1e-6)
            corner.level.by_probability(
                boiling.mean_probability(peaks), now_us
            )
            series.append(peaks)
        self.away = boiling.mean_probability(_hottest(series))
        self._level.by_probability(self.away, now_us)

    def _memories(self) -> dict[str, LevelMemory]:
        found = {"car": self._level}
        for corner in self._corners:
            found[f"{corner.name}.fluid"] = corner.level
            found[f"{corner.name}.fade"] = corner.fade
        return found


def _hottest(series: Sequence[Sequence[float]]) -> list[float]:
    """Return the hottest corner of each member; *series* one a corner."""
    return [max(values) for values in zip(*series, strict=True)]


def _factor(validity: Validity) -> float:
    return 1.0 if validity == Validity.VALID else DEGRADED_FACTOR

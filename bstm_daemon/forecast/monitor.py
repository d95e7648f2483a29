"""Risk and forecast along the publications, live and in replay alike.

:class:`RiskMonitor` takes the estimator's blocks and gives a
:class:`CarRisk` a publication. Everything in it happens on the grid of data
time, so a recording gives the same risk as the bus it was recorded on, to
the last byte, and however a stream is cut: once a second the risk of now,
every :data:`GRID_US` and when the car stops a forecast, half a corner of it a
publication.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isnan, nan
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.forecast.duty import Duty
from bstm_daemon.forecast.fluid import (
    CHANGED_ROLE,
    WATER_ROLE,
    FluidKnowledge,
)
from bstm_daemon.forecast.likelihood import hottest, likelihood
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
    HORIZON_S,
    PARKED_STEPS,
    Conditions,
    Job,
)
from bstm_daemon.forecast.members import DEGRADED_FACTOR, Ensemble, Spread
from bstm_daemon.forecast.records import CarRisk, CornerRisk
from bstm_daemon.forecast.under_way import UnderWay
from bstm_daemon.heat.sample_plan import CHANNELS, VEHICLE_CHANNELS
from bstm_daemon.native import load_kernel
from bstm_daemon.risk.levels import (
    PROBABILITIES,
    Level,
    LevelMemory,
    published_level,
)
from bstm_daemon.units import KELVIN_OFFSET
from bstm_daemon.validity import DEGRADED, INVALID, VALID

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.config import Config
    from bstm_daemon.estimator import Block, Estimator, Floats, Ints
    from bstm_daemon.forecast.march import Course
    from bstm_daemon.risk.vaporisation import Boiling

SECOND_US: Final = 1_000_000
GRID_US: Final = 10 * SECOND_US
"""A forecast begins on whole multiples of this in data time."""

PYTHON_MEMBERS: Final = 8
"""Members without the compiled kernel."""

PYTHON_STEPS: Final = 1
COMPILED_STEPS: Final = 50
"""Steps of an ensemble marched a publication: half a corner with the
compiled kernel; without it one, so that no publication waits."""

DROVE_MS: Final = 2.0
STOPPED_MS: Final = 0.3
"""A car that drove faster and is now slower has stopped."""

HEARD: Final = (CHANGED_ROLE, WATER_ROLE)

GAP_US: Final = 2 * SECOND_US
"""After such a gap of publications everything begins anew."""


@dataclass(slots=True)
class _Corner:
    """A corner's place in the blocks, its memory and its forecast."""

    name: str
    group: int
    member: int
    place: int
    ensemble: Ensemble
    duty: Duty
    level: LevelMemory = field(default_factory=LevelMemory)
    fade: LevelMemory = field(default_factory=LevelMemory)
    record: CornerRisk = field(default_factory=CornerRisk)
    peaks_k: list[float] = field(default_factory=list)
    ahead: float = nan
    now_k: list[float] = field(default_factory=list)


class RiskMonitor:
    """Risk and forecast of one car."""

    def __init__(self, config: Config, estimator: Estimator) -> None:
        """Watch *estimator* of the car *config*."""
        self._kernel = load_kernel()
        compiled = self._kernel is not None
        self.members = config.forecast.members if compiled else PYTHON_MEMBERS
        self._steps = COMPILED_STEPS if compiled else PYTHON_STEPS
        self.fluid = FluidKnowledge(config.fluid)
        self._heard: list[tuple[int, int, float]] = []
        self._limits = [
            [c + KELVIN_OFFSET for c in config.forecast.disc_limits_c],
            [c + KELVIN_OFFSET for c in config.forecast.pad_limits_c],
        ]
        spread = Spread().scaled(config.forecast.uncertainty)
        self._groups = estimator.groups
        self._programs = estimator.programs
        order = estimator.plan.corners
        corners = [
            _Corner(
                name,
                number,
                member,
                order.index(name),
                Ensemble(estimator.programs[name], self.members, spread),
                Duty(estimator.programs[name], group.size),
            )
            for number, group in enumerate(self._groups)
            for member, name in enumerate(group.corners)
        ]
        self._corners = sorted(corners, key=lambda c: c.place)
        self._level = LevelMemory()
        self._forecast: UnderWay | None = None
        self._forecast_us: int | None = None
        self._last_us: int | None = None
        self._drove = False
        self._stopped = False
        self._car = CarRisk(members=self.members)
        self._ahead = nan
        self.away = nan
        """Probability that vapour formed while the computer was off."""
        self._said: tuple[CarRisk, tuple[int, ...], bool, CarRisk] | None = (
            None
        )

    def hear(self, times_us: Ints, roles: Ints, values: Floats) -> None:
        """Take samples that the estimator is about to get.

        Only those of the fluid matter; each holds from its stamp on.
        """
        # columns of a replay; the live service does without NumPy's 15 MiB
        if hasattr(roles, "nonzero"):
            column: Any = roles
            (picked,) = ((column == HEARD[0]) | (column == HEARD[1])).nonzero()
        else:
            picked = [i for i, role in enumerate(roles) if role in HEARD]
        self._heard += [
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
        found = []
        for i, time_us in enumerate(block.times_us):
            self._pass(block, i, time_us)
            found.append(self._published(block, i))
        return found

    def _pass(self, block: Block, i: int, time_us: int) -> None:
        if self._last_us is None or not (
            0 < time_us - self._last_us <= GAP_US
        ):
            self._begin_anew()
        self._last_us = time_us
        while self._heard and self._heard[0][0] <= time_us:
            self.fluid.hear(*self._heard.pop(0))
        speed_ms = block.vehicle[i * len(VEHICLE_CHANNELS)]
        stopped = self._drove and speed_ms < STOPPED_MS
        self._drove = (self._drove and not stopped) or speed_ms > DROVE_MS
        whole = time_us % SECOND_US == 0
        first = self._forecast is None and self._forecast_us is None
        if whole or first:
            self._second(block, i, time_us)
        due = self._forecast is None and time_us % GRID_US == 0
        self._stopped = self._stopped or stopped
        under_way = self._forecast
        # what comes of an earlier stop is said first: in slow traffic and
        # pure Python there would be no forecast else
        parks = under_way is not None and under_way.parks
        at_stop = self._stopped and not parks
        if at_stop or due or first:
            self._begin(block, i, time_us, at_stop=at_stop)
        if self._forecast is not None:
            self._work(self._forecast)

    def _begin_anew(self) -> None:
        """Forget what was foreseen before a gap; levels fall as usual."""
        self._forecast, self._forecast_us = None, None
        self._ahead, self._stopped = nan, False
        for corner in self._corners:
            corner.duty.restart()
            corner.peaks_k, corner.ahead = [], nan
            corner.record = CornerRisk()

    def _state(self, block: Block, i: int, corner: _Corner) -> list[float]:
        group = self._groups[corner.group]
        first = (i * len(group.corners) + corner.member) * group.size
        wide = len(group.state_names)
        return block.outputs[corner.group][first : first + wide].tolist()

    def _row(self, block: Block, i: int, corner: _Corner) -> Sequence[float]:
        corners = len(block.rows) // (len(block.times_us) * len(CHANNELS))
        first = (i * corners + corner.place) * len(CHANNELS)
        return block.rows[first : first + len(CHANNELS)]

    def _second(self, block: Block, i: int, time_us: int) -> None:
        """Update what is known of now."""
        boiling = self.fluid.boiling(time_us)
        for corner in self._corners:
            group = self._groups[corner.group]
            first = (i * len(group.corners) + corner.member) * group.size
            output = block.outputs[corner.group]
            row = self._row(block, i, corner)
            corner.duty.add(time_us, row, output, first)
            nodes = output[first : first + group.nodes]
            state = dict(zip(group.state_names, nodes, strict=False))
            ambient_k = row[CHANNELS.index("ambient_k")]
            factor = _factor(block.validity[corner.name][i])
            deviation_k = corner.ensemble.fluid_deviation_k(
                state["fluid"], ambient_k, factor
            )
            corner.now_k = [
                state["fluid"] + deviation_k * draw
                for draw in corner.ensemble.now_draws
            ]
            now = likelihood(boiling, corner.now_k)
            probability = (
                now if isnan(corner.ahead) else max(now, corner.ahead)
            )
            corner.level.by_probability(probability, time_us)
            corner.fade.by_temperatures(
                (state["disc"], state["pad_front"]), self._limits, time_us
            )
            corner.record = replace(
                corner.record,
                deviation_k=deviation_k,
                probability_now=now,
                probability=probability,
            )
        self._tell_car(boiling, time_us)

    def _tell_car(self, boiling: Boiling, time_us: int) -> None:
        now = likelihood(boiling, hottest([c.now_k for c in self._corners]))
        probability = now if isnan(self._ahead) else max(now, self._ahead)
        self._level.by_probability(probability, time_us)
        self._car = CarRisk(
            now,
            probability,
            Level.UNKNOWN,
            boiling.quantile(0.01),
            boiling.quantile(0.5),
            self.fluid.water.median_percent,
            self._forecast_us,
            self.members,
            {c.name: c.record for c in self._corners},
        )

    def _begin(
        self, block: Block, i: int, time_us: int, *, at_stop: bool
    ) -> None:
        conditions = []
        self._stopped = self._stopped and not at_stop
        for corner in self._corners:
            row = self._row(block, i, corner)
            ambient_k = row[CHANNELS.index("ambient_k")]
            conditions.append(corner.duty.conditions(ambient_k))
        self._forecast = UnderWay(
            time_us,
            [self._state(block, i, corner) for corner in self._corners],
            conditions,
            [_factor(block.validity[c.name][i]) for c in self._corners],
            self.fluid.boiling(time_us),
            at_stop,
        )

    def _work(self, forecast: UnderWay) -> None:
        """Do one publication's share of *forecast*."""
        count = len(self._corners)
        if forecast.index == count and not forecast.told:
            self._commit(forecast)
            return
        place = forecast.index % count
        corner = self._corners[place]
        parked = forecast.index < count
        if forecast.job is None:
            program = self._programs[corner.name]
            if corner.ensemble.program is not program:
                # as much work as a forecast: a publication of its own
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
                channels=CHANNELS,
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

    def _commit(self, forecast: UnderWay) -> None:
        """Publish what happens if the car parks."""
        forecast.told = True
        boiling = forecast.boiling
        self._forecast_us = forecast.time_us
        for corner, course in zip(self._corners, forecast.parked, strict=True):
            corner.peaks_k = course.peaks_k(HORIZON_S)
            corner.ahead = likelihood(boiling, corner.peaks_k)
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
        self._ahead = likelihood(
            boiling, hottest([c.peaks_k for c in self._corners])
        )
        self._tell_car(boiling, forecast.time_us)

    def _commit_duty(
        self, forecast: UnderWay, corner: _Corner, course: Course
    ) -> None:
        """Publish what happens to *corner* if its duty goes on."""
        corner.record = replace(
            corner.record,
            duty_peak_k=course.peak(HORIZON_S)[0],
            duty_in_s=course.reached_in_s(forecast.boiling, PROBABILITIES[1]),
        )
        corners = {c.name: c.record for c in self._corners}
        self._car = replace(self._car, corners=corners)

    def _published(self, block: Block, i: int) -> CarRisk:
        """Return the record with levels as the estimate allows them."""
        known = i >= block.known_from
        codes = tuple(block.validity[c.name][i] for c in self._corners)
        if self._said is not None:
            car, said_codes, said_known, said = self._said
            if (
                car is self._car
                and said_codes == codes
                and said_known == known
            ):
                return said
        corners = {
            corner.name: replace(
                corner.record,
                level=_allowed(corner.level.level, code, known=known),
                fade=_allowed(corner.fade.level, code, known=known),
            )
            for corner, code in zip(self._corners, codes, strict=True)
        }
        worst = max(codes, default=INVALID)
        level = _allowed(self._level.level, worst, known=known)
        if level is Level.UNKNOWN:
            # one corner without an estimate does not hide a raised level
            raised = [
                c.level
                for c in corners.values()
                if c.level not in {Level.NORMAL, Level.UNKNOWN}
            ]
            level = max(raised, default=Level.UNKNOWN)
        told = replace(self._car, level=level, corners=corners)
        self._said = (self._car, codes, known, told)
        return told

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
        self,
        document: object,
        states: Mapping[str, Sequence[float]] | None = None,
        air: tuple[float, float, int] | None = None,
    ) -> None:
        """Take back what :meth:`export` gave; what does not fit is left.

        Args:
            document: what :meth:`export` gave, or anything else.
            states: nodes [K] and memories of each corner at the save.
            air: its temperature [K], for how long the car stood in it since
                [s], and the time now [us]: vapour may have formed meanwhile.
        """
        self._take_back(document)
        if states is not None and air is not None and air[1] > 0.0:
            self._look_back(states, *air)

    def _look_back(
        self,
        states: Mapping[str, Sequence[float]],
        ambient_k: float,
        parked_s: float,
        now_us: int,
    ) -> None:
        """Find whether vapour formed while nobody watched."""
        boiling = self.fluid.boiling(now_us)
        series = []
        for corner in self._corners:
            state = states.get(corner.name)
            if state is None:
                continue
            program = self._programs[corner.name]
            corner.ensemble = corner.ensemble.of(program)
            job = Job(
                corner.ensemble,
                self._kernel,
                state,
                Conditions(ambient_k),
                PARKED_STEPS,
                channels=CHANNELS,
                factor=1.0,
            )
            job.advance(len(PARKED_STEPS))
            peaks = job.course().peaks_k(parked_s)
            corner.level.by_probability(likelihood(boiling, peaks), now_us)
            series.append(peaks)
        self.away = likelihood(boiling, hottest(series)) if series else nan
        self._level.by_probability(self.away, now_us)

    def _take_back(self, document: object) -> None:
        if not isinstance(document, dict):
            return
        fluid = document.get("fluid")
        if isinstance(fluid, dict):
            self.fluid.resume(fluid)
        levels = document.get("levels")
        if not isinstance(levels, dict):
            return
        for name, memory in self._memories().items():
            match levels.get(name):
                case [int(level), None | int() as since] if level in {
                    *range(Level.CRITICAL + 1)
                }:
                    memory.level = Level(level)
                    memory.below_since_us = since

    def _memories(self) -> dict[str, LevelMemory]:
        found = {"car": self._level}
        for corner in self._corners:
            found[f"{corner.name}.fluid"] = corner.level
            found[f"{corner.name}.fade"] = corner.fade
        return found


def _factor(validity: int) -> float:
    return 1.0 if validity == VALID else DEGRADED_FACTOR


def _allowed(level: Level, validity: int, *, known: bool) -> Level:
    usable = validity in {VALID, DEGRADED}
    return published_level(level, usable=usable, history_known=known)

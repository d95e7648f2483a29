"""March of an ensemble into the future in small portions, parked or on duty.

Parked brakes change slowly and the scheme is stable at any step, so the steps
grow with the time ahead; the tests compare them with a march of 0.05 s.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from itertools import accumulate, chain
from math import exp, inf, isnan, nan
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.estimator.blocks import channels_at_rest, friction_energies
from bstm_daemon.model.thermal.kernel import Batch

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.estimator.blocks import Instant
    from bstm_daemon.forecast.members import Ensemble
    from bstm_daemon.model.risk.vaporisation import Boiling
    from bstm_daemon.model.thermal.program import Program
    from bstm_daemon.native.loader import Kernel

HORIZON_S: Final = 1800.0
"""Horizon of the risk: it is that of vapour within this time."""

PARKED_STEPS: Final = (
    *((5.0,) * 6),
    *((10.0,) * 9),
    *((20.0,) * 12),
    *((36.0,) * 40),
    *((120.0,) * 30),
)
"""Steps ahead [s]: 30 min to the horizon, then 1 h to see it safe again."""

NEAR_STEPS: Final = PARKED_STEPS[:67]
LATER_STEPS: Final = PARKED_STEPS[67:]
"""Those up to the horizon and behind it."""

DUTY_STEPS: Final = (*((5.0,) * 6), *((10.0,) * 9), *((30.0,) * 56))
"""Steps of a continued duty [s], up to the horizon."""


class Conditions(NamedTuple):
    """Inputs of a corner from now on; powers in W, all else SI.

    At rest all but ``ambient_k`` is 0.
    """

    ambient_k: float
    speed_ms: float = 0.0
    pressure_pa: float = 0.0
    brake_on: float = 0.0
    power_w: float = 0.0


DUTY_MEMORY_S: Final = 120.0
"""Time constant of the duty's means: a few bends of a descent."""

_CHANNELS: Final = tuple(channels_at_rest(0.0))
_AT_REST: Final = array("d", channels_at_rest(0.0).values())
_AIR: Final = _CHANNELS.index("ambient_k")
_CONDITION_CHANNELS: Final = tuple(
    _CHANNELS.index("brake_power_w" if name == "power_w" else name)
    for name in Conditions._fields
)

_DUTY_CHANNELS: Final = ("speed_ms", "pressure_pa", "brake_on")


class Duty:
    """Exponentially fading means of speed, pressure, braking and power."""

    def __init__(self, program: Program) -> None:
        """Start without data for the corner of *program*."""
        self._sources = friction_energies(program)
        self._last: tuple[int, float] | None = None
        self._means = [0.0] * 4
        self._weight = 0.0

    def restart(self) -> None:
        """Forget everything after a gap in the data."""
        self._last, self._means, self._weight = None, [0.0] * 4, 0.0

    def add(self, instant: Instant, corner: str) -> None:
        """Take a publication of the *corner* that this is the duty of."""
        output, time_us = instant.output(corner), instant.time_us
        energy_j = sum(output[i] for i in self._sources)
        last, self._last = self._last, (time_us, energy_j)
        if last is None:
            return
        elapsed_s = (time_us - last[0]) * 1e-6
        if elapsed_s <= 0.0:
            return
        power_w = max(energy_j - last[1], 0.0) / elapsed_s
        news = (
            *(instant.channel(corner, channel) for channel in _DUTY_CHANNELS),
            power_w,
        )
        keep = exp(-elapsed_s / DUTY_MEMORY_S)
        self._means = [
            keep * mean + (1.0 - keep) * value
            for mean, value in zip(self._means, news, strict=True)
        ]
        self._weight = keep * self._weight + (1.0 - keep)

    def conditions(self, ambient_k: float) -> Conditions:
        """Return the duty as constant conditions."""
        weight = self._weight or 1.0
        speed, pressure, brake_on, power = (m / weight for m in self._means)
        return Conditions(ambient_k, speed, pressure, brake_on, power)


class Course(NamedTuple):
    """Course of the members' fluid temperature.

    ``times_s`` of the points, the first 0; ``fluid_k`` one series a member.
    """

    times_s: tuple[float, ...]
    fluid_k: Sequence[Sequence[float]]

    def peaks_k(self, until_s: float) -> list[float]:
        """Return each member's highest temperature [K] up to *until_s*."""
        end = self._end(until_s)
        return [max(series[:end]) for series in self.fluid_k]

    def peak(self, until_s: float) -> tuple[float, float]:
        """Return the median of the members' peaks [K] and of their times [s].

        The top between points is that of a parabola through three.
        """
        end = self._end(until_s)
        tops = [_top(self.times_s, series[:end]) for series in self.fluid_k]
        return (
            median([kelvin for kelvin, _ in tops]),
            median([seconds for _, seconds in tops]),
        )

    def probability(self, place: int, boiling: Boiling) -> float:
        """Return the probability of vapour at the point number *place*."""
        return boiling.mean_probability([s[place] for s in self.fluid_k])

    def safe_in_s(self, boiling: Boiling, limit: float) -> float:
        """Return when the probability of vapour stays below *limit* [s].

        Infinite if that is not within the time marched.
        """
        last = len(self.times_s) - 1
        if self.probability(last, boiling) >= limit:
            return inf
        mean = [sum(values) for values in zip(*self.fluid_k, strict=True)]
        low, high = mean.index(max(mean)), last
        if self.probability(low, boiling) < limit:
            return 0.0
        # after its peak the fluid only cools
        while high - low > 1:
            middle = (low + high) // 2
            if self.probability(middle, boiling) >= limit:
                low = middle
            else:
                high = middle
        return self.times_s[high]

    def is_over(self, boiling: Boiling, limit: float) -> bool:
        """Whether the fluid cools at the end, its risk below *limit*."""
        before_k, last_k = (sum(s[i] for s in self.fluid_k) for i in (-2, -1))
        return last_k < before_k and self.probability(-1, boiling) < limit

    def _end(self, until_s: float) -> int:
        return bisect_right(self.times_s, until_s)


class DutyCourse(NamedTuple):
    """Course of a fluid on duty, and its standard deviation [K] at a point."""

    times_s: tuple[float, ...]
    fluid_k: Sequence[float]
    std_k: Callable[[int], float]

    def reached_in_s(
        self, boiling: Boiling, draws: Sequence[float], limit: float
    ) -> float:
        """Return when the probability of vapour first reaches *limit* [s].

        *draws* are of the standard normal distribution; infinite where it
        does not, NaN where the fluid is none.
        """

        def is_reached(place: int) -> bool:
            kelvin, std_k = self.fluid_k[place], self.std_k(place)
            if boiling.probability(kelvin + std_k * most) < limit:
                return False
            if boiling.probability(kelvin + std_k * least) >= limit:
                return True
            all_k = [kelvin + std_k * draw for draw in draws]
            return boiling.mean_probability(all_k) >= limit

        least, most = min(draws), max(draws)
        top_k = max(self.fluid_k)
        if isnan(top_k):
            return nan
        places = range(self.fluid_k.index(top_k) + 1)
        if not is_reached(places[-1]):
            return inf
        return self.times_s[bisect_left(places, x=True, key=is_reached)]


class Job:
    """March of a batch, in progress."""

    def __init__(
        self,
        batch: Batch,
        fluid: int,
        state: array[float],
        inputs: array[float],
        steps: Sequence[float],
    ) -> None:
        """Start the march of *batch*.

        Args:
            batch: corners or members.
            fluid: number of the fluid in a state.
            state: nodes [K] and memories of each, flat.
            inputs: of one step, a row each, flat.
            steps: of the march [s].
        """
        self._batch, self._fluid_at = batch, fluid
        self._state, self._inputs, self._steps = state, inputs, steps
        self._done = 0
        self._fluid = state[fluid :: batch.width]

    @classmethod
    def of_members(
        cls,
        ensemble: Ensemble,
        kernel: Kernel | None,
        state: Sequence[float],
        conditions: Conditions,
        steps: Sequence[float],
        *,
        factor: float,
    ) -> Job:
        """Return the march of an *ensemble* of one corner.

        Args:
            ensemble: the members.
            kernel: the compiled one; None runs the reference.
            state: nodes [K] and memories of the corner now.
            conditions: what acts on it from now on.
            steps: of the march [s].
            factor: widens the spread.
        """
        air_k = ensemble.ambients_k(conditions.ambient_k, factor)
        inputs = _inputs([conditions]) * ensemble.count
        inputs[_AIR :: len(_CHANNELS)] = array("d", air_k)
        return cls(
            ensemble.batch(kernel),
            ensemble.fluid,
            ensemble.states(state, conditions.ambient_k, factor),
            inputs,
            steps,
        )

    @classmethod
    def of_corners(
        cls,
        batch: Batch,
        states: Sequence[Sequence[float]],
        conditions: Sequence[Conditions],
        steps: Sequence[float],
    ) -> Job:
        """Return the march of corners of one structure as they are estimated.

        Args:
            batch: of the corners.
            states: nodes [K] and memories of each now.
            conditions: what acts on each from now on.
            steps: of the march [s].
        """
        return cls(
            batch,
            batch.names.index("fluid"),
            array("d", chain.from_iterable(states)),
            _inputs(conditions),
            steps,
        )

    @property
    def lanes(self) -> int:
        """Number of corners or members."""
        return len(self._batch.programs)

    @property
    def finished(self) -> bool:
        """Whether the course is complete."""
        return self._done == len(self._steps)

    def extend(self, steps: Sequence[float]) -> None:
        """Let *steps* [s] follow those of the march."""
        self._steps = (*self._steps, *steps)

    def advance(self, limit: int) -> int:
        """March at most *limit* steps; return how many of them are left."""
        limit += self._done
        end = min(limit, len(self._steps))
        if end > self._done:
            # of all jobs of the batch
            self._batch.state = self._state
            self._fluid += self._batch.march_held(
                self._inputs, self._steps[self._done : end], self._fluid_at
            )
            self._done = end
        return limit - end

    def course(self) -> Course:
        """Return the course of the members' fluid so far."""
        times = accumulate(self._steps[: self._done], initial=0.0)
        lanes = self.lanes
        series = [self._fluid[lane::lanes] for lane in range(lanes)]
        return Course(tuple(times), series)


def parked_course(
    ensemble: Ensemble,
    kernel: Kernel | None,
    state: Sequence[float],
    ambient_k: float,
    factor: float,
) -> Course:
    """Return the whole course of a corner that parks; Args as of a Job."""
    job = Job.of_members(
        *(ensemble, kernel, state, Conditions(ambient_k), PARKED_STEPS),
        factor=factor,
    )
    job.advance(len(PARKED_STEPS))
    return job.course()


def _inputs(conditions: Sequence[Conditions]) -> array[float]:
    """Return one step's rows, a row for each of *conditions*."""
    rows = _AT_REST * len(conditions)
    for channel, values in zip(
        _CONDITION_CHANNELS, zip(*conditions, strict=True), strict=True
    ):
        rows[channel :: len(_CHANNELS)] = array("d", values)
    return rows


def median(values: list[float]) -> float:
    """Return the middle of *values*."""
    ordered = sorted(values)
    middle = len(ordered) // 2
    if len(ordered) % 2:
        return ordered[middle]
    return 0.5 * (ordered[middle - 1] + ordered[middle])


def _top(
    times_s: Sequence[float], series: Sequence[float]
) -> tuple[float, float]:
    """Return the highest temperature of *series* and its time.

    Both are NaN if it began with NaN.
    """
    best = max(series)
    if isnan(best):
        return nan, nan
    at = series.index(best)
    if at in {0, len(series) - 1}:
        return best, times_s[at]
    before, after = (
        times_s[at] - times_s[at - 1],
        times_s[at + 1] - times_s[at],
    )
    left = (best - series[at - 1]) / before
    right = (series[at + 1] - best) / after
    bend = (right - left) / (before + after)
    if not bend < 0.0:
        return best, times_s[at]
    slope = (left * after + right * before) / (before + after)
    shift = -0.5 * slope / bend
    return best + 0.5 * slope * shift, times_s[at] + shift

"""Driving that nobody saw: the heat of a hole in the data.

A hole is a silence of the bus, a gap between stamps, a process that was
stopped or a clock that jumped ahead. While it lasts the brakes cool as in a
parked car. Where the car drives before it and after it, or the bus fell
silent at speed for less than an hour, the networks march once more, from
where the hole began, with the heat of the load history, and each node takes
the higher temperature:

- in the last ten minutes the hottest stretch of the history as long as that,
  but at least one full stop from the faster of the two speeds, and at most
  what tyres can brake at that speed,
- before them the mean of the history.

A hole whose length is not known (a clock that may have been set, a parked
time that no clock proves) is marched until the heat is in balance, and
nothing is colder than it was before.
"""

from __future__ import annotations

import operator
from array import array
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from itertools import groupby
from typing import Annotated, Any, ClassVar, Final, NamedTuple

from pydantic import Field

from bstm_daemon.channels import CHANNELS, FLAGS
from bstm_daemon.estimator.blocks import Block, channels_at_rest
from bstm_daemon.estimator.memory import Flag, Int64, Machine, Number
from bstm_daemon.model.heat.sample_pass import AHEAD_US
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.settling import LONGEST_SETTLING_S
from bstm_daemon.units import GRAVITY_MS2

DROVE_MS: Final = 5.0
"""A car above this speed is not about to park, or has not just parked."""

LEAST_S: Final = 5.0
"""A shorter hole has no heat: the disc moves by 1 K/s."""

FASTEST_MS: Final = 150.0
"""No sample of a speed is above it (``docs/validity.md``)."""

MINUTE_S: Final = 60.0
STRETCH: Final = 10
"""Minutes of the longest stretch: the disc has forgotten what was before."""

KEPT: Final = 30
"""Minutes of driving that are kept."""

COARSE_STEPS: Final = ((60.0, 1.0), (1800.0, 10.0), (float("inf"), 60.0))
"""Step [s] by time marched [s]: the scheme damps any step, and within a
minute the fast nodes have come to rest."""

_LOAD: Final = ("speed_ms", "pressure_pa", "brake_on", "brake_power_w")
_WIDE: Final = len(_LOAD)
_POWER: Final = _LOAD.index("brake_power_w")

_Kelvin = Annotated[Number, Field(gt=200.0, lt=1800.0)]
_Means = tuple[Number, ...]


class Hole(NamedTuple):
    """A hole that is over.

    How long it lasted [s], the speeds before and after [m/s], whether its
    heat was added, and whether it was marched as a silence of the bus.
    """

    seconds: float
    before_ms: float
    after_ms: float
    driven: bool
    marched: bool


class Unseen(Machine):
    """The load history of a car, and the hole that is open.

    A minute of the history is the mean of each channel of ``_LOAD``, corner
    by corner.
    """

    MEMORY: ClassVar[Mapping[str, Any]] = {
        "_minutes": tuple[_Means, ...],
        "_sums": _Means,
        "_count": Annotated[int, Field(strict=True, ge=0)],
        "_nodes": dict[str, list[_Kelvin]],
        "_open": Flag,
        "since_us": Int64,
        "_before_ms": Number,
        "_marched": Flag,
        "_proven": Flag,
    }

    def __init__(
        self, shares: Sequence[float], mass_kg: float, minute: int
    ) -> None:
        """Begin with no history and no hole.

        Args:
            shares: each corner's share of the brake force, in the order of
                a block's rows.
            mass_kg: of the car.
            minute: publications in a minute.
        """
        self._shares, self._mass_kg, self._minute = shares, mass_kg, minute
        self._places = [
            corner * len(CHANNELS) + CHANNELS.index(name)
            for corner in range(len(shares))
            for name in _LOAD
        ]
        self._minutes: tuple[_Means, ...] = ()
        self._sums: _Means = (0.0,) * (_WIDE * len(shares))
        self._count = 0
        self._nodes: dict[str, list[float]] = {}
        self._open = self._marched = self._proven = False
        self.since_us = 0
        """Begin of the last hole on the present axis of time [us]."""
        self._before_ms = 0.0
        self.driven = 0
        """Count of the holes that the car was driven in, since the start."""

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Take over what :meth:`export` gave.

        The history of a car with other corners is left out.

        Raises:
            KeyError, TypeError, ValueError: it is nothing of that kind.
        """
        fresh = self._sums
        super().restore(saved)
        wide = len(fresh)
        kept = self._sums, *self._minutes
        if self._count >= self._minute or any(len(m) != wide for m in kept):
            self._minutes, self._sums, self._count = (), (0.0,) * wide, 0

    @property
    def is_open(self) -> bool:
        """Whether a hole lasts."""
        return self._open

    @property
    def is_parked(self) -> bool:
        """Whether a hole lasts that :meth:`move` dated."""
        return self._open and not self._marched

    def add(self, block: Block) -> None:
        """Add to the history what *block* has with a speed, none in a hole.

        The sums run on from publication to publication, so that a cut
        between two blocks changes no bit.
        """
        if self._open:
            return
        first = 0
        for missing, run in groupby(
            block.flags, FLAGS["speed_missing"].__and__
        ):
            last = first + len(list(run))
            while first < last and not missing:
                end = min(first + self._minute - self._count, last)
                self._add(block, first, end)
                first = end
            first = last

    def _add(self, block: Block, first: int, last: int) -> None:
        """Add publications of *block* that end no later than the minute."""
        size = len(self._shares) * len(CHANNELS)
        self._sums = tuple(
            reduce(
                operator.add,
                block.rows[first * size + at : last * size : size],
                total,
            )
            for total, at in zip(self._sums, self._places, strict=True)
        )
        self._count += last - first
        if self._count == self._minute:
            self._end_minute()

    def _end_minute(self) -> None:
        means = tuple(total / self._count for total in self._sums)
        self._sums, self._count = (0.0,) * len(means), 0
        # the speed of the first corner is that of the car
        if means and means[0] > DROVE_MS:
            self._minutes = (*self._minutes, means)[-KEPT:]

    def begin(
        self, nodes_k: dict[str, list[float]], since_us: int, before_ms: float
    ) -> None:
        """Begin a hole, unless one lasts.

        Args:
            nodes_k: temperatures of the nodes of each corner [K].
            since_us: the last sample [us].
            before_ms: the last known speed [m/s].
        """
        if not self._open:
            self._open, self._marched, self._proven = True, True, False
            self._nodes = nodes_k
            self.since_us, self._before_ms = since_us, before_ms

    def move(self, since_us: int, *, proven: bool) -> None:
        """Let the hole have begun at *since_us*, by a clock set anew.

        *proven*: that is certain; else it may have lasted for any time.
        """
        if not proven:
            since_us -= round(LONGEST_SETTLING_S * 1e6)
        self.since_us, self._marched, self._proven = since_us, False, proven

    def end(
        self,
        now_us: int,
        after_ms: float,
        batches: Sequence[tuple[Batch, Sequence[str]]],
        air_k: float,
    ) -> Hole:
        """End the hole; give *batches* its heat if the car drove in it.

        Args:
            now_us: time of the first speed [us].
            after_ms: that speed [m/s].
            batches: with the names of their corners.
            air_k: temperature of the air [K].
        """
        seconds = max((now_us - self.since_us) * 1e-6, 0.0)
        # a saved speed may be anything
        before_ms = min(self._before_ms, FASTEST_MS)
        slower_ms, faster_ms = sorted((before_ms, after_ms))
        is_short = seconds <= AHEAD_US * 1e-6
        # a bus that falls silent at speed is not that of a car that parks
        lowest_ms = (
            self._before_ms if self._marched and is_short else slower_ms
        )
        driven = seconds > LEAST_S and lowest_ms > DROVE_MS
        if driven:
            self.driven += 1
            is_known = self._proven or is_short
            last_s = min(seconds, STRETCH * MINUTE_S)
            stop_w = 0.5 * self._mass_kg * faster_ms**2 / last_s
            standing = (slower_ms, 0.0, 0.0, 0.0) * len(self._shares)
            mean, hottest = self._loads(last_s) or (standing, standing)
            parts = (
                (self._row(mean, 0.0, faster_ms, air_k), seconds - last_s),
                (self._row(hottest, stop_w, faster_ms, air_k), last_s),
            )
            for batch, names in batches:
                self._heat(batch, names, parts, is_known=is_known)
        self._open, self._nodes = False, {}
        return Hole(seconds, self._before_ms, after_ms, driven, self._marched)

    def _row(
        self, means: _Means, least_w: float, speed_ms: float, air_k: float
    ) -> array[float]:
        """Return the channels of all corners under the load *means*.

        Args:
            means: as in a minute of the history.
            least_w: power of the whole car at least [W].
            speed_ms: speed that tyres brake from [m/s].
            air_k: temperature of the air [K].
        """
        powers_w = [
            max(power_w, share * least_w)
            for power_w, share in zip(
                means[_POWER::_WIDE], self._shares, strict=True
            )
        ]
        most_w = self._mass_kg * GRAVITY_MS2 * max(speed_ms, *means[:1])
        limit = min(most_w / max(sum(powers_w), most_w), 1.0)
        row = array("d")
        for corner, power_w in enumerate(powers_w):
            own = means[corner * _WIDE : (corner + 1) * _WIDE]
            channels = channels_at_rest(air_k)
            channels |= dict(zip(_LOAD, own, strict=True))
            channels["brake_power_w"] = limit * power_w
            row.extend(channels.values())
        return row

    def _loads(self, seconds: float) -> tuple[_Means, _Means] | None:
        """Return the mean of the history and its hottest stretch.

        *seconds*: of the stretch. None without any history.
        """
        minutes = list(self._minutes)
        if self._count:
            # the minute that is not over has its energy so far
            means = [total / self._count for total in self._sums]
            for at in range(_POWER, len(means), _WIDE):
                means[at] *= self._count / self._minute
            minutes.append(tuple(means))
        if not minutes:
            return None
        whole = len(self._minutes) or 1
        length = min(-int(-seconds // MINUTE_S), whole)
        stretches = [
            _mean(minutes[first : first + length])
            for first in range(len(minutes) - length + 1)
        ]
        hottest = max(stretches, key=lambda means: sum(means[_POWER::_WIDE]))
        return _mean(minutes[:whole]), hottest

    def _heat(
        self,
        batch: Batch,
        names: Sequence[str],
        parts: Sequence[tuple[array[float], float]],
        *,
        is_known: bool,
    ) -> None:
        """March *batch* from the begin of the hole; keep what is hotter.

        *parts*: rows of channels, and for how long [s].
        """
        parked, ledger = batch.state[:], batch.ledger[:]
        for member, nodes in _node_places(batch):
            begun_k = self._nodes.get(names[member], [])
            if len(begun_k) == nodes.stop - nodes.start:
                batch.state[nodes] = array("d", begun_k)
        begun = batch.state[:]
        for row, seconds in parts:
            for step_s in coarse_steps(min(seconds, LONGEST_SETTLING_S)):
                batch.march(row, 1, step_s)
        driven = batch.state[:]
        for _, nodes in _node_places(batch):
            for i in range(nodes.start, nodes.stop):
                parked[i] = max(parked[i], driven[i])
                if not is_known:
                    parked[i] = max(parked[i], begun[i])
        batch.state[:], batch.ledger[:] = parked, ledger


def _mean(minutes: Sequence[_Means]) -> _Means:
    return tuple(
        sum(of_channel) / len(minutes)
        for of_channel in zip(*minutes, strict=True)
    )


def _node_places(batch: Batch) -> Iterator[tuple[int, slice]]:
    """Give each member and where its nodes are in the state."""
    for member, program in enumerate(batch.programs):
        first = batch.part(member).start
        yield member, slice(first, first + len(program.network.nodes))


def coarse_steps(seconds: float) -> Iterator[float]:
    """Give steps [s] that add up to *seconds*."""
    elapsed = 0.0
    for until, step_s in COARSE_STEPS:
        while elapsed < min(until, seconds):
            step = min(step_s, seconds - elapsed)
            yield step
            elapsed += step

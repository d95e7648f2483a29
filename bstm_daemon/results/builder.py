"""From an estimator's blocks to rows of named columns."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import repeat
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.estimator import PUBLISH_US
from bstm_daemon.heat.sample_plan import CHANNELS, VEHICLE_CHANNELS
from bstm_daemon.results.advice import advice_columns
from bstm_daemon.results.risk import risk_columns
from bstm_daemon.results.rows import STRETCH_ROWS, Results
from bstm_daemon.risk.boiling import wet_boiling_point_k
from bstm_daemon.roles import MEASURED_NODES
from bstm_daemon.units import KELVIN_OFFSET
from bstm_daemon.wear.dose import DISTANCE, DOSE
from bstm_daemon.wear.table import WEAR_COLUMNS, wear_table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy.typing as npt

    from bstm_daemon.bus.publication_slow import AdviceSnapshot
    from bstm_daemon.estimator import Block, Estimator, Group
    from bstm_daemon.forecast.records import CarRisk
    from bstm_daemon.results.rows import Sink

    Column = npt.NDArray[np.float64]

BOUNDARIES: Final = ("ambient", "dissolved", DISTANCE)
"""Numbers of every state that are not worth a column of their own."""

LEARNED: Final = VEHICLE_CHANNELS[4:-1]
"""What the observer says of the car, columns where the heat is fused."""

_POWER: Final = CHANNELS.index("brake_power_w")
_POWER_STD: Final = CHANNELS.index("brake_power_std_w")
_MEASURED: Final = CHANNELS.index(f"measured_{MEASURED_NODES[0]}_k")


@dataclass(frozen=True, slots=True)
class _Publications:
    """What blocks hold of some publications, each array [n, ...]."""

    times_us: npt.NDArray[np.int64]
    rows: Column
    vehicle: Column
    flags: npt.NDArray[np.int64]
    outputs: tuple[Column, ...]
    validity: tuple[npt.NDArray[np.int8], ...]
    wear: tuple[Column, ...]
    risk: npt.NDArray[np.object_]
    advice: npt.NDArray[np.object_]

    def __len__(self) -> int:
        return len(self.times_us)

    def __getitem__(
        self, which: slice | npt.NDArray[np.bool_]
    ) -> _Publications:
        return _Publications(
            self.times_us[which],
            self.rows[which],
            self.vehicle[which],
            self.flags[which],
            tuple(output[which] for output in self.outputs),
            tuple(codes[which] for codes in self.validity),
            tuple(table[which] for table in self.wear),
            self.risk[which],
            self.advice[which],
        )

    @classmethod
    def joined(cls, parts: Sequence[_Publications]) -> _Publications:
        """Return all publications of *parts*."""
        return cls(
            np.concatenate([part.times_us for part in parts]),
            np.concatenate([part.rows for part in parts]),
            np.concatenate([part.vehicle for part in parts]),
            np.concatenate([part.flags for part in parts]),
            tuple(
                np.concatenate(one)
                for one in zip(*(p.outputs for p in parts), strict=True)
            ),
            tuple(
                np.concatenate(one)
                for one in zip(*(p.validity for p in parts), strict=True)
            ),
            tuple(
                np.concatenate(one)
                for one in zip(*(p.wear for p in parts), strict=True)
            ),
            np.concatenate([part.risk for part in parts]),
            np.concatenate([part.advice for part in parts]),
        )


class ResultsBuilder:
    """Makes rows of an estimator's blocks and hands them to sinks.

    The estimator's first publication is left out: no whole interval lies
    before it, so it has no mean power. If it stays alone, it is a row.
    Stretches are of :data:`~bstm_daemon.results.rows.STRETCH_ROWS` rows
    however the blocks are cut, the last one shorter.
    """

    def __init__(
        self,
        estimator: Estimator,
        sinks: Sequence[Sink],
        every_us: int = PUBLISH_US,
    ) -> None:
        """Take blocks of *estimator*, keeping a row every *every_us*."""
        self.rows = 0
        self._estimator = estimator
        self._sinks = sinks
        self._every_us = every_us
        self._modelled = tuple(
            name for group in estimator.groups for name in group.corners
        )
        self._begun = False
        # in front of the first part the publication before it, if there is
        # one: its time and its energies begin the mean powers
        self._parts: list[_Publications] = []
        self._before = 0
        self._open_flags = 0

    def add(
        self,
        blocks: Iterable[Block],
        risks: Iterable[Sequence[CarRisk]] | None = None,
        advice: Iterable[Sequence[AdviceSnapshot]] | None = None,
    ) -> None:
        """Take *blocks* and hand on what makes whole stretches.

        *risks* and *advice* are at each publication of each block; with them
        there are columns of it, which must then be so for every block.
        """
        told = repeat(None) if risks is None else risks
        said = repeat(None) if advice is None else advice
        for block, risk, words in zip(blocks, told, said, strict=False):
            part = self._publications(block, risk, words)
            if not self._begun:
                self._begun = True
                first_us = block.times_us[0]
                kept = len(part) > 0 and part.times_us[0] == first_us
                self._before = int(kept)
                self.rows -= self._before
            self.rows += len(part)
            self._parts.append(part)
            waiting = sum(map(len, self._parts)) - self._before
            while waiting >= STRETCH_ROWS:
                self._hand_on(STRETCH_ROWS)
                waiting -= STRETCH_ROWS

    def finish(self) -> None:
        """Hand on the rows that are left."""
        waiting = sum(map(len, self._parts)) - self._before
        if self._before and not self.rows:
            self.rows = waiting = 1
            self._before = 0
        if waiting:
            self._hand_on(waiting)

    def _publications(
        self,
        block: Block,
        risk: Sequence[CarRisk] | None,
        advice: Sequence[AdviceSnapshot] | None,
    ) -> _Publications:
        """Return those of *block* that are kept."""
        times_us = np.frombuffer(block.times_us, np.int64)
        keep = times_us % self._every_us == 0
        flags = self._flags_since(np.frombuffer(block.flags, np.int64), keep)
        count = len(times_us)
        corners = len(self._estimator.plan.corners)
        outputs = tuple(
            _floats(output, count, len(group.corners), group.size)
            for group, output in zip(
                self._estimator.groups, block.outputs, strict=True
            )
        )
        return _Publications(
            times_us,
            _floats(block.rows, count, corners, len(CHANNELS)),
            _floats(block.vehicle, count, len(VEHICLE_CHANNELS)),
            flags,
            outputs,
            tuple(
                np.frombuffer(block.validity[name], np.int8)
                for name in self._modelled
            ),
            tuple(
                wear_table(block.wear[name], output[:, member, dose])
                for group, output in zip(
                    self._estimator.groups, outputs, strict=True
                )
                for dose in (group.state_names.index(DOSE),)
                for member, name in enumerate(group.corners)
            ),
            _objects(risk, count),
            _objects(advice, count),
        )[keep]

    def _flags_since(
        self,
        flags: npt.NDArray[np.int64],
        keep: npt.NDArray[np.bool_],
    ) -> npt.NDArray[np.int64]:
        """Give each row that is kept the bits of those dropped before it.

        A finding between two rows would show nowhere else.
        """
        gathered = flags.copy()
        gathered[0] |= self._open_flags
        kept = np.flatnonzero(keep)
        # each run of rows begins behind one that is kept
        starts = np.concatenate([[0], kept[kept < len(flags) - 1] + 1])
        runs = np.bitwise_or.reduceat(gathered, starts)
        gathered[kept] = runs[: len(kept)]
        ends_open = not (len(kept) and kept[-1] == len(flags) - 1)
        self._open_flags = int(runs[-1]) if ends_open else 0
        return gathered

    def _hand_on(self, count: int) -> None:
        waiting = _Publications.joined(self._parts)
        end = self._before + count
        stretch = self._rows_of(waiting[:end])
        self._parts = [waiting[end - 1 :]]
        self._before = 1
        for sink in self._sinks:
            sink.write(stretch)

    def _rows_of(self, publications: _Publications) -> Results:
        times_us = publications.times_us
        rows, vehicle = publications.rows, publications.vehicle
        start_us = times_us[0] - self._every_us
        interval_s = np.diff(times_us, prepend=start_us) * 1e-6
        # over a clock set back there is no interval and so no mean
        interval_s[interval_s <= 0.0] = np.nan
        corners = self._estimator.plan.corners
        columns: dict[str, Column] = {
            "time_s": times_us.astype(np.float64) * 1e-6,
            "speed_ms": vehicle[:, 0],
            "distance_m": vehicle[:, 1],
            "brake_force_fb_n": vehicle[:, 2],
            "flags": publications.flags.astype(np.float64),
        }
        if self._estimator.config.heat.mode == "fused":
            columns |= {
                name: vehicle[:, 4 + i] for i, name in enumerate(LEARNED)
            }
        parts: dict[str, dict[str, Column]] = {name: {} for name in corners}
        validity = dict(
            zip(self._modelled, publications.validity, strict=True)
        )
        for group, outputs in zip(
            self._estimator.groups, publications.outputs, strict=True
        ):
            for member, name in enumerate(group.corners):
                parts[name] = self._modelled_columns(
                    name, group, outputs[:, member], interval_s
                )
        for name, table in zip(self._modelled, publications.wear, strict=True):
            parts[name] |= dict(zip(WEAR_COLUMNS, table.T, strict=True))
            parts[name]["validity"] = validity[name].astype(np.float64)
        columns |= self._risk_columns(publications, parts)
        if publications.advice[-1] is not None:
            columns |= advice_columns(publications.advice)
        config = self._estimator.config
        for index, name in enumerate(corners):
            part = parts[name]
            row = rows[:, index]
            forward = _rate(row[:, 6], interval_s)
            back = _rate(row[:, 7], interval_s)
            part.setdefault(
                "brake_power_w",
                {"fb": back, "fused": row[:, _POWER]}.get(
                    config.heat.mode, forward
                ),
            )
            if config.heat.mode == "fused":
                part["brake_power_std_w"] = row[:, _POWER_STD]
            part["brake_power_ff_w"] = forward
            part["brake_power_fb_w"] = back
            part["pressure_pa"] = row[:, 1]
            for i, node in enumerate(MEASURED_NODES):
                # by the mapping, not the values: the first rows do not know
                # of what comes later
                if f"temp_{name.lower()}_{node}" in config.signals:
                    part[f"{node}_measured_c"] = (
                        row[:, _MEASURED + i] - KELVIN_OFFSET
                    )
            columns |= {f"{name}.{key}": part[key] for key in part}
        columns = {
            # a copy: a view would hold every channel of the publications
            name: np.array(column[self._before :])
            for name, column in columns.items()
        }
        return Results(columns, corners, self._modelled)

    def _risk_columns(
        self,
        publications: _Publications,
        parts: dict[str, dict[str, Column]],
    ) -> dict[str, Column]:
        """Add those of the corners to *parts* and return those of the car."""
        if publications.risk[-1] is None:
            return {}
        car, of_corners = risk_columns(
            publications.risk, publications.times_us, self._modelled
        )
        for name, found in of_corners.items():
            parts[name] |= found
        return car

    def _modelled_columns(
        self, name: str, group: Group, output: Column, interval_s: Column
    ) -> dict[str, Column]:
        estimator = self._estimator
        part: dict[str, Column] = {}
        for i, state in enumerate(group.state_names):
            if state in BOUNDARIES:
                continue
            if i < group.nodes:
                part[f"{state}_c"] = output[:, i] - KELVIN_OFFSET
            else:
                part[state] = output[:, i]
        boiling_k = wet_boiling_point_k(estimator.config.fluid.grade)
        fluid = output[:, group.state_names.index("fluid")]
        part["margin_k"] = boiling_k - fluid
        first = len(group.state_names)
        sources = estimator.programs[name].network.sources
        friction = [
            first + i
            for i, source in enumerate(sources)
            if any(factor.a == "brake_power_w" for factor in source.factors)
        ]
        energy_j = output[:, friction].sum(axis=1)
        part["brake_power_w"] = _rate(energy_j, interval_s)
        return part


def _objects(
    found: Sequence[object] | None, count: int
) -> npt.NDArray[np.object_]:
    column = np.full(count, None, object)
    if found is not None:
        column[:] = found
    return column


def _floats(flat: object, *shape: int) -> Column:
    data: Column = np.frombuffer(flat, np.float64)  # type: ignore[call-overload]
    return data.reshape(shape)


def _rate(running: Column, interval_s: Column) -> Column:
    """Mean power [W] from an energy [J] that ran from 0 at the start."""
    rate: Column = np.diff(running, prepend=0.0) / interval_s
    return rate

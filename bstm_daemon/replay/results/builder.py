"""Builds rows of named columns from an estimator's blocks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import repeat
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.channels import CHANNELS, VEHICLE_CHANNELS
from bstm_daemon.estimator.blocks import Block, Group, friction_energies
from bstm_daemon.estimator.estimator import PUBLISH_US, Estimator
from bstm_daemon.model.risk.boiling import wet_boiling_point_k
from bstm_daemon.model.wear.dose import DISTANCE, DOSE
from bstm_daemon.model.wear.table import WEAR_COLUMNS, wear_table
from bstm_daemon.replay.results.rows import (
    ADVICE_COLUMNS,
    STRETCH_ROWS,
    Results,
    Sink,
    record_columns,
    risk_columns,
)
from bstm_daemon.roles import MEASURED_NODES
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.estimate import Advice, CarRisk


Column = npt.NDArray[np.float64]
Arrays = dict[str, npt.NDArray[Any]]
"""What blocks hold of some publications, each array [n, ...]: times_us,
rows, vehicle, flags; output, validity, reasons and wear of each corner;
risk and advice."""

BOUNDARIES: Final = ("ambient", "dissolved", DISTANCE)
"""Numbers of every state that are not worth a column of their own."""

LEARNED: Final = VEHICLE_CHANNELS[4:-1]
"""Estimates of the observer, columns where the heat is fused."""

_FORWARD: Final = CHANNELS.index("brake_energy_ff_j")
_BACK: Final = CHANNELS.index("brake_energy_fb_j")
_PRESSURE: Final = CHANNELS.index("pressure_pa")
_POWER: Final = CHANNELS.index("brake_power_w")
_POWER_STD: Final = CHANNELS.index("brake_power_std_w")
_MEASURED: Final = CHANNELS.index(f"measured_{MEASURED_NODES[0]}_k")


_OUTPUT: Final = "output of "
_VALIDITY: Final = "validity of "
_REASONS: Final = "reasons of "
_WEAR: Final = "wear of "


class ResultsBuilder:
    """Makes rows of an estimator's blocks and hands them to sinks.

    The estimator's first publication is left out: no whole interval lies
    before it, so it has no mean power. If it stays alone, it is a row.
    Stretches are of :data:`~bstm_daemon.replay.results.rows.STRETCH_ROWS` rows
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
        config = estimator.config
        self._has_torque = (
            "powertrain_torque" in config.signals
            or config.heat.assume_powertrain_torque_nm is not None
        )
        self._begun = False
        # in front of the first part the publication before it, if there is
        # one: its time and its energies begin the mean powers
        self._parts: list[Arrays] = []
        self._before = 0
        self._open_flags = 0

    def add(
        self,
        blocks: Iterable[Block],
        risks: Iterable[Sequence[CarRisk]] | None = None,
        advice: Iterable[Sequence[Advice]] | None = None,
    ) -> None:
        """Take *blocks* and hand on what makes whole stretches.

        *risks* and *advice* are at each publication of each block; with them
        there are columns of it, which must then be so for every block.
        """
        risk_lists = repeat(None) if risks is None else risks
        advice_lists = repeat(None) if advice is None else advice
        for block, risk, one in zip(
            blocks, risk_lists, advice_lists, strict=False
        ):
            part = self._publications(block, risk, one)
            if not self._begun:
                self._begun = True
                first_us = block.times_us[0]
                self._before = int(first_us in part["times_us"][:1])
                self.rows -= self._before
            self.rows += len(part["times_us"])
            self._parts.append(part)
            waiting = self._waiting()
            while waiting >= STRETCH_ROWS:
                self._hand_on(STRETCH_ROWS)
                waiting -= STRETCH_ROWS

    def finish(self) -> None:
        """Hand on the rows that are left."""
        waiting = self._waiting()
        if self._before and not self.rows:
            self.rows = waiting = 1
            self._before = 0
        if waiting:
            self._hand_on(waiting)

    def _waiting(self) -> int:
        return sum(len(p["times_us"]) for p in self._parts) - self._before

    def _publications(
        self,
        block: Block,
        risk: Sequence[CarRisk] | None,
        advice: Sequence[Advice] | None,
    ) -> Arrays:
        """Return those of *block* that are kept."""
        times_us = np.frombuffer(block.times_us, np.int64)
        keep = times_us % self._every_us == 0
        flags = self._flags_since(np.frombuffer(block.flags, np.int64), keep)
        count = len(times_us)
        found: Arrays = {
            "times_us": times_us,
            "rows": _floats(
                block.rows, count, len(block.layout.corners), len(CHANNELS)
            ),
            "vehicle": _floats(block.vehicle, count, len(VEHICLE_CHANNELS)),
            "flags": flags,
            "risk": _objects(risk, count),
            "advice": _objects(advice, count),
        }
        for group, flat in zip(
            block.layout.groups, block.outputs, strict=True
        ):
            outputs = _floats(flat, count, len(group.corners), group.size)
            dose_j = outputs[:, :, group.state_names.index(DOSE)]
            for member, name in enumerate(group.corners):
                found[_OUTPUT + name] = outputs[:, member]
                if block.validity:
                    found[_VALIDITY + name] = np.array(block.validity[name])
                    found[_REASONS + name] = np.array(block.reasons[name])
                found[_WEAR + name] = wear_table(
                    block.wear[name], dose_j[:, member]
                )
        return {name: array[keep] for name, array in found.items()}

    def _flags_since(
        self, flags: npt.NDArray[np.int64], keep: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.int64]:
        """Give each row that is kept the bits of those dropped before it.

        Otherwise a finding between two rows would be lost.
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
        waiting = {
            name: np.concatenate([part[name] for part in self._parts])
            for name in self._parts[0]
        }
        end = self._before + count
        stretch = self._rows_of(
            {name: array[:end] for name, array in waiting.items()}
        )
        self._parts = [
            {name: array[end - 1 :] for name, array in waiting.items()}
        ]
        self._before = 1
        for sink in self._sinks:
            sink.write(stretch)

    def _rows_of(self, publications: Arrays) -> Results:
        times_us = publications["times_us"]
        rows, vehicle = publications["rows"], publications["vehicle"]
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
            "flags": publications["flags"].astype(np.float64),
        }
        if self._estimator.config.heat.mode == "fused":
            columns |= {
                name: vehicle[:, 4 + i] for i, name in enumerate(LEARNED)
            }
        parts: dict[str, dict[str, Column]] = {name: {} for name in corners}
        for group in self._estimator.layout.groups:
            for name in group.corners:
                parts[name] = self._modelled_columns(
                    name, group, publications, interval_s
                )
        risk, advice = publications["risk"], publications["advice"]
        if risk[-1] is not None:
            car, of_corners = risk_columns(risk, times_us, self._modelled)
            columns |= car
            for name, found in of_corners.items():
                parts[name] |= found
        if advice[-1] is not None:
            columns |= record_columns(ADVICE_COLUMNS, [*advice])
        for index, name in enumerate(corners):
            own = parts[name]
            # behind those of the model, whose own power counts
            part = own | self._input_columns(name, rows[:, index], interval_s)
            columns |= {f"{name}.{k}": own.get(k, part[k]) for k in part}
        # copies: a view would hold every channel of the publications
        columns = {
            k: np.array(one[self._before :]) for k, one in columns.items()
        }
        return Results(columns, corners, self._modelled)

    def _input_columns(
        self, name: str, row: Column, interval_s: Column
    ) -> dict[str, Column]:
        """Return what *row* [n, channels] holds of the corner *name*."""
        config = self._estimator.config
        forward = _rate(row[:, _FORWARD], interval_s)
        back = _rate(row[:, _BACK], interval_s)
        if not self._has_torque:
            back = np.full_like(back, np.nan)
        power = {"fb": back, "fused": row[:, _POWER]}
        part = {"brake_power_w": power.get(config.heat.mode, forward)}
        if config.heat.mode == "fused":
            part["brake_power_std_w"] = row[:, _POWER_STD]
        part |= {
            "brake_power_ff_w": forward,
            "brake_power_fb_w": back,
            "pressure_pa": row[:, _PRESSURE],
        }
        for i, node in enumerate(MEASURED_NODES):
            # by the mapping, not the values: the first rows do not know
            # of what comes later
            if f"temp_{name.lower()}_{node}" in config.signals:
                measured_k = row[:, _MEASURED + i]
                part[f"{node}_measured_c"] = measured_k - KELVIN_OFFSET
        return part

    def _modelled_columns(
        self, name: str, group: Group, publications: Arrays, interval_s: Column
    ) -> dict[str, Column]:
        """Return what is known of the corner *name* of *group*."""
        estimator = self._estimator
        output = publications[_OUTPUT + name]
        part: dict[str, Column] = {}
        for i, state in enumerate(group.state_names):
            if state not in BOUNDARIES and i < group.nodes:
                part[f"{state}_c"] = output[:, i] - KELVIN_OFFSET
            elif state not in BOUNDARIES:
                part[state] = output[:, i]
        boiling_k = wet_boiling_point_k(estimator.config.fluid.grade)
        fluid = output[:, group.state_names.index("fluid")]
        part["margin_k"] = boiling_k - fluid
        places = friction_energies(estimator.programs[name])
        energy_j = output[:, places].sum(axis=1)
        part["brake_power_w"] = _rate(energy_j, interval_s)
        wear = publications[_WEAR + name].T
        part |= dict(zip(WEAR_COLUMNS, wear, strict=True))
        for column, key in (("validity", _VALIDITY), ("reasons", _REASONS)):
            if key + name in publications:
                part[column] = publications[key + name].astype(np.float64)
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

"""Estimates of a whole log as named columns, and the files made of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.errors import MissingExtraError
from bstm_daemon.estimator import PUBLISH_US
from bstm_daemon.files import replacing
from bstm_daemon.heat.sample_plan import CHANNELS, VEHICLE_CHANNELS
from bstm_daemon.risk.boiling import wet_boiling_point_k
from bstm_daemon.roles import MEASURED_NODES
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    import numpy.typing as npt

    from bstm_daemon.estimator import Block, Estimator, Group

    Column = npt.NDArray[np.float64]

BOUNDARIES: Final = ("ambient", "dissolved")
"""Nodes of every network that are not worth a column of their own."""


@dataclass(frozen=True)
class Results:
    """One row a publication.

    ``columns`` by name, all of one length, ``time_s`` (log time) first;
    temperatures degC, everything else SI. ``corners`` are all corners,
    ``modelled`` those with temperatures.
    """

    columns: dict[str, Column]
    corners: tuple[str, ...]
    modelled: tuple[str, ...]

    @property
    def elapsed_s(self) -> Column:
        """Time since the first row; a clock set back does not count."""
        time_s = self.columns["time_s"]
        elapsed: Column = np.cumsum(
            np.maximum(np.diff(time_s, prepend=time_s[:1]), 0.0)
        )
        return elapsed

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.columns["time_s"])


class ResultsBuilder:
    """Collects an estimator's blocks and makes columns of them."""

    def __init__(
        self, estimator: Estimator, every_us: int = PUBLISH_US
    ) -> None:
        """Collect from *estimator*, keeping a row every *every_us*."""
        self._estimator = estimator
        self._every_us = every_us
        self._first_us: int | None = None
        self._times: list[npt.NDArray[np.int64]] = []
        self._rows: list[Column] = []
        self._vehicle: list[Column] = []
        self._flags: list[Column] = []
        self._outputs: list[list[Column]] = [[] for _ in estimator.groups]
        self._validity: dict[str, list[Column]] = {
            name: [] for group in estimator.groups for name in group.corners
        }

    @property
    def rows(self) -> int:
        """Number of rows so far."""
        return sum(map(len, self._times))

    def add(self, blocks: Iterable[Block]) -> None:
        """Append *blocks*."""
        corners = len(self._estimator.plan.corners)
        for block in blocks:
            if self._first_us is None:
                self._first_us = block.times_us[0]
            times = np.frombuffer(block.times_us, np.int64)
            keep = times % self._every_us == 0
            n = len(times)
            self._times.append(times[keep])
            self._rows.append(
                _floats(block.rows, n, corners, len(CHANNELS))[keep]
            )
            self._vehicle.append(
                _floats(block.vehicle, n, len(VEHICLE_CHANNELS))[keep]
            )
            flags = np.frombuffer(block.flags, np.int32)[keep]
            self._flags.append(flags.astype(float))
            for group, output, kept in zip(
                self._estimator.groups,
                block.outputs,
                self._outputs,
                strict=True,
            ):
                shape = (n, len(group.corners), group.size)
                kept.append(_floats(output, *shape)[keep])
            for name, validity in block.validity.items():
                codes = np.frombuffer(validity, np.int8)[keep]
                self._validity[name].append(codes.astype(float))

    def finish(self) -> Results:
        """Return the columns of all blocks so far; at least one is needed.

        The estimator's first publication is left out: no whole interval lies
        before it, so it has no mean power.
        """
        times_us = np.concatenate(self._times)
        rows = np.concatenate(self._rows)
        vehicle = np.concatenate(self._vehicle)
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
            "flags": np.concatenate(self._flags),
        }
        parts: dict[str, dict[str, Column]] = {name: {} for name in corners}
        for group, outputs in zip(
            self._estimator.groups, self._outputs, strict=True
        ):
            stacked = np.concatenate(outputs)
            for member, name in enumerate(group.corners):
                parts[name] = self._corner(
                    name, group, stacked[:, member], interval_s
                )
        mode = self._estimator.config.heat.mode
        for index, name in enumerate(corners):
            part = parts[name]
            row = rows[:, index]
            forward = _rate(row[:, 6], interval_s)
            back = _rate(row[:, 7], interval_s)
            part.setdefault("brake_power_w", back if mode == "fb" else forward)
            part["brake_power_ff_w"] = forward
            part["brake_power_fb_w"] = back
            part["pressure_pa"] = row[:, 1]
            for i, node in enumerate(MEASURED_NODES):
                measured = row[:, 8 + i]
                if not np.isnan(measured).all():
                    part[f"{node}_measured_c"] = measured - KELVIN_OFFSET
            columns |= {f"{name}.{key}": part[key] for key in part}
        if len(times_us) > 1 and times_us[0] == self._first_us:
            columns = {key: column[1:] for key, column in columns.items()}
        return Results(columns, corners, tuple(self._validity))

    def _corner(
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
        part["validity"] = np.concatenate(self._validity[name])
        return part


def write_csv(path: Path, results: Results) -> None:
    """Write *results* as CSV: a header, then a row a publication.

    A value that is not there is an empty cell.

    Raises:
        FileAccessError: *path* can not be written.
    """
    names = list(results.columns)
    form = ",".join(map(_format, names)) + "\n"
    table = np.column_stack([results.columns[name] for name in names])
    with (
        replacing(path) as temporary,
        temporary.open("w", encoding="utf-8") as file,
    ):
        file.write(",".join(names) + "\n")
        for row in table.tolist():
            file.write((form % tuple(row)).replace("nan", ""))


def write_parquet(path: Path, results: Results) -> None:
    """Write *results* as Parquet.

    Raises:
        MissingExtraError: pyarrow is not installed.
        FileAccessError: *path* can not be written.
    """
    if not has_parquet():
        raise MissingExtraError(
            package="pyarrow", extra="parquet", purpose="--format parquet"
        )
    import pyarrow as pa  # noqa: PLC0415  (an extra, loaded when needed)
    from pyarrow import parquet  # noqa: PLC0415

    with replacing(path) as temporary:
        parquet.write_table(
            pa.table(results.columns),
            temporary,
            compression="zstd",
            use_dictionary=False,
            use_byte_stream_split=True,
        )


def has_parquet() -> bool:
    """Whether Parquet can be written here."""
    from importlib.util import find_spec  # noqa: PLC0415

    return find_spec("pyarrow") is not None


def _format(name: str) -> str:
    if name == "time_s":
        return "%.6f"
    if name.endswith(("validity", "flags")):
        return "%.0f"
    if name.endswith(("_c", "_k", "_ms", "_m")):
        return "%.3f"
    if name.endswith(("_w", "_pa", "_n")):
        return "%.1f"
    return "%.6g"


def _floats(flat: object, *shape: int) -> Column:
    data: Column = np.frombuffer(flat, np.float64)  # type: ignore[call-overload]
    return data.reshape(shape)


def _rate(running: Column, interval_s: Column) -> Column:
    """Mean power [W] from an energy [J] that ran from 0 at the start."""
    rate: Column = np.diff(running, prepend=0.0) / interval_s
    return rate

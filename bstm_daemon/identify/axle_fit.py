"""Front and rear brakes apart, where their pressures part.

``F = s_f K_f (p_f - p0) + s_r K_r (p_r - p0)`` is linear in both scales and
in one constant. With one pressure for both axles the sum alone is seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan, sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.identify.friction_fit import weights

if TYPE_CHECKING:
    import numpy.typing as npt

    from bstm_daemon.config import Config
    from bstm_daemon.identify.friction_fit import Table
    from bstm_daemon.quality.recording import Column

    Rows = npt.NDArray[np.intp]

AXLE_SPREAD: Final = 0.05
"""Spread of rear over front pressure that tells the axles apart."""

AXLE_ERROR: Final = 0.05
"""Largest standard error of a front share that is identified."""

PARTS: Final = 10
"""Errors come from leaving out one such part of the samples at a time."""


@dataclass(frozen=True, slots=True)
class AxleFit:
    """Pairs of value and standard error; ``doubt`` says why they are none.

    ``total`` is the scale of both axles at equal pressure.
    """

    share: tuple[float, float]
    front: tuple[float, float] = (nan, nan)
    rear: tuple[float, float] = (nan, nan)
    total: tuple[float, float] = (nan, nan)
    pushout_pa: tuple[float, float] = (nan, nan)
    residual_n: float = nan
    doubt: str = ""


def fit_axles(
    table: Table, config: Config, pushout_pa: float | None
) -> AxleFit:
    """Fit the axles of *config* apart; *pushout_pa* is held if given."""
    doubt = _why_not(table, config)
    if doubt:
        return AxleFit((table.front_gain / table.gain, nan), doubt=doubt)
    every = np.arange(len(table.force))
    whole = _solve(table, every, pushout_pa)
    groups = every * PARTS // len(every)
    parts = np.array(
        [
            _solve(table, np.flatnonzero(groups != n), pushout_pa)
            for n in range(PARTS)
        ]
    )
    errors = [_error(column) for column in parts.T]
    front, rear, total, share, pushout = zip(
        whole.tolist(), errors, strict=True
    )
    if share[1] > AXLE_ERROR or not 0.0 < share[0] < 1.0:
        doubt = (
            f"the pressures of the axles differ too little: {share[0]:.2f} "
            f"with a standard error of {share[1]:.2f}"
        )
        return AxleFit(share, doubt=doubt)
    rest = (
        table.force
        - front[0] * table.front_gain * (table.front - pushout[0])
        - rear[0] * table.rear_gain * (table.rear - pushout[0])
    )
    residual = float(np.sqrt(np.mean(rest**2)))
    return AxleFit(share, front, rear, total, pushout, residual)


def _solve(table: Table, rows: Rows, pushout_pa: float | None) -> Column:
    """Return front, rear and total scale, front share and push-out."""
    weight = weights(table)[rows]
    front, rear = table.front[rows], table.rear[rows]
    held = 0.0 if pushout_pa is None else pushout_pa
    columns = [
        table.front_gain * (front - held),
        table.rear_gain * (rear - held),
    ]
    if pushout_pa is None:
        columns.append(np.full(len(rows), table.gain))
    matrix = np.column_stack(columns) * weight[:, None]
    norm = np.linalg.norm(matrix, axis=0)
    solved = (
        np.linalg.lstsq(matrix / norm, table.force[rows] * weight, rcond=None)[
            0
        ]
        / norm
    )
    pushed_front = float(solved[0]) * table.front_gain
    pushed = pushed_front + float(solved[1]) * table.rear_gain
    if pushout_pa is None:
        held = -float(solved[2]) * table.gain / pushed
    return np.array(
        [
            solved[0],
            solved[1],
            pushed / table.gain,
            pushed_front / pushed,
            held,
        ]
    )


def _error(values: Column) -> float:
    spread = float(((values - values.mean()) ** 2).sum())
    return sqrt(spread * (len(values) - 1) / len(values))


def _why_not(table: Table, config: Config) -> str:
    """Say why front and rear can not be told apart; empty if they can."""
    if not table.front_gain or not table.rear_gain:
        return "brakes of one axle only have a pressure"
    ratio = table.rear / table.front
    spread = float(np.std(ratio) / abs(np.mean(ratio)))
    if spread >= AXLE_SPREAD:
        return ""
    text = (
        "the rear pressure is the same share of the front one in every "
        f"sample (spread {100 * spread:.1f} %): the car's motion shows their "
        "sum only"
    )
    if not any(role.startswith("wheel_pressure_") for role in config.signals):
        text += (
            ". Wheel pressures that part (brake force distribution, one "
            "circuit bled) would tell; wheel slip would need the tyres' "
            "stiffness"
        )
    return text

"""The heat flow that the model lacks at a node, neighbours as measured.

The weak form of a node's balance: over a window of time the node starts at
its measured temperature, its measured neighbours follow theirs, and the heat
that would have brought it to what was measured at the window's end is what
the model lacks. No derivative of a measurement is formed, and losses within
the window are counted, as the response to a constant heat is marched too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.gap.noise import noise_of
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.march import (
    initial_temperatures,
    march,
    model_of,
)
from bstm_daemon.analysis.matching.phases import BRAKING_W, STANDING_MS
from bstm_daemon.analysis.statistics.series import Column, block_means
from bstm_daemon.estimator.corner_model import compiled_model
from bstm_daemon.model.thermal.program import Program, compile_network

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config.sections import Config

WINDOW_STEPS: Final = 60
"""Half a minute: longer than a thermocouple's lag, shorter than a descent."""

SMOOTH_STEPS: Final = 10
"""Measured series are means over so many steps to either side."""

PROBE_W: Final = 100.0
SHIFT_K: Final = 1.0
DRAWS: Final = 100

REGIMES: Final = ("braking", "driving", "parked")
BRAKED_SHARE: Final = 0.1
"""Of a window, from which it is one of braking."""


@dataclass(frozen=True, slots=True, eq=False)
class NodeHeat:
    """Residual heat of one node of a corner over one drive.

    By window (n,): its end [s], the missing heat [J], the regime's index and
    the means of the node's temperature [K], speed and pressure.
    ``draws_j`` (draws, n) is what noise alone would give.
    """

    drive: str
    corner: str
    node: str
    time_s: Column
    missing_j: Column
    draws_j: Column
    regime: Column
    temperature_k: Column
    speed_ms: Column
    pressure_pa: Column


def residual_heat(
    config: Config, drive: Drive, corner: str, seed: int = 0
) -> list[NodeHeat]:
    """Return the residual heat of every measured node of *corner*."""
    program = compiled_model(model_of(config, corner))
    measured = _measured(drive, corner, program)
    count = len(drive) // WINDOW_STEPS
    if count < 1 or not measured:
        return []
    initial = initial_temperatures(program, drive, corner)
    rng = np.random.default_rng(seed)
    noise = {
        node: _noise(config, drive, corner, node, series, rng)
        for node, series in measured.items()
    }
    place = (program, drive, corner, initial)
    heats = [_node_heat(place, node, measured, noise) for node in measured]
    return [one for one in heats if one is not None]


def _measured(
    drive: Drive, corner: str, program: Program
) -> dict[str, Column]:
    """Return smoothed temperatures [K] by node, (steps,); NaN in gaps."""
    nodes = {node.name for node in program.network.nodes}
    parts: dict[str, list[Column]] = {}
    for couple, node in drive.couples(corner, nodes):
        series = drive.measured[corner][couple]
        parts.setdefault(node, []).append(series.at(drive.time_s))
    width = 2 * SMOOTH_STEPS + 1
    found = {}
    for node, several in parts.items():
        padded = np.pad(np.mean(several, axis=0), SMOOTH_STEPS, "edge")
        found[node] = np.convolve(padded, np.full(width, 1 / width), "valid")
    return found


def _node_heat(
    place: tuple[Program, Drive, str, Mapping[str, float]],
    node: str,
    measured: Mapping[str, Column],
    noise: Mapping[str, Column],
) -> NodeHeat | None:
    program, drive, corner, initial = place
    steps = len(drive)
    begins = np.arange(0, steps - WINDOW_STEPS + 1, WINDOW_STEPS)
    ends = begins + WINDOW_STEPS - 1

    def ended(shifted: str = "", extra_w: float = 0.0) -> Column:
        """Return the node's temperature at the end of each window."""
        series = {
            name: own + (SHIFT_K if name == shifted else 0.0)
            for name, own in measured.items()
        }
        anchored = np.full(steps, np.nan)
        anchored[begins] = series[node][begins]
        series[node] = anchored
        probed = drive.with_extra_heat(
            np.full(drive.inputs.shape[:2], extra_w)
        )
        heated = compile_network(program.network.with_extra_heat(node))
        out = march([heated], probed, corner, initial, series)
        return np.asarray(out[node][ends, 0])

    base = ended()
    response = (ended(extra_w=PROBE_W) - base) / PROBE_W
    kept = (ended(node) - base) / SHIFT_K
    duration_s = (WINDOW_STEPS - 1) * GRID_S
    to_heat = duration_s / response
    error = base - measured[node][ends]
    # noise of the node's own two readings and of its neighbours'
    draws = kept * noise[node][:, :-1] - noise[node][:, 1:]
    for name in (one for one in measured if one != node):
        slope = (ended(name) - base) / SHIFT_K
        middle = 0.5 * (noise[name][:, :-1] + noise[name][:, 1:])
        draws = draws + slope * middle
    known = np.isfinite(error) & np.isfinite(to_heat)
    if not known.any():
        return None
    return NodeHeat(
        drive.name,
        corner,
        node,
        drive.time_s[ends][known],
        (-error * to_heat)[known],
        (-draws * to_heat)[:, known],
        regimes(drive, corner)[known],
        _means(measured[node])[known],
        *(
            _means(drive.channel(corner, name))[known]
            for name in ("speed_ms", "pressure_pa")
        ),
    )


def regimes(drive: Drive, corner: str) -> Column:
    """Return the index in :data:`REGIMES` of each window."""
    braked = _means(
        (drive.channel(corner, "brake_power_w") > BRAKING_W).astype(float)
    )
    moving = _means(
        (drive.channel(corner, "speed_ms") > STANDING_MS).astype(float)
    )
    return np.where(braked > BRAKED_SHARE, 0, np.where(moving > 0.5, 1, 2))


def _means(column: Column) -> Column:
    return block_means(column, WINDOW_STEPS)


def _noise(
    config: Config,
    drive: Drive,
    corner: str,
    node: str,
    series: Column,
    rng: np.random.Generator,
) -> Column:
    """Return draws of a thermocouple's error at windows' ends (draws, n+1)."""
    count = len(series) // WINDOW_STEPS
    at = np.concatenate(([0], np.arange(1, count + 1) * WINDOW_STEPS - 1))
    known = np.nan_to_num(series[at], nan=float(np.nanmean(series)))
    time_s = drive.time_s[at]
    air = drive.channel(corner, "ambient_k")[at]
    covariance = (
        noise_of(config, node)
        .scaled(1.0, (2 * SMOOTH_STEPS + 1) ** -0.5)
        .covariance(time_s, np.gradient(known, time_s), known - air)
    )
    lower = np.linalg.cholesky(covariance)
    return np.asarray(rng.standard_normal((DRAWS, len(at))) @ lower.T)

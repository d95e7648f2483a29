"""What no candidate has: heat at a node, and readings that differ.

The open set. For each node and regime a heat flow into the node that follows
its excess over the air, or the brake power at the disc while braking; and for
each node a thermocouple that reads otherwise. Together they stand for whatever
is missing there, without a name. They decide whether anything is missing that
no candidate explains.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.comparison import Comparison
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.residual_heat import REGIMES
from bstm_daemon.analysis.matching.drives import Drive
from bstm_daemon.analysis.matching.march import (
    initial_temperatures,
    march,
    model_of,
)
from bstm_daemon.analysis.matching.phases import STANDING_MS, braking
from bstm_daemon.analysis.matching.problem import Series
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.estimator.corner_model import compiled_model
from bstm_daemon.model.thermal.program import compile_network

SILENT_K: Final = 1e-3
"""What nowhere changes the model by more is not excited."""

TYPICAL_W_K: Final = {
    "disc": 2.0,
    "pad_front": 1.0,
    "pad_back": 0.4,
    "fluid": 0.4,
}
"""Heat per kelvin above the air that counts as strength 1."""

OF_BRAKING: Final = 0.05
"""Share of the brake power at the disc, likewise."""

OTHER_W_K: Final = 0.4

READS_LESS: Final = 0.1
READS_LATE_S: Final = 15.0
READS_LOW_K: Final = 3.0
"""By what a thermocouple errs at strength 1: of its node's excess over the
air, of the temperature's rate, and always."""


@dataclass(frozen=True, slots=True, eq=False)
class Unnamed:
    """Heat at a node, or else what differs, and when or with what it does.

    ``change`` (n,) is that of the residuals.
    """

    place: str
    when: str
    change: Column
    is_heat: bool = True

    @property
    def said(self) -> str:
        """What it is, in words."""
        if self.is_heat:
            return f"heat at {self.place}, {self.when}"
        return f"{self.place} that differs {self.when}"


def unnamed_heats(
    comparison: Comparison, base_k: Column
) -> tuple[Unnamed, ...]:
    """Return what each heat would change in residuals *base_k* (n,) [K]."""
    nodes = list(dict.fromkeys(one.node for one in comparison.series))
    found = []
    for node in nodes:
        for regime in REGIMES:
            change = _apart(comparison, node, regime) - base_k
            if float(np.abs(change).max()) > SILENT_K:
                found.append(Unnamed(node, regime, change))
    return tuple(found)


def unnamed_readings(
    layout: Layout, residual_k: Column
) -> tuple[Unnamed, ...]:
    """Return what each reading would change in *residual_k* (n,) [K].

    By what the model has: with the noisy reading itself, tunables that scale
    the model would leave the noise, and that explains the residuals.
    """
    parts: dict[tuple[str, str], Column] = {}
    for one, ends in zip(layout.series, pairwise(layout.edges), strict=True):
        own = slice(*ends)
        for what, change_k in _misread(one, residual_k[own]):
            place = f"reading of {one.node}", what
            whole = parts.setdefault(place, np.zeros(len(residual_k)))
            whole[own] = change_k
    return tuple(
        Unnamed(*place, change, is_heat=False)
        for place, change in parts.items()
    )


def _misread(
    series: Series, residual_k: Column
) -> Iterator[tuple[str, Column]]:
    """Yield what a reading may differ with, and the change (n,) [K]."""
    rate = np.gradient(series.measured_k + residual_k, series.time_s)
    yield "with its excess", READS_LESS * (series.rise_k + residual_k)
    yield "with its rate", -READS_LATE_S * rate
    yield "always", np.full(len(residual_k), READS_LOW_K)


def _apart(comparison: Comparison, node: str, regime: str) -> Column:
    """Return the residuals [K] with that heat, (n,)."""
    shown = {}
    config = comparison.config(comparison.start)
    own = {s.drive: s for s in comparison.series if s.node == node}
    for number, name in comparison.pairs:
        drive = comparison.recordings[number].drive
        model = model_of(config, name)
        program = compile_network(model.network.with_extra_heat(node))
        heat = np.zeros(drive.inputs.shape[:2])
        if number in own:
            heat[:] = _heat_w(drive, name, own[number], regime)[:, None]
        initial = initial_temperatures(compiled_model(model), drive, name)
        result = march([program], drive.with_extra_heat(heat), name, initial)
        shown[number, name] = comparison.sampled(config, number, model, result)
    return comparison.less_measured(config, shown)[:, 0]


def _heat_w(drive: Drive, corner: str, series: Series, regime: str) -> Column:
    braked = braking(drive, corner)
    moving = drive.channel(corner, "speed_ms") > STANDING_MS
    if regime == "braking" and series.node == "disc":
        power = drive.channel(corner, "brake_power_w")
        return np.asarray(OF_BRAKING * power * braked)
    mask = {
        "braking": braked,
        "driving": moving & ~braked,
        "parked": ~moving & ~braked,
    }[regime]
    rise = np.interp(drive.time_s, series.time_s, series.rise_k)
    typical = TYPICAL_W_K.get(series.node, OTHER_W_K)
    return np.asarray(typical * rise * mask)

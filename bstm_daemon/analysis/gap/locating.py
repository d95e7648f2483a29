"""Where, when and how much: the residual heat in cells, with significance.

A cell is a node, a regime and a bin of the node's temperature; marginal
tables by speed, pressure, wetness and time stand beside. Two nodes whose
residual heats are opposite lack a link between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.gap.residual_heat import (
    REGIMES,
    NodeHeat,
    residual_heat,
)
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.statistics.series import Column, Indices
    from bstm_daemon.config.sections import Config

TEMPERATURES_C: Final = (100.0, 200.0, 300.0, 450.0)
SPEEDS_KMH: Final = (5.0, 40.0, 80.0, 120.0)
PRESSURES_BAR: Final = (2.0, 10.0, 30.0)

SIGNIFICANT: Final = 3.0
OPPOSITE: Final = -0.6
"""Correlation of two nodes' residual heats from which it is a link."""

LEAST_WINDOWS: Final = 3


@dataclass(frozen=True, slots=True)
class Cell:
    """Missing heat of one node in one regime and bin.

    ``energy_j`` is what the model lacks, negative where it has too much;
    ``windows`` how many half minutes.
    """

    node: str
    regime: str
    bin: str
    energy_j: float
    deviation_j: float
    windows: int

    @property
    def z(self) -> float:
        """Energy over its standard deviation."""
        return self.energy_j / max(self.deviation_j, 1e-9)


@dataclass(frozen=True, slots=True)
class Place:
    """The gap in a word: a node, or the link of two.

    ``other`` is the link's second node, "" for a single one.
    """

    node: str
    other: str
    regime: str
    energy_j: float
    z: float

    def __str__(self) -> str:
        """Return it for people."""
        where = self.node if not self.other else f"{self.node} - {self.other}"
        return f"{where}, {self.regime}"


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """The places; the map: cells by temperature, and by other drivers."""

    places: tuple[Place, ...]
    cells: tuple[Cell, ...]
    by_speed: tuple[Cell, ...]
    by_pressure: tuple[Cell, ...]
    by_time: tuple[Cell, ...]


def locate(
    config: Config, recordings: Sequence[Recording], corners: Sequence[str]
) -> Located:
    """Return where *config* and the recordings disagree."""
    heats = [
        one
        for number, recording in enumerate(recordings)
        for corner in corners
        if corner in recording.drive.measured
        for one in residual_heat(config, recording.drive, corner, number)
    ]
    tables = (
        (_temperature_bin, labels(TEMPERATURES_C, "degC")),
        (
            lambda h: np.digitize(3.6 * h.speed_ms, SPEEDS_KMH),
            labels(SPEEDS_KMH, "km/h"),
        ),
        (
            lambda h: np.digitize(1e-5 * h.pressure_pa, PRESSURES_BAR),
            labels(PRESSURES_BAR, "bar"),
        ),
        (
            lambda h: (h.time_s > 0.5 * h.time_s[-1]).astype(int),
            ("first half", "second half"),
        ),
    )
    return Located(_places(heats), *(_cells(heats, *one) for one in tables))


def _temperature_bin(heat: NodeHeat) -> Indices:
    return np.digitize(heat.temperature_k - KELVIN_OFFSET, TEMPERATURES_C)


def labels(edges: Sequence[float], unit: str) -> tuple[str, ...]:
    """Return the names of the bins between *edges*."""
    return (
        f"< {edges[0]:g} {unit}",
        *(f"{a:g} to {b:g} {unit}" for a, b in pairwise(edges)),
        f"> {edges[-1]:g} {unit}",
    )


def _cells(
    heats: Sequence[NodeHeat],
    bin_of: Callable[[NodeHeat], Indices],
    names: Sequence[str],
) -> tuple[Cell, ...]:
    found = []
    nodes = dict.fromkeys(one.node for one in heats)
    for node in nodes:
        own = [one for one in heats if one.node == node]
        for regime, regime_name in enumerate(REGIMES):
            for number, name in enumerate(names):
                masks = [
                    (one.regime == regime) & (bin_of(one) == number)
                    for one in own
                ]
                windows = sum(int(mask.sum()) for mask in masks)
                if windows >= LEAST_WINDOWS:
                    energy, sd = _summed(own, masks)
                    found.append(
                        Cell(node, regime_name, name, energy, sd, windows)
                    )
    return tuple(found)


def _summed(
    heats: Sequence[NodeHeat], masks: Sequence[Column]
) -> tuple[float, float]:
    """Return energy and deviation: a mean over corners that err alike."""
    corners = len({one.corner for one in heats})
    energy = sum(
        float(one.missing_j[mask].sum())
        for one, mask in zip(heats, masks, strict=True)
    )
    deviation = sum(
        float(one.draws_j[:, mask].sum(axis=1).std()) ** 2 * corners
        for one, mask in zip(heats, masks, strict=True)
    )
    return energy / corners, deviation**0.5 / corners


def _places(heats: Sequence[NodeHeat]) -> tuple[Place, ...]:
    """Return nodes and links by regime, the plainest first."""
    nodes = list(dict.fromkeys(one.node for one in heats))
    found: list[Place] = []
    for regime, name in enumerate(REGIMES):
        plain = {}
        for node in nodes:
            own = [one for one in heats if one.node == node]
            masks = [one.regime == regime for one in own]
            if sum(int(mask.sum()) for mask in masks) < LEAST_WINDOWS:
                continue
            z, energy = _strength(own, masks)
            if z >= SIGNIFICANT:
                plain[node] = (z, energy)
        linked = set()
        for a, b in combinations(plain, 2):
            if _correlation(heats, a, b, regime) < OPPOSITE:
                ratio = abs(plain[a][1]) / max(abs(plain[b][1]), 1e-9)
                if 1 / 3 < ratio < 3.0:
                    linked |= {a, b}
                    found.append(
                        Place(
                            a,
                            b,
                            name,
                            plain[a][1],
                            min(plain[a][0], plain[b][0]),
                        )
                    )
        found += [
            Place(node, "", name, energy, z)
            for node, (z, energy) in plain.items()
            if node not in linked
        ]
    return tuple(sorted(found, key=lambda one: -one.z))


def _strength(
    heats: Sequence[NodeHeat], masks: Sequence[Column]
) -> tuple[float, float]:
    """Return standard deviations and energy of the largest sum of a sign.

    Heat that is missing here and too much there must not cancel: the sum is
    taken over temperature bins, in quadrature of their significance.
    """
    parts = []
    for number in range(len(TEMPERATURES_C) + 1):
        own = [
            mask & (_temperature_bin(one) == number)
            for one, mask in zip(heats, masks, strict=True)
        ]
        if sum(int(mask.sum()) for mask in own) >= LEAST_WINDOWS:
            parts.append(_summed(heats, own))
    if not parts:
        return 0.0, 0.0
    energy, sd = max(parts, key=lambda p: abs(p[0]) / max(p[1], 1e-9))
    return abs(energy) / max(sd, 1e-9), energy


def _correlation(
    heats: Sequence[NodeHeat], a: str, b: str, regime: int
) -> float:
    one, two = [], []
    for first in heats:
        for second in heats:
            if (
                (first.node, second.node) == (a, b)
                and first.drive == second.drive
                and first.corner == second.corner
            ):
                _, i, j = np.intersect1d(
                    first.time_s, second.time_s, return_indices=True
                )
                own = first.regime[i] == regime
                one.append(first.missing_j[i][own])
                two.append(second.missing_j[j][own])
    x, y = np.concatenate(one or [[]]), np.concatenate(two or [[]])
    if len(x) < LEAST_WINDOWS or not x.any() or not y.any():
        return 0.0
    return float(x @ y / np.sqrt((x @ x) * (y @ y)))

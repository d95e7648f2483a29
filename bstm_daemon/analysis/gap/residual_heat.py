"""The heat flow that the model lacks at a node, neighbours as measured.

The weak form of a node's balance: over a window of time the node starts at
its measured temperature, its measured neighbours follow theirs, and the heat
that would have brought it to what was measured at the window's end is what
the model lacks. No derivative of a measurement is formed, and losses within
the window are counted, as the response to a constant heat is marched too.

Where, when and how much, with significance, is said in cells. A cell is a
node, a regime and a bin of the node's temperature; marginal tables by speed,
pressure and time stand beside. Two nodes whose residual heats are opposite
lack a link between them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.noise import noise_of
from bstm_daemon.analysis.gap.recording import Recording
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.march import (
    initial_temperatures,
    march,
    model_of,
)
from bstm_daemon.analysis.matching.phases import STANDING_MS, braking
from bstm_daemon.analysis.statistics.series import Column, Indices, block_means
from bstm_daemon.config.sections import Config
from bstm_daemon.estimator.corner_model import compiled_model
from bstm_daemon.model.thermal.program import Program, compile_network
from bstm_daemon.units import KELVIN_OFFSET

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

TEMPERATURES_C: Final = (100.0, 200.0, 300.0, 450.0)
SPEEDS_KMH: Final = (5.0, 40.0, 80.0, 120.0)
PRESSURES_BAR: Final = (2.0, 10.0, 30.0)

SIGNIFICANT: Final = 3.0
OPPOSITE: Final = -0.6
"""Correlation of two nodes' residual heats from which it is a link."""

LEAST_WINDOWS: Final = 3


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


def residual_heat(
    config: Config, drive: Drive, corner: str, seed: int = 0
) -> list[NodeHeat]:
    """Return the residual heat of every measured node of *corner*."""
    program = compiled_model(model_of(config, corner))
    measured = measured_nodes(drive, corner, program)
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


def measured_nodes(
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

    def ended(shifted: Sequence[str], extra_w: float = 0.0) -> Column:
        """Return the node's temperature at the end of each window.

        (windows, shifted), each with the series of that name shifted.
        """
        series = {
            name: own[:, None] + [SHIFT_K * (one == name) for one in shifted]
            for name, own in measured.items()
        }
        anchored = np.full((steps, len(shifted)), np.nan)
        anchored[begins] = series[node][begins]
        series[node] = anchored
        probed = drive.with_extra_heat(
            np.full(drive.inputs.shape[:2], extra_w)
        )
        heated = compile_network(program.network.with_extra_heat(node))
        variants = [heated] * len(shifted)
        out = march(variants, probed, corner, initial, series)
        return np.asarray(out[node][ends])

    others = [name for name in measured if name != node]
    base, own, *beside = ended(["", node, *others]).T
    response = (ended([""], PROBE_W)[:, 0] - base) / PROBE_W
    kept = (own - base) / SHIFT_K
    duration_s = (WINDOW_STEPS - 1) * GRID_S
    to_heat = duration_s / response
    error = base - measured[node][ends]
    # noise of the node's own two readings and of its neighbours'
    draws = kept * noise[node][:, :-1] - noise[node][:, 1:]
    for name, shifted in zip(others, beside, strict=True):
        slope = (shifted - base) / SHIFT_K
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
    braked = _means(braking(drive, corner).astype(float))
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
        (
            lambda h: np.digitize(
                h.temperature_k - KELVIN_OFFSET, TEMPERATURES_C
            ),
            labels(TEMPERATURES_C, "degC"),
        ),
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
    cells, *others = [_cells(heats, *one) for one in tables]
    return Located(_places(heats, cells), cells, *others)


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


def _places(
    heats: Sequence[NodeHeat], cells: Sequence[Cell]
) -> tuple[Place, ...]:
    """Return nodes and links by regime, the plainest first.

    Heat that is missing here and too much there must not cancel: of the
    *cells* by temperature the plainest one counts.
    """
    found: list[Place] = []
    for regime, name in enumerate(REGIMES):
        plain: dict[str, Cell] = {}
        for cell in cells:
            if cell.regime == name and abs(cell.z) >= SIGNIFICANT:
                there = plain.setdefault(cell.node, cell)
                if abs(cell.z) > abs(there.z):
                    plain[cell.node] = cell
        linked = set()
        for a, b in combinations(plain, 2):
            if _correlation(heats, a, b, regime) < OPPOSITE:
                one, other = plain[a], plain[b]
                ratio = abs(one.energy_j) / max(abs(other.energy_j), 1e-9)
                if 1 / 3 < ratio < 3.0:
                    linked |= {a, b}
                    z = min(abs(one.z), abs(other.z))
                    found.append(Place(a, b, name, one.energy_j, z))
        found += [
            Place(node, "", name, cell.energy_j, abs(cell.z))
            for node, cell in plain.items()
            if node not in linked
        ]
    return tuple(sorted(found, key=lambda one: -one.z))


def _correlation(
    heats: Sequence[NodeHeat], a: str, b: str, regime: int
) -> float:
    one, two = [], []
    for first in heats:
        for second in heats:
            if (first.node, second.node) == (a, b) and (
                (first.drive, first.corner) == (second.drive, second.corner)
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

"""Thermocouples: what they read, and where below the friction face they lie.

A lining has a gradient of tens of kelvin a millimetre: its temperature is
read between the slabs. The disc is one node; while a brake works, a cheek is
hotter at its face than in its mean. For a heat flux q [W/m2] into a plate of
thickness d, insulated behind, the quasi-steady profile over the depth x is
``q d / k (1/3 - x / d + x^2 / (2 d^2))`` (Carslaw and Jaeger, Conduction of
Heat in Solids, 3.8), and builds up with the time constant
``d^2 / (pi^2 a)`` of its slowest part.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import Final

import numpy as np

from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import ConfigError
from bstm_daemon.model.thermal.brake_corner import CornerSpec, corner_spec
from bstm_daemon.model.thermal.network import Network
from bstm_daemon.roles import MEASURED_NODES, ROLE_INDEX, ROLES

LONGEST_GAP_S: Final = 5.0
"""Between two samples of a thermocouple that are joined by a line."""

EDGE_S: Final = 0.5
"""Its first and last sample hold so far beyond, a step of matching."""

NODE_OF: Final = {"disc_2": "disc"}
"""Thermocouple to node, where the names differ."""

THERMOCOUPLES: Final = frozenset(
    number
    for number, role in enumerate(ROLES)
    if role.name.startswith("temp_")
)
"""Numbers of their roles."""

PAD: Final = "pad_front"

MEMORY_STEPS: Final = 24
"""What came before so many steps has no part in the profile of a disc."""


LAG_STEPS: Final = 64
"""Steps of a lag that are taken at a time."""


@dataclass(frozen=True, slots=True)
class Thermocouple:
    """Samples of one thermocouple: since the drive's start [s], and [K]."""

    time_s: Column
    temperature_k: Column

    def at(self, time_s: Column) -> Column:
        """Return the temperature at *time_s*, (n,); NaN within a gap."""
        value = np.asarray(
            np.interp(time_s, self.time_s, self.temperature_k), np.float64
        )
        after = np.searchsorted(self.time_s, time_s)
        last = len(self.time_s) - 1
        right = self.time_s[np.minimum(after, last)]
        left = self.time_s[np.maximum(after - 1, 0)]
        inside = (time_s >= self.time_s[0] - EDGE_S) & (
            time_s <= self.time_s[-1] + EDGE_S
        )
        near = inside & (right - left <= LONGEST_GAP_S)
        value[~near] = np.nan
        return value


@dataclass(frozen=True, slots=True)
class InPad:
    """So deep below the friction face of a lining."""

    depth_m: float

    def shares(self, network: Network) -> dict[str, float]:
        """Return how much of its reading is of which node.

        Above the first node and below the last as these are.

        Raises:
            ConfigError: a pad model of the user's that gives no depths.
        """
        lining = _known_lining(network)
        depths_m = list(lining.values())
        place = float(np.interp(self.depth_m, depths_m, range(len(depths_m))))
        above = min(int(place), len(depths_m) - 2)
        upper, lower = list(lining)[above : above + 2]
        return {upper: 1.0 - (place - above), lower: place - above}

    def node(self, network: Network) -> str:
        """Return the nearest node.

        Raises:
            ConfigError: a pad model of the user's that gives no depths.
        """
        lining = _known_lining(network)
        return min(lining, key=lambda name: abs(lining[name] - self.depth_m))


@dataclass(frozen=True, slots=True)
class InDisc:
    """Above the disc's mean by ``excess_k_w`` [K/W], ``lag_s`` late."""

    excess_k_w: float
    lag_s: float

    def excess_k(self, power_w: Column, step_s: float) -> Column:
        """Return by how much it is hotter [K], (steps,), at *power_w*."""
        weights = np.exp(-step_s / self.lag_s * np.arange(MEMORY_STEPS))
        weights *= self.excess_k_w / weights.sum()
        return np.convolve(power_w, weights)[: len(power_w)]


Placement = InPad | InDisc


def placements(config: Config) -> dict[str, dict[str, Placement]]:
    """Return the thermocouples whose depth is configured.

    By corner and node; the others read their node.
    """
    found: dict[str, dict[str, Placement]] = {}
    for corner in config.disc_corners():
        for node in ("disc", PAD):
            role = f"temp_{corner.name.lower()}_{node}"
            signal = config.signals.get(role)
            if signal is not None and signal.depth_m is not None:
                spec = corner_spec(config, corner)
                found.setdefault(corner.name, {})[node] = (
                    InPad(signal.depth_m)
                    if node == PAD
                    else _in_disc(spec, signal.depth_m)
                )
    return found


def _in_disc(spec: CornerSpec, depth_m: float) -> InDisc:
    disc = spec.disc
    density = disc.density_kg_m3
    thickness_m = disc.mass_kg / (density * disc.swept_area_m2)
    part = min(depth_m / thickness_m, 1.0)
    shape = 1.0 / 3.0 - part + 0.5 * part**2
    k_w_mk = disc.conductivity_w_mk
    diffusivity = k_w_mk / (density * disc.effusivity_heat_capacity_j_kgk)
    return InDisc(
        spec.disc_share * shape * thickness_m / (k_w_mk * disc.swept_area_m2),
        thickness_m**2 / (pi**2 * diffusivity),
    )


def lagged(values: Column, time_s: float, step_s: float) -> Column:
    """Return *values* (steps, n) as what follows them with *time_s* shows.

    Exact for what goes in straight lines from step to step; the first is
    there from the start.
    """
    if not time_s > 0.0:
        return values
    keep = np.exp(-step_s / time_s)
    rise = (
        -time_s
        / step_s
        * (1.0 - keep)
        * np.diff(values, axis=0, prepend=values[:1])
    )
    ages = np.arange(LAG_STEPS)
    since = np.tril(keep ** np.abs(ages[:, None] - ages))
    behind = np.zeros(values.shape[1:])
    shown = np.empty_like(values)
    for first in range(0, len(values), LAG_STEPS):
        own = slice(first, first + LAG_STEPS)
        count = len(rise[own])
        apart = since[:count, :count] @ rise[own]
        apart += keep ** (ages[:count, None] + 1.0) * behind
        shown[own] = values[own] + apart
        behind = apart[-1]
    return shown


def node_at(
    node: str, placed: Mapping[str, Placement], network: Network
) -> str:
    """Return the node that the thermocouple of *node* is next to."""
    place = placed.get(node)
    return place.node(network) if isinstance(place, InPad) else node


def lining_of(network: Network) -> dict[str, float]:
    """Return the depth [m] of each node of a lining, from the face on."""
    depths_m = {
        one.name: one.depth_m
        for one in network.nodes
        if one.depth_m is not None
    }
    return dict(sorted(depths_m.items(), key=lambda one: one[1]))


def _known_lining(network: Network) -> dict[str, float]:
    lining = lining_of(network)
    if len(lining) < 2:
        msg = (
            f"[signals] depth_m: pad.model gives {len(lining)} of its nodes a "
            "depth_m; two or more are needed"
        )
        raise ConfigError([msg])
    return lining


def thermocouples_of(
    temperatures: Mapping[int, list[tuple[Column, Column]]],
    corners: tuple[str, ...],
    start_s: float,
) -> dict[str, dict[str, Thermocouple]]:
    """Return thermocouples by corner and node, of samples by role number.

    Times [s] of the samples are stamps; those returned count from *start_s*.
    """
    found: dict[str, dict[str, Thermocouple]] = {}
    for corner in corners:
        own = {}
        for node in MEASURED_NODES:
            role = ROLE_INDEX[f"temp_{corner.lower()}_{node}"]
            parts = temperatures.get(role)
            if parts:
                time_s = np.concatenate([time for time, _ in parts]) - start_s
                value = np.concatenate([value for _, value in parts])
                order = np.argsort(time_s, kind="stable")
                own[node] = Thermocouple(time_s[order], value[order])
        if own:
            found[corner] = own
    return found

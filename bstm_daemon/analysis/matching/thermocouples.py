"""Thermocouples: what they read, and where below the friction face they lie.

A lining has a gradient of tens of kelvin a millimetre: its temperature is
read between the slabs. The disc is one node; while a brake works, a cheek is
hotter at its face than in its mean. For a heat flux q [W/m2] into a plate of
thickness d, insulated behind, the quasi-steady profile over the depth x is
``q d / k (1/3 - x / d + x^2 / (2 d^2))`` (Carslaw and Jaeger, Conduction of
Heat in Solids, 3.8), and builds up with the time constant
``d^2 / (pi^2 a)`` of its slowest part.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import pi
from typing import Final

import numpy as np

from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.config.sections import Config
from bstm_daemon.model.thermal.brake_corner import CornerSpec, corner_spec
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
    """At ``slab`` of the chain of pad nodes, counted from the face."""

    slab: float

    def reading(self, at_k: Mapping[str, Column]) -> Column:
        """Return the temperature [K], shaped as that of a node of *at_k*."""
        names = pad_nodes(at_k)
        below = min(int(self.slab), len(names) - 2)
        share = self.slab - below
        upper, lower = at_k[names[below]], at_k[names[below + 1]]
        return (1.0 - share) * upper + share * lower

    def node(self, names: Collection[str]) -> str:
        """Return the nearest node."""
        chain = pad_nodes(names)
        return chain[min(round(self.slab), len(chain) - 1)]


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
                place = _placement(spec, node, signal.depth_m)
                found.setdefault(corner.name, {})[node] = place
    return found


def _placement(spec: CornerSpec, node: str, depth_m: float) -> Placement:
    if node == PAD:
        pad = spec.pad
        full = pad.surface_cells == "full"
        cells = pad.slabs + (2 if full else 1)
        slab = depth_m / pad.thickness_m * cells - (0.5 if full else 0.0)
        return InPad(min(max(slab, 0.0), float(pad.slabs + 1)))
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


def node_at(
    node: str, placed: Mapping[str, Placement], names: Collection[str]
) -> str:
    """Return the one of *names* that the thermocouple of *node* is next to."""
    place = placed.get(node)
    return place.node(names) if isinstance(place, InPad) else node


def pad_nodes(names: Collection[str]) -> list[str]:
    """Return the pad's nodes among *names*, from the face to the back."""
    slabs = [name for name in names if name.removeprefix("pad_").isdigit()]
    slabs.sort(key=lambda name: int(name.removeprefix("pad_")))
    return [PAD, *slabs, "pad_back"]


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

"""Where a thermocouple lies below the friction face, and what is there.

A lining has a gradient of tens of kelvin a millimetre: its temperature is
read between the slabs. The disc is one node; while a brake works, a cheek is
hotter at its face than in its mean. For a heat flux q [W/m2] into a plate of
thickness d, insulated behind, the quasi-steady profile over the depth x is
``q d / k (1/3 - x / d + x^2 / (2 d^2))`` (Carslaw and Jaeger, Conduction of
Heat in Solids, 3.8), and builds up with the time constant
``d^2 / (pi^2 a)`` of its slowest part.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.model.thermal.brake_corner import corner_spec

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.config.sections import Config
    from bstm_daemon.model.thermal.brake_corner import CornerSpec

PAD: Final = "pad_front"

MEMORY_STEPS: Final = 24
"""What came before so many steps has no part in the profile of a disc."""


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

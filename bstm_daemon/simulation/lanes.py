"""Brake corners side by side: parameters, masses and state as arrays.

The last axis of every array is the lane, one brake corner each. A corner is
two *chains*, one a side of the disc, and nine *lumps* that both share::

    backplate | lining, back to front | cheek, surface to inside | centre
    j = 0       1 ... pad_nodes         then cheek nodes

    chain arrays (j, side, lane)        side 0 = piston, 1 = finger
    lump arrays  (lump, lane)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.simulation import materials, parameters, sizes
from bstm_daemon.simulation.materials import Array

CENTRE, HAT, HUB, PISTON, FLUID, BODY, FINGER, BRACKET, AIR = range(
    len(parameters.LUMPS)
)

FRICTION_EFFECTS: Final = tuple(
    name for name in parameters.EFFECT_NAMES if name.startswith("friction_")
)
"""Effects that make mu depart from its nominal value."""

STEEL_DENSITY_KG_M3: Final = 7850.0
STEEL_HEAT_CAPACITY_J_KGK: Final = 480.0

# a fully worn disc has lost about a tenth of each cheek, a worn pad 4.5 mm
_DISC_WEAR_FRACTION: Final = 0.08
_PAD_WEAR_M: Final = 0.0045
_WORN_OUT_M: Final = 0.002

DUCT: Final = parameters.DrawnPath(
    start=3 + CENTRE,
    end=len(parameters.LUMPS),
    conductance_w_k=3.6,
    speed_exponent=1.0,
    onset_k=623.15,
    width_k=10.0,
)
"""A flap that opens where the disc is hot, as of active cooling ducts.

10 cm2 of ram air to the vanes, a seventh of its heat capacity used.
"""


class Rows:
    """Parameters by name, each an array (lanes,)."""

    def __init__(self, table: Array) -> None:
        """Name the rows of *table*, shape (len(PARAMETER_NAMES), lanes)."""
        vars(self).update(zip(parameters.PARAMETER_NAMES, table, strict=True))

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Array:
            """Return the row *name*."""


class Lanes:
    """Constant data of a batch of corners."""

    def __init__(
        self,
        corners: Sequence[parameters.CornerParameters],
        effects: Sequence[parameters.Effects],
        mesh: parameters.Mesh,
    ) -> None:
        """Tabulate *corners* and *effects*, one of each a lane.

        Raises:
            ValueError: a disc whose cheeks leave nothing for its vanes.
        """
        self.table = np.array(
            [
                [getattr(part, name) for part in parts]
                for parts, names in (
                    (corners, parameters.CORNER_NAMES),
                    (effects, parameters.ACTING_NAMES),
                )
                for name in names
            ]
        )
        self.mesh = mesh
        self.count = len(corners)
        self.p = p = Rows(self.table)
        self.pad = slice(1, 1 + mesh.pad_nodes)
        self.cheek = slice(
            self.pad.stop, self.pad.stop + len(mesh.cheek_depths)
        )
        self.surface = self.pad.stop
        self.chain_nodes = self.cheek.stop
        self.first_lump = 2 * self.chain_nodes
        self.nodes = self.first_lump + len(parameters.LUMPS)

        pad_weight = np.full(mesh.pad_nodes, 1.0 / (mesh.pad_nodes - 1))
        pad_weight[[0, -1]] /= 2
        self.pad_weight = pad_weight[:, None, None]
        worn_pad_m = p.pad_thickness_m - _PAD_WEAR_M * p.pad_wear
        self.new_pad_m = np.maximum(
            worn_pad_m, np.minimum(p.pad_thickness_m, _WORN_OUT_M)
        )

        depths = np.array([*mesh.cheek_depths, 1.0])
        edges = np.concatenate(
            ([0.0], (depths[:-2] + depths[1:-1]) / 2, [1.0])
        )
        worn = 1.0 - _DISC_WEAR_FRACTION * p.disc_wear
        thickness = p.cheek_thickness_m * worn
        cheek_kg = p.iron_density_kg_m3 * p.face_area_m2 * thickness
        self.cheek_kg = np.diff(edges)[:, None, None] * cheek_kg
        # the last gap ends at the vent: half of it is bridged by the vanes
        self.cheek_gap_m = np.diff(depths)[:, None, None] * thickness
        fresh_kg = p.iron_density_kg_m3 * p.face_area_m2 * p.cheek_thickness_m
        self.centre_kg = p.ring_mass_kg - 2 * fresh_kg
        if np.any(self.centre_kg <= 0.0):
            msg = (
                f"a ring of {np.min(p.ring_mass_kg):.3g} kg is no heavier "
                f"than its cheeks, {2 * np.max(fresh_kg):.3g} kg: no vanes"
            )
            raise ValueError(msg)
        self.backplate_j_k = (
            STEEL_DENSITY_KG_M3
            * STEEL_HEAT_CAPACITY_J_KGK
            * p.backplate_area_m2
            * p.backplate_thickness_m
        )
        # that of the centre, of iron, follows from its temperature
        self.lump_j_k = np.zeros((len(parameters.LUMPS), self.count))
        for lump, name in enumerate(parameters.LUMPS[HAT:], start=HAT):
            self.lump_j_k[lump] = getattr(p, f"{name}_capacity_j_k")
        self.lining = (
            *(p.pad_heat_capacity_j_kgk, p.pad_capacity),
            p.pad_capacity_slope_j_kgk2,
        )
        self.lining_k = (
            *(p.pad_conductivity_w_mk, p.pad_conductivity),
            p.pad_conductivity_slope_1_k,
        )
        self.variable_pad = bool(
            np.any(p.pad_capacity) or np.any(p.pad_capacity_slope_j_kgk2)
        )
        self.wears = bool(np.any(p.pad_wear))
        self.chars = bool(np.any(p.pad_pyrolysis))
        self.friction_varies = any(
            np.any(getattr(p, name)) for name in FRICTION_EFFECTS
        )
        self.gaps = bool(np.any(p.gap_conduction))
        self.wets = bool(np.any(p.wet_disc))
        self.shields = bool(np.any(p.dust_shield))
        # C has as many of each lane
        self.drawn = np.zeros(
            (self.count, parameters.DRAWN, len(parameters.PATH_NAMES))
        )
        for lane, corner in enumerate(corners):
            duct = DUCT.conductance_w_k * effects[lane].brake_duct
            every = (replace(DUCT, conductance_w_k=duct), *corner.drawn_paths)
            for place, path in zip(self.drawn[lane], every, strict=False):
                place[:] = [
                    getattr(path, name) for name in parameters.PATH_NAMES
                ]
        self.iron = p.disc_capacity_hot, p.iron_slope_j_kgk2
        self.boils = bool(np.any(p.fluid_latent_heat))

    def joined(self, chain: Array, lumps: Array) -> Array:
        """Return all nodes of each lane, chain by chain, (lanes, nodes)."""
        chains = chain.transpose(2, 1, 0).reshape(self.count, -1)
        return np.concatenate((chains, lumps.T), axis=1)

    def split(self, nodes: Array) -> tuple[Array, Array]:
        """Return the chain and the lump array that were joined."""
        chains = nodes[:, : self.first_lump].reshape(self.count, 2, -1)
        return chains.transpose(2, 1, 0), nodes[:, self.first_lump :].T

    def pad_kg(self, state: State) -> Array:
        """Return the mass of every lining node [kg], (nodes, 2, lanes)."""
        p = self.p
        column = p.pad_density_kg_m3 * p.pad_area_m2 * state.pad_m
        return self.pad_weight * column

    def chain_capacity(self, state: State) -> Array:
        """Return the heat capacity of every chain node [J/K]."""
        capacity = np.empty_like(state.chain_k)
        capacity[0] = self.backplate_j_k
        specific = materials.lining_heat_capacity(
            state.chain_k[self.pad], self.lining
        )
        capacity[self.pad] = self.pad_kg(state) * specific
        capacity[self.cheek] = self.cheek_kg * materials.iron_heat_capacity(
            state.chain_k[self.cheek], *self.iron
        )
        return capacity

    def lump_capacity(self, state: State) -> Array:
        """Return the heat capacity of every lump [J/K], (lumps, lanes)."""
        capacity = self.lump_j_k.copy()
        capacity[CENTRE] = self.centre_kg * materials.iron_heat_capacity(
            state.lump_k[CENTRE], *self.iron
        )
        if self.boils:
            x = (state.lump_k[FLUID] - sizes.BOILING_K) / sizes.BOILING_WIDTH_K
            capacity[FLUID] += (
                self.p.fluid_latent_heat
                * (sizes.BOILING_J / (2 * sizes.BOILING_WIDTH_K))
                * (1.0 - np.tanh(x) ** 2)
            )
        return capacity

    def lining_temperature(self, enthalpy_j_kg: Array, near_k: Array) -> Array:
        """Return the temperature [K] of linings with this enthalpy.

        Newton steps from *near_k*, where any lane's capacity varies.
        """
        p = self.p
        if not self.variable_pad:
            return (
                sizes.REFERENCE_K + enthalpy_j_kg / p.pad_heat_capacity_j_kgk
            )
        return materials.lining_temperature(enthalpy_j_kg, near_k, self.lining)

    def fluid_temperature(self, energy_j: Array, near_k: Array) -> Array:
        """Return the temperature [K] of boiling fluid of this energy."""
        latent = self.p.fluid_latent_heat * (sizes.BOILING_J / 2)
        sensible = self.lump_j_k[FLUID]
        t = near_k
        for _ in range(2 * materials.NEWTON_STEPS):
            x = np.tanh((t - sizes.BOILING_K) / sizes.BOILING_WIDTH_K)
            stored = sensible * (t - sizes.REFERENCE_K) + latent * (1 + x)
            slope = sensible + latent / sizes.BOILING_WIDTH_K * (1 - x * x)
            t = t + (energy_j - stored) / slope
        return t

    def energies(self, state: State) -> tuple[Array, Array]:
        """Return the energy of chain and lump nodes [J], 0 at 20 degC."""
        p = self.p
        chain = np.empty_like(state.chain_k)
        chain[0] = self.backplate_j_k * (state.chain_k[0] - sizes.REFERENCE_K)
        specific = materials.lining_enthalpy(
            state.chain_k[self.pad], self.lining
        )
        chain[self.pad] = self.pad_kg(state) * specific
        chain[self.cheek] = self.cheek_kg * materials.iron_enthalpy(
            state.chain_k[self.cheek], *self.iron
        )
        lumps = self.lump_j_k * (state.lump_k - sizes.REFERENCE_K)
        lumps[CENTRE] = self.centre_kg * materials.iron_enthalpy(
            state.lump_k[CENTRE], *self.iron
        )
        if self.boils:
            x = (state.lump_k[FLUID] - sizes.BOILING_K) / sizes.BOILING_WIDTH_K
            lumps[FLUID] += (
                p.fluid_latent_heat
                * (sizes.BOILING_J / 2)
                * (1.0 + np.tanh(x))
            )
        return chain, lumps


@dataclass(slots=True)
class State:
    """Everything of a batch that changes in time.

    ``chain_k``/``lump_k`` follow from the energies; ``pad_m`` (2, lanes) is
    the lining thickness, ``char`` the pyrolysed fraction of every lining node
    and ``friction_j`` (lanes,) the friction energy since the start.
    """

    chain_k: Array
    lump_k: Array
    chain_j: Array
    lump_j: Array
    pad_m: Array
    char: Array
    friction_j: Array


def start_state(lanes: Lanes, temperature_k: Array) -> State:
    """Return a state with every node of a lane at *temperature_k* (lanes,)."""
    chain = np.broadcast_to(
        temperature_k, (lanes.chain_nodes, 2, lanes.count)
    ).copy()
    lumps = np.broadcast_to(
        temperature_k, (len(parameters.LUMPS), lanes.count)
    ).copy()
    state = State(
        chain,
        lumps,
        chain,
        lumps,
        np.broadcast_to(lanes.new_pad_m, (2, lanes.count)).copy(),
        np.zeros((lanes.mesh.pad_nodes, 2, lanes.count)),
        np.zeros(lanes.count),
    )
    state.chain_j, state.lump_j = lanes.energies(state)
    return state

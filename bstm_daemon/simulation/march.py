"""Inputs and results of a march of brake corners."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.simulation.lanes import (
    BODY,
    CENTRE,
    FLUID,
    LUMPS,
    Lanes,
    State,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.simulation.lanes import Lanes, State
    from bstm_daemon.simulation.materials import Array

# thermocouples of a disc sit 1.5 mm under the friction surface
_MEASURED_DEPTH: Final = 0.15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inputs:
    """Inputs of the corners during one step, each (lanes,) or (1,).

    ``power_w`` is friction power, ``contact`` the fraction of the step with
    pressed pads, ``pumping_pa_s`` the mean of the absolute pressure rate.
    """

    speed_ms: Array
    power_w: Array
    pressure_pa: Array
    contact: Array
    ambient_k: Array
    wetness: Array
    pumping_pa_s: Array


INPUT_NAMES: Final = tuple(field.name for field in fields(Inputs))
"""Rows of the inputs of a step, in the order of the compiled form."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneInputs(Inputs):
    """Inputs of a batch, constant over each of n steps.

    Shapes: ``step_s`` (n,), ``keep`` (n,) bool, the rest (n, lanes) or
    (n, 1). ``power_w`` is the friction power at nominal mu. With
    ``corners_per_car`` k > 0 the lanes come in cars of k and each car's total
    power is what its driver demands: where mu falls the pressure rises and
    the corners share the power again. With 0 the pressure is given and power
    follows mu.
    """

    step_s: Array
    keep: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    corners_per_car: int = 0

    def at(self, step: int) -> Inputs:
        """Return the inputs of *step*."""
        return Inputs(**{n: getattr(self, n)[step] for n in INPUT_NAMES})


@dataclass(frozen=True, slots=True, eq=False)
class LaneResult:
    """Outcome of a march.

    ``time_s`` (m,) are the ends of the kept steps; ``nodes`` name to
    temperature [K] (m, lanes); ``power_w`` and ``friction`` (n, lanes) the
    friction power and mu over nominal of every step. ``stored_j``,
    ``heat_in_j``, ``heat_out_j`` (lanes,) over the whole march.
    """

    time_s: Array
    nodes: Mapping[str, Array]
    power_w: Array
    friction: Array
    stored_j: Array
    heat_in_j: Array
    heat_out_j: Array
    state: State

    @property
    def balance_residual(self) -> Array:
        """Energy not accounted for over energy put in, (lanes,)."""
        missing = self.heat_in_j - self.heat_out_j - self.stored_j
        scale = np.maximum(np.abs(self.heat_in_j), np.abs(self.stored_j))
        return missing / np.maximum(scale, 1.0)


@dataclass(slots=True, eq=False)
class March:
    """Raw outcome of a march, filled by either implementation.

    ``chain_k`` (m, chain nodes, 2, lanes) and ``lump_k`` (m, lumps, lanes)
    hold the kept steps, ``power_w`` and ``friction`` (n, lanes) every step.
    """

    chain_k: Array
    lump_k: Array
    power_w: Array
    friction: Array
    heat_in_j: Array
    heat_out_j: Array
    state: State


def empty_march(lanes: Lanes, state: State, inputs: LaneInputs) -> March:
    """Return room for the outcome of marching *lanes* under *inputs*."""
    steps, kept = len(inputs.step_s), int(inputs.keep.sum())
    return March(
        chain_k=np.empty((kept, lanes.chain_nodes, 2, lanes.count)),
        lump_k=np.empty((kept, len(LUMPS), lanes.count)),
        power_w=np.empty((steps, lanes.count)),
        friction=np.empty((steps, lanes.count)),
        heat_in_j=np.zeros(lanes.count),
        heat_out_j=np.zeros(lanes.count),
        state=state,
    )


def lane_result(
    lanes: Lanes, march: March, inputs: LaneInputs, before_j: Array
) -> LaneResult:
    """Return *march* with its nodes by name; *before_j* the energy before."""
    return LaneResult(
        np.cumsum(inputs.step_s)[inputs.keep],
        _named_nodes(lanes, march),
        march.power_w,
        march.friction,
        total_energy(march.state) - before_j,
        march.heat_in_j,
        march.heat_out_j,
        march.state,
    )


def total_energy(state: State) -> Array:
    """Return the energy in each lane [J], 0 at 20 degC, (lanes,)."""
    total: Array = state.chain_j.sum(axis=(0, 1)) + state.lump_j.sum(axis=0)
    return total


def _named_nodes(lanes: Lanes, march: March) -> dict[str, Array]:
    chain, lumps = march.chain_k, march.lump_k
    cheek = chain[:, lanes.cheek]
    ring_kg = lanes.cheek_kg.sum(axis=0) * 2 + lanes.centre_kg
    mean = (cheek * lanes.cheek_kg).sum(axis=(1, 2))
    mean += lumps[:, CENTRE] * lanes.centre_kg
    depths = np.array(lanes.mesh.cheek_depths)
    layer = int(np.argmin(np.abs(depths - _MEASURED_DEPTH)))
    nodes = {
        "disc": cheek[:, layer, 1],
        "disc_2": cheek[:, layer, 0],
        "disc_mean": mean / ring_kg,
        "disc_surface": cheek[:, 0, 1],
        "pad_front": chain[:, lanes.surface - 1, 0],
        "pad_back": chain[:, 1, 0],
        "pad_front_outer": chain[:, lanes.surface - 1, 1],
        "pad_back_outer": chain[:, 1, 1],
        "backplate": chain[:, 0, 0],
        "fluid": lumps[:, FLUID],
        "caliper": lumps[:, BODY],
    }
    for index, name in enumerate(LUMPS):
        if index not in (FLUID, BODY):
            nodes[name] = lumps[:, index]
    return nodes

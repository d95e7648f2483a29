"""The reality: marching brake corners through time.

Linearly implicit Euler in the nodes' energies with one Richardson
extrapolation (two half steps against one whole step): second order, damping
stiff cells fully at any step. Conductances are frozen at the start of each
Euler step and every flow is booked on both of its ends, so the energy balance
closes to rounding whatever the step. The form in C agrees with that in NumPy
to rounding and is some 70 times as fast for the corners of one car.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import ModuleType
from typing import Final, cast

import numpy as np

from bstm_daemon.native.loader import VARIABLE, load_module
from bstm_daemon.simulation import materials, parameters, sizes
from bstm_daemon.simulation.lanes import (
    BODY,
    CENTRE,
    FLUID,
    HAT,
    Lanes,
    State,
    start_state,
)
from bstm_daemon.simulation.linings import friction_factor, pyrolyse, wear_pads
from bstm_daemon.simulation.materials import Array
from bstm_daemon.simulation.network import Paths, paths

# thermocouples of a disc sit 1.5 mm under the friction surface
_MEASURED_DEPTH: Final = 0.15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneInputs(parameters.Inputs):
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

    def at(self, step: int) -> parameters.Inputs:
        """Return the inputs of *step*."""
        return parameters.Inputs(
            **{n: getattr(self, n)[step] for n in parameters.INPUT_NAMES}
        )


class LaneResult:
    """Outcome of a march, filled by either implementation.

    ``time_s`` (m,) are the ends of the kept steps, ``chain_k`` (m, chain
    nodes, 2, lanes) and ``lump_k`` (m, lumps, lanes) temperatures [K] then;
    ``power_w`` and ``friction`` (n, lanes) the friction power and mu over
    nominal of every step. ``heat_in_j`` and ``heat_out_j`` (lanes,) over the
    whole march, ``state`` is that at its end.
    """

    def __init__(self, lanes: Lanes, state: State, inputs: LaneInputs) -> None:
        """Make room for marching *lanes* from *state* under *inputs*."""
        self.time_s: Array = np.cumsum(inputs.step_s)[inputs.keep]
        steps, kept = len(inputs.step_s), len(self.time_s)
        self.chain_k = np.empty((kept, lanes.chain_nodes, 2, lanes.count))
        self.lump_k = np.empty((kept, len(parameters.LUMPS), lanes.count))
        self.power_w = np.empty((steps, lanes.count))
        self.friction = np.empty((steps, lanes.count))
        self.heat_in_j = np.zeros(lanes.count)
        self.heat_out_j = np.zeros(lanes.count)
        self.state = state
        self._lanes = lanes
        self._before_j = total_energy(state)

    @property
    def stored_j(self) -> Array:
        """Energy that stayed in each lane, (lanes,)."""
        return total_energy(self.state) - self._before_j

    @property
    def balance_residual(self) -> Array:
        """Energy not accounted for over energy put in, (lanes,)."""
        missing = self.heat_in_j - self.heat_out_j - self.stored_j
        scale = np.maximum(np.abs(self.heat_in_j), np.abs(self.stored_j))
        return missing / np.maximum(scale, 1.0)

    @cached_property
    def nodes(self) -> dict[str, Array]:
        """Temperatures [K] by name, (m, lanes)."""
        lanes, chain, lumps = self._lanes, self.chain_k, self.lump_k
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
        for index, name in enumerate(parameters.LUMPS):
            if index not in (FLUID, BODY):
                nodes[name] = lumps[:, index]
        return nodes


def total_energy(state: State) -> Array:
    """Return the energy in each lane [J], 0 at 20 degC, (lanes,)."""
    total: Array = state.chain_j.sum(axis=(0, 1)) + state.lump_j.sum(axis=0)
    return total


MAX_NODES: Final = 128
"""Nodes of a chain in the compiled form."""

CORNER: Final = np.dtype(
    [
        ("table", np.float64, len(parameters.PARAMETER_NAMES)),
        ("drawn", np.float64, (parameters.DRAWN, len(parameters.PATH_NAMES))),
        ("cheek_kg", np.float64, MAX_NODES),
        ("gap_m", np.float64, MAX_NODES),
        ("centre_kg", np.float64),
        ("backplate_j_k", np.float64),
        ("lump_j_k", np.float64, len(parameters.LUMPS)),
        *((name, np.int32) for name in ("pads", "cheeks", "nodes", "surface")),
    ]
)
STATE: Final = np.dtype(
    [
        ("chain_k", np.float64, (2, MAX_NODES)),
        ("lump_k", np.float64, len(parameters.LUMPS)),
        ("chain_j", np.float64, (2, MAX_NODES)),
        ("lump_j", np.float64, len(parameters.LUMPS)),
        ("pad_m", np.float64, 2),
        ("char", np.float64, (2, MAX_NODES)),
        ("friction_j", np.float64),
    ]
)
"""``Corner`` and ``State`` of ``_reality_paths.h``, named as in ``lanes``."""


def extension() -> ModuleType | None:
    """Return the compiled march, None where NumPy has to do.

    That is where it is not built, and with ``BSTM_KERNEL=reference``.

    Raises:
        UsageError: it was built from other sources than these.
    """
    if os.environ.get(VARIABLE) == "reference":
        return None
    return cast("ModuleType | None", load_module("simulation._reality"))


def march_compiled(
    reality: ModuleType, lanes: Lanes, state: State, inputs: LaneInputs
) -> LaneResult:
    """March *lanes* from *state* under *inputs* with the extension *reality*.

    Raises :class:`ValueError` for a mesh beyond the compiled limit.
    """
    if lanes.chain_nodes > MAX_NODES:
        msg = f"a mesh has at most {MAX_NODES} nodes a side"
        raise ValueError(msg)
    done = LaneResult(lanes, state, inputs)
    steps, count = len(inputs.step_s), lanes.count
    rows = np.empty((steps, len(parameters.INPUT_NAMES), count))
    for index, name in enumerate(parameters.INPUT_NAMES):
        rows[:, index] = getattr(inputs, name)
    packed = np.zeros(count, STATE)
    members = [getattr(state, field.name) for field in fields(state)]
    places = [
        packed[field.name][..., : len(member)]
        for field, member in zip(fields(state), members, strict=True)
    ]
    for place, member in zip(places, members, strict=True):
        place[...] = member.T
    record = np.empty((len(done.chain_k), count, lanes.nodes))
    ledger = np.zeros((2, count))
    reality.march(
        _corners(lanes).view(np.uint8),
        np.ascontiguousarray(inputs.step_s, dtype=np.float64),
        np.ascontiguousarray(inputs.keep, dtype=np.uint8),
        rows,
        packed.view(np.uint8),
        record,
        done.power_w,
        done.friction,
        ledger,
        lanes.friction_varies,
        inputs.corners_per_car,
    )
    chain = record[:, :, : lanes.first_lump].reshape(len(record), count, 2, -1)
    done.chain_k = chain.transpose(0, 3, 2, 1)
    done.lump_k = record[:, :, lanes.first_lump :].transpose(0, 2, 1)
    done.heat_in_j, done.heat_out_j = ledger
    done.state = type(state)(*(place.T.copy() for place in places))
    return done


def _corners(lanes: Lanes) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Return the constant data of each lane as C has it."""
    found = np.zeros(lanes.count, CORNER)
    cheeks = len(lanes.mesh.cheek_depths)
    found["table"] = lanes.table.T
    found["drawn"] = lanes.drawn
    found["cheek_kg"][:, :cheeks] = lanes.cheek_kg[:, 0].T
    found["gap_m"][:, :cheeks] = lanes.cheek_gap_m[:, 0].T
    found["centre_kg"] = lanes.centre_kg
    found["backplate_j_k"] = lanes.backplate_j_k
    found["lump_j_k"] = lanes.lump_j_k.T
    found["pads"], found["cheeks"] = lanes.mesh.pad_nodes, cheeks
    found["nodes"], found["surface"] = lanes.chain_nodes, lanes.surface
    return found


def march_lanes(
    corners: Sequence[parameters.CornerParameters],
    effects: Sequence[parameters.Effects],
    inputs: LaneInputs,
    *,
    start_k: Array,
    mesh: parameters.Mesh = parameters.DEFAULT_MESH,
) -> LaneResult:
    """March *corners*, one a lane, under *inputs* from *start_k* (lanes,).

    See :func:`march`.
    """
    lanes = Lanes(corners, effects, mesh)
    return march(lanes, start_state(lanes, start_k), inputs)


def march(lanes: Lanes, state: State, inputs: LaneInputs) -> LaneResult:
    """March *lanes* from *state*: compiled if it is built, else by NumPy."""
    compiled = extension()
    if compiled is None:
        return march_numpy(lanes, state, inputs)
    return march_compiled(compiled, lanes, state, inputs)


def march_numpy(lanes: Lanes, state: State, inputs: LaneInputs) -> LaneResult:
    """March *lanes* from *state* under *inputs* with whole-array steps."""
    done = LaneResult(lanes, state, inputs)
    varies = lanes.friction_varies
    row_kept = 0
    for i, dt in enumerate(inputs.step_s.tolist()):
        row = inputs.at(i)
        factor = np.ones(lanes.count)
        if varies:
            factor = friction_factor(
                lanes, state, row.speed_ms, row.pressure_pa
            )
            row = _with_friction(row, factor, inputs.corners_per_car)
        done.friction[i] = factor
        done.power_w[i] = row.power_w
        state, gained, lost = _step(lanes, state, row, dt)
        done.heat_in_j += gained
        done.heat_out_j += lost
        if inputs.keep[i]:
            done.chain_k[row_kept] = state.chain_k
            done.lump_k[row_kept] = state.lump_k
            row_kept += 1
    done.state = state
    return done


def _with_friction(
    row: parameters.Inputs, factor: Array, per_car: int
) -> parameters.Inputs:
    actual = row.power_w * factor
    if not per_car:
        return replace(row, power_w=actual)
    nominal = np.broadcast_to(row.power_w, factor.shape)
    demanded = nominal.reshape(-1, per_car).sum(axis=1)
    reached = actual.reshape(-1, per_car).sum(axis=1)
    raised = np.divide(
        demanded, reached, out=np.ones_like(demanded), where=reached > 0
    )
    scale = np.repeat(raised, per_car)
    return replace(
        row, power_w=actual * scale, pressure_pa=row.pressure_pa * scale
    )


def _step(
    lanes: Lanes, state: State, inputs: parameters.Inputs, dt: float
) -> tuple[State, Array, Array]:
    """One extrapolated step; returns state, heat in and heat out [J]."""
    here = paths(lanes, state, inputs)
    whole, out_whole = _euler(lanes, state, here, inputs, dt)
    half, out_first = _euler(lanes, state, here, inputs, dt / 2)
    there = paths(lanes, half, inputs)
    fine, out_second = _euler(lanes, half, there, inputs, dt / 2)
    chain_j = 2 * fine.chain_j - whole.chain_j
    lump_j = 2 * fine.lump_j - whole.lump_j
    after = _settle(lanes, fine, chain_j, lump_j)
    lost = 2 * (out_first + out_second) - out_whole
    gained = dt * there.heat_in_w
    after.friction_j = state.friction_j + gained
    if lanes.chars:
        lost += pyrolyse(lanes, after, dt)
    if lanes.wears:
        lost += wear_pads(lanes, after, gained)
    return after, gained, lost


def _euler(
    lanes: Lanes,
    state: State,
    here: Paths,
    inputs: parameters.Inputs,
    dt: float,
) -> tuple[State, Array]:
    """One linearly implicit step; returns state and heat out [J]."""
    excess = lanes.joined(state.chain_k, state.lump_k)
    excess -= inputs.ambient_k[:, None]
    gain_w = here.source_w - (here.conductance @ excess[:, :, None])[:, :, 0]
    matrix = dt * here.conductance
    own = np.arange(lanes.nodes)
    matrix[:, own, own] += here.capacity_j_k
    found = np.linalg.solve(matrix, dt * gain_w[:, :, None])
    rise = np.asarray(found[:, :, 0], np.float64)

    chain_rise, lump_rise = lanes.split(rise)
    chain_gain, lump_gain = lanes.split(here.capacity_j_k * rise)
    settled = _settle(
        lanes,
        replace(
            state,
            chain_k=state.chain_k + chain_rise,
            lump_k=state.lump_k + lump_rise,
        ),
        state.chain_j + chain_gain,
        state.lump_j + lump_gain,
    )
    # heat of other parts is a loss below 0: friction is all that comes in
    lost = (here.to_ambient * (excess + rise) - here.source_w).sum(axis=1)
    return settled, dt * (lost + here.heat_in_w)


def _settle(lanes: Lanes, near: State, chain_j: Array, lump_j: Array) -> State:
    """Return the state with these energies; *near* starts the iteration.

    Two Newton steps: the start is already within a step's curvature, and
    the energies stay the truth.
    """
    chain_k = sizes.REFERENCE_K + chain_j / lanes.backplate_j_k
    pad_j_kg = chain_j[lanes.pad] / lanes.pad_kg(near)
    chain_k[lanes.pad] = lanes.lining_temperature(
        pad_j_kg, near.chain_k[lanes.pad]
    )
    chain_k[lanes.cheek] = materials.iron_temperature(
        chain_j[lanes.cheek] / lanes.cheek_kg,
        near.chain_k[lanes.cheek],
        *lanes.iron,
    )
    lump_k = near.lump_k.copy()
    lump_k[HAT:] = sizes.REFERENCE_K + lump_j[HAT:] / lanes.lump_j_k[HAT:]
    lump_k[CENTRE] = materials.iron_temperature(
        lump_j[CENTRE] / lanes.centre_kg, near.lump_k[CENTRE], *lanes.iron
    )
    if lanes.boils:
        lump_k[FLUID] = lanes.fluid_temperature(
            lump_j[FLUID], near.lump_k[FLUID]
        )
    return replace(
        near, chain_k=chain_k, lump_k=lump_k, chain_j=chain_j, lump_j=lump_j
    )

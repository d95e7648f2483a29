"""Many variants of a corner's model over one drive, side by side.

Variants are lanes of one march of the kernel, which leaves the interpreter
to others meanwhile: drives and corners run in threads.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np

from bstm_daemon.analysis.matching.drives import (
    BEGIN_S,
    GRID_S,
    Drive,
    flat,
    settled,
)
from bstm_daemon.analysis.matching.thermocouples import (
    InDisc,
    InPad,
    Placement,
    node_at,
)
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.channels import CHANNELS
from bstm_daemon.config.sections import Config
from bstm_daemon.estimator.corner_model import corner_model
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.program import Program, compile_network

STEADY_K: Final = 10.0
"""First temperatures that spread less are joined to their mean."""

STRETCH_STEPS: Final = 256
"""Steps of a call of the kernel: what they put out stays in the cache."""


def initial_temperatures(
    program: Program, drive: Drive, corner: str
) -> dict[str, float]:
    """Return every node's temperature [K] at the start of *drive*.

    Measured nodes as measured, the others as they settle beside them.
    """
    at_s = np.arange(0.0, BEGIN_S, GRID_S) + GRID_S
    network = program.network
    nodes = {node.name for node in network.nodes}
    held = {}
    for node, couple in drive.measured.get(corner, {}).items():
        first = couple.at(at_s)
        first = first[np.isfinite(first)]
        if node in nodes and len(first):
            # who brakes hard is at no mean
            if np.ptp(first) > STEADY_K:
                first = couple.temperature_k[:1]
            held[node] = float(first.mean())
    placed = drive.placed.get(corner, {})
    held = {node_at(one, placed, network): k for one, k in held.items()}
    ambient_k = float(drive.channel(corner, "ambient_k")[0])
    return settled(program, held, ambient_k)


def model_of(config: Config, corner: str) -> CornerModel:
    """Return the thermal model of the corner of that name."""
    own = next(one for one in config.corner if one.name == corner)
    return corner_model(config, own)


def march(  # noqa: PLR0913
    programs: Sequence[Program],
    drive: Drive,
    corner: str,
    initial_k: Mapping[str, float] | Sequence[Mapping[str, float]] = (),
    forced: Mapping[str, Column] | None = None,
    power_w: Column | None = None,
    *,
    nodes: Collection[str] = (),
    memories: Sequence[str] = (),
) -> dict[str, Column]:
    """March variants of *corner* over *drive*.

    Args:
        programs: one a variant, of one structure, without forced nodes.
        drive: its inputs.
        corner: whose inputs.
        initial_k: temperatures [K] at the start, by node, of all variants or
            of each; as measured, and as the first one settles.
        forced: nodes that follow a series, [K] at each step's end, (steps,)
            or (steps, variants); free where it is NaN.
        power_w: brake power of each variant, (steps, variants); as *drive*.
        nodes: those that are wanted; all.
        memories: of the network that are returned too.

    Returns:
        Temperatures [K] by node, (steps, variants); of a thermocouple whose
        depth is configured those at its place.
    """
    initial_k = initial_k or initial_temperatures(programs[0], drive, corner)
    if isinstance(initial_k, Mapping):
        initial_k = [initial_k] * len(programs)
    inputs = drive.inputs[:, drive.corners.index(corner)]
    placed = drive.placed.get(corner, {})
    network = programs[0].network
    names = [node.name for node in network.nodes]
    forced = {
        node_at(n, placed, network): k for n, k in (forced or {}).items()
    }
    sets = [0] * len(programs)
    if power_w is not None or any(k.ndim > 1 for k in forced.values()):
        sets = list(range(len(programs)))
        inputs = np.repeat(inputs[:, None], len(programs), axis=1)
    if power_w is not None:
        inputs[:, :, CHANNELS.index("brake_power_w")] = power_w
    if forced:
        programs, inputs = _following(programs, inputs, forced)
    batch = Batch(programs, 0.0, sets)
    for member, own_k in enumerate(initial_k):
        for i, name in enumerate(names):
            batch.state[member * batch.width + i] = own_k[name]
    wanted = [n for n in names if not nodes or n in {*nodes, *placed}]
    shares = {name: {name: 1.0} for name in (*wanted, *memories)}
    for couple, place in placed.items():
        if isinstance(place, InPad):
            shares[couple] = place.shares(network)
    found = _marched(batch, inputs, shares)
    if power_w is None:
        power_w = drive.channel(corner, "brake_power_w")[:, None]
    return found | _near_the_face(found, placed, power_w)


def _marched(
    batch: Batch,
    inputs: Column,
    shares: Mapping[str, Mapping[str, float]],
) -> dict[str, Column]:
    """Return, by name, sums of shares of the states, (steps, variants)."""
    variants = len(batch.programs)
    index = batch.programs[0].state_names.index
    size = batch.width + batch.sources
    found = {name: np.empty((len(inputs), variants)) for name in shares}
    for first in range(0, len(inputs), STRETCH_STEPS):
        part = inputs[first : first + STRETCH_STEPS]
        out = batch.march(flat(part), len(part), GRID_S)
        states = np.frombuffer(out).reshape(len(part), variants, size)
        for name, own in shares.items():
            found[name][first : first + len(part)] = sum(
                share * states[:, :, index(one)] for one, share in own.items()
            )
    return found


def _following(
    programs: Sequence[Program], inputs: Column, forced: Mapping[str, Column]
) -> tuple[list[Program], Column]:
    """Return programs whose nodes follow *forced*, and inputs with these."""
    networks = [one.network for one in programs]
    for node in forced:
        networks = [one.with_forced(node) for one in networks]
    shape = inputs.shape[:-1]
    series = [
        np.broadcast_to(k if k.ndim == len(shape) else k[:, None], shape)
        for k in forced.values()
    ]
    inputs = np.concatenate((inputs, np.stack(series, -1)), axis=-1)
    return [compile_network(one) for one in networks], inputs


def _near_the_face(
    found: Mapping[str, Column],
    placed: Mapping[str, Placement],
    power_w: Column,
) -> dict[str, Column]:
    """Return what thermocouples of known depth show of the discs *found*."""
    return {
        couple: found[couple]
        + np.stack([place.excess_k(one, GRID_S) for one in power_w.T], axis=1)
        for couple, place in placed.items()
        if isinstance(place, InDisc)
    }

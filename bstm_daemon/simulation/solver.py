"""Direct solution of one implicit step for all lanes at once.

The matrix is symmetric and has arrow form: two tridiagonal chains a lane,
joined to a few lumps through three *port* nodes a chain. The chains are
solved by parallel cyclic reduction (Hockney 1965), five whole-array sweeps
instead of a loop over nodes; the lumps by their dense Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bstm_daemon.simulation.materials import Array


def solve_chains(diagonal: Array, link: Array, rhs: Array) -> Array:
    """Solve symmetric tridiagonal systems along the node axis.

    Shapes: *diagonal* (n, ...), *link* (n - 1, ...) the positive conductance
    between neighbours (the off-diagonal is its negative), *rhs* (columns, n,
    ...). Returns the solution in the shape of *rhs*.
    """
    n = len(diagonal)
    b = diagonal.copy()
    d = rhs.copy()
    lower = np.zeros_like(b)
    upper = np.zeros_like(b)
    lower[1:] = -link
    upper[:-1] = -link
    stride = 1
    while stride < n:
        alpha = lower[stride:] / b[:-stride]
        beta = upper[:-stride] / b[stride:]
        old = d
        d = old.copy()
        d[:, stride:] -= alpha * old[:, :-stride]
        d[:, :-stride] -= beta * old[:, stride:]
        b[stride:] -= alpha * upper[:-stride]
        b[:-stride] -= beta * lower[stride:]
        new_lower = np.zeros_like(b)
        new_upper = np.zeros_like(b)
        new_lower[stride:] = -alpha * lower[:-stride]
        new_upper[:-stride] = -beta * upper[stride:]
        lower, upper = new_lower, new_upper
        stride *= 2
    d /= b
    return d


@dataclass(slots=True)
class Arrow:
    """The matrix of one implicit step for all lanes.

    Shapes with k = 2 sides x 3 ports: ``diagonal`` (n, 2, lanes), ``link``
    (n - 1, 2, lanes) and ``coupling`` (lanes, k, lumps) the positive
    conductances off the diagonal, ``lumps`` (lanes, lumps, lumps) the lumps'
    own block; ``ports`` the three chain nodes that meet lumps.
    """

    diagonal: Array
    link: Array
    coupling: Array
    lumps: Array
    ports: list[int]


def solve_arrow(
    matrix: Arrow, chain_rhs: Array, lump_rhs: Array
) -> tuple[Array, Array]:
    """Solve chains and lumps together.

    *chain_rhs* (n, 2, lanes) and *lump_rhs* (lumps, lanes); the solutions
    have these shapes.
    """
    n, sides, count = matrix.diagonal.shape
    ports, coupling = matrix.ports, matrix.coupling
    columns = np.zeros((1 + len(ports), n, sides, count))
    columns[0] = chain_rhs
    for column, node in enumerate(ports, start=1):
        columns[column, node] = 1.0
    columns = solve_chains(matrix.diagonal, matrix.link, columns)

    # response of port i to a unit flow into port j, of the same side only
    at_ports = columns[:, ports]
    by_side = np.zeros((count, sides, len(ports), sides, len(ports)))
    for side in range(sides):
        by_side[:, side, :, side] = at_ports[1:, :, side].transpose(2, 1, 0)
    k = sides * len(ports)
    response = by_side.reshape(count, k, k)
    free = at_ports[0].transpose(2, 1, 0).reshape(count, k, 1)

    transposed = coupling.transpose(0, 2, 1)
    schur = matrix.lumps - transposed @ (response @ coupling)
    load = lump_rhs.T[:, :, None] + transposed @ free
    lumps = np.linalg.solve(schur, load)
    flow = (coupling @ lumps).reshape(count, sides, len(ports))
    chains = columns[0]
    for column in range(len(ports)):
        chains = chains + columns[column + 1] * flow[:, :, column].T
    return chains, lumps[:, :, 0].T

"""The arrow solver against a dense one."""

import numpy as np
import pytest

from bstm_daemon.simulation.solver import Arrow, solve_arrow, solve_chains


@pytest.mark.parametrize("n", [2, 3, 8, 31, 33])
def test_chains_match_a_dense_solution(n: int) -> None:
    rng = np.random.default_rng(n)
    link = rng.uniform(0.1, 200.0, (n - 1, 2))
    diagonal = rng.uniform(0.1, 5.0, (n, 2))
    diagonal[:-1] += link
    diagonal[1:] += link
    rhs = rng.normal(size=(3, n, 2))

    x = solve_chains(diagonal, link, rhs)

    for lane in range(2):
        matrix = np.diag(diagonal[:, lane])
        matrix -= np.diag(link[:, lane], 1) + np.diag(link[:, lane], -1)
        expected = np.linalg.solve(matrix, rhs[:, :, lane].T).T
        np.testing.assert_allclose(x[:, :, lane], expected, rtol=1e-9)


def test_arrow_matches_a_dense_solution() -> None:
    rng = np.random.default_rng(0)
    n, lanes, lumps = 9, 3, 4
    ports = [0, 5, 8]
    link = rng.uniform(0.1, 50.0, (n - 1, 2, lanes))
    coupling = rng.uniform(0.0, 20.0, (lanes, 6, lumps))
    diagonal = rng.uniform(1.0, 3.0, (n, 2, lanes))
    diagonal[:-1] += link
    diagonal[1:] += link
    diagonal[ports] += coupling.sum(axis=2).reshape(lanes, 2, 3).T
    own = np.zeros((lanes, lumps, lumps))
    index = np.arange(lumps)
    own[:, index, index] = rng.uniform(1.0, 3.0, (lanes, lumps))
    own[:, index, index] += coupling.sum(axis=1)
    chain_rhs = rng.normal(size=(n, 2, lanes))
    lump_rhs = rng.normal(size=(lumps, lanes))

    chains, lump_x = solve_arrow(
        Arrow(diagonal, link, coupling, own, ports), chain_rhs, lump_rhs
    )

    for lane in range(lanes):
        dense = np.zeros((2 * n + lumps,) * 2)
        rhs = np.zeros(2 * n + lumps)
        dense[2 * n :, 2 * n :] = own[lane]
        rhs[2 * n :] = lump_rhs[:, lane]
        for side in range(2):
            at = slice(side * n, side * n + n)
            dense[at, at] = np.diag(diagonal[:, side, lane])
            dense[at, at] -= np.diag(link[:, side, lane], 1)
            dense[at, at] -= np.diag(link[:, side, lane], -1)
            rhs[at] = chain_rhs[:, side, lane]
            for port, node in enumerate(ports):
                k = coupling[lane, 3 * side + port]
                dense[side * n + node, 2 * n :] = -k
                dense[2 * n :, side * n + node] = -k
        x = np.linalg.solve(dense, rhs)
        np.testing.assert_allclose(chains[:, 0, lane], x[:n], rtol=1e-9)
        np.testing.assert_allclose(chains[:, 1, lane], x[n : 2 * n], rtol=1e-9)
        np.testing.assert_allclose(lump_x[:, lane], x[2 * n :], rtol=1e-9)

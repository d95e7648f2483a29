"""What a judge of vapour can reach at best where the boiling point is open.

An ideal judge knows every temperature and the boiling point but for an error
of a normal distribution; with the true margins of the descents its false
warnings follow without a draw.
"""

from __future__ import annotations

from statistics import NormalDist
from typing import TYPE_CHECKING, Final

import numpy as np
from risk_fluids import MISSED, DrawnFluid, left_open_k
from side_by_side import Table

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

SIGMAS_K: Final = (0.5, 1.0, 2.0, 3.0)
GOAL: Final = 1.0 / 20.0
"""False warnings a safe descent that are asked for."""

HALVINGS: Final = 60
FURTHEST_K: Final = 200.0
_BELOW: Final = np.vectorize(NormalDist().cdf)


def ideal_false_share(margins_k: Column, sigma_k: float) -> float:
    """Return the share of safe descents warned of where 1 % are missed.

    *margins_k* are the hottest fluid less its boiling point; the judge sees
    them with the error *sigma_k*.
    """
    boil = margins_k >= 0.0

    def missed(limit_k: float) -> float:
        return float(_BELOW((limit_k - margins_k[boil]) / sigma_k).mean())

    limit_k = _root(lambda k: missed(k) >= MISSED, -FURTHEST_K, FURTHEST_K)
    return float(_BELOW((margins_k[~boil] - limit_k) / sigma_k).mean())


def limit_table(margins_k: Column) -> Table:
    """Return the false warnings of ideal judges, and who meets the goal."""
    meets_k = _root(
        lambda k: ideal_false_share(margins_k, k) >= GOAL, 0.05, 20.0
    )
    shares = [
        (f"{sigma_k:.1f}", f"{ideal_false_share(margins_k, sigma_k):.1%}")
        for sigma_k in (*SIGMAS_K, meets_k)
    ]
    return Table(
        "Ideal judge: temperatures known, boiling point but for an error",
        ("deviation of the error, K", "false warnings at 1 % missed"),
        (*shares[:-1], (f"{shares[-1][0]} (meets 1 in 20)", shares[-1][1])),
    )


def causes_table(fluids: list[DrawnFluid]) -> Table:
    """Return what leaves the boiling point open with the water given."""
    each = [left_open_k(fluid) for fluid in fluids]
    causes = {name: np.array([one[name] for one in each]) for name in each[0]}
    total = np.sqrt(sum(column**2 for column in causes.values()))
    return Table(
        "What leaves the boiling point open, water given",
        ("deviation by", "median, K", "90 % within, K"),
        tuple(
            (
                name,
                f"{np.median(values):.1f}",
                f"{np.quantile(values, 0.9):.1f}",
            )
            for name, values in (*causes.items(), ("all together", total))
        ),
    )


def _root(reached: Callable[[float], bool], low: float, high: float) -> float:
    """Return where *reached* becomes true between *low* and *high*."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if reached(middle):
            high = middle
        else:
            low = middle
    return high

"""A proven upper bound of the fluid's peak after parking.

A *ceiling* is a temperature of each node and of the air. While no member of an
ensemble is above it, no member's fluid gets hotter than the members would
that start at the ceiling itself; these are marched once for many forecasts.

Proof. Parked, without sources, C_i(T_i) dT_i/dt = sum_j q_ij(T_j, T_i), and
each q_ij rises with T_j and falls with T_i (:func:`is_ordered`). Let T and U
be two courses of one member with T <= U at first. When they first meet at a
node i, T_i = U_i, so the capacities agree, T_j <= U_j of all others, hence
dT_i/dt <= dU_i/dt: T never passes U (Kamke's theorem). Warmer air is a node
that is warmer. Every member's own numbers are used, and nothing in it is of
a brake, so that effects which add nodes are covered.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise, product
from math import inf, isfinite, isnan
from typing import TYPE_CHECKING, Final

from bstm_daemon.estimator.blocks import channels_at_rest
from bstm_daemon.forecast.march import PARKED_STEPS, Conditions, Job

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.forecast.members import Ensemble
    from bstm_daemon.model.thermal.network import Factor, Link, Network
    from bstm_daemon.native.loader import Kernel

MARGIN_K: Final = 1.0
"""Covers the error of the marches in coarse steps."""

FACTORS: Final = 1.1, 1.5
OFFSET_K: Final = 5.0
"""A new ceiling is above the rises of now by an offset and a factor in this
range, so that it lasts."""

GRID_K: Final = tuple(float(kelvin) for kelvin in range(220, 921, 20))
"""Temperatures between which the order of heat flows is checked."""

_REST: Final = {
    name: value
    for name, value in channels_at_rest(0.0).items()
    if name != "ambient_k"
}


class Ceiling:
    """The ceiling of one corner's ensemble."""

    def __init__(self, ensemble: Ensemble, kernel: Kernel | None) -> None:
        """Have none yet for *ensemble*; *kernel* None runs the reference."""
        self.ensemble, self._kernel = ensemble, kernel
        self._is_ordered = is_ordered(ensemble.program.network)
        self._nodes_k: list[float] = []
        self._air_k = -inf
        self._peak_k = inf

    def peak_k(
        self, state: Sequence[float], ambient_k: float, factor: float
    ) -> float:
        """Return what no member's fluid exceeds [K]; infinite if unknown.

        Args:
            state: nodes [K] and memories of the corner now.
            ambient_k: the air from now on [K].
            factor: widens the spread.
        """
        highest, air_k = self.ensemble.highest(state, ambient_k, factor)
        is_below = air_k <= self._air_k and all(
            one <= limit
            for one, limit in zip(highest, self._nodes_k, strict=False)
        )
        return self._peak_k if is_below else inf

    def higher(
        self,
        state: Sequence[float],
        ambient_k: float,
        factor: float,
        *,
        peak_k: float,
        limit_k: float,
    ) -> Job | None:
        """Return the march of a ceiling above *state*, if it may be of use.

        Args:
            state: nodes [K] and memories of the corner now.
            ambient_k: the air from now on [K].
            factor: widens the spread.
            peak_k: of the hottest member from *state* [K].
            limit_k: a ceiling whose peak is above it is of no use [K].
        """
        highest, air_k = self.ensemble.highest(state, ambient_k, factor)
        room_k = limit_k - MARGIN_K - OFFSET_K - air_k
        widest = room_k / max(peak_k - air_k, 1.0)
        if not self._is_ordered or not widest > FACTORS[0]:
            return None
        wider = min(widest, FACTORS[1]) - 1.0
        nodes_k = [
            kelvin + OFFSET_K + wider * max(kelvin - air_k, 0.0)
            for kelvin in highest
        ]
        if self._peak_k < limit_k:
            nodes_k = [*map(max, nodes_k, self._nodes_k)]
        if not GRID_K[0] < min(nodes_k) <= max(nodes_k) < GRID_K[-1]:
            return None
        self._nodes_k, self._peak_k = nodes_k, inf
        self._air_k = air_k + OFFSET_K
        start = [*nodes_k, *state[len(nodes_k) :]]
        return Job(
            *(self.ensemble, self._kernel, start, Conditions(self._air_k)),
            PARKED_STEPS,
            factor=0.0,
        )

    def accept(self, job: Job) -> None:
        """Take the result of the march that :meth:`higher` returned last."""
        peaks_k = job.course().peaks_k(sum(PARKED_STEPS))
        self._peak_k = max(peaks_k) + MARGIN_K


def is_ordered(net: Network) -> bool:
    """Whether a parked corner that starts hotter stays hotter, at each node.

    False wherever that does not follow from its parts one by one: a source
    that acts at rest, or a flow that depends on more than its two ends.
    """
    boundaries = {"ambient_k", None}
    return (
        all(
            not node.factors
            and (
                node.boundary_input in boundaries
                or isnan(_REST.get(node.boundary_input or "", 0.0))
            )
            for node in net.nodes
        )
        and all(
            _product(source.factors, _REST) == 0.0 for source in net.sources
        )
        and all(map(_is_rising, net.links))
    )


@lru_cache(maxsize=256)
def _is_rising(link: Link) -> bool:
    """Whether the flow from a to b rises with a and falls with b."""
    if link.conductance_w_k == 0.0 or _product(link.factors, _REST) == 0.0:
        return True
    slots = {slot for f in link.factors for slot in (f.a, f.b or f.a)}
    if not slots - _REST.keys():
        return True
    if slots - _REST.keys() - {link.a, link.b}:
        return False
    flows = {
        (a, b): _product(link.factors, _REST | {link.a: a, link.b: b})
        * (a - b)
        for a, b in product(GRID_K, repeat=2)
    }
    return all(isfinite(flow) for flow in flows.values()) and all(
        flows[low, at] <= flows[high, at] and flows[at, low] >= flows[at, high]
        for at in GRID_K
        for low, high in pairwise(GRID_K)
    )


def _product(factors: Sequence[Factor], slots: Mapping[str, float]) -> float:
    """Return the product of those of *factors* whose *slots* are known."""
    found = 1.0
    for factor in factors:
        a, b = slots.get(factor.a), slots.get(factor.b or factor.a)
        if a is None or b is None:
            continue
        found *= factor(a, b)
    return found

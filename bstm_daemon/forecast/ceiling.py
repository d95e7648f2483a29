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
from operator import le
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.estimator.blocks import channels_at_rest
from bstm_daemon.forecast.march import PARKED_STEPS, Conditions, Job

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.forecast.members import Ensemble
    from bstm_daemon.model.thermal.network import Factor, Link, Network
    from bstm_daemon.native.loader import Kernel

MARGIN_K: Final = 1.0
"""Covers the error of the marches in coarse steps."""

FACTORS: Final = 1.05, 2.0
OFFSET_K: Final = 3.0
"""A new ceiling is above the rises of now by an offset and a factor in this
range, so that it lasts."""

EASING: Final = 0.98
MOST_EXCESS: Final = 1.2
"""A ceiling that got hotter than expected makes the next one lower, by no more
than this; less so where that leaves no room for one."""

KEPT: Final = 32
"""Number of ceilings that are kept, those used last."""

GRID_K: Final = tuple(float(kelvin) for kelvin in range(220, 921, 20))
"""Temperatures between which the order of heat flows is checked."""

_REST: Final = {
    name: value
    for name, value in channels_at_rest(0.0).items()
    if name != "ambient_k"
}


class Ceiling(NamedTuple):
    """Nodes [K], air [K] and the peak [K] that no member below exceeds."""

    nodes_k: Sequence[float]
    air_k: float
    peak_k: float

    def covers(self, nodes_k: Sequence[float], air_k: float) -> bool:
        """Return whether nothing of *nodes_k* and *air_k* is above it."""
        # written so that a nan is covered by nothing
        return air_k <= self.air_k and all(map(le, nodes_k, self.nodes_k))


class Ceilings:
    """The ceilings of one corner's ensemble."""

    def __init__(self, ensemble: Ensemble, kernel: Kernel | None) -> None:
        """Have none yet for *ensemble*; *kernel* None runs the reference."""
        self.ensemble, self._kernel = ensemble, kernel
        self._is_ordered = is_ordered(ensemble.program.network)
        self._kept: list[Ceiling] = []
        # how many times hotter than expected a ceiling gets: all its members
        # begin at the highest of each node
        self._excess = 1.1

    def peak_k(
        self, state: Sequence[float], ambient_k: float, factor: float
    ) -> float:
        """Return what no member's fluid exceeds [K]; infinite if unknown.

        Args:
            state: nodes [K] and memories of the corner now.
            ambient_k: the air from now on [K].
            factor: widens the spread.
        """
        highest = self.ensemble.highest(state, ambient_k, factor)
        covering = [one for one in self._kept if one.covers(*highest)]
        if not covering:
            return inf
        lowest = min(covering, key=lambda one: one.peak_k)
        self._kept.remove(lowest)
        self._kept.append(lowest)
        return lowest.peak_k

    def higher(
        self,
        state: Sequence[float],
        ambient_k: float,
        factor: float,
        *,
        peak_k: float,
        limit_k: float,
    ) -> tuple[Ceiling, Job] | None:
        """Return a ceiling above *state* and its march, if it may be of use.

        Args:
            state: nodes [K] and memories of the corner now.
            ambient_k: the air from now on [K].
            factor: widens the spread.
            peak_k: of the hottest member from *state* [K].
            limit_k: a ceiling whose peak is above it is of no use [K].
        """
        highest, air_k = self.ensemble.highest(state, ambient_k, factor)
        room_k = limit_k - MARGIN_K - OFFSET_K - air_k
        rise_k = max(peak_k - air_k, 1.0)
        widest = room_k / (rise_k * self._excess)
        if not self._is_ordered or not widest > FACTORS[0]:
            self._excess = max(EASING * self._excess, 1.0)
            return None
        wider = min(widest, FACTORS[1]) - 1.0
        nodes_k = [
            kelvin + OFFSET_K + wider * max(kelvin - air_k, 0.0)
            for kelvin in highest
        ]
        if not GRID_K[0] < min(nodes_k) <= max(nodes_k) < GRID_K[-1]:
            return None
        # until its march has ended the peak is the one that is expected
        expected_k = air_k + OFFSET_K + (1.0 + wider) * rise_k
        above = Ceiling(nodes_k, air_k + OFFSET_K, expected_k)
        start = [*nodes_k, *state[len(nodes_k) :]]
        return above, Job(
            *(self.ensemble, self._kernel, start, Conditions(above.air_k)),
            PARKED_STEPS,
            factor=0.0,
        )

    def accept(self, ceiling: Ceiling, job: Job) -> None:
        """Keep *ceiling*, whose march *job* has ended."""
        peaks_k = job.course().peaks_k(sum(PARKED_STEPS))
        found = ceiling._replace(peak_k=max(peaks_k) + MARGIN_K)
        more = (found.peak_k - found.air_k) / (ceiling.peak_k - found.air_k)
        self._excess = min(max(more, 1.0) / EASING, MOST_EXCESS)
        self._kept = [
            one
            for one in self._kept
            if one.peak_k < found.peak_k
            or not found.covers(one.nodes_k, one.air_k)
        ][1 - KEPT :]
        self._kept.append(found)


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

"""Proven upper bounds of the fluid's peak, parked and on duty.

A *ceiling* is a march of all members from a state of the corner. While no
member starts hotter, at any node or with warmer air, none of them gets hotter
than it did in that march: one serves many forecasts.

Proof. Parked, without sources, C_i(T_i) dT_i/dt = sum_j q_ij(T_j, T_i), and
each q_ij rises with T_j and falls with T_i (:func:`is_ordered`). Let T and U
be two courses of one member with T <= U at first. When they first meet at a
node i, T_i = U_i, so the capacities agree, T_j <= U_j of all others, hence
dT_i/dt <= dU_i/dt: T never passes U (Kamke's theorem). Warmer air is a node
that is warmer. Every member's own numbers are used, and nothing in it is of
a brake, so that effects which add nodes are covered. With all of U as hot as
the hottest node of T, nothing flows: no member gets hotter than that either.

On duty no order is needed: let M be the hottest of all nodes and of the air at
first, and E the heat of the nodes above M, sum_i of the integral of C_i from M
to T_i > M. What one of these nodes conducts to another stays in E, and to all
that is at M or below it only gives, as no conductance is negative; so E rises
by the brake's heat at most, and the fluid's rise above M by that heat over the
least capacity of the fluid.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise, product
from math import inf, isfinite, isnan, nan, prod
from typing import Final, NamedTuple

from bstm_daemon.estimator.blocks import channels_at_rest
from bstm_daemon.forecast.members import Ensemble, Heat
from bstm_daemon.model.thermal.network import (
    Factor,
    Link,
    Network,
    Node,
    Source,
    value,
)

MARGIN_K: Final = 1.0
"""Covers the error of the marches in coarse steps."""

KEPT: Final = 32
"""Number of ceilings that are kept, those used last."""

GRID_K: Final = tuple(
    float(kelvin) for kelvin in (*range(220, 921, 20), *range(960, 1301, 40))
)
"""Temperatures between which the order of heat flows is checked."""

_REST: Final = {
    name: value
    for name, value in channels_at_rest(0.0).items()
    if name != "ambient_k"
}

_POWER: Final = value("brake_power_w")
_NEVER_NEGATIVE: Final = value("speed_ms"), value("brake_on")


class Ceiling(NamedTuple):
    """A march of all members from ``heat``.

    ``peaks_k`` are those of the members, ``top_k`` the highest; ``safe_in_s``
    is when vapour was unlikely and stayed so.
    """

    heat: Heat
    peaks_k: list[float]
    top_k: float
    safe_in_s: float


class Ceilings:
    """The ceilings of one corner's ensemble."""

    def __init__(self, ensemble: Ensemble) -> None:
        """Have none yet for *ensemble*."""
        self._ensemble = ensemble
        self.is_ordered = is_ordered(ensemble.program.network)
        """Whether there may be any."""
        fluid_j_k = ensemble.least_fluid_j_k
        self._rise_k_j = (
            heated_share(ensemble.program.network) / fluid_j_k
            if fluid_j_k
            else inf
        )
        self._kept: list[Ceiling] = []

    def clear(self) -> None:
        """Forget all."""
        self._kept = []

    def lowest(self, heat: Heat, enough_k: float) -> Ceiling | None:
        """Return the lowest one above members that start from *heat*.

        Any whose peaks are at most *enough_k* [K] is low enough.
        """
        highest = self._ensemble.highest(heat)
        lowest = None
        # most likely it is one that was used last
        for one in reversed(self._kept):
            if (
                lowest is None or one.top_k < lowest.top_k
            ) and self._ensemble.is_below(
                heat if one.heat.factor else highest, one.heat
            ):
                lowest = one
                if one.top_k <= enough_k:
                    break
        if lowest is not None:
            self._kept.remove(lowest)
            self._kept.append(lowest)
        return lowest

    def on_duty_k(self, heat: Heat, power_w: float, until_s: float) -> float:
        """Return what no member's fluid exceeds up to *until_s* on a duty.

        Args:
            heat: what the members start from.
            power_w: mean of the brake's, without its spread.
            until_s: end of the duty, whatever else acts.
        """
        top = self._ensemble.highest(heat)
        if isnan(sum(top.rises_k)):
            return nan
        heat_j = until_s * power_w * self._ensemble.most_power(heat.factor)
        return (
            top.ambient_k
            + max(0.0, *top.rises_k)
            + self._rise_k_j * heat_j
            + MARGIN_K
        )

    def keep(
        self, heat: Heat, peaks_k: Sequence[float], safe_in_s: float
    ) -> None:
        """Keep the march from *heat* that found *peaks_k* [K]."""
        if not self.is_ordered or not isfinite(sum(peaks_k)):
            return
        higher_k = [one + MARGIN_K for one in peaks_k]
        found = Ceiling(heat, higher_k, max(higher_k), safe_in_s)
        self._kept = [
            one
            for one in self._kept
            if one.top_k < found.top_k
            or not self._ensemble.is_below(one.heat, heat)
        ][1 - KEPT :]
        self._kept.append(found)


def is_ordered(net: Network) -> bool:
    """Whether a parked corner that starts hotter stays hotter, at each node.

    False wherever that does not follow from its parts one by one: a source
    that acts at rest, or a flow that depends on more than its two ends.
    """
    return (
        all(map(_is_plain, net.nodes))
        and all(
            _product(source.factors, _REST) == 0.0 for source in net.sources
        )
        and all(map(_is_rising, net.links))
    )


def heated_share(net: Network) -> float:
    """Return the most that a joule of brake power heats the nodes by [J].

    Infinite wherever something else may heat them.
    """
    # constants and tables of a conductance are never negative
    is_bounded = all(map(_is_plain, net.nodes)) and all(
        factor.table is not None
        or factor.kind == "radiation"
        or factor in _NEVER_NEGATIVE
        for link in net.links
        for factor in link.factors
    )
    return sum(map(_heated_share, net.sources)) if is_bounded else inf


def _heated_share(source: Source) -> float:
    others = [one for one in source.factors if one != _POWER]
    tables = [one.table.values for one in others if one.table is not None]
    if (
        len(others) != len(source.factors) - 1
        or len(tables) != len(others)
        or any(min(values) < 0.0 for values in tables)
    ):
        return inf
    return max(source.gain, 0.0) * prod(map(max, tables))


def _is_plain(node: Node) -> bool:
    """Whether *node* has a capacity of its own, and the air as boundary."""
    return not node.factors and (
        node.boundary_input in {"ambient_k", None}
        or isnan(_REST.get(node.boundary_input or "", 0.0))
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

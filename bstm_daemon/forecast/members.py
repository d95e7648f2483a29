"""The members of an ensemble: perturbed models of one corner.

A member is the compiled network of the corner with conductances, capacities
and the present temperatures multiplied by drawn factors. It keeps the corner's
structure, so the kernel marches all of them as lanes.
"""

from __future__ import annotations

from array import array
from dataclasses import replace
from math import hypot, isnan, nan
from operator import le
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.model.risk.sequence import normal_draws
from bstm_daemon.model.thermal.kernel import Batch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.model.risk.vaporisation import Boiling
    from bstm_daemon.model.thermal.network import Link, Network
    from bstm_daemon.model.thermal.program import Program
    from bstm_daemon.native.loader import Kernel


class Spread(NamedTuple):
    """Standard deviations of the uncertain quantities of an estimate.

    All are shares but ``ambient_k`` and ``fluid_floor_k`` [K]. ``heat`` is
    the brake heat so far, common to all nodes and corners, ``duty_heat`` that
    of the duty to come; ``fluid`` the error of the fluid alone. The others
    are of the model from now on: resistance of backplate and shim, losses of
    the fluid's lump and of the disc, conduction in the lining, exchange of
    disc and pad, capacity of the fluid's lump.
    """

    heat: float = 0.03
    fluid: float = 0.02
    fluid_floor_k: float = 1.0
    resistance: float = 0.04
    fluid_loss: float = 0.05
    disc_loss: float = 0.05
    lining: float = 0.04
    exchange: float = 0.10
    fluid_capacity: float = 0.015
    ambient_k: float = 1.5
    duty_heat: float = 0.15

    def scaled(self, factor: float) -> Spread:
        """Return all of it times *factor*."""
        return Spread(*(factor * value for value in self))


AXES: Final = Spread._fields
LOWEST_FACTOR: Final = 0.2
"""Lower bound of the factors on conductances and capacities."""

DEGRADED_FACTOR: Final = 2.0
"""Factor on the spread of a degraded estimate."""


class Heat(NamedTuple):
    """What the members of an ensemble start from.

    ``factor`` widens the spread; ``rises_k`` are those of the nodes above the
    air, ``own_k`` the deviations of the nodes that share the fluid's.
    """

    factor: float
    ambient_k: float
    rises_k: list[float]
    own_k: list[float]


class Ensemble:
    """Members of one corner, for any state of it."""

    def __init__(self, program: Program, count: int, spread: Spread) -> None:
        """Draw *count* members of *program*."""
        self.program = program
        self.count = count
        self.spread = spread
        self.draws = [
            dict(zip(AXES, point, strict=True))
            for point in normal_draws(count, len(AXES))
        ]
        self._farthest = {
            axis: max(abs(draw[axis]) for draw in self.draws) for axis in AXES
        }
        self._starts = [
            (draw["heat"], draw["fluid"], draw["ambient_k"])
            for draw in self.draws
        ]
        self.now_draws = [point[0] for point in normal_draws(count, 1)]
        self._top_draw = max(self.now_draws)
        self.draw_ends = tuple(
            self.now_draws.index(end(self.now_draws)) for end in (max, min)
        )
        net = program.network
        self.nodes = len(net.nodes)
        self.fluid = program.state_names.index("fluid")
        self._behind = [
            i
            for i, node in enumerate(net.nodes)
            if node.name in {"fluid", "backplate", "caliper"}
        ]
        self._before = [i for i in range(self.nodes) if i not in self._behind]
        self._batch: Batch | None = None
        places = _places(program)
        self.programs = [
            replace(program, floats=_changed(program, places, draw, spread))
            for draw in self.draws
        ]
        table = net.nodes[self.fluid].capacity_table
        self.least_fluid_j_k = min(
            one.floats[self.fluid] for one in self.programs
        ) * (1.0 if table is None else min(table.values))
        """The least capacity of a member's fluid [J/K]."""

    def is_of(self, program: Program, spread: Spread) -> bool:
        """Whether it has the members of *program* with *spread*."""
        return self.program == program and self.spread == spread

    def batch(self, kernel: Kernel | None) -> Batch:
        """Return the members as a batch of *kernel*, made once."""
        if self._batch is None or self._batch.kernel is not kernel:
            self._batch = Batch(self.programs, 0.0, None, kernel)
        return self._batch

    def states(
        self, state: Sequence[float], ambient_k: float, factor: float
    ) -> array[float]:
        """Return the members' states around *state*, [count, state] flat.

        *factor* widens the spread; the rise above *ambient_k* has a relative
        error, because it is proportional to the heat so far.
        """
        spread = self.spread
        found = array("d")
        fluid_k = state[self.fluid]
        rises = [(one, one - ambient_k) for one in state[: self.nodes]]
        alone = self._own(fluid_k - ambient_k)
        for of_heat, of_fluid, _ in self._starts:
            common = factor * spread.heat * of_heat
            own = factor * alone * of_fluid
            member = [value + common * rise_k for value, rise_k in rises]
            for node in self._behind:
                member[node] += own * rises[node][1]
            found.extend(member)
            found.extend(state[self.nodes :])
        return found

    def heat(
        self, state: Sequence[float], ambient_k: float, factor: float
    ) -> Heat:
        """Return what :meth:`states` starts from; Args as there."""
        rises_k = [one - ambient_k for one in state[: self.nodes]]
        own = self._own(rises_k[self.fluid])
        return Heat(
            factor,
            ambient_k,
            rises_k,
            [own * rises_k[i] for i in self._behind],
        )

    def highest(self, heat: Heat) -> Heat:
        """Return what no member exceeds, at any node, if it had no spread."""
        spread, far = self.spread, self._farthest
        common = heat.factor * spread.heat * far["heat"]
        width_k = heat.factor * spread.ambient_k * far["ambient_k"]
        rises_k = [one + common * abs(one) - width_k for one in heat.rises_k]
        for i, own_k in zip(self._behind, heat.own_k, strict=True):
            rises_k[i] += heat.factor * far["fluid"] * abs(own_k)
        return Heat(
            0.0, heat.ambient_k + width_k, rises_k, [0.0] * len(heat.own_k)
        )

    def most_power(self, factor: float) -> float:
        """Return the highest share that a member has of a duty's power."""
        width = factor * self.spread.duty_heat
        return 1.0 + width * self._farthest["duty_heat"]

    def is_below(self, heat: Heat, other: Heat) -> bool:
        """Whether no member starts hotter from *heat* than from *other*.

        A member's node is at a + (1 + c) r + d e, with its own c of the heat
        so far and d of the fluid alone, where e is not 0. False of a NaN.
        """
        if heat.factor != other.factor or not (
            heat.ambient_k <= other.ambient_k
            and all(map(le, heat.rises_k, other.rises_k))
        ):
            return False
        width = heat.factor * self._farthest["fluid"]
        least = 1.0 - heat.factor * self.spread.heat * self._farthest["heat"]
        return least >= 0.0 and all(
            width * abs(far - near)
            <= least * (other.rises_k[i] - heat.rises_k[i])
            for i, near, far in zip(
                self._behind, heat.own_k, other.own_k, strict=True
            )
        )

    def range_k(self, heat: Heat) -> tuple[list[float], list[float]]:
        """Return each member's fluid and its hottest node, or air [K].

        Both are NaN where a node is.
        """
        spread, ambient_k = self.spread, heat.ambient_k
        rises_k = heat.rises_k
        if isnan(sum(rises_k)):
            return [nan] * self.count, [nan] * self.count
        fluid_k = rises_k[self.fluid]
        own = heat.factor * self._own(fluid_k)
        common = heat.factor * spread.heat
        width_k = heat.factor * spread.ambient_k
        inner = [rises_k[i] for i in self._behind]
        outer = [rises_k[i] for i in self._before]
        high, low, inner_high, inner_low = (
            *(max(outer), min(outer)),
            *(max(inner), min(inner)),
        )
        least, most = [], []
        for of_heat, of_fluid, of_air in self._starts:
            share = 1.0 + common * of_heat
            alone = share + own * of_fluid
            least.append(ambient_k + alone * fluid_k)
            most.append(
                ambient_k
                + max(
                    width_k * of_air,
                    share * (high if share > 0.0 else low),
                    alone * (inner_high if alone > 0.0 else inner_low),
                )
            )
        return least, most

    def _own(self, fluid_rise_k: float) -> float:
        """Return the relative deviation of the fluid alone."""
        floor = self.spread.fluid_floor_k / max(abs(fluid_rise_k), 1.0)
        return hypot(self.spread.fluid, floor)

    def duty_deviation_k(
        self, start_k: float, duty_k: float, factor: float
    ) -> float:
        """Return the deviation [K] of a fluid's rise on duty.

        To first order: what it has from the start, *start_k*, is as uncertain
        as the heat so far and the fluid; what the duty adds, *duty_k*, as the
        power of the duty and all that the model does with it.
        """
        spread = self.spread
        model = hypot(
            spread.resistance,
            spread.fluid_loss,
            spread.disc_loss,
            spread.lining,
            spread.exchange,
            spread.fluid_capacity,
        )
        return hypot(
            self.fluid_deviation_k(start_k, 0.0, factor),
            hypot(factor * spread.duty_heat, model) * duty_k,
        )

    def fluid_deviation_k(
        self, fluid_k: float, ambient_k: float, factor: float
    ) -> float:
        """Return the standard deviation [K] of the fluid's temperature."""
        spread = self.spread
        share = hypot(spread.heat, spread.fluid)
        return factor * hypot(
            share * (fluid_k - ambient_k), spread.fluid_floor_k
        )

    def now(
        self, fluid_k: float, deviation_k: float, boiling: Boiling
    ) -> tuple[list[float], float]:
        """Return the present fluid of each draw [K] and its mean risk.

        Where nothing boils, the hottest one stands for all.
        """
        top_k = fluid_k + deviation_k * self._top_draw
        if boiling.probability(top_k) == 0.0:
            return [top_k] * self.count, 0.0
        now_k = [fluid_k + deviation_k * draw for draw in self.now_draws]
        return now_k, boiling.mean_probability(now_k)

    def ambients_k(self, ambient_k: float, factor: float) -> list[float]:
        """Return each member's air temperature [K]."""
        width = factor * self.spread.ambient_k
        return [ambient_k + width * of_air for _, _, of_air in self._starts]


def _places(program: Program) -> list[tuple[int, str]]:
    """Return numbers of *program* and the uncertainty of each."""
    net = program.network
    capacities = [
        (i, "fluid_capacity")
        for i, node in enumerate(net.nodes)
        if node.name in {"fluid", "caliper"}
    ]
    links = [
        (len(net.nodes) + k, axis)
        for k, link in enumerate(net.links)
        if (axis := _axis(net, link)) is not None
    ]
    return capacities + links


def _changed(
    program: Program,
    places: list[tuple[int, str]],
    draw: dict[str, float],
    spread: Spread,
) -> array[float]:
    """Return the numbers of *program* for the member *draw*."""
    floats = program.floats[:]
    for place, axis in places:
        width: float = getattr(spread, axis)
        floats[place] *= max(1.0 + width * draw[axis], LOWEST_FACTOR)
    return floats


def _axis(net: Network, link: Link) -> str | None:
    """Return the uncertainty of the conductance of *link*, if any."""
    ends = {link.a, link.b}
    air = any(net.node(end).boundary_input == "ambient_k" for end in ends)
    pads = sum(end.startswith("pad_") for end in ends)
    if air and ends & {"fluid", "caliper"}:
        return "fluid_loss"
    if air and "disc" in ends:
        return "disc_loss"
    if "backplate" in ends:
        return "resistance"
    if pads == len(ends):
        return "lining"
    return "exchange" if pads and "disc" in ends else None

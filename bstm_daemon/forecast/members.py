"""The members of an ensemble: perturbed models of one corner.

A member is the compiled network of the corner with conductances, capacities
and the present temperatures multiplied by drawn factors. It keeps the corner's
structure, so the kernel marches all of them as lanes.
"""

from __future__ import annotations

from array import array
from dataclasses import replace
from functools import cached_property
from math import hypot, prod
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.model.risk.sequence import normal_draws
from bstm_daemon.model.thermal.kernel import Batch

if TYPE_CHECKING:
    from collections.abc import Sequence

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
        self.now_draws = [point[0] for point in normal_draws(count, 1)]
        self.top_draw = max(self.now_draws)
        net = program.network
        self._nodes = len(net.nodes)
        self.fluid = program.state_names.index("fluid")
        self._behind = [
            i
            for i, node in enumerate(net.nodes)
            if node.name in {"fluid", "backplate", "caliper"}
        ]
        self._batch: Batch | None = None
        self._widest: dict[float, float] = {}
        places = _places(program)
        self.programs = [
            replace(program, floats=_changed(program, places, draw, spread))
            for draw in self.draws
        ]

    def of(self, program: Program) -> Ensemble:
        """Return the same members for *program*; itself if that is unchanged.

        The networks of worn linings replace the previous ones.
        """
        if program is self.program:
            return self
        return Ensemble(program, self.count, self.spread)

    def batch(self, kernel: Kernel | None) -> Batch:
        """Return the members as a batch of *kernel*, made once."""
        if self._batch is None or self._batch.kernel is not kernel:
            self._batch = Batch(self.programs, 0.0, None, kernel)
        return self._batch

    @cached_property
    def alone(self) -> Ensemble:
        """The estimate as an ensemble of one."""
        return Ensemble(self.program, 1, self.spread)

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
        rises = [(one, one - ambient_k) for one in state[: self._nodes]]
        floor = spread.fluid_floor_k / max(abs(fluid_k - ambient_k), 1.0)
        alone = hypot(spread.fluid, floor)
        for draw in self.draws:
            common = factor * spread.heat * draw["heat"]
            own = factor * alone * draw["fluid"]
            member = [value + common * rise_k for value, rise_k in rises]
            for node in self._behind:
                member[node] += own * rises[node][1]
            found.extend(member)
            found.extend(state[self._nodes :])
        return found

    def highest(
        self, state: Sequence[float], ambient_k: float, factor: float
    ) -> tuple[list[float], float]:
        """Return what no member exceeds: each node of *state*, its air [K].

        They are those of :meth:`states` and :meth:`ambients_k`.
        """
        spread, fluid_k = self.spread, state[self.fluid]
        floor = spread.fluid_floor_k / max(abs(fluid_k - ambient_k), 1.0)
        common = factor * spread.heat * self._farthest["heat"]
        own = factor * hypot(spread.fluid, floor) * self._farthest["fluid"]
        nodes_k = [
            kelvin + common * abs(kelvin - ambient_k)
            for kelvin in state[: self._nodes]
        ]
        for node in self._behind:
            nodes_k[node] += own * abs(state[node] - ambient_k)
        width_k = factor * spread.ambient_k * self._farthest["ambient_k"]
        return nodes_k, ambient_k + width_k

    def widest_rise(self, factor: float) -> float:
        """Return how many times the estimate's rise a member's may be on duty.

        A rule, no proof: every uncertainty of a member adds to it. *factor*
        widens the spread.
        """
        if factor in self._widest:
            return self._widest[factor]
        scaled = {"heat", "fluid", "duty_heat"}
        shares: dict[str, float] = self.spread._asdict()
        del shares["fluid_floor_k"], shares["ambient_k"]
        widest = max(
            prod(
                1.0
                + share * abs(draw[axis]) * (factor if axis in scaled else 1.0)
                for axis, share in shares.items()
            )
            for draw in self.draws
        )
        self._widest[factor] = widest
        return widest

    def fluid_deviation_k(
        self, fluid_k: float, ambient_k: float, factor: float
    ) -> float:
        """Return the standard deviation [K] of the fluid's temperature."""
        spread = self.spread
        share = hypot(spread.heat, spread.fluid)
        return factor * hypot(
            share * (fluid_k - ambient_k), spread.fluid_floor_k
        )

    def ambients_k(self, ambient_k: float, factor: float) -> list[float]:
        """Return each member's air temperature [K]."""
        width = factor * self.spread.ambient_k
        return [ambient_k + width * draw["ambient_k"] for draw in self.draws]

    def heats(self, factor: float) -> list[float]:
        """Return each member's factor on a duty's brake power."""
        width = factor * self.spread.duty_heat
        return [
            max(1.0 + width * draw["duty_heat"], 0.0) for draw in self.draws
        ]


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

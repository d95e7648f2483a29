"""An unknown start, bounded from both sides until it has no effect any more.

Where nobody knows how hot the brakes are at the start, the estimate begins
cold. Beside it the same networks are marched over the same rows from a hot
start, as hot as the car gets. What a network holds at the start decays, so the
truth lies between the two, and the start of a corner is known from the
publication on at which they agree within :data:`AGREE_K` at every node that is
published.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from math import inf, isfinite
from operator import sub
from typing import Final

from bstm_daemon.config.sections import Config
from bstm_daemon.estimator.blocks import BlockLayout, channels_at_rest
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.program import Program, compile_network
from bstm_daemon.model.thermal.settling import SETTLED_K
from bstm_daemon.model.wear.car import exchange
from bstm_daemon.model.wear.pads import Change
from bstm_daemon.native.loader import Kernel
from bstm_daemon.units import KELVIN_OFFSET

AGREE_K: Final = SETTLED_K
"""Largest difference of the two bounds that has no effect any more."""

PUBLISHED_NODES: Final = ("fluid", "pad_back", "pad_front", "disc")
"""Nodes of :class:`~bstm_daemon.estimate.CornerEstimate`, the slowest first;
what another node holds counts once it reaches one of these."""

HOTTEST_DISC_K: Final = 700.0 + KELVIN_OFFSET
"""Least temperature of the disc on the hottest descent: cast iron glows then,
and the descents of ``docs/risk.md`` end below it."""

DESCENT_MS: Final = 9.0
"""Speed of the hottest descent: 32 km/h, the slowest of ``docs/risk.md``; the
slower, the less air cools the caliper of a disc that hot."""

_DESCENT: Final = 96, 20.0
_SOAK: Final = 180, 20.0
"""Steps and their length [s]: 6 h down bring every node to rest, and parked
each has its peak within the hour."""


class StartBound:
    """The hot bound of each corner whose start is unknown."""

    def __init__(
        self,
        batches: Sequence[tuple[Batch, Sequence[str]]],
        config: Config,
        kernel: Kernel | None,
    ) -> None:
        """Take every start as known.

        Args:
            batches: of the estimate, with the names of their corners.
            config: the vehicle.
            kernel: the compiled one; None runs the reference.
        """
        self._estimate = batches
        self._kernel = kernel
        self._air_k = config.vehicle.ambient_k
        limit_k = config.forecast.disc_limits_c[-1] + KELVIN_OFFSET
        self._disc_k = max(limit_k, HOTTEST_DISC_K)
        self.unknown: set[str] = set()
        """Corners whose start is unknown."""
        self.batches: list[Batch] = []
        """One beside each of the estimate, with the same members, while any
        start is unknown."""

    def begin(
        self,
        corners: Collection[str],
        saved: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        """Take the start of *corners* as unknown from now on.

        Args:
            corners: their names.
            saved: by corner the bound's nodes [K] and memories, to go on
                with; without them it begins as hot as the car gets.
        """
        if corners and not self.batches:
            self.batches = [_beside(batch) for batch, _ in self._estimate]
        for own, bound, member, name in self._members():
            if name not in corners:
                continue
            self.unknown.add(name)
            program, state = own.programs[member], own.named_state(member)
            if saved is not None and name in saved:
                state |= saved[name]
            else:
                hottest = hottest_k(
                    program, self._disc_k, self._air_k, self._kernel
                )
                state |= {k: max(state[k], v) for k, v in hottest.items()}
            bound.state[own.part(member)] = array("d", state.values())

    def end(self) -> None:
        """Take every start as known."""
        self.unknown.clear()
        self.batches = []

    def states(self) -> dict[str, dict[str, float]]:
        """Return nodes [K] and memories of the bound where it is needed."""
        return {
            name: bound.named_state(member)
            for _, bound, member, name in self._members()
            if name in self.unknown
        }

    def known_from(
        self,
        layout: BlockLayout,
        outputs: Sequence[array[float]],
        bounds: Sequence[array[float]],
        count: int,
    ) -> dict[str, int]:
        """Return the first publication on which each start is known.

        Corners whose bounds have come to agree are done with.

        Args:
            layout: of a block.
            outputs: the estimate, per group.
            bounds: the hot bound, likewise; empty where every start is known.
            count: publications of the block; also what is returned for a
                start that stays unknown.
        """
        found = dict.fromkeys(layout.modelled, 0)
        for name in sorted(self.unknown):
            number, first, stride, group = layout.modelled[name]
            places = _places(group.state_names)
            cold, hot = outputs[number], bounds[number]
            nearest_k = max(
                min(map(sub, hot[at::stride], cold[at::stride]), default=inf)
                for at in (first + place for place in places)
            )
            # where one node's never come near, none is looked at; a nan is
            found[name] = next(
                (
                    i
                    for i in range(0 if nearest_k > AGREE_K else count)
                    if _agree(cold, hot, first + i * stride, places)
                ),
                count,
            )
        self._settle({name for name, i in found.items() if i < count})
        return found

    def exchange(
        self, corner: str, program: Program, change: Change, air_k: float
    ) -> None:
        """Replace the network of *corner*, as that of the estimate is.

        Args:
            corner: its name.
            program: the new network.
            change: of the linings.
            air_k: temperature of new linings [K].
        """
        for _, bound, member, name in self._members():
            if name == corner:
                exchange(bound, member, program, change, air_k)

    def compare(self) -> None:
        """Be done with corners whose bounds agree now."""
        self._settle(
            {
                name
                for own, bound, member, name in self._members()
                if _agree(
                    *(own.state, bound.state, member * own.width),
                    _places(own.programs[member].state_names),
                )
            }
        )

    def _settle(self, known: set[str]) -> None:
        self.unknown -= known
        if not self.unknown:
            self.batches = []

    def _members(self) -> Iterator[tuple[Batch, Batch, int, str]]:
        """Give batch, the one beside it, place and name of each corner."""
        if self.batches:
            for (own, names), bound in zip(
                self._estimate, self.batches, strict=True
            ):
                for member, name in enumerate(names):
                    yield own, bound, member, name


def hottest_k(
    program: Program, disc_k: float, air_k: float, kernel: Kernel | None
) -> dict[str, float]:
    """Return each node's highest temperature [K] on the hottest descent.

    It is endless, at :data:`DESCENT_MS` and with the brake power that holds
    the disc at *disc_k*; then the car parks. A real one ends before the pads,
    the caliper and the fluid come to rest, so no node gets hotter.

    Args:
        program: of the corner.
        disc_k: temperature of the disc [K].
        air_k: ambient temperature [K].
        kernel: the compiled one; None runs the reference.
    """
    nodes = [node.name for node in program.network.nodes]
    down = _descended(program, disc_k, air_k, kernel)[: len(nodes)]
    batch = Batch([program], air_k, [0], kernel, 1)
    batch.state[: len(nodes)] = down
    steps, step_s = _SOAK
    row = array("d", channels_at_rest(air_k).values())
    parked = batch.march(row * steps, steps, step_s)
    size = batch.width + batch.sources
    peaks_k = {
        name: max(down[i], *parked[i::size]) for i, name in enumerate(nodes)
    }
    if not isfinite(sum(down) + sum(parked)):
        # a network that can not be marched so far is as hot as its disc
        peaks_k = dict.fromkeys(nodes, disc_k)
    # the last stop may have heated the face of the linings like the disc
    return peaks_k | {"pad_front": disc_k}


def _descended(
    program: Program, disc_k: float, air_k: float, kernel: Kernel | None
) -> array[float]:
    """Return the state of the corner at rest on the hottest descent."""
    net = program.network.edit_node(
        "disc", lambda node: replace(node, boundary_input="measured_disc_k")
    )
    batch = Batch([compile_network(net)], air_k, [0], kernel, 1)
    batch.state[program.state_names.index("disc")] = disc_k
    given_off = [
        (i, 1.0 if link.a == "disc" else -1.0)
        for i, link in enumerate(net.links)
        if "disc" in {link.a, link.b}
    ]
    taken_up = [
        len(net.links) + i
        for i, source in enumerate(net.sources)
        if source.node == "disc"
    ]
    channels = channels_at_rest(air_k) | {
        "speed_ms": DESCENT_MS,
        "brake_on": 1.0,
        "measured_disc_k": disc_k,
    }
    steps, step_s = _DESCENT
    power_w = 1.0
    for _ in range(steps):
        channels["brake_power_w"] = power_w
        batch.ledger[:] = array("d", bytes(8 * len(batch.ledger)))
        batch.march(array("d", channels.values()), 1, step_s)
        lost_j = sum(sign * batch.ledger[i] for i, sign in given_off)
        heat_j = sum(batch.ledger[i] for i in taken_up)
        # what the disc gives off is what the brake power must bring it
        if lost_j > 0.0 and heat_j > 0.0:
            power_w *= lost_j / heat_j
    return batch.state


def _beside(batch: Batch) -> Batch:
    """Return a batch with the members and the state of *batch*."""
    beside = Batch(
        batch.programs, 0.0, batch.input_set, batch.kernel, batch.sets
    )
    beside.state[:] = batch.state
    return beside


def _places(names: Sequence[str]) -> list[int]:
    return [names.index(node) for node in PUBLISHED_NODES]


def _agree(
    cold: array[float], hot: array[float], first: int, places: Sequence[int]
) -> bool:
    for at in places:
        if not abs(hot[first + at] - cold[first + at]) <= AGREE_K:
            return False
    return True

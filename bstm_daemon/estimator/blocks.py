"""Blocks of estimates as flat arrays, and the layout of a publication."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from functools import cache, cached_property
from math import nan
from typing import Final, NamedTuple

from bstm_daemon.channels import CHANNELS, FLAGS, VEHICLE_CHANNELS
from bstm_daemon.estimate import Reason, Validity
from bstm_daemon.model.thermal.program import Program
from bstm_daemon.model.wear.car import Laws

_CHANNEL: Final = {name: i for i, name in enumerate(CHANNELS)}
_VEHICLE: Final = {name: i for i, name in enumerate(VEHICLE_CHANNELS)}

SHOWN: Final = ("disc", "pad_front", "pad_back", "fluid")
"""Nodes that every model has, and whose temperatures are shown."""

# calls of an enumeration are slow, and each publication needs many
_CODES: Final[dict[int, Validity]] = {int(code): code for code in Validity}
validity_of: Final = _CODES.__getitem__
reasons_of: Final = cache(Reason)


@dataclass(frozen=True, slots=True)
class Group:
    """Corners marched together.

    ``state_names`` are those of a state: nodes, of which there are
    ``nodes``, then memories; ``size`` counts the running energies too.
    """

    corners: tuple[str, ...]
    state_names: tuple[str, ...]
    nodes: int
    size: int


@dataclass(frozen=True)
class BlockLayout:
    """Corners in the order of a block's rows, and groups of its outputs."""

    corners: tuple[str, ...]
    groups: tuple[Group, ...]

    @cached_property
    def rows(self) -> dict[str, int]:
        """Place of each corner in a row of the channels."""
        return {
            name: place * len(CHANNELS)
            for place, name in enumerate(self.corners)
        }

    @cached_property
    def shown(self) -> dict[str, tuple[int, ...]]:
        """Places of :data:`SHOWN` in the state of each modelled corner."""
        return {
            name: tuple(map(group.state_names.index, SHOWN))
            for group in self.groups
            for name in group.corners
        }

    @cached_property
    def looked_up(self) -> dict[str, tuple[int, int, tuple[int, ...]]]:
        """Where :data:`SHOWN` of each modelled corner are in the outputs.

        Number of the group, numbers of the group at a publication, places.
        """
        return {
            name: (
                number,
                stride,
                tuple(first + place for place in self.shown[name]),
            )
            for name, (number, first, stride, _) in self.modelled.items()
        }

    @cached_property
    def modelled(self) -> dict[str, tuple[int, int, int, Group]]:
        """Group and place in its outputs of each corner with a model.

        Number of the group, first number of the corner, numbers of the group
        at a publication, the group; in the order of the outputs.
        """
        return {
            name: (
                number,
                member * group.size,
                len(group.corners) * group.size,
                group,
            )
            for number, group in enumerate(self.groups)
            for member, name in enumerate(group.corners)
        }


@dataclass(frozen=True, slots=True)
class Block:
    """Contiguous estimates at the publications of contiguous samples.

    With n publications: ``times_us`` [n]; ``rows`` [n, corners, CHANNELS]
    and ``vehicle`` [n, VEHICLE_CHANNELS], the step that ends at each;
    ``outputs`` per group [n, corners of the group, size]: node temperatures
    [K] and memories, then the running energy of each heat source [J];
    ``flags`` [n], the bits of all steps since the last publication;
    ``validity`` and ``reasons``, bits of Reason, per corner of a thermal
    model [n]; ``disagrees`` [n], whether the model disagrees with what is
    measured. All flat.
    """

    layout: BlockLayout
    times_us: array[int]
    rows: array[float]
    vehicle: array[float]
    outputs: tuple[array[float], ...]
    flags: array[int]
    validity: dict[str, array[int]]
    reasons: dict[str, array[int]]
    disagrees: array[int]
    known_from: dict[str, int]
    """Per corner of a thermal model: the first publication on which the start
    has no effect."""
    bounds: tuple[array[float], ...]
    """As ``outputs``, from the hot start; empty where no start was unknown."""
    wear: dict[str, Laws]
    """Per corner of a thermal model: wear laws, each from a publication on."""
    _corners: dict[str, list[tuple[float, ...]]] = field(default_factory=dict)

    def at(self, i: int) -> Instant:
        """Return a view of publication *i*."""
        # without the constructor's own call
        return tuple.__new__(Instant, (self, i))

    def each(self, channel: str) -> array[float]:
        """Return *channel* of VEHICLE_CHANNELS at each publication."""
        return self.vehicle[_VEHICLE[channel] :: len(VEHICLE_CHANNELS)]

    def of_corners(self, channel: str) -> list[tuple[float, ...]]:
        """Return *channel* of CHANNELS of every corner at each publication."""
        found = self._corners.get(channel)
        if found is None:
            place = _CHANNEL[channel]
            stride = len(self.layout.corners) * len(CHANNELS)
            columns = [
                self.rows[first + place :: stride]
                for first in self.layout.rows.values()
            ]
            self._corners[channel] = found = [*zip(*columns, strict=True)]
        return found


class Instant(NamedTuple):
    """One publication of a block: a view that copies on access."""

    block: Block
    i: int

    @property
    def time_us(self) -> int:
        """Its grid time [us]."""
        return self.block.times_us[self.i]

    @property
    def flags(self) -> int:
        """Bits of all steps since the publication before."""
        return self.block.flags[self.i]

    @property
    def is_silent(self) -> bool:
        """Whether no sample came, as from a bus that is down or asleep."""
        return bool(self.flags & (FLAGS["silent"] | FLAGS["asleep"]))

    @property
    def clock_jumped(self) -> bool:
        """Whether the clock of the samples jumped."""
        return bool(self.flags & FLAGS["clock_jump"])

    @property
    def history_known(self) -> bool:
        """Whether the start of no corner has an effect any more."""
        return self.i >= max(self.block.known_from.values(), default=0)

    def start_known(self, corner: str) -> bool:
        """Whether the start of *corner* has no effect any more."""
        return self.i >= self.block.known_from[corner]

    @property
    def model_disagrees(self) -> bool:
        """Whether the model disagrees with what is measured."""
        return bool(self.block.disagrees[self.i])

    def vehicle(self, channel: str) -> float:
        """Return *channel* of VEHICLE_CHANNELS."""
        wide = len(VEHICLE_CHANNELS)
        return self.block.vehicle[self.i * wide + _VEHICLE[channel]]

    def channel(self, corner: str, channel: str) -> float:
        """Return *channel* of CHANNELS of *corner*, modelled or not."""
        return self.block.rows[self._row(corner) + _CHANNEL[channel]]

    def each(self, channel: str) -> tuple[float, ...]:
        """Return *channel* of CHANNELS of every corner, modelled or not."""
        return self.block.of_corners(channel)[self.i]

    def row(self, corner: str) -> array[float]:
        """Return all channels of *corner*, modelled or not."""
        first = self._row(corner)
        return self.block.rows[first : first + len(CHANNELS)]

    def output(self, corner: str, *, hottest: bool = False) -> array[float]:
        """Return state and running energies of *corner*.

        Args:
            corner: its name.
            hottest: of the hot bound, as long as the start is unknown.
        """
        number, first, stride, group = self.block.layout.modelled[corner]
        first += self.i * stride
        bounded = hottest and not self.start_known(corner)
        outputs = self.block.bounds if bounded else self.block.outputs
        return outputs[number][first : first + group.size]

    def state(self, corner: str, *, hottest: bool = False) -> dict[str, float]:
        """Return nodes [K] and memories by name; Args as of :meth:`output`."""
        names = self.block.layout.modelled[corner][3].state_names
        return dict(
            zip(names, self.output(corner, hottest=hottest), strict=False)
        )

    def shown_k(self, corner: str, *, hottest: bool = False) -> list[float]:
        """Return the temperatures [K] of :data:`SHOWN`.

        Args as of :meth:`output`.
        """
        block, i = self
        number, stride, places = block.layout.looked_up[corner]
        bounded = hottest and not self.start_known(corner)
        output = (block.bounds if bounded else block.outputs)[number]
        first = i * stride
        return [output[first + place] for place in places]

    def validity(self, corner: str) -> Validity:
        """Return how far the estimate of *corner* may be relied on."""
        return validity_of(self.block.validity[corner][self.i])

    def reasons(self, corner: str) -> Reason:
        """Return why the estimate of *corner* is not valid."""
        return reasons_of(self.block.reasons[corner][self.i])

    def _row(self, corner: str) -> int:
        layout = self.block.layout
        stride = len(layout.corners) * len(CHANNELS)
        return self.i * stride + layout.rows[corner]


def channels_at_rest(ambient_k: float) -> dict[str, float]:
    """Return the channels of a corner that stands in air of *ambient_k*."""
    return {
        name: nan if name.startswith("measured_") else 0.0 for name in CHANNELS
    } | {"ambient_k": ambient_k}


def friction_energies(program: Program) -> list[int]:
    """Return where the friction heat [J] of *program* is in its output."""
    return [
        len(program.state_names) + i
        for i, source in enumerate(program.network.sources)
        if any(factor.a == "brake_power_w" for factor in source.factors)
    ]

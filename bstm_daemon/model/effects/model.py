"""Models that effects edit: one corner's, and the inputs of the whole car."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from bstm_daemon.config.sections import Config, CornerConfig
from bstm_daemon.model.heat.friction_law import FrictionLaw
from bstm_daemon.model.thermal.brake_corner import CornerSpec
from bstm_daemon.model.thermal.network import (
    Factor,
    Network,
    Source,
    with_factors,
)
from bstm_daemon.roles import ROLE_INDEX

AIR = "air"
"""Node of the air inside the wheel house, where an effect has made one."""

CALIPER = "caliper"
"""Node of the caliper, where an effect has split it from the fluid."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of an effect: unit, bounds, typical value, meaning."""

    name: str
    unit: str
    lower: float
    upper: float
    typical: float
    meaning: str


@dataclass(frozen=True, slots=True)
class CornerModel:
    """One corner's network and what it was built from.

    ``heat_from_pressure`` is whether the brake power is Feed-Forward; an
    effect on friction must leave a measured power alone. ``lag_s`` are the
    time constants of thermocouples that are late, by node. ``friction`` is
    what the pass over samples makes of the pressure, in any mode.
    """

    spec: CornerSpec
    network: Network
    heat_from_pressure: bool
    wheel_radius_m: float = 0.33
    lag_s: Mapping[str, float] = field(default_factory=dict)
    friction: FrictionLaw = field(default_factory=FrictionLaw)

    def with_network(self, network: Network) -> CornerModel:
        """Return the same corner with *network*."""
        return replace(self, network=network)

    def with_friction_law(self, law: FrictionLaw) -> CornerModel:
        """Return the same corner with the factors of *law* besides."""
        return replace(self, friction=self.friction.times(law))

    def with_heat_factors(self, *factors: Factor) -> CornerModel:
        """Return the corner with *factors* on the power that pressure gives.

        For what a :class:`FrictionLaw` does not know, such as a memory.
        """
        if not self.heat_from_pressure:
            return self

        def scaled(source: Source) -> Source:
            drivers = {factor.a for factor in source.factors}
            if "brake_power_w" not in drivers:
                return source
            return with_factors(source, *factors)

        net = self.network
        return self.with_network(
            replace(net, sources=tuple(map(scaled, net.sources)))
        )

    def has_node(self, name: str) -> bool:
        """Whether the network has a node *name*."""
        return any(node.name == name for node in self.network.nodes)

    @property
    def surroundings(self) -> str:
        """Node that convection in the wheel house goes to."""
        return AIR if self.has_node(AIR) else "ambient"

    @property
    def caliper(self) -> str:
        """Node of the caliper: its own, or the lump with the fluid."""
        return CALIPER if self.has_node(CALIPER) else "fluid"

    def with_lag(self, lag_s: Mapping[str, float]) -> CornerModel:
        """Return the same corner with thermocouples that are late besides."""
        return replace(self, lag_s={**self.lag_s, **lag_s})


@dataclass(frozen=True, slots=True)
class Correction:
    """Correction of the samples of a role: ``gain * reading + offset``.

    In the SI unit of the role, before any other use of the sample.
    """

    role: str
    gain: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class InputModel:
    """Inputs of the brake power.

    ``config`` is the configuration for the pass over samples (the file's own,
    edited), ``corrections`` apply to the samples in order,
    ``unpressed_share`` is the share of the braking without pressure that is
    counted as heat, ``clock_late`` by how much the clock of the thermocouples
    is late: at the start [s], and each second more [1].
    """

    config: Config
    corrections: tuple[Correction, ...] = ()
    unpressed_share: float = 0.0
    clock_late: tuple[float, float] = (0.0, 0.0)

    def with_config(self, **sections: object) -> InputModel:
        """Return the same with *sections* of the configuration replaced."""
        return replace(self, config=self.config.model_copy(update=sections))

    def with_vehicle(self, **keys: float) -> InputModel:
        """Return the same with *keys* of ``[vehicle]`` replaced."""
        vehicle = self.config.vehicle.model_copy(update=keys)
        return self.with_config(vehicle=vehicle)

    def with_heat(self, **keys: float) -> InputModel:
        """Return the same with *keys* of ``[heat]`` replaced."""
        heat = self.config.heat.model_copy(update=keys)
        return self.with_config(heat=heat)

    def with_corners(
        self, edit: Callable[[CornerConfig], CornerConfig]
    ) -> InputModel:
        """Return the same with every corner replaced by ``edit(corner)``."""
        return self.with_config(corner=list(map(edit, self.config.corner)))

    def with_correction(self, *corrections: Correction) -> InputModel:
        """Return the same with *corrections* after those it has."""
        return replace(self, corrections=self.corrections + corrections)


def corrections_by_role(
    corrections: Iterable[Correction],
) -> dict[int, tuple[float, float]]:
    """Return gain and offset by role number; of one role, one after another.

    Raises:
        KeyError: a role that does not exist.
    """
    found: dict[int, tuple[float, float]] = {}
    for one in corrections:
        role = ROLE_INDEX[one.role]
        gain, offset = found.get(role, (1.0, 0.0))
        found[role] = one.gain * gain, one.gain * offset + one.offset
    return found


def corrected(
    corrections: Mapping[int, tuple[float, float]],
    roles: Sequence[int] | Any,
    values: Sequence[float] | Any,
) -> array[float] | Any:
    """Return *values* [n] of *roles* [n], corrected; neither is changed."""
    all_of: Any = values
    if hasattr(all_of, "dtype"):  # numpy's: all of a role at once
        all_of = all_of.copy()
        for number, (gain, offset) in corrections.items():
            own = roles == number
            all_of[own] = gain * all_of[own] + offset
        return all_of
    found = array("d", values)
    for index, role in enumerate(roles):
        if role in corrections:
            gain, offset = corrections[role]
            found[index] = gain * found[index] + offset
    return found

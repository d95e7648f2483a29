"""What an effect is: a name, parameters with bounds, an edit of the model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar

from bstm_daemon.heat.friction_law import FrictionLaw

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.thermal.brake_corner import CornerSpec
    from bstm_daemon.thermal.network import Network


@dataclass(frozen=True, slots=True)
class CornerModel:
    """What an effect edits: one corner's network and what it was built from.

    ``heat_from_pressure`` tells whether the brake power is Feed-Forward; an
    effect on friction must leave a measured power alone. ``friction`` is
    what the pass over samples makes of the pressure, in any mode.
    """

    spec: CornerSpec
    network: Network
    heat_from_pressure: bool
    friction: FrictionLaw = field(default_factory=FrictionLaw)

    def with_network(self, network: Network) -> CornerModel:
        """Return the same corner with *network*."""
        return replace(self, network=network)

    def with_friction_law(self, law: FrictionLaw) -> CornerModel:
        """Return the same corner with the factors of *law* besides."""
        return replace(self, friction=self.friction.times(law))


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of an effect: unit, bounds, typical value, meaning."""

    name: str
    unit: str
    lower: float
    upper: float
    typical: float
    meaning: str


STRENGTH = Parameter("strength", "1", 0.0, 5.0, 1.0, "0 = absent, 1 = typical")


class Effect(ABC):
    """One effect with its parameter values.

    Subclasses give ``number`` and ``name`` of the catalogue, a
    ``description`` in plain words, the ``signature`` by which data show it,
    their own parameters in ``own_parameters``, and :meth:`apply`.
    """

    number: ClassVar[int]
    name: ClassVar[str]
    description: ClassVar[str]
    signature: ClassVar[str]
    own_parameters: ClassVar[tuple[Parameter, ...]] = ()

    def __init__(self, values: Mapping[str, float]) -> None:
        """Take *values* by name; what is not given is typical.

        Raises:
            ValueError: one or more names unknown or values out of bounds;
                one line each.
        """
        problems = self.problems(values)
        if problems:
            raise ValueError("\n".join(problems))
        self._values = {
            p.name: float(values.get(p.name, p.typical))
            for p in self.parameters()
        }

    @classmethod
    def parameters(cls) -> tuple[Parameter, ...]:
        """All parameters, strength first."""
        return (STRENGTH, *cls.own_parameters)

    @classmethod
    def problems(cls, values: Mapping[str, float]) -> list[str]:
        """What is wrong with *values*: a line per unknown name or bound."""
        known = {p.name: p for p in cls.parameters()}
        found = []
        for name, given in values.items():
            if name not in known:
                found.append(
                    f"parameters.{name}: unknown; {cls.name} has "
                    f"{', '.join(known)}"
                )
            elif not known[name].lower <= given <= known[name].upper:
                p = known[name]
                found.append(
                    f"parameters.{name} = {given}: allowed {p.lower:g} to "
                    f"{p.upper:g} {p.unit}"
                )
        return found

    def __getitem__(self, name: str) -> float:
        """Value of the parameter *name*."""
        return self._values[name]

    @property
    def strength(self) -> float:
        """The effect's strength, 1 = typical."""
        return self._values["strength"]

    @abstractmethod
    def apply(self, model: CornerModel) -> CornerModel:
        """Return *model* with the effect in it."""

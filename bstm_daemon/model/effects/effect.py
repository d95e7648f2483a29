"""Base class of effects: a name, parameters with bounds, a model edit."""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Literal

from bstm_daemon.config.sections import CornerConfig
from bstm_daemon.model.effects.model import CornerModel, InputModel, Parameter
from bstm_daemon.model.thermal.network import Network

Kind = Literal["thermal", "heat", "measurement"]

STRENGTH = Parameter("strength", "1", 0.0, 5.0, 1.0, "0 = absent, 1 = typical")
SIGNED_STRENGTH = Parameter(
    "strength", "1", -5.0, 5.0, 1.0, "0 = absent, 1 = typical, either sign"
)

FIRST, USUAL, LAST = -1, 0, 1
"""Stages of application: what makes the nodes that others use comes first,
what moves the ends of links comes last."""


class Effect:
    """One effect with its parameter values.

    Subclasses give the ``number`` of the catalogue, the ``kind`` of what is
    edited, a ``description`` in plain words, the ``signature`` by which data
    show it, its ``twins`` (one of a pair names the other), their parameters in
    ``own_parameters``, and at least one of :meth:`edit_network`,
    :meth:`edit`, :meth:`edit_inputs` and :meth:`edit_corner_inputs`. At
    strength 0 none is called. The ``name`` is that of their file.

    Three kinds. ``thermal``: the network of a corner. ``heat``: the power
    that heats it, by its sources, by the configuration that the pass over
    samples is built from, or by a correction of what a sensor reads.
    ``measurement``: what a thermocouple reads of a node.
    """

    number: ClassVar[int]
    name: ClassVar[str]
    kind: ClassVar[Kind] = "thermal"
    description: ClassVar[str]
    signature: ClassVar[str]
    twins: ClassVar[tuple[str, ...]] = ()
    own_parameters: ClassVar[tuple[Parameter, ...]] = ()

    forms: ClassVar[tuple[Mapping[str, float], ...]] = ()
    """Other forms that it may have: values beside the typical ones."""

    most_strength: ClassVar[float] = STRENGTH.upper
    """What physics allows, where that is another."""

    either_sign: ClassVar[bool] = False
    """Whether physics allows a strength below 0."""

    whole_car: ClassVar[bool]
    """Whether it acts on the car and can not be given for one corner: one
    that has :meth:`edit_inputs`."""

    stage: ClassVar[int] = USUAL

    def __init_subclass__(cls) -> None:
        """Name the effect after its file."""
        cls.name = cls.__module__.rpartition(".")[2]
        cls.whole_car = cls.edit_inputs is not Effect.edit_inputs

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
        strength = SIGNED_STRENGTH if cls.either_sign else STRENGTH
        strength = replace(strength, upper=cls.most_strength)
        return (strength, *cls.own_parameters)

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
                unit = "" if p.unit == "1" else f" {p.unit}"
                found.append(
                    f"parameters.{name} = {given}: allowed {p.lower:g} to "
                    f"{p.upper:g}{unit}"
                )
        return found

    def __getitem__(self, name: str) -> float:
        """Value of the parameter *name*."""
        return self._values[name]

    @property
    def strength(self) -> float:
        """The effect's strength, 1 = typical."""
        return self._values["strength"]

    def scaled(self, name: str) -> float:
        """Value of the parameter *name* times the strength."""
        return self.strength * self[name]

    def apply(self, model: CornerModel) -> CornerModel:
        """Return *model*, one corner, with the effect in it."""
        return model if self.strength == 0.0 else self.edit(model)

    def apply_to_inputs(
        self, inputs: InputModel, corner: CornerConfig | None
    ) -> InputModel:
        """Return *inputs*, the car's, with the effect in it.

        Called once for the car with *corner* None where the effect is of the
        ``whole_car``, and otherwise once for each corner that it is given
        for.
        """
        if self.strength == 0.0:
            return inputs
        if corner is None:
            return self.edit_inputs(inputs)
        return self.edit_corner_inputs(inputs, corner)

    def edit(self, model: CornerModel) -> CornerModel:
        """Edit one corner; the strength is not 0."""
        return model.with_network(self.edit_network(model))

    def edit_network(self, model: CornerModel) -> Network:
        """Return the edited network of one corner; the strength is not 0."""
        return model.network

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Edit the inputs of the whole car; the strength is not 0."""
        return inputs

    def edit_corner_inputs(
        self,
        inputs: InputModel,
        corner: CornerConfig,  # noqa: ARG002
    ) -> InputModel:
        """Edit what *corner* puts into the inputs; the strength is not 0."""
        return inputs

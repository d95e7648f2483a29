"""Effect 38: the wind cools the disc, where the baseline has none."""

from __future__ import annotations

from typing import ClassVar

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, value
from bstm_daemon.model.thermal.table import Table

FASTEST_MS = 120.0
POINTS = 481


class SpeedDependentConvection(Effect):
    """A conductance ``v^n`` beside a cooling coefficient without speed.

    For a baseline whose S is one number: discs of road cars lose 1 to 1.5
    W/K more for each m/s.
    """

    number = 38
    name = "speed_dependent_convection"
    description = "Driving wind cools the disc, parked air does not."
    signature = "Disc, driving, with speed and its excess over the air."
    twins = ("convection_exponent", "disc_radiation_driving")
    own_parameters: ClassVar = (
        Parameter("conductance_w_k", "W/K", 0.1, 300.0, 12.0, "at 10 m/s"),
        Parameter("exponent", "1", 0.3, 1.2, 0.8, "of the speed"),
    )

    def edit(self, model: CornerModel) -> CornerModel:
        """Add the link disc to air."""
        power = self["exponent"]
        wind = Table.from_function(
            lambda v: (v / 10.0) ** power, 0.0, FASTEST_MS, POINTS
        )
        link = Link(
            "speed_dependent_convection",
            "disc",
            model.surroundings,
            self.strength * self["conductance_w_k"],
            (value("speed_ms", wind),),
        )
        return model.with_network(model.network.with_link(link))

"""Effect 3: friction depends on the pressure."""

from __future__ import annotations

from typing import ClassVar

from bstm_daemon.effects.effect import Effect
from bstm_daemon.effects.model import CornerModel, Parameter
from bstm_daemon.thermal.network import value
from bstm_daemon.thermal.table import Table

REFERENCE_PA = 1.0e6
LOWEST_PA = 1.0e5
HIGHEST_PA = 2.0e7


class FrictionPressure(Effect):
    """mu ~ p^(a - 1), Rhee's power law, 1 at 1 MPa.

    Rhee (SAE 740415) gives F = K P^a with a from 0.80 to 1.25 by compound.
    """

    number = 3
    name = "friction_pressure"
    kind = "heat"
    description = "Linings grip less the harder they are pressed."
    signature = (
        "All heat input of a corner in proportion, while braking only, with "
        "pressure; needs Feed-Forward."
    )
    twins = ("friction_speed", "pushout_pressure")
    either_sign = True
    own_parameters: ClassVar = (
        Parameter("exponent", "1", 0.0, 0.3, 0.05, "1 - a, with pressure"),
    )

    def edit(self, model: CornerModel) -> CornerModel:
        """Multiply mu by a power of the pressure."""
        power = -self.strength * self["exponent"]
        law = Table.from_function(
            lambda p: (max(p, LOWEST_PA) / REFERENCE_PA) ** power,
            0.0,
            HIGHEST_PA,
            401,
        )
        return model.with_friction(value("pressure_pa", law))

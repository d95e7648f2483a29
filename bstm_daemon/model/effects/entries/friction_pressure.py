"""Effect 3: friction depends on the pressure."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import power_or_line
from bstm_daemon.model.heat.friction_law import FrictionLaw

REFERENCE_PA = 1.0e6
LOWEST_PA = 2.5e5


class FrictionPressure(Effect):
    """mu ~ p^(a - 1), Rhee's power law, 1 at 1 MPa.

    Rhee (SAE 740415) gives F = K P^a with a from 0.80 to 1.25 by compound.
    The second form is a line of the same slope at 1 MPa.
    """

    number = 3
    kind = "heat"
    description = "Friction falls with pressure."
    signature = "All heat, braking only, with pressure."
    twins = ("pushout_pressure",)
    either_sign = True
    own_parameters = (
        Parameter("exponent", "1", 0.0, 0.3, 0.05, "1 - a, with pressure"),
        Parameter("linear", "1", 0.0, 1.0, 0.0, "1: on a line, not a power"),
    )
    forms = ({"linear": 1.0},)

    def edit(self, model: CornerModel) -> CornerModel:
        """Multiply mu by a power of the pressure, or a line in it."""
        power = -self.scaled("exponent")
        return model.with_friction_law(
            FrictionLaw.of(
                pressure_pa=lambda p: power_or_line(
                    max(p, LOWEST_PA) / REFERENCE_PA, power, self["linear"]
                )
            )
        )

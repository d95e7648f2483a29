"""Effect 3: friction depends on the pressure."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.heat.friction_law import FrictionLaw

REFERENCE_PA = 1.0e6
LOWEST_PA = 2.5e5


class FrictionPressure(Effect):
    """mu ~ p^(a - 1), Rhee's power law, 1 at 1 MPa.

    Rhee (SAE 740415) gives F = K P^a with a from 0.80 to 1.25 by compound.
    """

    number = 3
    kind = "heat"
    description = "Friction falls with pressure."
    signature = "All heat, braking only, with pressure."
    twins = ("pushout_pressure",)
    either_sign = True
    own_parameters = (
        Parameter("exponent", "1", 0.0, 0.3, 0.05, "1 - a, with pressure"),
    )

    def edit(self, model: CornerModel) -> CornerModel:
        """Multiply mu by a power of the pressure."""
        power = -self.scaled("exponent")

        def law(p: float) -> float:
            ratio: float = (max(p, LOWEST_PA) / REFERENCE_PA) ** power
            return ratio

        return model.with_friction_law(FrictionLaw.of(pressure_pa=law))

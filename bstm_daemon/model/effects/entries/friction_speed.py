"""Effect 2: friction depends on the sliding speed."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import power_or_line
from bstm_daemon.model.heat.friction_law import FrictionLaw

REFERENCE_MS = 10.0
SLOWEST_MS = 1.0


class FrictionSpeed(Effect):
    """mu ~ v^b, Rhee's power law, 1 at 36 km/h.

    Rhee (SAE 740415) gives b from -0.25 to +0.25 by compound. The second
    form is a line of the same slope at 36 km/h.
    """

    number = 2
    kind = "heat"
    description = "Friction falls with sliding speed."
    signature = "All heat, braking only, with speed."
    twins = ("friction_pressure",)
    either_sign = True
    own_parameters = (
        Parameter("exponent", "1", 0.0, 0.3, 0.1, "-b, fall with speed"),
        Parameter("linear", "1", 0.0, 1.0, 0.0, "1: on a line, not a power"),
    )
    forms = ({"linear": 1.0},)

    def edit(self, model: CornerModel) -> CornerModel:
        """Multiply mu by a power of the speed, or a line in it."""
        power = -self.scaled("exponent")
        return model.with_friction_law(
            FrictionLaw.of(
                speed_ms=lambda v: power_or_line(
                    max(v, SLOWEST_MS) / REFERENCE_MS, power, self["linear"]
                )
            )
        )

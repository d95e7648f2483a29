"""Effect 34: the car is heavier than configured."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import InputModel, Parameter

LIGHTEST_SHARE = 0.3


class MassError(Effect):
    """The mass of ``[vehicle]`` times one plus a share.

    Two passengers are 6 to 7 % of a 2.2 t car, a trailer is 50 %.
    """

    number = 34
    kind = "heat"
    description = "The car is heavier than configured."
    signature = "All heat, braking, most in stops from speed."
    twins = ("powertrain_torque_error", "brake_share")
    either_sign = True
    most_strength = 10.0  # a trailer of half the car's mass
    own_parameters = (
        Parameter("share", "1", 0.0, 0.6, 0.06, "of the configured mass"),
    )

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Scale the mass of ``[vehicle]``."""
        factor = max(1.0 + self.scaled("share"), LIGHTEST_SHARE)
        mass = factor * inputs.config.vehicle.mass_kg
        return inputs.with_vehicle(mass_kg=mass)

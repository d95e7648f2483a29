"""Effect 6: the pressure at the wheel comes later than the signal."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import InputModel, Parameter


class HydraulicLag(Effect):
    """A first-order lag of each circuit, more than configured.

    0.1 to 0.3 s from master cylinder to wheel in boosted systems; the second
    circuit follows the first.
    """

    number = 6
    kind = "heat"
    description = "The wheel brakes follow the pedal with a delay."
    signature = (
        "All heat, at the edges of brakings, with the rate of the pressure."
    )
    twins = ("powertrain_torque_error",)
    own_parameters = (
        Parameter("primary_s", "s", 0.0, 2.0, 0.15, "of the first circuit"),
        Parameter("secondary_s", "s", 0.0, 2.0, 0.3, "of the second circuit"),
    )
    forms = ({"primary_s": 0.0},)

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Raise the lags of ``[heat]``."""
        heat = inputs.config.heat
        return inputs.with_heat(
            primary_lag_s=heat.primary_lag_s + self.scaled("primary_s"),
            secondary_lag_s=heat.secondary_lag_s + self.scaled("secondary_s"),
        )

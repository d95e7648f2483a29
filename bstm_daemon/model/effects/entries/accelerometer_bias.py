"""Effect 33: the accelerometer reads too much."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import Correction, InputModel, Parameter


class AccelerometerBias(Effect):
    """The reading is the true specific force plus a constant.

    0.1 m/s2 is 1 % of grade: 16 % of the braking force on a descent of 8 %.
    """

    number = 33
    kind = "heat"
    description = "The accelerometer has an offset, like a wrong grade."
    signature = (
        "All heat, braking, with speed, the same on the flat and downhill."
    )
    twins = ("mass_error", "powertrain_torque_error", "brake_share")
    either_sign = True
    own_parameters = (
        Parameter("bias_ms2", "m/s2", 0.0, 0.5, 0.08, "reads too high"),
    )

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Take the offset off every sample."""
        bias = self.scaled("bias_ms2")
        return inputs.with_correction(
            Correction("acceleration_longitudinal", offset=-bias)
        )

"""Effect 36: the powertrain's torque is not what the signal says."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import Correction, InputModel, Parameter


class PowertrainTorqueError(Effect):
    """The reading is a share of the torque at the wheels, plus an offset.

    Engine maps are good to 5 to 10 %; drag of gearbox and differential adds
    some newton metres.
    """

    number = 36
    kind = "heat"
    description = "Engine drag is less or more than the torque signal."
    signature = (
        "All heat, braking with the clutch closed, with the engine's drag "
        "and speed."
    )
    either_sign = True
    own_parameters = (
        Parameter("share", "1", 0.0, 0.18, 0.08, "of the torque, missing"),
        Parameter("offset_nm", "Nm", -200.0, 200.0, 12.0, "reads too high"),
    )
    forms = ({"offset_nm": 0.0}, {"share": 0.0})

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Undo gain and offset of every sample."""
        read = 1.0 - self.scaled("share")
        offset = self.scaled("offset_nm")
        return inputs.with_correction(
            Correction("powertrain_torque", 1.0 / read, -offset / read)
        )

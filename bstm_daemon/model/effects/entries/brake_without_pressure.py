"""Effect 39: the brakes act without primary pressure."""

from dataclasses import replace

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import InputModel


class BrakeWithoutPressure(Effect):
    """Braking that the motion shows counts although no pressure does.

    Assist functions, anti-slip control and the park brake press the pads
    from behind the primary circuit. What decelerates the car by more than
    ``[heat] brake_on_force_n`` beyond torque, resistance and slope is then
    brake heat, divided as Feed-Back's. ``fused`` finds such braking by
    itself. The strength is the share that counts.
    """

    number = 39
    kind = "heat"
    description = "Something other than the pedal applies the brakes."
    signature = (
        "All heat, braked by more than its resistance without pressure; by "
        "the motion only."
    )
    twins = ("powertrain_torque_error", "mass_error")

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Let the pass over samples count what the motion shows."""
        return replace(inputs, unpressed_share=self.strength)

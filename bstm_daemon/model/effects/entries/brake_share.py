"""Effect 35: the axles share the braking otherwise than configured."""

from bstm_daemon.config.sections import CornerConfig
from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import InputModel, Parameter

LEAST, MOST = 0.02, 0.98


class BrakeShare(Effect):
    """The front axle's share times one plus a part, the rear has the rest.

    Valves and friction of the axles vary by about a tenth. Feed-Back divides
    by ``front_share``; the torques of Feed-Forward are scaled alike, so that
    the car brakes as before.
    """

    number = 35
    kind = "heat"
    description = "The front brakes do more of the work than assumed."
    signature = (
        "All heat, front and rear in opposite ways, braking; the force of "
        "the whole car agrees."
    )
    twins = ("powertrain_torque_error",)
    either_sign = True
    own_parameters = (
        Parameter("share", "1", 0.0, 0.5, 0.1, "added to the front's share"),
    )

    def edit_inputs(self, inputs: InputModel) -> InputModel:
        """Move force from the rear axle to the front."""
        old = inputs.config.vehicle.front_share
        if not LEAST < old < MOST:
            return inputs
        wanted = old * (1.0 + self.scaled("share"))
        new = min(max(wanted, LEAST), MOST)
        front, rear = new / old, (1.0 - new) / (1.0 - old)

        def edited(one: CornerConfig) -> CornerConfig:
            factor = front if one.name.startswith("F") else rear
            mu = factor * one.friction_coefficient
            brake = factor * one.drum_brake_factor
            return one.model_copy(
                update={"friction_coefficient": mu, "drum_brake_factor": brake}
            )

        return inputs.with_vehicle(front_share=new).with_corners(edited)

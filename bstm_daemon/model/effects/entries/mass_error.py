"""Effect 34: the car is heavier than configured."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import InputModel, Parameter

if TYPE_CHECKING:
    from bstm_daemon.config.sections import CornerConfig

LIGHTEST_SHARE = 0.3


class MassError(Effect):
    """The mass of ``[vehicle]`` times one plus a share.

    Two passengers are 6 to 7 % of a 2.2 t car, a trailer is 50 %.
    """

    number = 34
    name = "mass_error"
    kind = "heat"
    description = "The car weighs more than the configuration says."
    signature = (
        "All heat input in proportion, while braking, most in stops from "
        "speed; needs Feed-Back."
    )
    twins = ("accelerometer_bias", "powertrain_torque_error", "brake_share")
    either_sign = True
    whole_car = True
    own_parameters: ClassVar = (
        Parameter("share", "1", 0.0, 0.6, 0.06, "of the configured mass"),
    )

    def edit_inputs(
        self,
        inputs: InputModel,
        corner: CornerConfig | None,  # noqa: ARG002
    ) -> InputModel:
        """Scale the mass of ``[vehicle]``."""
        factor = max(1.0 + self.strength * self["share"], LIGHTEST_SHARE)
        mass = factor * inputs.config.vehicle.mass_kg
        return inputs.with_vehicle(mass_kg=mass)

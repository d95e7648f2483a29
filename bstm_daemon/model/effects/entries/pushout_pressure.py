"""Effect 5: the first bit of pressure only moves the pistons."""

from bstm_daemon.config.sections import CornerConfig
from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import InputModel, Parameter


class PushoutPressure(Effect):
    """T = 2 (p - p0) A n eta mu r: p0 more than configured.

    Seals and guides take 0.05 to 0.15 MPa (Limpert); Eq 4.1 has none.
    """

    number = 5
    kind = "heat"
    description = "Part of the pressure only overcomes seals and guides."
    signature = (
        "All heat, braking at low pressure, a constant loss of pressure."
    )
    twins = ("friction_history",)
    own_parameters = (Parameter("pressure_pa", "Pa", 0.0, 5e5, 1e5, "lost"),)

    def edit_corner_inputs(
        self, inputs: InputModel, corner: CornerConfig
    ) -> InputModel:
        """Raise the push-out pressure of *corner*."""
        more = self.scaled("pressure_pa")

        def edited(one: CornerConfig) -> CornerConfig:
            if one.name != corner.name:
                return one
            pressure = one.pushout_pressure_pa + more
            return one.model_copy(update={"pushout_pressure_pa": pressure})

        return inputs.with_corners(edited)

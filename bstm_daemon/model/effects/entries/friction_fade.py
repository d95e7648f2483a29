"""Effect 1: friction falls when disc and linings get hot."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import LEAST_FRICTION
from bstm_daemon.model.heat.friction_law import FrictionLaw
from bstm_daemon.units import KELVIN_OFFSET


class FrictionFade(Effect):
    """mu falls linearly between two temperatures of the interface.

    0.38 cold to 0.25 to 0.30 above 500 to 600 degC is usual; the interface
    is the mean of the disc and the face of the pads.
    """

    number = 1
    kind = "heat"
    description = "Hot brakes fade: friction falls above about 350 degC."
    signature = (
        "All heat, braking only, beyond a temperature of the interface."
    )
    twins = ("disc_radiation_driving",)
    own_parameters = (
        Parameter("drop", "1", 0.0, 0.8, 0.28, "fall of mu when hot"),
        Parameter("onset_c", "degC", 100.0, 600.0, 350.0, "mu begins to fall"),
        Parameter("span_k", "K", 20.0, 500.0, 180.0, "until it has fallen"),
    )
    forms = ({"onset_c": 150.0, "span_k": 400.0},)

    def edit(self, model: CornerModel) -> CornerModel:
        """Multiply mu by a ramp over the temperature of the interface."""
        fall = self.scaled("drop")
        onset_k = self["onset_c"] + KELVIN_OFFSET

        def fade(t: float) -> float:
            done = min(max((t - onset_k) / self["span_k"], 0.0), 1.0)
            return max(1.0 - fall * done, LEAST_FRICTION)

        return model.with_friction_law(FrictionLaw.of(temperature_k=fade))

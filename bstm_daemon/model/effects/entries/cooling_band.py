"""Effect 42: in a band of speed the disc is cooled less."""

from math import exp

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import over_speed
from bstm_daemon.model.thermal.network import Network, with_factors


class CoolingBand(Effect):
    """A loss of the disc's convection around one speed.

    Where the wakes of wheel and body meet, air is drawn back into the wheel
    well: a fifth to a half of the convection, over 20 to 60 km/h. A bell, or
    ``flat`` where the flow flips.
    """

    number = 42
    description = "Around one speed the wheel well sheds less of its air."
    signature = "Disc, driving in a band of speed, with its excess over air."
    twins = ("convection_exponent",)
    most_strength = 2.5  # at the typical loss, which is below 1
    own_parameters = (
        Parameter("loss", "1", 0.0, 0.9, 0.35, "of the convection"),
        Parameter("middle_ms", "m/s", 5.0, 50.0, 20.0, "of the band"),
        Parameter("half_width_ms", "m/s", 1.0, 15.0, 6.0, "to its ends"),
        Parameter("flat", "1", 0.0, 1.0, 0.0, "1: alike within it"),
    )
    forms = ({"middle_ms": 13.0}, {"middle_ms": 28.0, "flat": 1.0})

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the conductance of the disc's convection."""
        loss, flat = self.scaled("loss"), self["flat"] >= 0.5

        def left(v: float) -> float:
            x = abs(v - self["middle_ms"]) / self["half_width_ms"]
            inside = float(x <= 1.0) if flat else exp(-x * x)
            return max(1.0 - loss * inside, 0.05)

        return model.network.edit_link(
            "disc_convection",
            lambda link: with_factors(link, over_speed(left)),
        )

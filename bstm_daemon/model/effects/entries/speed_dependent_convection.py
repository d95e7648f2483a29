"""Effect 38: the wind cools the disc, where the baseline has none."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import over_speed
from bstm_daemon.model.thermal.network import Link, Network


class SpeedDependentConvection(Effect):
    """A conductance ``v^n`` beside a cooling coefficient without speed.

    For a baseline whose S is one number: discs of road cars lose 1 to 1.5
    W/K more for each m/s. Nu ~ Re^0.8 in turbulent flow (Limpert); between
    vanes 27, 53 and 78 W/m2K were measured at 342, 684 and 1025 rpm, a line
    (McPhee and Johnson, Int. J. Thermal Sciences 47, 2008).
    """

    number = 38
    description = "Driving wind cools the disc, parked air does not."
    signature = "Disc, driving, with speed and its excess over the air."
    twins = ("convection_exponent", "disc_radiation_driving")
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.1, 300.0, 12.0, "at 10 m/s"),
        Parameter("exponent", "1", 0.3, 1.2, 0.8, "of the speed"),
    )
    forms = ({"exponent": 1.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to air."""
        power = self["exponent"]
        wind = over_speed(lambda v: (v / 10.0) ** power)
        link = Link(
            "speed_dependent_convection",
            "disc",
            model.surroundings,
            self.scaled("conductance_w_k"),
            (wind,),
        )
        return model.network.with_link(link)

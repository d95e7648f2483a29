"""Effect 26: the hot disc radiates into the caliper's bridge."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, Network, radiation
from bstm_daemon.units import STEFAN_BOLTZMANN_W_M2K4


class DiscCaliperRadiation(Effect):
    """Net exchange over the area of the caliper that sees the disc.

    The bridge spans 3 to 4 cm of the rim over 10 cm and the fingers see the
    faces beside the pads; painted iron takes up nine tenths.
    """

    number = 26
    description = "The disc's glow heats the caliper directly."
    signature = "Edge disc to fluid, with T^4 of the disc, parked strongest."
    most_strength = 10.0  # all of a large caliper's inside sees the disc
    own_parameters = (
        Parameter("view_m2", "m2", 1e-4, 0.05, 3.2e-3, "that sees the disc"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to caliper."""
        link = Link(
            "disc_caliper_radiation",
            "disc",
            model.caliper,
            self.scaled("view_m2")
            * STEFAN_BOLTZMANN_W_M2K4
            * model.spec.thermal.disc_emissivity,
            (radiation("disc", model.caliper),),
        )
        return model.network.with_link(link)

"""Effect 28: the caliper radiates."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, Network, radiation
from bstm_daemon.units import STEFAN_BOLTZMANN_W_M2K4

PAINT_EMISSIVITY = 0.9


class CaliperRadiation(Effect):
    """Net radiation of the caliper's painted outside to the surroundings."""

    number = 28
    description = "A hot caliper also loses heat by radiation."
    signature = "Fluid, above 120 degC and parked most, with T^4."
    twins = ("fluid_latent_heat", "fluid_exchange")
    own_parameters = (
        Parameter("area_m2", "m2", 1e-3, 0.2, 0.05, "of the caliper"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link caliper to ambient."""
        link = Link(
            "caliper_radiation",
            model.caliper,
            "ambient",
            self.scaled("area_m2")
            * PAINT_EMISSIVITY
            * STEFAN_BOLTZMANN_W_M2K4,
            (radiation(model.caliper, "ambient"),),
        )
        return model.network.with_link(link)

"""Effect 11: the disc radiates also while driving."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.thermal.network import Link, Network, radiation, value
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import STEFAN_BOLTZMANN_W_M2K4


class DiscRadiationDriving(Effect):
    """Net radiation above the standstill blend, where the thesis has none.

    At 600 degC it is 20 to 33 % of what a disc loses at 36 km/h. The
    S-function must then be that of convection alone.
    """

    number = 11
    description = "A hot disc also radiates while the car drives."
    signature = "Disc, driving, with T^4 and not with speed."
    twins = ("convection_exponent",)

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to ambient where the base model has none."""
        spec = model.spec
        driving = Table(0.0, spec.cooling.blend_end_ms, (0.0, 1.0))
        link = Link(
            "disc_radiation_driving",
            "disc",
            "ambient",
            self.strength
            * STEFAN_BOLTZMANN_W_M2K4
            * spec.thermal.disc_emissivity
            * spec.disc_radiating_m2,
            (radiation("disc", "ambient"), value("speed_ms", driving)),
        )
        return model.network.with_link(link)

"""Effect 15: rain and spray cool the disc."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, Network, value
from bstm_daemon.model.thermal.table import Table

HALF_WET_K = 353.15
BOILING_K = 393.15


class WetDisc(Effect):
    """Water flung onto the disc evaporates: a loss that grows with speed.

    Below boiling only part of the film evaporates before it is thrown off,
    so the coefficient rises between 80 and 120 degC.
    """

    number = 15
    description = "On a wet road spray evaporates on the disc and cools it."
    signature = "Disc, wet road only, with speed, strongest above 100 degC."
    own_parameters = (
        Parameter(
            "evaporation_w_k", "W/K", 0.1, 100.0, 5.0, "at 25 m/s, boiling"
        ),
        Parameter("cold_fraction", "1", 0.0, 1.0, 0.25, "below 80 degC"),
    )
    forms = ({"cold_fraction": 0.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to ambient."""
        boiling = Table(
            HALF_WET_K, BOILING_K - HALF_WET_K, (self["cold_fraction"], 1.0)
        )
        spray = Table(0.0, 25.0, (0.0, 1.0, 2.0))
        link = Link(
            "wet_disc",
            "disc",
            "ambient",
            self.scaled("evaporation_w_k"),
            (
                value("wetness"),
                value("speed_ms", spray),
                value("disc", boiling),
            ),
        )
        return model.network.with_link(link)

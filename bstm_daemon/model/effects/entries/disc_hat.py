"""Effect 17: the disc's hat is a mass of its own."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import rising_with_speed
from bstm_daemon.model.thermal.network import Link, Network, Node

STILL_W_M2K = 5.0
RISE_WS_M3K = 3.5


class DiscHat(Effect):
    """Ring to hat by conduction through its neck, hat to air.

    2.4 kg of iron behind a neck of 7 mm wall, 0.16 m across and 3 cm long:
    k A / l = 5 W/K. Convection 5 W/m2K at rest and 3.5 more for each m/s.
    """

    number = 17
    description = "The hat of the disc lags behind the ring and cools it."
    signature = (
        "Disc, after brakings begin and end, minutes; then like a steady loss."
    )
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.2, 30.0, 5.0, "ring to hat"),
        Parameter("mass_kg", "kg", 0.5, 8.0, 2.4, "of the hat"),
        Parameter("area_m2", "m2", 5e-3, 0.2, 0.06, "that air cools"),
    )
    forms = ({"mass_kg": 0.8},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add the node ``hat`` and its links."""
        ring = model.network.node("disc").capacity_table
        wind = rising_with_speed(STILL_W_M2K, RISE_WS_M3K)
        return model.network.with_node(
            Node("hat", self["mass_kg"], ring)
        ).with_link(
            Link("disc_hat", "disc", "hat", self.scaled("conductance_w_k")),
            Link(
                "hat_convection",
                "hat",
                model.surroundings,
                self["area_m2"],
                (wind,),
            ),
        )

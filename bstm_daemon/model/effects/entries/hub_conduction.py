"""Effect 14: the disc heats the hub it is bolted to."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, Network, Node


class HubConduction(Effect):
    """Disc to hub through the bolted face, hub to bearing and knuckle.

    Hub, wheel flange and what is tight to them weigh 5 to 6 kg; hat and face
    pass about a watt a kelvin.
    """

    number = 14
    description = "The hub absorbs heat of the disc and returns it later."
    signature = (
        "Disc, at any time, with a memory of 20 to 40 minutes; no speed."
    )
    twins = ("local_air", "disc_hat")
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.05, 10.0, 1.0, "disc to hub"),
        Parameter("capacity_j_k", "J/K", 500.0, 1e4, 2600.0, "of the hub"),
        Parameter("loss_w_k", "W/K", 0.0, 20.0, 1.8, "hub to the knuckle"),
    )
    forms = ({"loss_w_k": 0.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add the node ``hub`` and its links."""
        conductance = self.scaled("conductance_w_k")
        return model.network.with_node(
            Node("hub", self["capacity_j_k"])
        ).with_link(
            Link("hub_conduction", "disc", "hub", conductance),
            Link("hub_loss", "hub", "ambient", self["loss_w_k"]),
        )

"""Effect 40: a drum in the hat or a bearing heats the hub."""

from bstm_daemon.model.effects.effect import LAST, Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import over_speed
from bstm_daemon.model.thermal.network import Link, Network, Node, Source


class HubHeat(Effect):
    """A torque at the hub, whose heat comes to the disc through the hat.

    Shoes of a parking brake that drag take 5 to 30 Nm, a bearing with too
    much preload a few, more with speed. The force is no pad's.
    """

    number = 40
    description = "A dragging drum or bearing heats the hub, and it the disc."
    signature = "Disc, driving, with speed and a memory of 20 to 40 minutes."
    twins = ("residual_drag",)
    stage = LAST
    own_parameters = (
        Parameter("torque_nm", "Nm", 0.1, 60.0, 10.0, "at 20 m/s"),
        Parameter("exponent", "1", 0.0, 1.0, 0.0, "of the torque, speed"),
        Parameter("conductance_w_k", "W/K", 0.05, 20.0, 2.0, "hub to disc"),
    )
    forms = ({"exponent": 1.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Heat the node ``hub``, which is made where there is none."""
        net = model.network
        if not model.has_node("hub"):
            net = net.with_node(Node("hub", 2600.0)).with_link(
                Link("hub_heat", "hub", "disc", self["conductance_w_k"]),
                Link("hub_heat_loss", "hub", "ambient", 1.8),
            )
        power = 1.0 + self["exponent"]
        turned = over_speed(lambda v: 20.0 * (v / 20.0) ** power)
        watts = self.scaled("torque_nm") / model.wheel_radius_m
        return net.with_source(Source("hub_heat", "hub", watts, (turned,)))

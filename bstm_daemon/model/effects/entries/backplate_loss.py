"""Effect 22: edges and ears of the backplates lose heat at rest too."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, Network


class BackplateLoss(Effect):
    """A constant conductance from the plates to the air.

    Both plates show some 0.03 m2 of edges and ears; 5 to 8 W/m2K at rest.
    The thesis's hammerhead loss (Eq 4.19) is 0 at rest.
    """

    number = 22
    description = "The backplates' edges lose heat to the air, also parked."
    signature = (
        "Pad back, at any time, with its excess over the air; no speed."
    )
    twins = ("bracket_conduction", "caliper_bypass")
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.01, 3.0, 0.22, "both plates"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link backplate to air."""
        link = Link(
            "backplate_loss",
            "backplate",
            model.surroundings,
            self.scaled("conductance_w_k"),
        )
        return model.network.with_link(link)

"""Effect 24: backplates heat the caliper past piston and shim."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, Network


class CaliperBypass(Effect):
    """A constant conductance beside the shim, plate to caliper body.

    Films of air of half a millimetre over 50 cm2 around the piston and at
    the guides pass about half a watt a kelvin.
    """

    number = 24
    description = "Heat passes the piston on its way into the caliper."
    signature = (
        "Edge pad back to fluid (to the caliper where that is apart), with "
        "their temperature difference."
    )
    twins = ("shim_contact",)
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.02, 5.0, 0.5, "both plates"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link backplate to caliper."""
        link = Link(
            "caliper_bypass",
            "backplate",
            model.caliper,
            self.scaled("conductance_w_k"),
        )
        return model.network.with_link(link)

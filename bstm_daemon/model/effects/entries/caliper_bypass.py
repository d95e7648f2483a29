"""Effect 24: backplates heat the caliper past piston and shim."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import AIR_CONDUCTIVITY
from bstm_daemon.model.thermal.network import Link, Network, mean
from bstm_daemon.model.thermal.table import Table


class CaliperBypass(Effect):
    """A constant conductance beside the shim, plate to caliper body.

    Films of air of half a millimetre over 50 cm2 around the piston and at
    the guides pass about half a watt a kelvin, more when hot; pins and
    springs of steel pass the same at any temperature.
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
        Parameter("air_share", "1", 0.0, 1.0, 0.0, "of it, by air"),
    )
    forms = ({"air_share": 1.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link backplate to caliper."""
        air = self["air_share"]
        hotter = Table(
            AIR_CONDUCTIVITY.x0,
            AIR_CONDUCTIVITY.dx,
            tuple(1.0 + air * (k - 1.0) for k in AIR_CONDUCTIVITY.values),
        )
        link = Link(
            "caliper_bypass",
            "backplate",
            model.caliper,
            self.scaled("conductance_w_k"),
            (mean("backplate", model.caliper, hotter),) if air else (),
        )
        return model.network.with_link(link)

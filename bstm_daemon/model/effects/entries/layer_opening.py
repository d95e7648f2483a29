"""Effect 41: layers behind the lining come apart when hot."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import (
    Memory,
    Network,
    value,
    with_factors,
)
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET


class LayerOpening(Effect):
    """The shim conducts less above a temperature of the backplate.

    The rubber of a shim lets go of its steel at 100 to 200 degC. Where it
    sticks again on cooling it is a table; where it does not, ``latched``, a
    memory of the hottest it was.
    """

    number = 41
    description = "Layers of the shim open when hot and conduct less."
    signature = "Edge pad back to fluid, beyond a temperature, or after it."
    twins = ("shim_contact",)
    most_strength = 2.4  # at the typical loss, which is below 1
    own_parameters = (
        Parameter("loss", "1", 0.0, 0.9, 0.4, "of the conductance"),
        Parameter("onset_c", "degC", 60.0, 300.0, 110.0, "begins to open"),
        Parameter("span_k", "K", 5.0, 200.0, 50.0, "until it is open"),
        Parameter("latched", "1", 0.0, 1.0, 0.0, "1: stays open"),
    )
    forms = ({"latched": 1.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the shim's conductance by what is left of it."""
        left = max(1.0 - self.scaled("loss"), 0.02)
        onset_k, span_k = self["onset_c"] + KELVIN_OFFSET, self["span_k"]
        net = model.network
        factor = value("backplate", Table(onset_k, span_k, (1.0, left)))
        if self["latched"] >= 0.5:
            hottest = value("backplate", Table(onset_k, span_k, (0.0, 1.0)))
            net = net.with_memory(
                Memory("layers_open", "latch", 1.0, (hottest,))
            )
            factor = value("layers_open", Table(0.0, 1.0, (1.0, left)))
        return net.edit_link("shim", lambda link: with_factors(link, factor))

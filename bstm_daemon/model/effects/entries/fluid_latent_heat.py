"""Effect 30: fluid that boils at the piston holds the temperature."""

from dataclasses import replace

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Network, Node
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

COLDEST_K = 200.0
HOTTEST_K = 700.0
POINTS = 1001


class FluidLatentHeat(Effect):
    """The latent heat as a tent of heat capacity around a temperature.

    The film at the piston boils some 10 K before the bulk; it condenses
    where it is colder, so the same heat comes back on cooling.
    """

    number = 30
    description = "Boiling brake fluid absorbs heat without getting hotter."
    signature = "Fluid, a plateau above 130 degC, parked, in wet fluid."
    own_parameters = (
        Parameter("heat_j", "J", 100.0, 1e5, 8e3, "absorbed in total"),
        Parameter(
            "centre_c", "degC", 110.0, 260.0, 138.0, "bulk, in mid-boil"
        ),
        Parameter("half_width_k", "K", 2.0, 40.0, 12.0, "to its ends"),
    )
    forms = ({"half_width_k": 40.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Raise the fluid's capacity around the boiling point."""
        centre = self["centre_c"] + KELVIN_OFFSET
        width = self["half_width_k"]
        peak = self.scaled("heat_j") / width

        def edited(node: Node) -> Node:
            old, constant = node.capacity_table, node.capacity_j_k

            def share(t: float) -> float:
                usual = 1.0 if old is None else old(t)
                tent = max(1.0 - abs(t - centre) / width, 0.0)
                return usual + peak * tent / constant

            table = Table.from_function(share, COLDEST_K, HOTTEST_K, POINTS)
            return replace(node, capacity_table=table)

        return model.network.edit_node("fluid", edited)

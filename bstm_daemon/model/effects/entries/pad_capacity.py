"""Effect 19: the lining's heat capacity rises with its temperature."""

from dataclasses import replace

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.linings import edit_lining, with_effusivity
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import ROOM_K
from bstm_daemon.model.thermal.network import Network, Node
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

LEAST = 0.3


class PadCapacity(Effect):
    """cp rises linearly from 20 degC on, up to a temperature.

    1000 J/kgK cold and 0.9 more a kelvin are typical of linings. Their share
    of the friction heat rises with their effusivity.
    """

    number = 19
    description = "The heat capacity of linings rises with temperature."
    signature = (
        "Pad front and pad back, with their change of temperature, with the "
        "lining's temperature."
    )
    twins = ("pad_pyrolysis",)
    either_sign = True
    own_parameters = (
        Parameter("rise_per_k", "1/K", 0.0, 3e-3, 9e-4, "of cp, cold = 1"),
        Parameter("until_c", "degC", 100.0, 800.0, 400.0, "rises up to here"),
    )
    forms = ({"until_c": 200.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply cp of every slab by a ramp."""
        span = self["until_c"] + KELVIN_OFFSET - ROOM_K
        hot = max(1.0 + self.scaled("rise_per_k") * span, LEAST)
        ramp = Table(ROOM_K, span, (1.0, hot))

        def warmed(slab: Node) -> Node:
            old = slab.capacity_table
            table = ramp if old is None else old.times(ramp)
            return replace(slab, capacity_table=table)

        net = with_effusivity(model.network, ramp, self.name)
        return edit_lining(net, warmed)

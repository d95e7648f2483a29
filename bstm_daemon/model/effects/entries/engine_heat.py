"""Effect 45: engine, exhaust or damper heat caliper and wheel house."""

from bstm_daemon.model.effects.effect import LAST, Effect
from bstm_daemon.model.effects.model import AIR, CornerModel, Parameter
from bstm_daemon.model.thermal.network import (
    Memory,
    Network,
    Source,
    difference,
    value,
)
from bstm_daemon.model.thermal.table import Table

WARMS_UP = Table(-1.0, 1.0, (-1.0, 0.0, 1.0))
"""Rate over speed minus memory m: 1 above walking pace, up to m = 1, and -m
at rest, which cools as an exponential."""


class EngineHeat(Effect):
    """Heat from beside the brake, once the car has been driven warm.

    A radiator, an exhaust or a damper warms the air of the wheel house, and
    the caliper takes up a part by itself. The sizes are guesses without a
    published source: 200 W warm the air by about 15 K at rest. Without
    ``local_air`` the model has no such air, and that part is left out.
    """

    number = 45
    description = "Engine, exhaust or damper heat caliper and wheel house."
    signature = "All nodes, the fluid most, driving, constant."
    stage = LAST + 1
    # after the one that makes the air which it heats
    own_parameters = (
        Parameter("caliper_w", "W", 0.0, 1000.0, 60.0, "to the caliper"),
        Parameter(
            *("air_w", "W", 0.0, 3000.0, 200.0),
            "to the wheel house's air",
        ),
        Parameter("time_s", "s", 60.0, 3600.0, 600.0, "of warming up"),
    )
    forms = ({"caliper_w": 0.0}, {"air_w": 0.0})

    def edit_network(self, model: CornerModel) -> Network:
        """Add sources that begin as the car warms up."""
        warm = Memory(
            "engine_warm",
            "integral",
            1.0 / self["time_s"],
            (difference("speed_ms", "engine_warm", WARMS_UP),),
        )
        net = model.network.with_memory(warm)
        for name, node in (("caliper", model.caliper), ("air", AIR)):
            watts = self.scaled(f"{name}_w")
            if watts and model.has_node(node):
                follows = (value(warm.name),)
                net = net.with_source(
                    Source(f"engine_{name}", node, watts, follows)
                )
        return net

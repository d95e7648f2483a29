"""Effect 37: parked, the ambient sensor is warmed by the car."""

from dataclasses import replace

from bstm_daemon.model.effects.effect import LAST, Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import (
    Link,
    Memory,
    Network,
    Source,
    difference,
    value,
)
from bstm_daemon.model.thermal.table import Table

SOAK = Table(-1.0, 1.0, (0.0, 1.0, -1.0))
"""Rate over speed minus memory: 1 - m at rest, which it approaches as an
exponential; -1 above walking pace, where the wind clears it in as long."""


class AmbientHeatSoak(Effect):
    """The reading rises above the air while parked and falls when driving.

    Each loss to the air is larger by its conductance times what the sensor
    reads too much; that goes off as heat of its own.
    """

    number = 37
    kind = "measurement"
    description = "The bumper's sensor reads the warm front of a parked car."
    signature = "All nodes at once, parked, with a memory of minutes."
    twins = ("local_air",)
    either_sign = True
    stage = LAST
    own_parameters = (
        Parameter("excess_k", "K", 0.5, 30.0, 8.0, "reads too high, finally"),
        Parameter("time_s", "s", 60.0, 3600.0, 400.0, "to 63 % of it"),
    )
    forms = ({"time_s": 1500.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add a memory and, beside each loss, what is lost besides."""
        memory = Memory(
            "ambient_soak",
            "integral",
            1.0 / self["time_s"],
            (difference("speed_ms", "ambient_soak", SOAK),),
        )
        excess = self.scaled("excess_k")

        def beside(link: Link) -> Source:
            return Source(
                f"{link.name}_soak",
                link.a,
                -excess * link.conductance_w_k,
                (*link.factors, value("ambient_soak")),
            )

        net = model.network
        losses = [link for link in net.links if link.b == "ambient"]
        return replace(
            net.with_memory(memory),
            sources=(*net.sources, *map(beside, losses)),
        )

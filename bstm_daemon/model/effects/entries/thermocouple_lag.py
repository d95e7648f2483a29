"""Effect 32: thermocouples follow late."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import (
    EACH_SENSOR,
    NEGLIGIBLE,
    SENSOR,
    sensors_of,
)
from bstm_daemon.model.thermal.network import Link, Node

BEAD_J_K = 1e-3
"""A welded bead of 0.7 mm; what it takes from its node can not be seen."""


class ThermocoupleLag(Effect):
    """A bead on each measured node, or one, that follows with a time constant.

    Sheathed elements in contact take 5 to 20 s. A lag can not be taken off a
    noisy reading, so the model shows what a lagging sensor would.
    """

    number = 32
    kind = "measurement"
    description = "Thermocouples show what the part had seconds ago."
    signature = "One sensor, with its rate of change."
    twins = ("disc_hat",)
    own_parameters = (
        Parameter("time_s", "s", 0.1, 120.0, 15.0, "time constant"),
        SENSOR,
    )
    forms = EACH_SENSOR

    def edit(self, model: CornerModel) -> CornerModel:
        """Add a bead for every node that may be measured."""
        if self.strength < NEGLIGIBLE:
            return model
        conductance = BEAD_J_K / self.scaled("time_s")
        net, shown = model.network, dict(model.shown_by)
        for node in sensors_of(self["sensor"]):
            if not model.has_node(node):
                continue
            bead = f"{node}_sensor"
            net = net.with_node(Node(bead, BEAD_J_K)).with_link(
                Link(f"{node}-sensor", node, bead, conductance)
            )
            shown[node] = bead
        return model.showing(net, shown)

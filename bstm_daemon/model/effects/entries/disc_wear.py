"""Effect 16: a worn disc is lighter."""

from dataclasses import replace

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Network

MOST = 0.5


class DiscWear(Effect):
    """The ring has lost a part of its mass; its surface is as it was.

    Manufacturers allow 2 to 3 mm of a 28 mm disc; 8 % is 1.6 mm of the two
    cheeks. What it gives off does not depend on its mass, so the rate of
    Eq 4.12 rises as the capacity falls.
    """

    number = 16
    description = "A worn disc has less iron to heat."
    signature = (
        "Disc, with its change of temperature, at any temperature; does not "
        "change within a drive."
    )
    own_parameters = (
        Parameter("lost_share", "1", 0.0, 0.3, 0.08, "of the ring's mass"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Lower the disc's capacity and keep what it gives off."""
        left = 1.0 - min(self.scaled("lost_share"), MOST)
        return model.network.edit_node(
            "disc",
            lambda node: replace(node, capacity_j_k=left * node.capacity_j_k),
        )

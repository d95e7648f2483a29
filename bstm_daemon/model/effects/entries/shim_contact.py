"""Effect 25: the shim conducts better while it is pressed."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Network, value, with_factors
from bstm_daemon.model.thermal.table import Table


class ShimContact(Effect):
    """The conductance of the shim falls when the brake is released.

    Contacts of plate, shim and piston open when nothing presses them; the
    configured resistance holds for a pressed shim.
    """

    number = 25
    description = "Released, plate and piston touch only loosely."
    signature = "Edge pad back to fluid, differs with the brake held or not."
    most_strength = 2.8  # at the typical loss, which is below 1
    own_parameters = (
        Parameter("loss", "1", 0.0, 0.9, 0.35, "fall of the conductance"),
        Parameter(
            "full_pressure_pa", "Pa", 1e4, 5e6, 3e5, "fully pressed from here"
        ),
    )
    forms = ({"full_pressure_pa": 3e6},)

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the shim's conductance by a table over pressure."""
        loose = max(1.0 - self.scaled("loss"), 0.02)
        pressed = Table(0.0, self["full_pressure_pa"], (loose, 1.0))
        return model.network.edit_link(
            "shim",
            lambda link: with_factors(link, value("pressure_pa", pressed)),
        )

"""Effect 29: pumped fluid and the line carry heat out of the caliper."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, Memory, Network, difference
from bstm_daemon.model.thermal.table import Table

FOLLOWS_S = 0.5
HIGHEST_PA = 3.0e7
FASTEST_PA_S = 2.0e7


class FluidExchange(Effect):
    """Conduction along the line, and fluid moved by every stroke.

    A stroke to 3 MPa moves about half a millilitre, which carries 1.2 J a
    kelvin, up and down: 0.4 W/K for each MPa/s. The rate is that of a
    pressure that follows within half a second.
    """

    number = 29
    description = "Pumping the pedal exchanges hot fluid for cold."
    signature = "Fluid, with the rate of the pressure: pulses, anti-lock."
    own_parameters = (
        Parameter("line_w_k", "W/K", 0.0, 1.0, 0.05, "along the line"),
        Parameter(
            "pumping_w_k", "W/K", 0.0, 5.0, 0.4, "for each MPa/s of pressure"
        ),
    )
    forms = ({"pumping_w_k": 0.0}, {"line_w_k": 0.0})

    def edit_network(self, model: CornerModel) -> Network:
        """Add a memory of the pressure and the links fluid to ambient."""
        limit = FASTEST_PA_S * FOLLOWS_S
        rate = 1.0 / FOLLOWS_S
        following = Memory(
            "following_pressure_pa",
            "integral",
            rate,
            (difference("pressure_pa", "following_pressure_pa"),),
            upper=HIGHEST_PA,
        )
        # MPa/s of a lag: the difference over its time constant
        fastest = FASTEST_PA_S / 1e6
        pumped = Table(-limit, limit, (fastest, 0.0, fastest))
        return model.network.with_memory(following).with_link(
            Link("fluid_line", "fluid", "ambient", self.scaled("line_w_k")),
            Link(
                "fluid_pumping",
                "fluid",
                "ambient",
                self.scaled("pumping_w_k"),
                (difference("pressure_pa", "following_pressure_pa", pumped),),
            ),
        )

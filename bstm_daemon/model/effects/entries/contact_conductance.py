"""Effect 8: heat crosses the contact between disc and pads."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, Network, value
from bstm_daemon.model.thermal.table import Table


class ContactConductance(Effect):
    """q = h_c(p) (T_disc - T_pad) while the pads press on the disc.

    The thesis splits the heat by a constant; real surfaces also exchange
    heat, so in a long drag the share drifts with their temperatures. The
    contact conductance of pressed rough surfaces grows about as p^0.95
    (Yovanovich); 1e3 to 1e4 W/m2K while braking. A layer of wear debris
    between them conducts alike under any pressure.
    """

    number = 8
    description = "Disc and pads exchange heat through their contact."
    signature = (
        "Edge disc to pad front, braking only, with their temperature "
        "difference."
    )
    own_parameters = (
        Parameter("conductance_w_m2k", "W/m2K", 10.0, 2e4, 160.0, "at 1 MPa"),
        Parameter("exponent", "1", 0.0, 1.0, 0.95, "of the pressure"),
    )
    forms = ({"exponent": 0.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to pad_front."""
        rise = Table.from_function(
            lambda p: (max(p, 0.0) / 1e6) ** self["exponent"], 0.0, 2e7, 401
        )
        link = Link(
            "contact_conductance",
            "disc",
            "pad_front",
            self.scaled("conductance_w_m2k") * model.spec.pads_area_m2,
            (value("brake_on"), value("pressure_pa", rise)),
        )
        return model.network.with_link(link)

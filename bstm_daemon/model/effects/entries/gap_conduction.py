"""Effect 9: released pads exchange heat with the disc through the gap."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import AIR_CONDUCTIVITY, RELEASED
from bstm_daemon.model.thermal.network import Link, Network, mean, value
from bstm_daemon.model.thermal.table import Table

TURNING_MS = 0.25


class GapConduction(Effect):
    """q = h_gap k(T)/k_ref (T_disc - T_pad) while the brake is off.

    Air of 0.04 W/mK over the 0.1 to 0.5 mm that seals roll back gives 80 to
    400 W/m2K, against 20 of radiation. Hot air conducts better: T is the mean
    of both faces. Run-out of the turning disc knocks the pads back further.
    """

    number = 9
    description = "The narrow gap of a released brake still conducts heat."
    signature = (
        "Edge disc to pad front, brake off, proportional to the difference "
        "of their temperatures and not to that of T^4; strongest parked."
    )
    twins = ("contact_conductance",)
    own_parameters = (
        Parameter(
            "conductance_w_m2k", "W/m2K", 5.0, 1e3, 130.0, "of air at 500 K"
        ),
        Parameter("turning_share", "1", 0.0, 1.0, 1.0, "of it, driving"),
    )
    forms = ({"turning_share": 0.4},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to pad_front."""
        turning = self["turning_share"]
        driven = Table(0.0, TURNING_MS, (1.0, turning))
        link = Link(
            "gap_conduction",
            "disc",
            "pad_front",
            self.scaled("conductance_w_m2k") * model.spec.pads_area_m2,
            (
                value("brake_on", RELEASED),
                *([value("speed_ms", driven)] if turning < 1.0 else ()),
                mean("disc", "pad_front", AIR_CONDUCTIVITY),
            ),
        )
        return model.network.with_link(link)

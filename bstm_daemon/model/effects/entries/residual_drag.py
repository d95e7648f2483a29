"""Effect 7: released pads still rub."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import RELEASED, ROOM_K
from bstm_daemon.model.thermal.network import Network, Source, value
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET


class ResidualDrag(Effect):
    """A drag torque while released, more when the pads are hot.

    0.5 to 5 Nm a corner are usual, tens where a piston binds. Hot pads have
    expanded and a hot seal draws back less. The heat is divided as friction
    heat is.
    """

    number = 7
    kind = "heat"
    description = "Pads that do not release keep heating the disc."
    signature = (
        "Disc, a little pad front, driving with the brake off, with speed; "
        "more after the brake was used."
    )
    twins = ("convection_exponent", "brake_without_pressure")
    own_parameters = (
        Parameter("torque_nm", "Nm", 0.1, 50.0, 5.0, "pads hot"),
        Parameter("cold_share", "1", 0.0, 1.0, 0.35, "of it, pads cold"),
        Parameter("hot_c", "degC", 40.0, 400.0, 130.0, "pad back, hot"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add sources in disc and pads while the brake is off."""
        span = self["hot_c"] + KELVIN_OFFSET - ROOM_K
        drag = (
            value("speed_ms"),
            value("brake_on", RELEASED),
            value("pad_back", Table(ROOM_K, span, (self["cold_share"], 1.0))),
        )
        watts = self.scaled("torque_nm") / model.wheel_radius_m
        pads = 1.0 - model.spec.disc_share
        return model.network.with_source(
            Source("residual_drag_disc", "disc", watts * (1.0 - pads), drag),
            Source("residual_drag_pads", "pad_front", watts * pads, drag),
        )

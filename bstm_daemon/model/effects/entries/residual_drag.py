"""Effect 7: released pads still rub."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import RELEASED, ROOM_K
from bstm_daemon.model.thermal.network import Link, Network, Source, value
from bstm_daemon.model.thermal.partition import pad_share
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET


class ResidualDrag(Effect):
    """A drag torque while released, more when the pads are hot.

    0.5 to 5 Nm a corner are usual, tens where a piston binds. Hot pads have
    expanded and a hot seal draws back less. The heat is divided as friction
    heat is. A piston or slider that binds, the other form, does so cold too,
    and heat crosses to the pads: 20 W/m2K by the pressure of 5 Nm, 400 by
    0.1 mm of air.
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
        Parameter(
            "contact_w_m2k", "W/m2K", 0.0, 5e3, 0.0, "across the contact, hot"
        ),
    )
    forms = ({"cold_share": 1.0, "contact_w_m2k": 100.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add sources in disc and pads, and a link, while the brake is off."""
        spec, span = model.spec, self["hot_c"] + KELVIN_OFFSET - ROOM_K
        rubbing = (
            value("brake_on", RELEASED),
            value("pad_back", Table(ROOM_K, span, (self["cold_share"], 1.0))),
        )
        drag = (value("speed_ms"), *rubbing)
        watts = self.scaled("torque_nm") / model.wheel_radius_m
        pads = pad_share(
            spec.disc_share, spec.thermal.heat_partition_correction_factor
        )
        net = model.network.with_source(
            Source("residual_drag_disc", "disc", watts * (1.0 - pads), drag),
            Source("residual_drag_pads", "pad_front", watts * pads, drag),
        )
        conductance = self.scaled("contact_w_m2k") * spec.pads_area_m2
        if conductance == 0.0:
            return net
        return net.with_link(
            Link("rubbing", "disc", "pad_front", conductance, rubbing)
        )

"""Effect 40: a drum in the hat or a bearing heats the disc by its hub."""

from bstm_daemon.model.effects.effect import LAST, Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import FASTEST_MS, over_speed
from bstm_daemon.model.thermal.network import (
    Memory,
    Network,
    Source,
    difference,
    value,
)


class HubHeat(Effect):
    """Heat of a torque at the hub that comes to the disc through the hat.

    Shoes of a parking brake that drag take 5 to 30 Nm, a bearing with too
    much preload a few, more with speed. Half of the heat or less goes to the
    disc, as late as hub and hat follow, or the hat alone where its inside is
    the drum; the rest to the knuckle, and with it to the bracket that is
    bolted there.
    """

    number = 40
    description = "A dragging drum or bearing heats the disc by its hub."
    signature = "Disc, driving and parked after it, with a memory of minutes."
    twins = ("residual_drag",)
    stage = LAST
    own_parameters = (
        Parameter("torque_nm", "Nm", 0.1, 60.0, 5.0, "to the disc, 20 m/s"),
        Parameter("exponent", "1", 0.0, 1.0, 0.0, "of the torque, speed"),
        Parameter("time_s", "s", 60.0, 7200.0, 1200.0, "of hub and hat"),
        Parameter(
            *("bracket_share", "1", 0.0, 2.0, 0.0),
            "to bracket or caliper, of that to the disc",
        ),
    )
    forms = (
        {"exponent": 1.0},
        {"bracket_share": 1.0},
        # 1 kJ/K of hat, 2.5 W/K through its throat
        {"time_s": 400.0},
        {"time_s": 400.0, "bracket_share": 0.5},
        # the knuckle has the outer race and the anchor of the shoes
        {"time_s": 400.0, "bracket_share": 1.0},
        {"time_s": 400.0, "bracket_share": 1.7},
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add sources at disc and bracket that follow the speed late."""
        late = Memory(
            "hub_turning",
            "integral",
            1.0 / self["time_s"],
            (difference("speed_ms", "hub_turning"),),
            upper=FASTEST_MS,
        )
        power = 1.0 + self["exponent"]
        turned = over_speed(lambda v: 20.0 * (v / 20.0) ** power).table
        watts = self.scaled("torque_nm") / model.wheel_radius_m
        follows = (value(late.name, turned),)
        net = model.network.with_memory(late).with_source(
            Source("hub_heat", "disc", watts, follows)
        )
        if not self["bracket_share"]:
            return net
        other = "bracket" if model.has_node("bracket") else model.caliper
        watts *= self["bracket_share"]
        return net.with_source(Source("knuckle_heat", other, watts, follows))

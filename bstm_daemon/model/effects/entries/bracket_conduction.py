"""Effect 23: the backplates' ears heat the bracket they slide in."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import rising_with_speed
from bstm_daemon.model.thermal.network import Link, Network, Node, value
from bstm_daemon.model.thermal.table import Table


class BracketConduction(Effect):
    """Hammerheads conduct to the bracket, which warms up and cools.

    Four ears of about 1 cm2 on steel clips, 1 kW/m2K each; the bracket of
    some 2.4 kg is bolted to the knuckle and stands in the wind. While the
    brake is held the friction force presses two of the ears on firmly.
    """

    number = 23
    description = "Part of the pads' heat goes into the caliper's bracket."
    signature = (
        "Pad back, at any time, most with the brake held, with its excess "
        "over the bracket; no speed."
    )
    twins = ("caliper_bypass",)
    most_strength = 10.0  # 10 kW/m2K: ears pressed on, with grease
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.02, 5.0, 0.4, "all four ears"),
        Parameter("pressed_rise", "1", 0.0, 3.0, 0.5, "of it, brake held"),
        Parameter("capacity_j_k", "J/K", 100.0, 5e3, 1150.0, "of the bracket"),
        Parameter("loss_w_k", "W/K", 0.0, 20.0, 1.0, "bracket, at rest"),
        Parameter("loss_rise_s_m", "s/m", 0.0, 2.0, 0.08, "of it, per m/s"),
    )
    forms = (
        {"pressed_rise": 0.0, "loss_w_k": 0.3},
        # heat comes 6 cm into cast iron in 5 min: half of the bracket
        {"pressed_rise": 0.0, "capacity_j_k": 600.0},
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the node ``bracket`` and its links."""
        wind = rising_with_speed(1.0, self["loss_rise_s_m"])
        held = Table(0.0, 1.0, (1.0, 1.0 + self["pressed_rise"]))
        return model.network.with_node(
            Node("bracket", self["capacity_j_k"])
        ).with_link(
            Link(
                "bracket_conduction",
                "backplate",
                "bracket",
                self.scaled("conductance_w_k"),
                (value("brake_on", held),),
            ),
            Link(
                "bracket_loss", "bracket", "ambient", self["loss_w_k"], (wind,)
            ),
        )

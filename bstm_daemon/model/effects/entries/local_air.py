"""Effect 13: the air inside the wheel house is warmer than outside."""

from dataclasses import replace
from math import hypot

from bstm_daemon.model.effects.effect import LAST, Effect
from bstm_daemon.model.effects.model import AIR, CornerModel, Parameter
from bstm_daemon.model.effects.tables import NEGLIGIBLE, over_speed
from bstm_daemon.model.thermal.network import Link, Network, Node

AIR_J_M3K = 1210.0
"""rho cp of air at 20 degC."""

OUTSIDE = frozenset(
    {"wet_disc", "hub_loss", "bracket_loss", "fluid_line", "fluid_pumping"}
)
"""Losses that do not go into the wheel house's air."""


class LocalAir(Effect):
    """Convection heats the air of the wheel house, which is exchanged.

    The heat that air carries off is rho cp times a flow: a share of the
    driving wind through the rim's openings, and what rises through them at
    rest. The air's own capacity, some 100 J/K, follows within seconds and is
    left out.
    """

    number = 13
    description = "Warm air inside the rim slows the cooling of all parts."
    signature = (
        "Disc, pad back and fluid at once, slow and parked; air warmer with "
        "the disc."
    )
    twins = ("disc_caliper_radiation",)
    stage = LAST
    own_parameters = (
        Parameter("opening_m2", "m2", 1e-3, 0.2, 0.02, "admits the wind"),
        Parameter("parked_w_k", "W/K", 1.0, 100.0, 13.0, "removed at rest"),
    )
    forms = ({"parked_w_k": 40.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Let every convective loss end in a node of air."""
        wind = self["opening_m2"] * AIR_J_M3K
        exchange = over_speed(lambda v: hypot(self["parked_w_k"], wind * v))

        def moved(link: Link) -> Link:
            radiates = any(f.kind == "radiation" for f in link.factors)
            if link.b != "ambient" or radiates or link.name in OUTSIDE:
                return link
            return replace(link, b=AIR)

        net = model.network
        net = replace(net, links=tuple(map(moved, net.links)))
        return net.with_node(Node(AIR, 0.0)).with_link(
            Link(
                "air_exchange",
                AIR,
                "ambient",
                1.0 / max(self.strength, NEGLIGIBLE),
                (exchange,),
            )
        )

"""Effects of the air and the water that cool a brake."""

from dataclasses import replace
from math import exp, hypot

from bstm_daemon.model.effects.effect import LAST, Effect
from bstm_daemon.model.effects.model import AIR, CornerModel, Parameter
from bstm_daemon.model.effects.tables import NEGLIGIBLE, over_speed
from bstm_daemon.model.thermal.network import (
    Link,
    Network,
    Node,
    value,
    with_factors,
)
from bstm_daemon.model.thermal.table import Table

REFERENCE_MS = 10.0


class ConvectionExponent(Effect):
    """S(v) times ``(v / v0)^n``, 1 at 36 km/h, where S is usually measured.

    Nu ~ Re^0.55 in laminar, Re^0.8 in turbulent flow (Limpert). Below
    ``blend_end_ms`` the factor of that speed goes to 1 at rest, where no
    flow is forced.
    """

    number = 12
    description = "Cooling of the disc rises more steeply with speed."
    signature = (
        "Disc, driving: too hot above and too cold below one speed, with "
        "the excess over the air."
    )
    twins = ("disc_radiation_driving", "residual_drag")
    either_sign = True
    own_parameters = (
        Parameter("exponent", "1", 0.0, 0.5, 0.18, "in addition to S"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the conductance of the disc's convection."""
        power = self.scaled("exponent")
        slow = model.spec.cooling.blend_end_ms

        def steeper(v: float) -> float:
            share: float = (max(v, slow) / REFERENCE_MS) ** power
            return share if v >= slow else 1.0 + (share - 1.0) * v / slow

        return model.network.edit_link(
            "disc_convection",
            lambda link: with_factors(link, over_speed(steeper)),
        )


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


HALF_WET_K = 353.15
BOILING_K = 393.15


class WetDisc(Effect):
    """Water flung onto the disc evaporates: a loss that grows with speed.

    Below boiling only part of the film evaporates before it is thrown off,
    so the coefficient rises between 80 and 120 degC.
    """

    number = 15
    description = "On a wet road spray evaporates on the disc and cools it."
    signature = "Disc, wet road only, with speed, strongest above 100 degC."
    own_parameters = (
        Parameter(
            "evaporation_w_k", "W/K", 0.1, 100.0, 5.0, "at 25 m/s, boiling"
        ),
        Parameter("cold_fraction", "1", 0.0, 1.0, 0.25, "below 80 degC"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to ambient."""
        boiling = Table(
            HALF_WET_K, BOILING_K - HALF_WET_K, (self["cold_fraction"], 1.0)
        )
        spray = Table(0.0, 25.0, (0.0, 1.0, 2.0))
        link = Link(
            "wet_disc",
            "disc",
            "ambient",
            self.scaled("evaporation_w_k"),
            (
                value("wetness"),
                value("speed_ms", spray),
                value("disc", boiling),
            ),
        )
        return model.network.with_link(link)


class SpeedDependentConvection(Effect):
    """A conductance ``v^n`` beside a cooling coefficient without speed.

    For a baseline whose S is one number: discs of road cars lose 1 to 1.5
    W/K more for each m/s.
    """

    number = 38
    description = "Driving wind cools the disc, parked air does not."
    signature = "Disc, driving, with speed and its excess over the air."
    twins = ("convection_exponent", "disc_radiation_driving")
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.1, 300.0, 12.0, "at 10 m/s"),
        Parameter("exponent", "1", 0.3, 1.2, 0.8, "of the speed"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to air."""
        power = self["exponent"]
        wind = over_speed(lambda v: (v / 10.0) ** power)
        link = Link(
            "speed_dependent_convection",
            "disc",
            model.surroundings,
            self.scaled("conductance_w_k"),
            (wind,),
        )
        return model.network.with_link(link)


class CoolingBand(Effect):
    """A loss of the disc's convection around one speed.

    Where the wakes of wheel and body meet, air is drawn back into the wheel
    well: a fifth to a half of the convection, over 20 to 60 km/h. A bell, or
    ``flat`` where the flow flips.
    """

    number = 42
    description = "Around one speed the wheel well sheds less of its air."
    signature = "Disc, driving in a band of speed, with its excess over air."
    twins = ("convection_exponent",)
    most_strength = 2.5  # at the typical loss, which is below 1
    own_parameters = (
        Parameter("loss", "1", 0.0, 0.9, 0.35, "of the convection"),
        Parameter("middle_ms", "m/s", 5.0, 50.0, 20.0, "of the band"),
        Parameter("half_width_ms", "m/s", 1.0, 15.0, 6.0, "to its ends"),
        Parameter("flat", "1", 0.0, 1.0, 0.0, "1: alike within it"),
    )
    forms = ({"middle_ms": 13.0}, {"middle_ms": 28.0, "flat": 1.0})

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the conductance of the disc's convection."""
        loss, flat = self.scaled("loss"), self["flat"] >= 0.5

        def left(v: float) -> float:
            x = abs(v - self["middle_ms"]) / self["half_width_ms"]
            inside = float(x <= 1.0) if flat else exp(-x * x)
            return max(1.0 - loss * inside, 0.05)

        return model.network.edit_link(
            "disc_convection",
            lambda link: with_factors(link, over_speed(left)),
        )

"""Effects of the caliper and the fluid in it."""

from __future__ import annotations

from dataclasses import replace

from bstm_daemon.model.effects.effect import FIRST, Effect
from bstm_daemon.model.effects.model import CALIPER, CornerModel, Parameter
from bstm_daemon.model.effects.tables import NEGLIGIBLE
from bstm_daemon.model.thermal.network import (
    Link,
    Memory,
    Network,
    Node,
    difference,
    radiation,
)
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET, STEFAN_BOLTZMANN_W_M2K4


class CaliperBypass(Effect):
    """A constant conductance beside the shim, plate to caliper body.

    Films of air of half a millimetre over 50 cm2 around the piston and at
    the guides pass about half a watt a kelvin.
    """

    number = 24
    description = "Heat passes the piston on its way into the caliper."
    signature = (
        "Edge pad back to fluid (to the caliper where that is apart), with "
        "their temperature difference."
    )
    twins = ("shim_contact", "backplate_loss")
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.02, 5.0, 0.5, "both plates"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link backplate to caliper."""
        link = Link(
            "caliper_bypass",
            "backplate",
            model.caliper,
            self.scaled("conductance_w_k"),
        )
        return model.network.with_link(link)


class DiscCaliperRadiation(Effect):
    """Net exchange over the area of the caliper that sees the disc.

    The bridge spans 3 to 4 cm of the rim over 10 cm and the fingers see the
    faces beside the pads; painted iron takes up nine tenths.
    """

    number = 26
    description = "The disc's glow heats the caliper directly."
    signature = "Edge disc to fluid, with T^4 of the disc, parked strongest."
    twins = ("local_air",)
    own_parameters = (
        Parameter("view_m2", "m2", 1e-4, 0.05, 3.2e-3, "that sees the disc"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to caliper."""
        link = Link(
            "disc_caliper_radiation",
            "disc",
            model.caliper,
            self.scaled("view_m2")
            * STEFAN_BOLTZMANN_W_M2K4
            * model.spec.thermal.disc_emissivity,
            (radiation("disc", model.caliper),),
        )
        return model.network.with_link(link)


class CaliperFluidSplit(Effect):
    """The lump of section 4.7 becomes two nodes.

    One pad heats the fluid through the piston, the other the caliper's
    finger; the fluid heats the caliper, which carries all losses. The
    stronger the effect the weaker the couplings.
    """

    number = 27
    description = "The fluid behind the piston is not as warm as the caliper."
    signature = (
        "Fluid, while brakings begin and end and at the start of a soak, "
        "minutes; with the difference of fluid and caliper."
    )
    twins = ("fluid_exchange",)
    stage = FIRST
    own_parameters = (
        Parameter(
            "fluid_capacity_j_k",
            "J/K",
            20.0,
            500.0,
            160.0,
            "fluid and half of the piston",
        ),
        Parameter("piston_w_k", "W/K", 0.5, 500.0, 4.0, "shim to fluid"),
        Parameter("finger_w_k", "W/K", 0.5, 500.0, 8.0, "finger to the body"),
        Parameter("coupling_w_k", "W/K", 2.0, 500.0, 40.0, "fluid to caliper"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Split ``fluid`` and let every loss start at ``caliper``."""
        if self.strength < NEGLIGIBLE:
            return model.network
        net = model.network
        whole = net.node("fluid").capacity_j_k
        fluid = min(self["fluid_capacity_j_k"], 0.5 * whole)
        shim = net.link("shim")
        one_pad = 0.5 * shim.conductance_w_k

        def behind(own_w_k: float) -> float:
            return 1.0 / (1.0 / one_pad + self.strength / own_w_k)

        def moved(link: Link) -> Link:
            if link is shim:
                return replace(
                    link, conductance_w_k=behind(self["piston_w_k"])
                )
            return replace(
                link,
                a=CALIPER if link.a == "fluid" else link.a,
                b=CALIPER if link.b == "fluid" else link.b,
            )

        net = replace(net, links=tuple(map(moved, net.links)))
        return (
            net.edit_node("fluid", lambda n: replace(n, capacity_j_k=fluid))
            .with_node(Node(CALIPER, whole - fluid))
            .with_link(
                replace(
                    shim,
                    name="shim_finger",
                    b=CALIPER,
                    conductance_w_k=behind(self["finger_w_k"]),
                ),
                Link(
                    "fluid-caliper",
                    "fluid",
                    CALIPER,
                    self["coupling_w_k"] / self.strength,
                ),
            )
        )


PAINT_EMISSIVITY = 0.9


class CaliperRadiation(Effect):
    """Net radiation of the caliper's painted outside to the surroundings."""

    number = 28
    description = "A hot caliper also loses heat by radiation."
    signature = "Fluid, above 120 degC and parked most, with T^4."
    twins = ("fluid_latent_heat", "fluid_exchange")
    own_parameters = (
        Parameter("area_m2", "m2", 1e-3, 0.2, 0.05, "of the caliper"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link caliper to ambient."""
        link = Link(
            "caliper_radiation",
            model.caliper,
            "ambient",
            self.scaled("area_m2")
            * PAINT_EMISSIVITY
            * STEFAN_BOLTZMANN_W_M2K4,
            (radiation(model.caliper, "ambient"),),
        )
        return model.network.with_link(link)


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
    twins = ("caliper_fluid_split", "caliper_radiation")
    own_parameters = (
        Parameter("line_w_k", "W/K", 0.0, 1.0, 0.05, "along the line"),
        Parameter(
            "pumping_w_k", "W/K", 0.0, 5.0, 0.4, "for each MPa/s of pressure"
        ),
    )

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


COLDEST_K = 200.0
HOTTEST_K = 700.0
POINTS = 1001


class FluidLatentHeat(Effect):
    """The latent heat as a tent of heat capacity around a temperature.

    The film at the piston boils some 10 K before the bulk; it condenses
    where it is colder, so the same heat comes back on cooling.
    """

    number = 30
    description = "Boiling brake fluid absorbs heat without getting hotter."
    signature = "Fluid, a plateau above 130 degC, parked, in wet fluid."
    twins = ("caliper_radiation",)
    own_parameters = (
        Parameter("heat_j", "J", 100.0, 1e5, 8e3, "absorbed in total"),
        Parameter(
            "centre_c", "degC", 110.0, 260.0, 138.0, "bulk, in mid-boil"
        ),
        Parameter("half_width_k", "K", 2.0, 40.0, 12.0, "to its ends"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Raise the fluid's capacity around the boiling point."""
        centre = self["centre_c"] + KELVIN_OFFSET
        width = self["half_width_k"]
        peak = self.scaled("heat_j") / width

        def edited(node: Node) -> Node:
            old, constant = node.capacity_table, node.capacity_j_k

            def share(t: float) -> float:
                usual = 1.0 if old is None else old(t)
                tent = max(1.0 - abs(t - centre) / width, 0.0)
                return usual + peak * tent / constant

            table = Table.from_function(share, COLDEST_K, HOTTEST_K, POINTS)
            return replace(node, capacity_table=table)

        return model.network.edit_node("fluid", edited)

"""Effect 27: fluid and caliper have temperatures of their own."""

from dataclasses import replace

from bstm_daemon.model.effects.effect import FIRST, Effect
from bstm_daemon.model.effects.model import CALIPER, CornerModel, Parameter
from bstm_daemon.model.effects.tables import NEGLIGIBLE
from bstm_daemon.model.thermal.network import Link, Network, Node


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
            2000.0,
            160.0,
            "fluid, half a piston, its bore",
        ),
        Parameter("piston_w_k", "W/K", 0.5, 500.0, 4.0, "shim to fluid"),
        Parameter("finger_w_k", "W/K", 0.5, 500.0, 8.0, "finger to the body"),
        Parameter("coupling_w_k", "W/K", 2.0, 500.0, 40.0, "fluid to caliper"),
    )
    forms = ({"coupling_w_k": 12.0},)

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

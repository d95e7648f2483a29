"""Effect 27: fluid and caliper have temperatures of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from bstm_daemon.effects.effect import CornerModel, Effect, Parameter
from bstm_daemon.thermal.network import Link, Node

NEGLIGIBLE = 1e-6
"""Below this strength the two are one lump to within a microkelvin."""


class CaliperFluidSplit(Effect):
    """The lump of section 4.7 becomes two nodes.

    The shim heats the fluid behind the piston; the fluid heats the caliper,
    which carries all losses. The stronger the effect the weaker the coupling.
    """

    number = 27
    name = "caliper_fluid_split"
    description = "The fluid behind the piston is hotter than the caliper."
    signature = (
        "Fluid, at the start of a soak, minutes; proportional to the "
        "difference of fluid and caliper."
    )
    own_parameters: ClassVar = (
        Parameter(
            "fluid_capacity_j_k", "J/K", 20.0, 500.0, 90.0, "fluid only"
        ),
        Parameter("coupling_w_k", "W/K", 2.0, 500.0, 25.0, "at strength 1"),
    )

    def apply(self, model: CornerModel) -> CornerModel:
        """Split ``fluid`` and let every loss start at ``caliper``."""
        if self.strength < NEGLIGIBLE:
            return model
        net = model.network
        whole = net.node("fluid").capacity_j_k
        fluid = min(self["fluid_capacity_j_k"], 0.5 * whole)

        def moved(link: Link) -> Link:
            if link.name == "shim":
                return link
            return replace(
                link,
                a="caliper" if link.a == "fluid" else link.a,
                b="caliper" if link.b == "fluid" else link.b,
            )

        net = replace(net, links=tuple(map(moved, net.links)))
        net = (
            net.edit_node("fluid", lambda n: replace(n, capacity_j_k=fluid))
            .with_node(Node("caliper", whole - fluid))
            .with_link(
                Link(
                    "fluid-caliper",
                    "fluid",
                    "caliper",
                    self["coupling_w_k"] / self.strength,
                )
            )
        )
        return model.with_network(net)

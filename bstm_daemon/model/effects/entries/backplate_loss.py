"""Effect 22: edges and ears of the backplates lose heat at rest too."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Link, Network, radiation

RADIATING_K = 400.0


class BackplateLoss(Effect):
    """A conductance from the plates to the air.

    Both plates show some 0.03 m2 of edges and ears; 5 to 8 W/m2K at rest.
    Without wind painted steel radiates about as much as it convects.
    The thesis's hammerhead loss (Eq 4.19) is 0 at rest.
    """

    number = 22
    description = "The backplates' edges lose heat to the air, also parked."
    signature = (
        "Pad back, at any time, with its excess over the air; no speed."
    )
    twins = ("bracket_conduction", "caliper_bypass")
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.01, 3.0, 0.22, "both plates"),
        Parameter("radiated_share", "1", 0.0, 1.0, 0.0, "of it, at 400 K"),
    )
    forms = ({"radiated_share": 0.5},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add the links backplate to air."""
        radiated = self["radiated_share"]
        whole = self.scaled("conductance_w_k")
        links = [
            Link(
                "backplate_loss",
                "backplate",
                model.surroundings,
                (1.0 - radiated) * whole,
            )
        ]
        if radiated:
            links.append(
                Link(
                    "backplate_radiation",
                    "backplate",
                    model.surroundings,
                    radiated * whole / (4.0 * RADIATING_K**3),
                    (radiation("backplate", model.surroundings),),
                )
            )
        return model.network.with_link(*links)

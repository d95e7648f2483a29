"""Effect 12: convection of the disc rises with another power of speed."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import over_speed
from bstm_daemon.model.thermal.network import Network, with_factors


class ConvectionExponent(Effect):
    """S(v) times ``(v / v0)^n``, 1 at the speed that S is measured at.

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
    either_sign = True
    own_parameters = (
        Parameter("exponent", "1", 0.0, 0.5, 0.18, "in addition to S"),
        Parameter("unchanged_ms", "m/s", 5.0, 50.0, 10.0, "S holds there"),
    )
    forms = ({"unchanged_ms": 25.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the conductance of the disc's convection."""
        power = self.scaled("exponent")
        unchanged_ms = self["unchanged_ms"]
        slow = model.spec.cooling.blend_end_ms

        def steeper(v: float) -> float:
            share: float = (max(v, slow) / unchanged_ms) ** power
            return share if v >= slow else 1.0 + (share - 1.0) * v / slow

        return model.network.edit_link(
            "disc_convection",
            lambda link: with_factors(link, over_speed(steeper)),
        )

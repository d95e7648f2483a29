"""Effect 18: the lining's conductivity depends on its temperature."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.linings import edit_lining, with_effusivity
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Network, mean, with_factors
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

LEAST = 0.2


class PadConductivity(Effect):
    """k rises linearly with temperature, as configured in the middle.

    Resin-bound linings vary by some 20 % up to 400 degC, either way by
    compound. The linings' share of the friction heat goes with their
    effusivity.
    """

    number = 18
    description = "Hot linings conduct heat differently from cold ones."
    signature = (
        "Between pad front and pad back, with the lining's temperature."
    )
    twins = ("pad_capacity",)
    either_sign = True
    own_parameters = (
        Parameter("rise", "1", 0.0, 0.8, 0.22, "of k from the middle up"),
        Parameter("middle_c", "degC", 50.0, 400.0, 220.0, "k as configured"),
        Parameter("span_k", "K", 50.0, 500.0, 180.0, "from there to the end"),
    )
    forms = (
        {"middle_c": 120.0, "span_k": 80.0},
        # k as configured of a cold lining, with the same slope
        {"middle_c": 50.0, "span_k": 350.0, "rise": 0.43},
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the links of the lining by a ramp."""
        rise, span = self.scaled("rise"), self["span_k"]
        start_k = self["middle_c"] + KELVIN_OFFSET - span
        ramp = Table(
            start_k,
            span,
            (max(1.0 - rise, LEAST), 1.0, max(1.0 + rise, LEAST)),
        )
        return edit_lining(
            with_effusivity(model.network, ramp, self.name),
            link=lambda one: with_factors(one, mean(one.a, one.b, ramp)),
        )

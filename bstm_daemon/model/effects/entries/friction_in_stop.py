"""Effect 43: friction rises while the brake is held."""

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Memory, difference, value
from bstm_daemon.model.thermal.table import Table

RELEASE_S = 2.0
"""Time constant with which the contact forgets a stop."""


class FrictionInStop(Effect):
    """mu = mu0 (1 + rise (1 - exp(-t / time))), t since the brake is held.

    Within a stop of SAE J2522 organic linings gain 5 to 30 % while their
    contact plateaus grow; some lose as much. How fast is the form.
    """

    number = 43
    kind = "heat"
    description = "Friction rises or falls within each braking."
    signature = "All heat, with the seconds since braking began."
    twins = ("hydraulic_lag", "pushout_pressure")
    either_sign = True
    own_parameters = (
        Parameter("rise", "1", 0.0, 0.5, 0.15, "of mu in a long stop"),
        Parameter("time_s", "s", 0.2, 30.0, 3.0, "to 63 % of it"),
    )
    forms = ({"time_s": 0.8}, {"time_s": 10.0})

    def edit(self, model: CornerModel) -> CornerModel:
        """Scale the friction heat by a memory of the braking's length."""
        if not model.heat_from_pressure:
            return model
        release = -self["time_s"] / RELEASE_S
        rate = difference(
            "brake_on", "stop_length", Table(-1.0, 1.0, (release, 0.0, 1.0))
        )
        memory = Memory(
            "stop_length", "integral", 1.0 / self["time_s"], (rate,)
        )
        factor = Table(0.0, 1.0, (1.0, max(1.0 + self.scaled("rise"), 0.1)))
        net = model.network.with_memory(memory)
        return model.with_network(net).with_heat_factors(
            value("stop_length", factor)
        )

"""Effect 4: friction changes as the pads bed in."""

from math import exp

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Memory, value
from bstm_daemon.model.thermal.table import Table

WORN_IN = 6.0
"""Multiples of the bedding energy after which nothing changes any more."""


class FrictionHistory(Effect):
    """mu = mu0 (1 - drop (1 - exp(-E / E0))), E the heat since new.

    The thesis saw p/F rise from 400 to 600 Pa/N on new pads (Fig 4.9), so mu
    fell by a third, less on the second run and not on the third.
    """

    number = 4
    kind = "heat"
    description = (
        "Friction of new pads falls with the heat they absorb at first."
    )
    signature = (
        "All heat, braking only; early drives differ from late ones; gone "
        "on a repeated run."
    )
    own_parameters = (
        Parameter("drop", "1", 0.0, 0.6, 0.33, "fall of mu when worn in"),
        Parameter(
            "bedding_energy_j", "J", 1e5, 1e8, 5e6, "heat for 63 % of the fall"
        ),
    )
    forms = ({"bedding_energy_j": 5e7},)

    def edit(self, model: CornerModel) -> CornerModel:
        """Scale the friction heat by a memory of its own integral."""
        if not model.heat_from_pressure:
            return model
        drop = min(self.scaled("drop"), 0.95)
        worn = Table.from_function(
            lambda e: 1.0 - drop * (1.0 - exp(-e)), 0.0, WORN_IN
        )
        bedding = Memory(
            "bedding",
            "integral",
            1.0 / self["bedding_energy_j"],
            (value("brake_power_w"),),
            upper=WORN_IN,
        )
        net = model.network.with_memory(bedding)
        return model.with_network(net).with_heat_factors(
            value("bedding", worn)
        )

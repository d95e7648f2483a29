"""Effect 10: the disc's heat capacity peaks at the Curie point."""

from dataclasses import replace
from math import ceil

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.linings import with_effusivity
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.thermal.network import Network
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

LEAST_SHARE = 0.3
HOTTEST_K = 1300.0
FINEST_K = 5.0


class DiscCapacityHot(Effect):
    """A tent on top of cp(T), over what the configured curve has.

    Curie point (770 degC in pure iron) and eutectoid take up some 40 kJ/kg
    in all, and give them back on cooling. A lump has a mean temperature: the
    surface gets there 100 K and more before it, so its tent is wider and
    lower than iron's own peak.
    """

    number = 10
    description = "Near 750 degC iron absorbs heat without getting hotter."
    signature = (
        "Disc, with its change of temperature, above 650 degC, heating and "
        "cooling alike."
    )
    twins = ("friction_fade", "disc_radiation_driving")
    either_sign = True
    own_parameters = (
        Parameter("peak_j_kgk", "J/kgK", 0.0, 1500.0, 380.0, "above cp(T)"),
        Parameter("centre_c", "degC", 650.0, 800.0, 755.0, "of the peak"),
        Parameter("half_width_k", "K", 20.0, 250.0, 150.0, "to its foot"),
    )
    forms = ({"half_width_k": 60.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Raise cp(T) of the disc, and with it its share of the heat."""
        centre = self["centre_c"] + KELVIN_OFFSET
        width, peak = self["half_width_k"], self.scaled("peak_j_kgk")
        net = model.network
        old = net.node("disc").capacity_table
        if old is None:
            msg = "disc_capacity_hot: the disc has no cp(T)"
            raise ValueError(msg)

        def relative(t: float) -> float:
            tent = max(1.0 - abs(t - centre) / width, 0.0)
            return max(1.0 + peak * tent / old(t), LEAST_SHARE)

        # the old points stay points: below the peak not a bit of cp moves
        dx = old.dx / ceil(old.dx / FINEST_K)
        points = round((max(old.x1, HOTTEST_K) - old.x0) / dx) + 1
        at = [old.x0 + i * dx for i in range(points)]
        table = Table(old.x0, dx, tuple(old(t) * relative(t) for t in at))
        net = net.edit_node("disc", lambda n: replace(n, capacity_table=table))
        return with_effusivity(net, relative, self.name, "disc")

"""Effects of the disc, of what it touches and of what carries it."""

from dataclasses import replace
from math import ceil

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import (
    FASTEST_MS,
    RELEASED,
    ROOM_K,
    over_speed,
    rising_with_speed,
    with_effusivity,
)
from bstm_daemon.model.thermal.network import (
    Link,
    Memory,
    Network,
    Node,
    Source,
    difference,
    mean,
    radiation,
    value,
)
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET, STEFAN_BOLTZMANN_W_M2K4


class ResidualDrag(Effect):
    """A drag torque while released, more when the pads are hot.

    0.5 to 5 Nm a corner are usual, tens where a piston binds. Hot pads have
    expanded and a hot seal draws back less. The heat is divided as friction
    heat is.
    """

    number = 7
    kind = "heat"
    description = "Pads that do not release keep heating the disc."
    signature = (
        "Disc, a little pad front, driving with the brake off, with speed; "
        "more after the brake was used."
    )
    twins = ("convection_exponent", "brake_without_pressure")
    own_parameters = (
        Parameter("torque_nm", "Nm", 0.1, 50.0, 5.0, "pads hot"),
        Parameter("cold_share", "1", 0.0, 1.0, 0.35, "of it, pads cold"),
        Parameter("hot_c", "degC", 40.0, 400.0, 130.0, "pad back, hot"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add sources in disc and pads while the brake is off."""
        span = self["hot_c"] + KELVIN_OFFSET - ROOM_K
        drag = (
            value("speed_ms"),
            value("brake_on", RELEASED),
            value("pad_back", Table(ROOM_K, span, (self["cold_share"], 1.0))),
        )
        watts = self.scaled("torque_nm") / model.wheel_radius_m
        pads = 1.0 - model.spec.disc_share
        return model.network.with_source(
            Source("residual_drag_disc", "disc", watts * (1.0 - pads), drag),
            Source("residual_drag_pads", "pad_front", watts * pads, drag),
        )


class ContactConductance(Effect):
    """q = h_c(p) (T_disc - T_pad) while the pads press on the disc.

    The thesis splits the heat by a constant; real surfaces also exchange
    heat, so in a long drag the share drifts with their temperatures. The
    contact conductance of pressed rough surfaces grows about as p^0.95
    (Yovanovich); 1e3 to 1e4 W/m2K while braking.
    """

    number = 8
    description = "Disc and pads exchange heat through their contact."
    signature = (
        "Edge disc to pad front, braking only, with their temperature "
        "difference."
    )
    own_parameters = (
        Parameter("conductance_w_m2k", "W/m2K", 10.0, 2e4, 160.0, "at 1 MPa"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to pad_front."""
        rise = Table.from_function(
            lambda p: (max(p, 0.0) / 1e6) ** 0.95, 0.0, 2e7, 401
        )
        link = Link(
            "contact_conductance",
            "disc",
            "pad_front",
            self.scaled("conductance_w_m2k") * model.spec.pads_area_m2,
            (value("brake_on"), value("pressure_pa", rise)),
        )
        return model.network.with_link(link)


REFERENCE_K = 500.0
AIR_CONDUCTIVITY = Table.from_function(
    lambda k: (k / REFERENCE_K) ** 0.79, 220.0, 1300.0, 109
)
"""Conductivity of air over that at the reference; 0.026 W/mK at 300 K, 0.041
at 500 K, 0.063 at 900 K."""


class GapConduction(Effect):
    """q = h_gap k(T)/k_ref (T_disc - T_pad) while the brake is off.

    Air of 0.04 W/mK over the 0.1 to 0.5 mm that seals roll back gives 80 to
    400 W/m2K, against 20 of radiation. Hot air conducts better: T is the mean
    of both faces.
    """

    number = 9
    description = "The narrow gap of a released brake still conducts heat."
    signature = (
        "Edge disc to pad front, brake off, proportional to the difference "
        "of their temperatures and not to that of T^4; strongest parked."
    )
    twins = ("contact_conductance",)
    own_parameters = (
        Parameter(
            "conductance_w_m2k", "W/m2K", 5.0, 1e3, 130.0, "of air at 500 K"
        ),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to pad_front."""
        link = Link(
            "gap_conduction",
            "disc",
            "pad_front",
            self.scaled("conductance_w_m2k") * model.spec.pads_area_m2,
            (
                value("brake_on", RELEASED),
                mean("disc", "pad_front", AIR_CONDUCTIVITY),
            ),
        )
        return model.network.with_link(link)


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


class DiscRadiationDriving(Effect):
    """Net radiation above the standstill blend, where the thesis has none.

    At 600 degC it is 20 to 33 % of what a disc loses at 36 km/h. The
    S-function must then be that of convection alone.
    """

    number = 11
    description = "A hot disc also radiates while the car drives."
    signature = "Disc, driving, with T^4 and not with speed."
    twins = ("friction_fade", "convection_exponent")
    own_parameters = (
        Parameter(
            "view_share",
            "1",
            0.05,
            1.0,
            1.0,
            "of the free area that sees cold surroundings and not the rim",
        ),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link disc to ambient where the base model has none."""
        spec = model.spec
        free_m2 = max(spec.disc.total_area_m2 - spec.pads_area_m2, 0.0)
        driving = Table(0.0, spec.cooling.blend_end_ms, (0.0, 1.0))
        link = Link(
            "disc_radiation_driving",
            "disc",
            "ambient",
            self.scaled("view_share")
            * STEFAN_BOLTZMANN_W_M2K4
            * spec.thermal.disc_emissivity
            * free_m2,
            (radiation("disc", "ambient"), value("speed_ms", driving)),
        )
        return model.network.with_link(link)


class HubConduction(Effect):
    """Disc to hub through the bolted face, hub to bearing and knuckle.

    Hub, wheel flange and what is tight to them weigh 5 to 6 kg; hat and face
    pass about a watt a kelvin.
    """

    number = 14
    description = "The hub absorbs heat of the disc and returns it later."
    signature = (
        "Disc, at any time, with a memory of 20 to 40 minutes; no speed."
    )
    twins = ("local_air", "disc_hat")
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.05, 10.0, 1.0, "disc to hub"),
        Parameter("capacity_j_k", "J/K", 500.0, 1e4, 2600.0, "of the hub"),
        Parameter("loss_w_k", "W/K", 0.0, 20.0, 1.8, "hub to the knuckle"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the node ``hub`` and its links."""
        conductance = self.scaled("conductance_w_k")
        return model.network.with_node(
            Node("hub", self["capacity_j_k"])
        ).with_link(
            Link("hub_conduction", "disc", "hub", conductance),
            Link("hub_loss", "hub", "ambient", self["loss_w_k"]),
        )


MOST = 0.5


class DiscWear(Effect):
    """The ring has lost a part of its mass; its surface is as it was.

    Manufacturers allow 2 to 3 mm of a 28 mm disc; 8 % is 1.6 mm of the two
    cheeks. What it gives off does not depend on its mass, so the rate of
    Eq 4.12 rises as the capacity falls.
    """

    number = 16
    description = "A worn disc has less iron to heat."
    signature = (
        "Disc, with its change of temperature, at any temperature; does not "
        "change within a drive."
    )
    own_parameters = (
        Parameter("lost_share", "1", 0.0, 0.3, 0.08, "of the ring's mass"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Lower the disc's capacity and keep what it gives off."""
        left = 1.0 - min(self.scaled("lost_share"), MOST)
        return model.network.edit_node(
            "disc",
            lambda node: replace(node, capacity_j_k=left * node.capacity_j_k),
        )


STILL_W_M2K = 5.0
RISE_WS_M3K = 3.5


class DiscHat(Effect):
    """Ring to hat by conduction through its neck, hat to air.

    2.4 kg of iron behind a neck of 7 mm wall, 0.16 m across and 3 cm long:
    k A / l = 5 W/K. Convection 5 W/m2K at rest and 3.5 more for each m/s.
    """

    number = 17
    description = "The hat of the disc lags behind the ring and cools it."
    signature = (
        "Disc, after brakings begin and end, minutes; then like a steady loss."
    )
    twins = ("hub_conduction",)
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.2, 30.0, 5.0, "ring to hat"),
        Parameter("mass_kg", "kg", 0.5, 8.0, 2.4, "of the hat"),
        Parameter("area_m2", "m2", 5e-3, 0.2, 0.06, "that air cools"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the node ``hat`` and its links."""
        ring = model.network.node("disc").capacity_table
        wind = rising_with_speed(STILL_W_M2K, RISE_WS_M3K)
        return model.network.with_node(
            Node("hat", self["mass_kg"], ring)
        ).with_link(
            Link("disc_hat", "disc", "hat", self.scaled("conductance_w_k")),
            Link(
                "hat_convection",
                "hat",
                model.surroundings,
                self["area_m2"],
                (wind,),
            ),
        )


class HubHeat(Effect):
    """Heat of a torque at the hub that comes to the disc through the hat.

    Shoes of a parking brake that drag take 5 to 30 Nm, a bearing with too
    much preload a few, more with speed. About half of the heat goes to the
    disc, as late as hub and hat follow; the rest to the knuckle.
    """

    number = 40
    description = "A dragging drum or bearing heats the disc by its hub."
    signature = "Disc, driving and parked after it, with a memory of minutes."
    twins = ("residual_drag",)
    own_parameters = (
        Parameter("torque_nm", "Nm", 0.1, 60.0, 5.0, "to the disc, 20 m/s"),
        Parameter("exponent", "1", 0.0, 1.0, 0.0, "of the torque, speed"),
        Parameter("time_s", "s", 60.0, 7200.0, 1200.0, "of hub and hat"),
    )
    forms = ({"exponent": 1.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Add a source at the disc that follows the speed late."""
        late = Memory(
            "hub_turning",
            "integral",
            1.0 / self["time_s"],
            (difference("speed_ms", "hub_turning"),),
            upper=FASTEST_MS,
        )
        power = 1.0 + self["exponent"]
        turned = over_speed(lambda v: 20.0 * (v / 20.0) ** power).table
        watts = self.scaled("torque_nm") / model.wheel_radius_m
        heat = Source("hub_heat", "disc", watts, (value(late.name, turned),))
        return model.network.with_memory(late).with_source(heat)

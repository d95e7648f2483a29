"""Effects of linings, backplates and shims."""

from __future__ import annotations

from dataclasses import replace

from bstm_daemon.model.effects.effect import Effect
from bstm_daemon.model.effects.model import CornerModel, Parameter
from bstm_daemon.model.effects.tables import (
    ROOM_K,
    edit_lining,
    rising_with_speed,
    with_effusivity,
)
from bstm_daemon.model.thermal.network import (
    Link,
    Memory,
    Network,
    Node,
    Source,
    mean,
    value,
    with_factors,
)
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

LEAST_CONDUCTIVITY = 0.2


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

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the links of the lining by a ramp."""
        rise, span = self.scaled("rise"), self["span_k"]
        start_k = self["middle_c"] + KELVIN_OFFSET - span
        ramp = Table(
            start_k,
            span,
            (
                max(1.0 - rise, LEAST_CONDUCTIVITY),
                1.0,
                max(1.0 + rise, LEAST_CONDUCTIVITY),
            ),
        )
        return edit_lining(
            with_effusivity(model.network, ramp, self.name),
            link=lambda one: with_factors(one, mean(one.a, one.b, ramp)),
        )


LEAST_CAPACITY = 0.3


class PadCapacity(Effect):
    """cp rises linearly from 20 degC on, up to a temperature.

    1000 J/kgK cold and 0.9 more a kelvin are typical of linings. Their share
    of the friction heat rises with their effusivity.
    """

    number = 19
    description = "The heat capacity of linings rises with temperature."
    signature = (
        "Pad front and pad back, with their change of temperature, with the "
        "lining's temperature."
    )
    twins = ("pad_conductivity", "pad_pyrolysis")
    either_sign = True
    own_parameters = (
        Parameter("rise_per_k", "1/K", 0.0, 3e-3, 9e-4, "of cp, cold = 1"),
        Parameter("until_c", "degC", 100.0, 800.0, 400.0, "rises up to here"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply cp of every slab by a ramp."""
        span = self["until_c"] + KELVIN_OFFSET - ROOM_K
        hot = max(1.0 + self.scaled("rise_per_k") * span, LEAST_CAPACITY)
        ramp = Table(ROOM_K, span, (1.0, hot))

        def warmed(slab: Node) -> Node:
            old = slab.capacity_table
            table = ramp if old is None else old.times(ramp)
            return replace(slab, capacity_table=table)

        net = with_effusivity(model.network, ramp, self.name)
        return edit_lining(net, warmed)


ONSET_WIDTH_K = 60.0


class PadPyrolysis(Effect):
    """d(alpha)/dt = k(T) (1 - alpha) at the pad's face, heat sink with it.

    Resin binders decompose from about 350 degC on and take up heat; what is
    gone stays gone, so a second identical run shows nothing.
    """

    number = 20
    description = "The lining's binder decomposes once and absorbs heat."
    signature = (
        "Pad front, first heating above about 350 degC only, irreversible."
    )
    own_parameters = (
        Parameter("heat_j", "J", 100.0, 2e5, 3.5e4, "absorbed in total"),
        Parameter("onset_c", "degC", 250.0, 500.0, 370.0, "half rate"),
        Parameter("rate_per_s", "1/s", 1e-4, 0.1, 5e-3, "rate when hot"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add a memory of the decomposed share and a sink in pad_front."""
        start_k = self["onset_c"] + KELVIN_OFFSET - 0.5 * ONSET_WIDTH_K
        onset = value("pad_front", Table(start_k, ONSET_WIDTH_K, (0.0, 1.0)))
        left = value("pyrolysis", Table(0.0, 1.0, (1.0, 0.0)))
        rate = self["rate_per_s"]
        return model.network.with_memory(
            Memory("pyrolysis", "integral", rate, (onset, left))
        ).with_source(
            Source(
                "pyrolysis_heat",
                "pad_front",
                -self.scaled("heat_j") * rate,
                (onset, left),
            )
        )


THINNEST_M = 1e-3
"""Less lining than this is not left: the plate would touch the disc."""


class PadWear(Effect):
    """Every slab is thinner by the same share: less mass, a shorter way.

    What is lost is lost before the drive; a drive of 60 MJ a corner takes
    about 1 mm more.
    """

    number = 21
    description = "Worn linings conduct heat to the fluid faster."
    signature = (
        "Pad back and fluid, sooner and hotter; pad front less; grows over "
        "many drives with their heat."
    )
    twins = ("shim_contact", "pad_conductivity")
    own_parameters = (
        Parameter("worn_m", "m", 0.0, 0.02, 4.5e-3, "lost of the lining"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Scale capacities and conductances of the lining."""
        whole = model.spec.pad.thickness_m
        least = min(THINNEST_M, whole)
        left = max(whole - self.scaled("worn_m"), least) / whole
        return edit_lining(
            model.network,
            lambda one: replace(one, capacity_j_k=left * one.capacity_j_k),
            lambda one: replace(
                one, conductance_w_k=one.conductance_w_k / left
            ),
        )


class BackplateLoss(Effect):
    """A constant conductance from the plates to the air.

    Both plates show some 0.03 m2 of edges and ears; 5 to 8 W/m2K at rest.
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
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the link backplate to air."""
        link = Link(
            "backplate_loss",
            "backplate",
            model.surroundings,
            self.scaled("conductance_w_k"),
        )
        return model.network.with_link(link)


class BracketConduction(Effect):
    """Hammerheads conduct to the bracket, which warms up and cools.

    Four ears of about 1 cm2 on steel clips, 1 kW/m2K each; the bracket of
    some 2.4 kg is bolted to the knuckle and stands in the wind. While the
    brake is held the friction force presses two of the ears on firmly.
    """

    number = 23
    description = "Part of the pads' heat goes into the caliper's bracket."
    signature = (
        "Pad back, at any time, most with the brake held, with its excess "
        "over the bracket; no speed."
    )
    twins = ("backplate_loss", "caliper_bypass")
    own_parameters = (
        Parameter("conductance_w_k", "W/K", 0.02, 5.0, 0.4, "all four ears"),
        Parameter("pressed_rise", "1", 0.0, 3.0, 0.5, "of it, brake held"),
        Parameter("capacity_j_k", "J/K", 100.0, 5e3, 1150.0, "of the bracket"),
        Parameter("loss_w_k", "W/K", 0.0, 20.0, 1.0, "bracket, at rest"),
        Parameter("loss_rise_ws_mk", "Ws/mK", 0.0, 2.0, 0.08, "with speed"),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Add the node ``bracket`` and its links."""
        wind = rising_with_speed(self["loss_w_k"], self["loss_rise_ws_mk"])
        held = Table(0.0, 1.0, (1.0, 1.0 + self["pressed_rise"]))
        return model.network.with_node(
            Node("bracket", self["capacity_j_k"])
        ).with_link(
            Link(
                "bracket_conduction",
                "backplate",
                "bracket",
                self.scaled("conductance_w_k"),
                (value("brake_on", held),),
            ),
            Link("bracket_loss", "bracket", "ambient", 1.0, (wind,)),
        )


class ShimContact(Effect):
    """The conductance of the shim falls when the brake is released.

    Contacts of plate, shim and piston open when nothing presses them; the
    configured resistance holds for a pressed shim.
    """

    number = 25
    description = "Released, plate and piston touch only loosely."
    signature = "Edge pad back to fluid, differs with the brake held or not."
    own_parameters = (
        Parameter("loss", "1", 0.0, 0.9, 0.35, "fall of the conductance"),
        Parameter(
            "full_pressure_pa", "Pa", 1e4, 5e6, 3e5, "fully pressed from here"
        ),
    )

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the shim's conductance by a table over pressure."""
        loose = max(1.0 - self.scaled("loss"), 0.02)
        pressed = Table(0.0, self["full_pressure_pa"], (loose, 1.0))
        return model.network.edit_link(
            "shim",
            lambda link: with_factors(link, value("pressure_pa", pressed)),
        )


class LayerOpening(Effect):
    """The shim conducts less above a temperature of the backplate.

    The rubber of a shim lets go of its steel at 100 to 200 degC. Where it
    sticks again on cooling it is a table; where it does not, ``latched``, a
    memory of the hottest it was.
    """

    number = 41
    description = "Layers of the shim open when hot and conduct less."
    signature = "Edge pad back to fluid, beyond a temperature, or after it."
    twins = ("shim_contact",)
    own_parameters = (
        Parameter("loss", "1", 0.0, 0.9, 0.4, "of the conductance"),
        Parameter("onset_c", "degC", 60.0, 300.0, 110.0, "begins to open"),
        Parameter("span_k", "K", 5.0, 200.0, 50.0, "until it is open"),
        Parameter("latched", "1", 0.0, 1.0, 0.0, "1: stays open"),
    )
    forms = ({"latched": 1.0},)

    def edit_network(self, model: CornerModel) -> Network:
        """Multiply the shim's conductance by what is left of it."""
        left = max(1.0 - self.scaled("loss"), 0.02)
        onset_k, span_k = self["onset_c"] + KELVIN_OFFSET, self["span_k"]
        net = model.network
        factor = value("backplate", Table(onset_k, span_k, (1.0, left)))
        if self["latched"] >= 0.5:
            hottest = value("backplate", Table(onset_k, span_k, (0.0, 1.0)))
            net = net.with_memory(
                Memory("layers_open", "latch", 1.0, (hottest,))
            )
            factor = value("layers_open", Table(0.0, 1.0, (1.0, left)))
        return net.edit_link("shim", lambda link: with_factors(link, factor))

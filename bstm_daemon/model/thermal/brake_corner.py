"""The thesis's brake corner, built as a network (chapters 2 and 4).

Disc, pads and fluid are parts built one after the other by builders chosen by
name in the configuration. Both pads are one chain of twice one pad's area:
they are heated alike, and what they give off adds up. Energy per joule of
brake power is split once, in :func:`_heat_sources`, and nothing is lost.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from itertools import pairwise
from math import log
from typing import Final

from bstm_daemon.config.section import Curve
from bstm_daemon.config.sections import (
    Config,
    CornerConfig,
    DiscConfig,
    PadConfig,
)
from bstm_daemon.config.thermal import CoolingConfig, ThermalConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.model.thermal.network import (
    Factor,
    Link,
    Network,
    Node,
    Source,
    mean,
    radiation,
    value,
)
from bstm_daemon.model.thermal.partition import (
    disc_share,
    effusivity,
    pad_share,
)
from bstm_daemon.model.thermal.properties import (
    REFERENCE_K,
    curve_table,
    disc_heat_capacity,
)
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET, STEFAN_BOLTZMANN_W_M2K4

PADS: Final = 2
"""Pads of a corner."""

PLATE_RESISTANCE_SHARE: Final = 0.05
"""Part of the backplate resistance between lining and plate; the rest, the
shim, lies between plate and piston. (6 mm of steel, 1.2e-4 m2K/W, of
2e-3 to 5e-3 in all.)"""

PLATE_J_M2K: Final = 26e3
"""Heat capacity of a backplate for each m2 of lining: 6 mm of steel, 7850
kg/m3, 480 J/kgK, on 1.15 times the lining's area."""

SPEED_LIMIT_MS: Final = 120.0
"""Upper end of tables over speed."""

WIND_MS: Final = 20.0
"""Speed at which the caliper's loss is the same with every exponent."""


@dataclass(frozen=True, slots=True)
class CornerSpec:
    """What builders work from: the configuration of one disc corner."""

    name: str
    disc: DiscConfig
    pad: PadConfig
    thermal: ThermalConfig
    cooling: CoolingConfig

    @property
    def pads_area_m2(self) -> float:
        """Friction area of both pads."""
        return PADS * self.pad.area_m2

    @property
    def disc_radiating_m2(self) -> float:
        """Area of the disc that radiates to the surroundings."""
        free_m2 = max(self.disc.total_area_m2 - self.pads_area_m2, 0.0)
        return self.thermal.disc_view_factor * free_m2

    @property
    def disc_mass_kg(self) -> float:
        """Disc mass with its correction factor."""
        return self.disc.mass_kg * self.thermal.disc_mass_correction_factor

    @property
    def disc_share(self) -> float:
        """Eq 2.3 for this corner."""
        disc, pad = self.disc, self.pad
        lining = pad.heat_capacity_j_kgk
        conductivity = pad.conductivity_w_mk
        return disc_share(
            effusivity(
                disc.conductivity_w_mk,
                disc.density_kg_m3,
                disc.effusivity_heat_capacity_j_kgk,
            ),
            disc.swept_area_m2,
            effusivity(
                _at_reference(conductivity),
                pad.density_kg_m3,
                _at_reference(lining),
            ),
            self.pads_area_m2,
        )


def corner_spec(config: Config, corner: CornerConfig) -> CornerSpec:
    """Gather what *corner*, a disc corner of *config*, is built from.

    Raises:
        ConfigError: the corner is a drum.
    """
    if corner.disc is None or corner.pad is None:
        msg = f"[[corner]] {corner.name}: a drum is not modelled"
        raise ConfigError([msg])
    return CornerSpec(
        corner.name,
        corner.disc,
        corner.pad,
        config.thermal_of(corner),
        config.cooling_of(corner),
    )


def build_corner(
    spec: CornerSpec, inputs: Sequence[str], *, force_measured: bool = False
) -> Network:
    """Build the network of one disc corner.

    Args:
        spec: the corner.
        inputs: the input channels in order; needs ``speed_ms``,
            ``brake_on``, ``ambient_k`` and ``brake_power_w``.
        force_measured: the disc follows ``measured_disc_k`` where finite.

    Raises:
        ConfigError: a builder or a share that does not exist.
    """
    net = Network(tuple(inputs)).with_node(
        Node("ambient", 0.0, boundary_input="ambient_k"),
        # heat that section 5.2.2 lets "dissolve" ends here, in the ledger
        Node("dissolved", 0.0, boundary_input="ambient_k"),
    )
    for part, model, builders in (
        ("disc.model", spec.disc.model, DISC_MODELS),
        ("pad.model", spec.pad.model, PAD_MODELS),
        ("thermal.fluid_model", spec.thermal.fluid_model, FLUID_MODELS),
    ):
        where = f"[[corner]] {spec.name} {part}"
        net = _built(_builder(model, builders, where), net, spec, where)
    net = _disc_pad_exchange(net, spec)
    try:
        if force_measured:
            net = net.edit_node(
                "disc", lambda n: replace(n, boundary_input="measured_disc_k")
            )
        return _heat_sources(net, spec)
    except ValueError as error:
        msg = f"[[corner]] {spec.name}: {error}"
        raise ConfigError([msg]) from error


def cooling_beyond(
    x: Sequence[float], y: Sequence[float], speed_ms: float
) -> float:
    """Return S [1/s] above the last speed of the table *x* [m/s], *y* [1/s].

    By the power law of the last two points, as forced convection rises with
    speed, with an exponent from 0 to 1.
    """
    exponent = 0.0
    if x[-2] > 0.0 and y[-1] > y[-2] > 0.0:
        exponent = min(log(y[-1] / y[-2]) / log(x[-1] / x[-2]), 1.0)
    elif x[-2] == 0.0 and y[-1] > y[-2]:
        # a straight line from rest on has no second point of a power
        exponent = 1.0 - y[-2] / y[-1]
    return float(y[-1] * (speed_ms / x[-1]) ** exponent)


def cooling_table(cooling: CoolingConfig) -> Table:
    """Return S [1/s] over speed up to :data:`SPEED_LIMIT_MS`."""
    x, y = cooling.speed_ms, cooling.s_per_s
    beyond = partial(cooling_beyond, x, y)
    return Table.from_points(x, y).continued(beyond, SPEED_LIMIT_MS)


def lumped_disc(net: Network, spec: CornerSpec) -> Network:
    """Disc as one lump (Eq 2.5) cooled by the S-function (Eq 4.12).

    A disc builder must add a node ``disc``: it takes the friction heat and
    faces the pads.

    ``rate``: dT/dt = -S (T - T_amb) at any temperature, as the thesis fits
    it, so the conductance is S C(T). ``conductance``: h A constant, so the
    rate falls as cp rises. Below ``blend_end_ms`` convection falls to the
    standstill fraction while net radiation (Eq 2.9) comes in; above, S holds
    both (section 4.4).
    """
    cooling = spec.cooling
    capacity = disc_heat_capacity(spec.disc)
    speed = cooling_table(cooling)
    still = cooling.standstill_convection_fraction
    blend = Table(0.0, cooling.blend_end_ms, (still, 1.0))
    radiating = Table(0.0, cooling.blend_end_ms, (1.0, 0.0))
    convection = [value("speed_ms", speed), value("speed_ms", blend)]
    conductance = spec.disc_mass_kg
    if cooling.form == "rate":
        convection.append(value("disc", capacity))
    else:
        conductance *= capacity(REFERENCE_K)
    return net.with_node(Node("disc", spec.disc_mass_kg, capacity)).with_link(
        Link(
            "disc_convection", "disc", "ambient", conductance, (*convection,)
        ),
        Link(
            "disc_radiation",
            "disc",
            "ambient",
            STEFAN_BOLTZMANN_W_M2K4
            * spec.thermal.disc_emissivity
            * spec.disc_radiating_m2,
            (radiation("disc", "ambient"), value("speed_ms", radiating)),
        ),
    )


def slab_pads(net: Network, spec: CornerSpec) -> Network:
    """Both pads as one chain of slabs (Eq 4.14 to 4.17) and the backplate.

    A pad builder must add ``pad_front``, ``pad_back`` and ``backplate``; a
    thermocouple is read between those nodes that have a depth.

    ``half`` puts a node on each surface with half a slab behind it;
    ``full`` is the thesis's mesh, whose end cells are whole and whose
    "surface" is a cell centre. No loss at the edges, as in the thesis.
    """
    pad, thermal = spec.pad, spec.thermal
    count = pad.slabs + 2
    full = pad.surface_cells == "full"
    dz = pad.thickness_m / (count if full else count - 1)
    names = (
        "pad_front",
        *(f"pad_{i + 1}" for i in range(pad.slabs)),
        "pad_back",
    )
    lump = pad.density_kg_m3 * spec.pads_area_m2 * dz
    cp_j_kgk, cp_table = _constant_and_table(pad.heat_capacity_j_kgk)
    k_w_mk, k_table = _constant_and_table(pad.conductivity_w_mk)
    for i, name in enumerate(names):
        surface = i in (0, count - 1) and not full
        size = lump * cp_j_kgk * (0.5 if surface else 1.0)
        depth_m = dz * (i + 0.5 if full else i)
        net = net.with_node(Node(name, size, cp_table, depth_m=depth_m))
    slab = k_w_mk * spec.pads_area_m2 / dz
    for a, b in pairwise(names):
        factors = () if k_table is None else (mean(a, b, k_table),)
        net = net.with_link(Link(f"{a}-{b}", a, b, slab, factors))
    resistance = thermal.pad_backplate_thermal_resistance_m2k_w
    to_plate = spec.pads_area_m2 / (resistance * PLATE_RESISTANCE_SHARE)
    plates_j_k = thermal.backplate_thermal_capacity_j_k
    if plates_j_k == 0.0 and thermal.structure == "extended":
        plates_j_k = PLATE_J_M2K * spec.pads_area_m2
    return net.with_node(Node("backplate", plates_j_k)).with_link(
        Link("pad_back-backplate", "pad_back", "backplate", to_plate)
    )


def lumped_fluid(net: Network, spec: CornerSpec) -> Network:
    """Fluid and caliper as one lump (section 4.7) behind the shim (Eq 4.18).

    A fluid builder must add ``fluid`` and connect ``backplate`` and, for the
    hammerheads (Eq 4.19), ``pad_back``. The hammerhead loss is
    ``h_dyn v^n A (T_pad_back - T_sink)`` with n = 1 in the thesis; as metal
    does not stop conducting when the car parks, a static part may be added.
    """
    thermal = spec.thermal
    resistance = thermal.pad_backplate_thermal_resistance_m2k_w
    shim = spec.pads_area_m2 / (resistance * (1.0 - PLATE_RESISTANCE_SHARE))
    sink = "fluid" if thermal.hammerhead_sink == "fluid" else "ambient"
    # one structure for every exponent, where a match may move it
    bent = thermal.structure == "extended"
    exponent = thermal.fluid_dynamic_convection_exponent
    wind = _speed_power(exponent, WIND_MS, always=bent)
    return net.with_node(
        Node("fluid", thermal.fluid_caliper_thermal_capacity_j_k)
    ).with_link(
        Link("shim", "backplate", "fluid", shim),
        Link(
            "hammerhead",
            "pad_back",
            sink,
            thermal.pad_dynamic_convection_ws_m3k * spec.pads_area_m2,
            (_speed_power(thermal.pad_dynamic_convection_exponent),),
        ),
        Link(
            "hammerhead_static", "pad_back", sink, thermal.pad_static_loss_w_k
        ),
        Link(
            "fluid_static",
            "fluid",
            "ambient",
            thermal.fluid_static_convection_w_k,
        ),
        Link(
            "fluid_dynamic",
            "fluid",
            "ambient",
            thermal.fluid_dynamic_convection_ws_mk,
            (wind,),
        ),
    )


def _disc_pad_exchange(net: Network, spec: CornerSpec) -> Network:
    """Radiation between disc and pads (Eq 2.10, 2.11) and gap conduction.

    ``grey-plates``: net exchange of closely spaced plates,
    ``sigma A (Td^4 - Tp^4) / (1/eps_d + 1/eps_p - 1)``. ``product``: the
    thesis's alpha F Q with A F = A_pad, so eps_d eps_p, made net.
    """
    thermal = spec.thermal
    eps_d, eps_p = thermal.disc_emissivity, thermal.pad_emissivity
    if thermal.disc_pad_radiation == "product":
        effective = eps_d * eps_p
    else:
        effective = 1.0 / (1.0 / eps_d + 1.0 / eps_p - 1.0)
    return net.with_link(
        Link(
            "disc_pad_radiation",
            "disc",
            "pad_front",
            STEFAN_BOLTZMANN_W_M2K4 * effective * spec.pads_area_m2,
            (radiation("disc", "pad_front"),),
        ),
        Link(
            "disc_pad_gap",
            "disc",
            "pad_front",
            thermal.gap_conductance_w_m2k * spec.pads_area_m2,
            (value("brake_on", Table(0.0, 1.0, (1.0, 0.0))),),
        ),
    )


def _heat_sources(net: Network, spec: CornerSpec) -> Network:
    """Split the brake power: disc, pads, air, and what "dissolves".

    Above ``hot_pad_threshold_c`` the heat into the pads is multiplied by
    ``hot_pad_factor`` (section 5.2.2: 0.6, "40 % dissolves"), with a linear
    transition of ``hot_pad_width_k``; the rest is booked on its own source.
    """
    thermal = spec.thermal
    pads = pad_share(spec.disc_share, thermal.heat_partition_correction_factor)
    air = thermal.direct_air_fraction
    threshold_k = thermal.hot_pad_threshold_c + KELVIN_OFFSET
    start_k, width_k = (
        threshold_k - 0.5 * thermal.hot_pad_width_k,
        (thermal.hot_pad_width_k),
    )
    factor = thermal.hot_pad_factor
    kept = value("pad_front", Table(start_k, width_k, (1.0, factor)))
    lost = value("pad_front", Table(start_k, width_k, (0.0, 1.0 - factor)))
    power = value("brake_power_w")
    into_pads = (1.0 - air) * pads
    return net.with_source(
        Source("disc_heat", "disc", (1.0 - air) * (1.0 - pads), (power,)),
        Source("pad_heat", "pad_front", into_pads, (power, kept)),
        Source("hot_pad_reduction", "dissolved", into_pads, (power, lost)),
        Source("air_heat", "ambient", air, (power,)),
    )


DISC_MODELS: Final = {"lumped": lumped_disc}
PAD_MODELS: Final = {"slabs": slab_pads}
FLUID_MODELS: Final = {"lump": lumped_fluid}


def _builder(
    model: str,
    builders: Mapping[str, Callable[[Network, CornerSpec], Network]],
    where: str,
) -> Callable[[Network, CornerSpec], Network]:
    """Return a shipped builder by name, or ``module:function``."""
    if model in builders:
        return builders[model]
    module_name, _, function_name = model.partition(":")
    try:
        builder: Callable[[Network, CornerSpec], Network] = getattr(
            import_module(module_name), function_name
        )
        if callable(builder):
            return builder
        reason = f"{function_name} is no function"
    except Exception as error:  # noqa: BLE001  (importing runs foreign code)
        reason = str(error)
    known = ", ".join(sorted(builders))
    msg = (
        f"{where} = {model!r}: not a model; allowed: {known}, or "
        f"'module:function' ({reason})"
    )
    raise ConfigError([msg])


def _built(
    builder: Callable[[Network, CornerSpec], Network],
    net: Network,
    spec: CornerSpec,
    where: str,
) -> Network:
    """Run a builder, which may be the user's; whatever it does is reported."""
    try:
        built: object = builder(net, spec)
    except Exception as error:  # noqa: BLE001  (foreign code may raise any)
        reason = f"failed with {type(error).__name__}: {error}"
    else:
        if isinstance(built, Network):
            return built
        reason = f"returned {type(built).__name__}, not a Network"
    msg = f"{where}: the builder {reason}"
    raise ConfigError([msg])


def _speed_power(
    exponent: float, about_ms: float = 1.0, *, always: bool = False
) -> Factor:
    """Return a power of the speed that equals the speed at *about_ms*.

    Exponent 1 is the speed itself; with *always* that is a table too.
    """
    if exponent == 1.0 and not always:
        return value("speed_ms")

    def power(v: float) -> float:
        return float(about_ms * (v / about_ms) ** exponent)

    table = Table.from_function(power, 0.0, SPEED_LIMIT_MS, 481)
    return value("speed_ms", table)


def _constant_and_table(quantity: float | Curve) -> tuple[float, Table | None]:
    if isinstance(quantity, float | int):
        return float(quantity), None
    return 1.0, curve_table(quantity)


def _at_reference(quantity: float | Curve) -> float:
    constant, table = _constant_and_table(quantity)
    return constant if table is None else table(REFERENCE_K)

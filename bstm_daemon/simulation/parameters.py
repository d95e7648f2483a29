"""What the reality's brake corner is made of, and which effects it has.

Figures of the nominal car: thesis vehicle 1 where the thesis gives them, and
otherwise the middle of the ranges for a 2.2 t car's front corner. The rear
corner is the same construction, smaller.

========================  =======  =======================================
quantity                  front    source
========================  =======  =======================================
ring mass                 7.5 kg   316 to 336 mm ventilated disc of 10 kg
swept area, one face      0.0425   both faces 0.085 m2
cheek thickness           10 mm    28 to 30 mm disc less 9 mm vent
effective radius          0.130 m  268 mm effective diameter, 330 mm disc
piston                    60 mm    thesis; rear 42 mm, floating, one piston
friction coefficient      0.38     410 Pa/N at the wheels (thesis 400)
lining rho, cp, k         2600,    low-metallic lining inside 2000 to 2900,
                          1050,    800 to 1300, 0.5 to 3; its effusivity
                          2.4      gives the pads 3 % of the friction heat
shim resistance           4.5e-3   rubber and steel layers, 1e-3 to 5e-3
fluid and caliper         2.6 kJ/K iron caliper 5.2 kg, 30 ml fluid
face, vent convection     c v^0.8  turbulent exponent (Limpert); the level
                                   gives a cooling rate S near 2e-3 1/s at
                                   36 km/h (1.2e-3 to 2.4e-3 on vehicles)
natural convection        4.2      3 to 5 W/(m2 K), Topouris et al. 2020
emissivity of faces,      0.70,    oxidised iron, lining, rusty vent
pad, vent                 0.90,
                          0.80
========================  =======  =======================================
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import pi
from typing import TYPE_CHECKING, Final

from bstm_daemon.errors import UsageError, hint

if TYPE_CHECKING:
    from bstm_daemon.simulation.materials import Array

LUMPS: Final = (
    "centre",
    "hat",
    "hub",
    "piston",
    "fluid",
    "body",
    "finger",
    "bracket",
    "air",
)
"""Lumps of a corner: vent region of the disc, hat, hub, caliper, air."""

DRAWN: Final = 3
"""Heat paths of a corner that may be drawn, the duct's included."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnPath:
    """A conductance from one part of the corner to another, of any form.

    ``conductance_w_k`` times (v / 20 m/s)^``speed_exponent``, times
    (T / 500 K)^``heat_exponent`` of the first part, times an S around
    ``onset_k`` (0: none) of width ``width_k``, times a bell around
    ``band_ms`` (0: none) of width ``band_width_ms``, both sides of the disc
    together. ``contact``: 1 with the brake held, -1 released, 0 always.
    ``start`` counts backplate, surface and inner cheek, then the lumps;
    ``end`` counts lumps, the last of them the ambient air.
    """

    start: int
    end: int
    conductance_w_k: float
    speed_exponent: float = 0.0
    heat_exponent: float = 0.0
    onset_k: float = 0.0
    width_k: float = 30.0
    band_ms: float = 0.0
    band_width_ms: float = 5.0
    contact: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CornerParameters:
    """One brake corner, SI units as the names say; defaults are the front.

    Areas of pad, backplate and shim are those of one pad; convection
    conductances are written ``(natural^3 + (forced * v^n)^3)^(1/3)`` with v in
    m/s.
    """

    # hydraulics and friction
    piston_area_m2: float = pi * 0.060**2 / 4
    piston_count: float = 1.0
    efficiency: float = 1.0
    friction_coefficient: float = 0.38
    effective_radius_m: float = 0.130
    piston_side_share: float = 0.5
    # disc
    ring_mass_kg: float = 7.5
    face_area_m2: float = 0.0425
    cheek_thickness_m: float = 0.010
    iron_density_kg_m3: float = 7200.0
    face_air_area_m2: float = 0.036
    vent_area_m2: float = 0.150
    vent_bridge_area_m2: float = 0.019
    face_emissivity: float = 0.70
    vent_emissivity: float = 0.80
    vent_opening_area_m2: float = 0.020
    natural_convection_w_m2k: float = 4.2
    parked_vent_fraction: float = 0.25
    forced_face_w_m2k: float = 6.0
    forced_vent_w_m2k: float = 6.0
    forced_exponent: float = 0.8
    # pads
    pad_area_m2: float = 6.5e-3
    pad_thickness_m: float = 0.011
    pad_density_kg_m3: float = 2600.0
    pad_heat_capacity_j_kgk: float = 1050.0
    pad_conductivity_w_mk: float = 2.4
    pad_emissivity: float = 0.90
    backplate_area_m2: float = 7.5e-3
    backplate_thickness_m: float = 0.006
    shim_resistance_m2k_w: float = 4.5e-3
    hammerhead_forced_w_k: float = 0.015
    # caliper and what carries it
    piston_capacity_j_k: float = 170.0
    fluid_capacity_j_k: float = 72.0
    body_capacity_j_k: float = 1430.0
    finger_capacity_j_k: float = 930.0
    bracket_capacity_j_k: float = 1150.0
    hat_capacity_j_k: float = 1200.0
    hub_capacity_j_k: float = 2800.0
    air_capacity_j_k: float = 60.0
    caliper_natural_w_k: float = 1.0
    caliper_forced_w_k: float = 0.25
    # how materials differ from the curves of materials.py
    iron_slope_j_kgk2: float = 0.0
    pad_capacity_slope_j_kgk2: float = 0.0
    pad_conductivity_slope_1_k: float = 0.0
    # the car gives every corner its own
    wheel_radius_m: float = 0.3418
    drawn_paths: tuple[DrawnPath, ...] = ()


FRONT: Final = CornerParameters()
"""Front corner of the nominal car."""

REAR: Final = CornerParameters(
    piston_area_m2=pi * 0.042**2 / 4,
    # 15 % of the brake force a corner against 35 % in front
    effective_radius_m=0.130 * (0.060 / 0.042) ** 2 * 15 / 35,
    ring_mass_kg=5.0,
    face_area_m2=0.036,
    cheek_thickness_m=0.0085,
    face_air_area_m2=0.031,
    vent_area_m2=0.055,
    vent_bridge_area_m2=0.034,
    vent_opening_area_m2=0.020,
    parked_vent_fraction=0.8,
    pad_area_m2=4.2e-3,
    pad_thickness_m=0.010,
    backplate_area_m2=4.8e-3,
    hammerhead_forced_w_k=0.010,
    piston_capacity_j_k=90.0,
    fluid_capacity_j_k=40.0,
    body_capacity_j_k=950.0,
    finger_capacity_j_k=650.0,
    bracket_capacity_j_k=800.0,
    hat_capacity_j_k=700.0,
    hub_capacity_j_k=2300.0,
    caliper_natural_w_k=0.7,
    caliper_forced_w_k=0.18,
)
"""Rear corner of the nominal car: solid disc, 42 mm piston."""


STRONGEST: Final = 3.0
"""Beyond this multiple of its typical size no effect is physical."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Effects:
    """Strength of every effect; 0 is off and 1 is typical.

    Numbers 1 to 30 of the effect table act in the brake corner, 31 to 37 in
    the car and its sensors.
    """

    friction_fade: float = 0.0
    friction_speed: float = 0.0
    friction_pressure: float = 0.0
    friction_history: float = 0.0
    pushout_pressure: float = 0.0
    hydraulic_lag: float = 0.0
    residual_drag: float = 0.0
    contact_conductance: float = 0.0
    gap_conduction: float = 0.0
    disc_capacity_hot: float = 0.0
    disc_radiation_driving: float = 0.0
    convection_exponent: float = 0.0
    local_air: float = 0.0
    hub_conduction: float = 0.0
    wet_disc: float = 0.0
    disc_wear: float = 0.0
    disc_hat: float = 0.0
    pad_conductivity: float = 0.0
    pad_capacity: float = 0.0
    pad_pyrolysis: float = 0.0
    pad_wear: float = 0.0
    backplate_loss: float = 0.0
    bracket_conduction: float = 0.0
    caliper_bypass: float = 0.0
    shim_contact: float = 0.0
    disc_caliper_radiation: float = 0.0
    caliper_fluid_split: float = 0.0
    caliper_radiation: float = 0.0
    fluid_exchange: float = 0.0
    fluid_latent_heat: float = 0.0
    thermocouple_offset: float = 0.0
    thermocouple_lag: float = 0.0
    accelerometer_bias: float = 0.0
    mass_error: float = 0.0
    brake_share: float = 0.0
    powertrain_torque_error: float = 0.0
    ambient_heat_soak: float = 0.0
    # beyond the table, see UNHEARD_NAMES
    dust_shield: float = 0.0
    brake_duct: float = 0.0
    damper_heat: float = 0.0

    def with_strength(self, name: str, strength: float) -> Effects:
        """Return a copy with the effect *name* at *strength*.

        Raises :class:`~bstm_daemon.errors.UsageError` for an unknown name or
        a strength outside 0 to :data:`STRONGEST`.
        """
        if name not in (*EFFECT_NAMES, *UNHEARD_NAMES):
            known = hint(name, EFFECT_NAMES, "docs/effects.md lists them")
            msg = f"no effect {name!r}: {known}"
            raise UsageError(msg)
        if not 0.0 <= strength <= STRONGEST:
            msg = (
                f"effect {name}: strength {strength:g} is not "
                f"0 to {STRONGEST:g}"
            )
            raise UsageError(msg)
        return replace(self, **{name: strength})


UNHEARD_NAMES: Final = ("dust_shield", "brake_duct", "damper_heat")
"""What acts in the brake corner and is in no catalogue."""

EFFECT_NAMES: Final = tuple(
    field.name for field in fields(Effects) if field.name not in UNHEARD_NAMES
)
"""The effects in the order of their numbers, 1 to 37."""

PATH_NAMES: Final = tuple(f.name for f in fields(DrawnPath))
CORNER_NAMES: Final = tuple(
    f.name for f in fields(CornerParameters) if f.name != "drawn_paths"
)
ACTING_NAMES: Final = (*EFFECT_NAMES, *UNHEARD_NAMES)
PARAMETER_NAMES: Final = (*CORNER_NAMES, *ACTING_NAMES)
"""Rows of the parameter table, in order."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inputs:
    """Inputs of the corners during one step, each (lanes,) or (1,).

    ``power_w`` is friction power, ``contact`` the fraction of the step with
    pressed pads, ``pumping_pa_s`` the mean of the absolute pressure rate.
    """

    speed_ms: Array
    power_w: Array
    pressure_pa: Array
    contact: Array
    ambient_k: Array
    wetness: Array
    pumping_pa_s: Array


INPUT_NAMES: Final = tuple(field.name for field in fields(Inputs))
"""Rows of the inputs of a step, in the order of the compiled form."""


ROAD_EFFECTS: Final = (
    "friction_fade",
    "friction_speed",
    "friction_pressure",
    "gap_conduction",
    "disc_radiation_driving",
    "local_air",
    "disc_hat",
    "bracket_conduction",
    "disc_caliper_radiation",
    "caliper_fluid_split",
    "contact_conductance",
)
"""Effects of the preset ``road``: those a usual brake plainly has."""

PRESETS: Final[dict[str, Effects]] = {
    "plain": Effects(),
    "road": Effects(**dict.fromkeys(ROAD_EFFECTS, 1.0)),
}
"""Preset name to strengths; ``plain`` has every effect off."""


def preset_effects(name: str) -> Effects:
    """Return the strengths of the preset *name*.

    Raises :class:`~bstm_daemon.errors.UsageError` for an unknown name.
    """
    try:
        return PRESETS[name]
    except KeyError:
        msg = f"no preset {name!r}: {hint(name, PRESETS)}"
        raise UsageError(msg) from None


@dataclass(frozen=True, slots=True)
class Mesh:
    """Cells of one side of the corner.

    ``pad_nodes`` counts the nodes of a lining with a half cell at each
    surface; ``cheek_depths`` are the nodes of a cheek as fractions of its
    thickness from the friction surface, rising from 0.
    """

    pad_nodes: int = 25
    cheek_depths: tuple[float, ...] = (0.0, 0.05, 0.15, 0.35, 0.70)


DEFAULT_MESH: Final = Mesh()
"""The reality's usual cells."""

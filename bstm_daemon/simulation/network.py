"""Heat paths of a brake corner: conductances and sources at one instant.

Every path is written as a symmetric conductance times a temperature
difference (radiation as ``sigma eps A (T1^2 + T2^2)(T1 + T2)``), so what
leaves one node enters the other exactly. Friction heat is released at the
interface and divided by the effusivities of the two surfaces at their present
temperatures, pad area against swept ring; contact under pressure adds
conduction across the interface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.simulation import materials
from bstm_daemon.simulation.lanes import (
    AIR,
    BODY,
    BRACKET,
    CENTRE,
    FINGER,
    FLUID,
    HAT,
    HUB,
    LUMPS,
    PATH_NAMES,
    PISTON,
    Inputs,
    Lanes,
    State,
)
from bstm_daemon.simulation.parameters import DrawnPath
from bstm_daemon.units import STEFAN_BOLTZMANN_W_M2K4

if TYPE_CHECKING:
    from bstm_daemon.simulation.materials import Array, Indices

_STEEL_CONDUCTIVITY_W_MK = 48.0
_VENT_HALF_GAP_M = 0.004
_TIGHT_W_K = 80.0
_OPEN_AIR_W_K = 1e5

# typical strength of the paths that effects switch on
_CONTACT_W_M2K = 360.0
_CONTACT_PA = 2.0e6
_GAP_M = 3.0e-4
_HAT_W_K = 5.0
_HUB_W_K = 1.0
_HAT_AIR_M2 = 0.05
_EXPONENT_RISE = 0.45
_BACKPLATE_LOSS_W_K = 0.12
_BRACKET_W_K = 0.18
_BRACKET_BRAKING_W_K = 0.14
_BYPASS_W_K = 0.25
_SHIM_LOOSE = 0.35
_SHIM_PA = 2.0e5
_VIEW_OF_DISC_M2 = 0.0015
_CALIPER_AREA_M2 = np.array([[0.030], [0.020]])
_LINE_W_K = 0.05
_PUMPING_W_K = 1.5
_PUMPING_PA_S = 3.0e6
_SPRAY_KG_S_PER_MS = 1.2e-5
_SPRAY_STILL_KG_S = 5.0e-5
_EVAPORATION_J_KG = 2.4e6
_DRAG_COLD_NM = 1.5
_DRAG_HOT_NM = 3.5
_DRAG_K = 80.0


# Heat paths that are in no catalogue of effects: see _shield, _damper_power
# and lanes.DUCT

# 0.03 m2 of the face, iron of 0.7 before zinc of 0.3, 10 mm of air
_FACING_M2 = 0.03
_GREY = 0.27
_FILM_W_M2K = 4.0
_STIRRED_W_M2K = 2.0
# lug of 0.8 mm sheet, 0.25 m wide, 0.03 m long
_LUG_W_K = 0.32
# both sides of the sheet in the wheel house
_SHEET_M2 = 0.06
_SHEET_W_M2K = 5.0
_SHEET_BLOWN_W_M2K = 3.0

# a tenth of 15 W s/m a corner: average road, 3.7; one ISO 8608 class rougher,
# four times that
_DAMPER_WS_M = 1.5


@dataclass(slots=True)
class Paths:
    """Conductances [W/K], sources [W] and capacities [J/K] at one instant.

    ``conductance`` (lanes, nodes, nodes) times the excess over the ambient is
    what leaves each node, ``to_ambient`` (lanes, nodes) the part of it that
    leaves the corner; ``source_w`` and ``capacity_j_k`` are (lanes, nodes),
    ``heat_in_w`` (lanes,) is the friction's.
    """

    conductance: Array
    to_ambient: Array
    source_w: Array
    heat_in_w: Array
    capacity_j_k: Array


def _radiation(a_k: Array, b_k: Array, exchange_m2: Array | float) -> Array:
    sigma = STEFAN_BOLTZMANN_W_M2K4
    return sigma * exchange_m2 * (a_k * a_k + b_k * b_k) * (a_k + b_k)


def mixed(natural: Array | float, forced: Array) -> Array:
    """Return the mixed convection ``(natural^3 + forced^3)^(1/3)``."""
    total: Array = np.cbrt(natural**3 + forced**3)
    return total


def radiating_share(speed_ms: Array, driving: Array) -> Array:
    """Return the share of disc radiation that counts at *speed_ms*.

    1 at rest, fading around walking pace to *driving* (0: none).
    """
    rest = 1.0 / (1.0 + (speed_ms / 2.2) ** 4)
    return rest + (1.0 - rest) * np.minimum(driving, 1.0)


def paths(lanes: Lanes, state: State, inputs: Inputs) -> Paths:
    """Return all conductances and sources of *state* under *inputs*."""
    p = lanes.p
    v = inputs.speed_ms
    faces, vent = _cooling(lanes, state, v)
    matrix = np.zeros((lanes.count, lanes.nodes, lanes.nodes))
    for side, link in enumerate(_chain_links(lanes, state, inputs)):
        nodes = lanes.chain_nodes * side + np.arange(lanes.chain_nodes)
        _join(matrix, nodes[:-1], nodes[1:], link)
    _join_chains_to_lumps(lanes, state, inputs, faces, matrix)
    _join_lumps(lanes, v, vent, matrix)
    if lanes.shields:
        _shield(lanes, state, v, matrix)
    radiates = radiating_share(v, p.disc_radiation_driving)
    chain_out = np.zeros_like(state.chain_k)
    chain_out[lanes.surface] = _radiation(
        state.chain_k[lanes.surface],
        inputs.ambient_k,
        p.face_emissivity * p.face_air_area_m2 * radiates,
    )
    lump_out = _ambient_links(lanes, state, inputs, radiates)
    _join_drawn(lanes, state, inputs, matrix, lump_out)
    to_ambient = lanes.joined(chain_out, lump_out)
    # what a node gives to all others
    own = np.arange(lanes.nodes)
    matrix[:, own, own] = to_ambient - matrix.sum(axis=2)
    chain_source, heat_in = _sources(lanes, state, inputs)
    return Paths(
        matrix,
        to_ambient,
        lanes.joined(chain_source, _damper_power(lanes, v)),
        heat_in,
        lanes.joined(lanes.chain_capacity(state), lanes.lump_capacity(state)),
    )


def _cooling(lanes: Lanes, state: State, v: Array) -> tuple[Array, Array]:
    """Convection of the cheeks' faces (2, lanes) and the vent (lanes,)."""
    p = lanes.p
    # a steeper rise with speed leaves 36 km/h, where the levels are given
    steeper = _EXPONENT_RISE * p.convection_exponent * (v - 10.0) / (v + 20.0)
    forced = v**p.forced_exponent * np.maximum(1.0 + steeper, 0.2)
    t_surface = state.chain_k[lanes.surface]
    excess = np.abs(t_surface - state.lump_k[AIR])
    buoyancy = np.sqrt(np.sqrt(np.maximum(excess, 1.0) / 200.0))
    natural = p.natural_convection_w_m2k * buoyancy
    # per unit of v^n: forced_*_w_m2k is the coefficient at 1 m/s
    faces = p.face_air_area_m2 * mixed(natural, p.forced_face_w_m2k * forced)
    vent = p.vent_area_m2 * mixed(
        p.parked_vent_fraction * natural.mean(axis=0),
        p.forced_vent_w_m2k * forced,
    )
    return faces, vent


def _chain_links(lanes: Lanes, state: State, inputs: Inputs) -> Array:
    """Return the links along each chain, (2, lanes, chain nodes - 1)."""
    p = lanes.p
    t_front, t_surface = state.chain_k[lanes.surface - 1 : lanes.surface + 1]
    link = np.empty((lanes.chain_nodes - 1, 2, lanes.count))
    link[0] = p.backplate_area_m2 / (
        p.backplate_thickness_m / (2 * _STEEL_CONDUCTIVITY_W_MK)
    )
    gap_m = state.pad_m / (lanes.mesh.pad_nodes - 1)
    pad_k = state.chain_k[lanes.pad]
    conductivity = materials.lining_conductivity(
        (pad_k[1:] + pad_k[:-1]) / 2, lanes.lining_k
    )
    link[1 : lanes.surface - 1] = conductivity * (p.pad_area_m2 / gap_m)
    cheek_k = state.chain_k[lanes.cheek]
    link[lanes.surface :] = materials.iron_conductivity(
        (cheek_k[1:] + cheek_k[:-1]) / 2
    ) * (p.face_area_m2 / lanes.cheek_gap_m[:-1])
    grey = 1.0 / (1.0 / p.face_emissivity + 1.0 / p.pad_emissivity - 1.0)
    interface = _radiation(t_front, t_surface, grey * p.pad_area_m2)
    if lanes.gaps:
        air = materials.air_conductivity((t_front + t_surface) / 2)
        released = p.gap_conduction * (1.0 - inputs.contact)
        interface += released * p.pad_area_m2 * air / _GAP_M
    pressed = p.contact_conductance * inputs.contact
    interface += (
        pressed
        * p.pad_area_m2
        * _CONTACT_W_M2K
        * inputs.pressure_pa
        / (inputs.pressure_pa + _CONTACT_PA)
    )
    link[lanes.surface - 1] = interface
    return link.transpose(1, 2, 0)


def _join_chains_to_lumps(
    lanes: Lanes, state: State, inputs: Inputs, faces: Array, matrix: Array
) -> None:
    p = lanes.p
    shim = p.pad_area_m2 / p.shim_resistance_m2k_w
    loose = (
        _SHIM_LOOSE * p.shim_contact * np.exp(-inputs.pressure_pa / _SHIM_PA)
    )
    shim = shim * np.maximum(1.0 - loose, 0.05)
    t_back = state.chain_k[0]
    excess = np.maximum(np.abs(t_back - state.lump_k[AIR]), 1.0)
    loss = (
        p.hammerhead_forced_w_k * inputs.speed_ms** 0.8
        + _BACKPLATE_LOSS_W_K
        * p.backplate_loss
        * np.sqrt(np.sqrt(excess / 100.0))
    )
    # friction presses the hammerheads against the bracket
    bracket = p.bracket_conduction * (
        _BRACKET_W_K + _BRACKET_BRAKING_W_K * inputs.contact
    )
    across = _BYPASS_W_K * p.caliper_bypass * t_back / 400.0
    cheek_k = state.chain_k[-1]
    to_vanes_per_m = (
        lanes.cheek_gap_m[-1] / p.face_area_m2
        + _VENT_HALF_GAP_M / p.vent_bridge_area_m2
    )
    bridge = materials.iron_conductivity(cheek_k) / to_vanes_per_m
    t_surface = state.chain_k[lanes.surface]
    for side, behind, bypass in ((0, PISTON, BODY), (1, FINGER, FINGER)):
        back = lanes.chain_nodes * side
        surface, last = back + lanes.surface, back + lanes.chain_nodes - 1
        view = p.face_emissivity * _VIEW_OF_DISC_M2 * p.disc_caliper_radiation
        bypass_k = state.lump_k[bypass]
        for node, lump, conductance in (
            (back, behind, shim),
            (back, bypass, across[side]),
            (back, BRACKET, bracket),
            (back, AIR, loss[side]),
            (surface, AIR, faces[side]),
            (surface, bypass, _radiation(t_surface[side], bypass_k, view)),
            (last, CENTRE, bridge[side]),
        ):
            _join(matrix, node, lanes.first_lump + lump, conductance)


def _join_lumps(lanes: Lanes, v: Array, vent: Array, matrix: Array) -> None:
    p, first = lanes.p, lanes.first_lump
    split = p.caliper_fluid_split
    caliper = mixed(p.caliper_natural_w_k, p.caliper_forced_w_k * v**0.7)
    pairs = (
        (CENTRE, AIR, vent),
        (CENTRE, HAT, _HAT_W_K * p.disc_hat),
        (CENTRE, HUB, _HUB_W_K * p.hub_conduction),
        (HAT, AIR, _HAT_AIR_M2 * vent / p.vent_area_m2),
        (PISTON, FLUID, 1.0 / (1.0 / _TIGHT_W_K + split / 6.0)),
        (FLUID, BODY, 1.0 / (1.0 / _TIGHT_W_K + split / 20.0)),
        (BODY, FINGER, 1.0 / (1.0 / _TIGHT_W_K + split / 2.5)),
        (BODY, AIR, 0.6 * caliper),
        (FINGER, AIR, 0.4 * caliper),
    )
    for a, b, conductance in pairs:
        _join(matrix, first + a, first + b, conductance)


def _join(
    matrix: Array, a: Indices | int, b: Indices | int, conductance: Array
) -> None:
    matrix[:, a, b] -= conductance
    matrix[:, b, a] -= conductance


def _shield(lanes: Lanes, state: State, v: Array, matrix: Array) -> None:
    """Add the dust shield behind the piston's face.

    A sheet of steel behind the disc, bolted to the caliper's lug. Face and
    shield exchange heat by radiation and through the air between them, the
    shield gives it on to the caliper and to the air. Its own 0.2 kJ/K are
    left out, which makes the three conductances a star about it.
    """
    face_k, body_k = state.chain_k[lanes.surface, 0], state.lump_k[BODY]
    blown = v**0.8
    squares = face_k * face_k + body_k * body_k
    near = _FACING_M2 * (
        _GREY * STEFAN_BOLTZMANN_W_M2K4 * squares * (face_k + body_k)
        + _FILM_W_M2K
        + _STIRRED_W_M2K * blown
    )
    away = _SHEET_M2 * (_SHEET_W_M2K + _SHEET_BLOWN_W_M2K * blown)
    share = lanes.p.dust_shield / (near + _LUG_W_K + away)
    body, air = lanes.first_lump + BODY, lanes.first_lump + AIR
    _join(matrix, lanes.surface, body, share * near * _LUG_W_K)
    _join(matrix, lanes.surface, air, share * near * away)
    _join(matrix, body, air, share * _LUG_W_K * away)


def _join_drawn(
    lanes: Lanes, state: State, inputs: Inputs, matrix: Array, out: Array
) -> None:
    """Add the paths of ``CornerParameters.drawn_paths``."""
    ports = (0, lanes.surface, lanes.chain_nodes - 1)
    nodes_k = lanes.joined(state.chain_k, state.lump_k)
    speeds, contacts = (
        np.broadcast_to(one, lanes.count)
        for one in (inputs.speed_ms, inputs.contact)
    )
    for lane, i in np.argwhere(lanes.drawn[:, :, 2]).tolist():
        values = lanes.drawn[lane, i].tolist()
        path = DrawnPath(**dict(zip(PATH_NAMES, values, strict=True)))
        v, held = speeds[lane], contacts[lane]
        base = path.conductance_w_k * (v / 20.0) ** path.speed_exponent
        if path.band_ms:
            off = (v - path.band_ms) / path.band_width_ms
            base *= np.exp(-off * off)
        if path.contact:
            base *= held if path.contact > 0.0 else 1.0 - held
        lump = lanes.first_lump + int(path.start) - len(ports)
        starts = [lump]
        if lump < lanes.first_lump:
            port = ports[int(path.start)]
            starts = [port, lanes.chain_nodes + port]
        for own in starts:
            t = nodes_k[lane, own]
            across = base * (t / 500.0) ** path.heat_exponent / len(starts)
            if path.onset_k:
                above = (t - path.onset_k) / (2.0 * path.width_k)
                across *= 0.5 * (1.0 + np.tanh(above))
            if path.end == len(LUMPS):
                out[own - lanes.first_lump, lane] += across
            else:
                other = lanes.first_lump + int(path.end)
                matrix[lane, own, other] -= across
                matrix[lane, other, own] -= across


def _damper_power(lanes: Lanes, v: Array) -> Array:
    """Heat of the damper that flows through the strut's clamp, by lump.

    Damper power is proportional to roughness and speed; Zuo and Zhang (2013)
    give up to 400 W a car at 97 km/h on an average road.
    """
    gains = np.zeros((len(LUMPS), lanes.count))
    gains[BODY] = lanes.p.damper_heat * _DAMPER_WS_M * v
    return gains


def _ambient_links(
    lanes: Lanes, state: State, inputs: Inputs, radiates: Array
) -> Array:
    p = lanes.p
    v = inputs.speed_ms
    out = np.zeros((len(LUMPS), lanes.count))
    ambient = inputs.ambient_k
    out[CENTRE] = _radiation(
        state.lump_k[CENTRE],
        ambient,
        p.vent_emissivity * p.vent_opening_area_m2 * radiates,
    )
    out[AIR] = 1.0 / (1.0 / _OPEN_AIR_W_K + p.local_air / (12.0 + 25.0 * v))
    out[HUB] = 1.2 + 0.1 * v**0.8
    out[BRACKET] = 1.0 + 0.12 * v**0.8
    calipers = state.lump_k[BODY : FINGER + 1]
    out[BODY : FINGER + 1] = _radiation(
        calipers, ambient, 0.9 * _CALIPER_AREA_M2 * p.caliper_radiation
    )
    out[FLUID] = p.fluid_exchange * (
        _LINE_W_K
        + _PUMPING_W_K
        * inputs.pumping_pa_s
        / (inputs.pumping_pa_s + _PUMPING_PA_S)
    )
    return out


def _sources(
    lanes: Lanes, state: State, inputs: Inputs
) -> tuple[Array, Array]:
    """Friction heat and its division, less what spray carries off."""
    p = lanes.p
    front = lanes.surface - 1
    t_front, t_surface = state.chain_k[front], state.chain_k[front + 1]
    pad = p.pad_area_m2 * np.sqrt(
        materials.lining_conductivity(t_front, lanes.lining_k)
        * p.pad_density_kg_m3
        * materials.lining_heat_capacity(t_front, lanes.lining)
    )
    ring = p.face_area_m2 * np.sqrt(
        materials.iron_conductivity(t_surface)
        * p.iron_density_kg_m3
        * materials.iron_heat_capacity(t_surface, *lanes.iron)
    )
    released = (1.0 - inputs.contact) * p.residual_drag
    # a hot seal and expanded pads draw the piston back less
    warm = np.maximum(state.chain_k[0].mean(axis=0) - 293.15, 0.0)
    drag_nm = _DRAG_COLD_NM - _DRAG_HOT_NM * np.expm1(-warm / _DRAG_K)
    heat_in = inputs.power_w + (
        released * drag_nm * inputs.speed_ms / p.wheel_radius_m
    )
    piston = p.piston_side_share
    heat = heat_in * np.array([piston, 1.0 - piston])
    to_pad = pad / (pad + ring)
    source = np.zeros_like(state.chain_k)
    source[front] = to_pad * heat
    source[lanes.surface] = (1.0 - to_pad) * heat
    if lanes.wets and inputs.wetness.any():
        spray = _SPRAY_STILL_KG_S + _SPRAY_KG_S_PER_MS * inputs.speed_ms
        above = np.maximum(t_surface - inputs.ambient_k, 0.0)
        source[lanes.surface] -= (
            p.wet_disc
            * inputs.wetness
            * spray
            * _EVAPORATION_J_KG
            * -np.expm1(-above / 70.0)
            / 2
        )
    return source, heat_in

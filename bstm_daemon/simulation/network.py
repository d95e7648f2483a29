"""Heat paths of a brake corner: conductances and sources at one instant.

Every path is written as a symmetric conductance times a temperature
difference (radiation as ``sigma eps A (T1^2 + T2^2)(T1 + T2)``), so what
leaves one node enters the other exactly. Friction heat is released at the
interface and divided by the effusivities of the two surfaces at their present
temperatures, pad area against swept ring; contact under pressure adds
conduction across the interface.
"""

from dataclasses import dataclass

import numpy as np

from bstm_daemon.simulation import materials, sizes
from bstm_daemon.simulation.lanes import (
    AIR,
    BODY,
    BRACKET,
    CENTRE,
    FINGER,
    FLUID,
    HAT,
    HUB,
    PISTON,
    Lanes,
    State,
)
from bstm_daemon.simulation.materials import Array, Indices
from bstm_daemon.simulation.parameters import (
    LUMPS,
    PATH_NAMES,
    DrawnPath,
    Inputs,
)


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
    return sizes.SIGMA * exchange_m2 * (a_k * a_k + b_k * b_k) * (a_k + b_k)


def mixed(natural: Array | float, forced: Array) -> Array:
    """Return the mixed convection ``(natural^3 + forced^3)^(1/3)``."""
    total: Array = np.cbrt(natural**3 + forced**3)
    return total


def radiating_share(speed_ms: Array, driving: Array) -> Array:
    """Return the share of disc radiation that counts at *speed_ms*.

    1 at rest, fading around walking pace to *driving* (0: none).
    """
    rest = 1.0 / (1.0 + (speed_ms / sizes.WALKING_MS) ** 4)
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
    steeper = (
        sizes.EXPONENT_RISE * p.convection_exponent * (v - 10.0) / (v + 20.0)
    )
    forced = v**p.forced_exponent * np.maximum(1.0 + steeper, 0.2)
    t_surface = state.chain_k[lanes.surface]
    excess = np.abs(t_surface - state.lump_k[AIR])
    buoyancy = np.sqrt(np.sqrt(np.maximum(excess, 1.0) / sizes.BUOYANCY_K))
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
        p.backplate_thickness_m / (2 * sizes.STEEL_CONDUCTIVITY_W_MK)
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
        interface += released * p.pad_area_m2 * air / sizes.GAP_M
    pressed = p.contact_conductance * inputs.contact
    interface += (
        pressed
        * p.pad_area_m2
        * sizes.CONTACT_W_M2K
        * inputs.pressure_pa
        / (inputs.pressure_pa + sizes.CONTACT_PA)
    )
    link[lanes.surface - 1] = interface
    return link.transpose(1, 2, 0)


def _join_chains_to_lumps(
    lanes: Lanes, state: State, inputs: Inputs, faces: Array, matrix: Array
) -> None:
    p = lanes.p
    shim = p.pad_area_m2 / p.shim_resistance_m2k_w
    loose = (
        sizes.SHIM_LOOSE
        * p.shim_contact
        * np.exp(-inputs.pressure_pa / sizes.SHIM_PA)
    )
    shim = shim * np.maximum(1.0 - loose, 0.05)
    t_back = state.chain_k[0]
    excess = np.maximum(np.abs(t_back - state.lump_k[AIR]), 1.0)
    loss = (
        p.hammerhead_forced_w_k * inputs.speed_ms** 0.8
        + sizes.BACKPLATE_LOSS_W_K
        * p.backplate_loss
        * np.sqrt(np.sqrt(excess / sizes.BACKPLATE_LOSS_K))
    )
    # friction presses the hammerheads against the bracket
    bracket = p.bracket_conduction * (
        sizes.BRACKET_W_K + sizes.BRACKET_BRAKING_W_K * inputs.contact
    )
    across = sizes.BYPASS_W_K * p.caliper_bypass * t_back / sizes.BYPASS_K
    cheek_k = state.chain_k[-1]
    to_vanes_per_m = (
        lanes.cheek_gap_m[-1] / p.face_area_m2
        + sizes.VENT_HALF_GAP_M / p.vent_bridge_area_m2
    )
    bridge = materials.iron_conductivity(cheek_k) / to_vanes_per_m
    t_surface = state.chain_k[lanes.surface]
    for side, behind, bypass in ((0, PISTON, BODY), (1, FINGER, FINGER)):
        back = lanes.chain_nodes * side
        surface, last = back + lanes.surface, back + lanes.chain_nodes - 1
        view = (
            p.face_emissivity
            * sizes.VIEW_OF_DISC_M2
            * p.disc_caliper_radiation
        )
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
        (CENTRE, HAT, sizes.HAT_W_K * p.disc_hat),
        (CENTRE, HUB, sizes.HUB_W_K * p.hub_conduction),
        (HAT, AIR, sizes.HAT_AIR_M2 * vent / p.vent_area_m2),
        (
            PISTON,
            FLUID,
            1.0 / (1.0 / sizes.TIGHT_W_K + split / sizes.SPLIT_PISTON_W_K),
        ),
        (
            FLUID,
            BODY,
            1.0 / (1.0 / sizes.TIGHT_W_K + split / sizes.SPLIT_BODY_W_K),
        ),
        (
            BODY,
            FINGER,
            1.0 / (1.0 / sizes.TIGHT_W_K + split / sizes.SPLIT_FINGER_W_K),
        ),
        (BODY, AIR, sizes.BODY_SHARE * caliper),
        (FINGER, AIR, sizes.FINGER_SHARE * caliper),
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
    near = sizes.FACING_M2 * (
        sizes.GREY * sizes.SIGMA * squares * (face_k + body_k)
        + sizes.FILM_W_M2K
        + sizes.STIRRED_W_M2K * blown
    )
    away = sizes.SHEET_M2 * (
        sizes.SHEET_W_M2K + sizes.SHEET_BLOWN_W_M2K * blown
    )
    share = lanes.p.dust_shield / (near + sizes.LUG_W_K + away)
    body, air = lanes.first_lump + BODY, lanes.first_lump + AIR
    _join(matrix, lanes.surface, body, share * near * sizes.LUG_W_K)
    _join(matrix, lanes.surface, air, share * near * away)
    _join(matrix, body, air, share * sizes.LUG_W_K * away)


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
    gains[BODY] = lanes.p.damper_heat * sizes.DAMPER_WS_M * v
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
    out[AIR] = 1.0 / (
        1.0 / sizes.OPEN_AIR_W_K
        + p.local_air / (sizes.AIR_STILL_W_K + sizes.AIR_BLOWN_W_K * v)
    )
    out[HUB] = sizes.HUB_STILL_W_K + sizes.HUB_BLOWN_W_K * v**0.8
    out[BRACKET] = sizes.BRACKET_STILL_W_K + sizes.BRACKET_BLOWN_W_K * v**0.8
    calipers = state.lump_k[BODY : FINGER + 1]
    areas_m2 = np.array([[sizes.BODY_AREA_M2], [sizes.FINGER_AREA_M2]])
    out[BODY : FINGER + 1] = _radiation(
        calipers,
        ambient,
        sizes.CALIPER_EMISSIVITY * areas_m2 * p.caliper_radiation,
    )
    out[FLUID] = p.fluid_exchange * (
        sizes.LINE_W_K
        + sizes.PUMPING_W_K
        * inputs.pumping_pa_s
        / (inputs.pumping_pa_s + sizes.PUMPING_PA_S)
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
    warm = np.maximum(state.chain_k[0].mean(axis=0) - sizes.REFERENCE_K, 0.0)
    drag_nm = sizes.DRAG_COLD_NM - sizes.DRAG_HOT_NM * np.expm1(
        -warm / sizes.DRAG_K
    )
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
        spray = (
            sizes.SPRAY_STILL_KG_S + sizes.SPRAY_KG_S_PER_MS * inputs.speed_ms
        )
        above = np.maximum(t_surface - inputs.ambient_k, 0.0)
        source[lanes.surface] -= (
            p.wet_disc
            * inputs.wetness
            * spray
            * sizes.EVAPORATION_J_KG
            * -np.expm1(-above / sizes.SPRAY_K)
            / 2
        )
    return source, heat_in

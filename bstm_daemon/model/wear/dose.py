"""The wear dose: memories of the network that the kernel integrates.

Wear per joule does not depend on the speed and is constant below 320 degC;
above it rises steeply (thesis section 2.6, Fig 2.7, after Zhang 2009). So the
dose is the friction energy with a weight over the temperature of the friction
face. By Archard (Eq 2.13) wear goes with contact pressure times sliding
speed; as ``mu p v A`` is a power, that dose has the same unit, and both differ
only where the heat is not from the pressure or mu is not the configured one.
"""

from math import ceil, log2
from typing import Final

from bstm_daemon.config.estimates import WearConfig
from bstm_daemon.config.sections import Config, CornerConfig
from bstm_daemon.model.heat.feed_forward import PressureTorque
from bstm_daemon.model.thermal.network import Factor, Memory, Network, value
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

DOSE: Final = "wear_dose_j"
DISTANCE: Final = "wear_distance_m"

PADS: Final = 2
PRESSURE_LIMIT_PA: Final = 4.0e7
"""Upper end of the table over pressure, where hydraulics burst."""

DOSE_LIMIT_J: Final = 1.0e13
DISTANCE_LIMIT_M: Final = 1.0e10
"""Beyond any pad's life, and exact to a joule and a metre."""

_HOT_STEP_K: Final = 5.0


def with_wear_memories(
    net: Network, config: Config, corner: CornerConfig
) -> Network:
    """Add the memory of its wear dose to *net*, the network of *corner*.

    Raises:
        NetworkError: it has no node ``pad_front``.
    """
    net.node("pad_front")
    hot = value("pad_front", hot_wear(config.wear))
    if config.wear.law == "archard":
        scale, factors = _sliding(config, corner)
    else:
        scale, factors = 1.0, (value("brake_power_w"),)
    return net.with_memory(
        Memory(DOSE, "integral", scale, (*factors, hot), upper=DOSE_LIMIT_J),
        Memory(
            DISTANCE,
            "integral",
            1.0,
            (value("speed_ms"),),
            upper=DISTANCE_LIMIT_M,
        ),
    )


def hot_wear(wear: WearConfig) -> Table:
    """Weight of a joule over the temperature [K] of the friction face.

    1 up to ``hot_from_c``, doubling every ``hot_doubling_k`` above, the shape
    of Fig 2.7; at ``hot_limit`` the table ends and the weight is held. So no
    temperature, however wrong, wears more than ``hot_limit`` times the
    friction energy.
    """
    rise_k = wear.hot_doubling_k * log2(wear.hot_limit)
    weights = (
        2.0 ** (i * _HOT_STEP_K / wear.hot_doubling_k)
        for i in range(max(ceil(rise_k / _HOT_STEP_K), 1) + 1)
    )
    return Table(
        wear.hot_from_c + KELVIN_OFFSET,
        _HOT_STEP_K,
        tuple(min(weight, wear.hot_limit) for weight in weights),
    )


def pad_rate_m_j(config: Config, corner: CornerConfig) -> float:
    """Expected lining loss per dose [m/J]: both pads share the energy."""
    if corner.pad is None:
        msg = f"corner {corner.name}: no pads"
        raise ValueError(msg)
    return config.wear.pad_wear_m3_j / (PADS * corner.pad.area_m2)


def disc_rate_m_j(config: Config, corner: CornerConfig) -> float:
    """Expected loss of disc thickness, both faces, per dose [m/J]."""
    if corner.disc is None:
        msg = f"corner {corner.name}: no disc"
        raise ValueError(msg)
    # half the swept area is one face, and both lose
    return config.wear.disc_wear_m3_j / (0.5 * corner.disc.swept_area_m2)


def _sliding(
    config: Config, corner: CornerConfig
) -> tuple[float, tuple[Factor, ...]]:
    """Scale and factors of ``mu p_contact v_slide A``.

    The torque is ``mu p_contact A r`` and ``v_slide = v r / R_w``, so that
    the product is torque times wheel speed.
    """
    torque = PressureTorque.of_corner(corner)
    start_pa = torque.pushout_pressure_pa
    span_pa = PRESSURE_LIMIT_PA - start_pa
    scale = torque.torque_per_pressure_nm_pa / config.vehicle.wheel_radius_m
    return scale, (
        value("pressure_pa", Table(start_pa, span_pa, (0.0, span_pa))),
        value("speed_ms"),
    )

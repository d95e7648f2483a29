"""The configuration flattened into the arrays of the per-sample pass.

The Python form reads :class:`PlanNumbers`, the compiled one the same as
structs.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Final

from bstm_daemon.channels import MODES, SLOPES
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.model.heat.feed_forward import PressureTorque
from bstm_daemon.model.heat.friction_law import FrictionLaw
from bstm_daemon.model.heat.memory import PER_CORNER, Corners, Values
from bstm_daemon.native.layout import pack, zeros
from bstm_daemon.roles import CORNERS, ROLE_INDEX, ROLES
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.config.sections import Config, CornerConfig

PLAN_LAYOUT: Final = 9
"""Version of the memory's layout: a state saved with another is not resumed.
"""

NOT_MAPPED: Final = float("-inf")
"""Timeout of a role without a signal."""


@dataclass(slots=True)
class PlanNumbers:
    """Numbers of a plan; of lists per corner only the first entries are used.

    ``place`` is the corner's index in :data:`~bstm_daemon.roles.CORNERS`,
    ``secondary`` whether it is on the secondary circuit; ``points`` counts
    those of the rear axle's pressure table. The timeouts are in us.
    """

    corners: int
    mode: int
    slope: int
    points: int
    pressure_mapped: int
    torque_assumed: int
    has_laws: int
    step_us: int
    place: Annotated[list[int], PER_CORNER]
    secondary: Annotated[list[int], PER_CORNER]
    mass_kg: float
    rotating_kg: float
    radius_m: float
    quadratic: float
    linear: float
    constant: float
    ambient_k: float
    assumed_torque_nm: float
    on_pressure_pa: float
    on_force_n: float
    filter_s: float
    settling_s: float
    unpressed_share: float
    torque_per_pa: Corners
    pushout_pa: Corners
    lag_s: Corners
    force_share: Corners
    timeout: Values


@dataclass(frozen=True, slots=True)
class SamplePlan:
    """The plan of the pass, as numbers and as the arrays of both forms.

    ``floats`` continues with the table of the rear axle's pressure (front,
    then rear) and with each corner's friction law, if there are any.
    """

    numbers: PlanNumbers
    table_front_pa: Sequence[float]
    table_rear_pa: Sequence[float]
    laws: Sequence[Sequence[float]]
    ints: array[int]
    floats: array[float]
    corners: tuple[str, ...]
    step_us: int


def plan_samples(
    config: Config,
    present: Mapping[int, int],
    step_us: int,
    settling_s: float = 86_400.0,
    laws: Mapping[str, FrictionLaw] | None = None,
    unpressed_share: float = 0.0,
) -> SamplePlan:
    """Flatten *config*.

    Args:
        config: the configuration.
        present: role number to timeout [us], for each role that is mapped.
        step_us: the estimator's step [us].
        settling_s: the longest time that past heat has an effect [s].
        laws: friction of corners by name, where it is not nominal.
        unpressed_share: share of the braking without pressure that is counted
            as heat.
    """
    vehicle = Vehicle.of_config(config.vehicle)
    heat = config.heat
    n = zeros(PlanNumbers)
    n.corners = len(config.corner)
    n.mode, n.slope = MODES[heat.mode], SLOPES[heat.slope]
    n.points = len(heat.front_pressure_pa)
    n.pressure_mapped = int(_has_pressure(present))
    n.torque_assumed = int(heat.assume_powertrain_torque_nm is not None)
    n.has_laws = int(bool(laws))
    n.step_us = step_us
    n.mass_kg = vehicle.mass_kg
    n.rotating_kg = vehicle.rotating_mass_kg
    n.radius_m = vehicle.wheel_radius_m
    n.quadratic = vehicle.quadratic
    n.linear = vehicle.linear
    n.constant = vehicle.constant
    n.ambient_k = config.vehicle.ambient_c + KELVIN_OFFSET
    n.assumed_torque_nm = heat.assume_powertrain_torque_nm or 0.0
    n.on_pressure_pa = heat.brake_on_pressure_pa
    n.on_force_n = heat.brake_on_force_n
    n.filter_s = heat.derivative_filter_s
    n.settling_s = settling_s
    # the fused power includes such braking already
    n.unpressed_share = 0.0 if heat.mode == "fused" else unpressed_share
    for c, corner in enumerate(config.corner):
        secondary = corner.circuit == "secondary"
        torque = PressureTorque.of_corner(corner)
        n.place[c] = CORNERS.index(corner.name)
        n.secondary[c] = int(secondary)
        n.torque_per_pa[c] = torque.torque_per_pressure_nm_pa
        n.pushout_pa[c] = torque.pushout_pressure_pa
        n.lag_s[c] = heat.secondary_lag_s if secondary else heat.primary_lag_s
        n.force_share[c] = _force_share(config, corner)
    n.timeout = [float(present.get(i, NOT_MAPPED)) for i in range(len(ROLES))]
    tables = [
        laws.get(corner.name, FrictionLaw()).numbers()
        for corner in config.corner
        if laws
    ]
    ints: list[int] = []
    floats: list[float] = []
    pack(n, ints, floats)
    floats += [*heat.front_pressure_pa, *heat.rear_pressure_pa]
    for table in tables:
        floats += table
    return SamplePlan(
        n,
        tuple(heat.front_pressure_pa),
        tuple(heat.rear_pressure_pa),
        tables,
        array("q", ints),
        array("d", floats),
        tuple(corner.name for corner in config.corner),
        step_us,
    )


def _has_pressure(present: Mapping[int, int]) -> bool:
    names = (
        "primary_pressure",
        "secondary_pressure",
        *(f"wheel_pressure_{c.lower()}" for c in CORNERS),
    )
    return any(ROLE_INDEX[name] in present for name in names)


def _force_share(config: Config, corner: CornerConfig) -> float:
    """Share of the vehicle's brake force: the axle's, halved (Eq 4.10)."""
    front = corner.name[0] == "F"
    share = config.vehicle.front_share
    return 0.5 * (share if front else 1.0 - share)

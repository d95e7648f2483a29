"""What the checks and the fusion need of a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from bstm_daemon.model.heat.memory import PER_CORNER, Pressures, Speeds, Twins


@dataclass(slots=True)
class Readings:
    """Inputs at the end of a step; nan for those that are missing.

    ``speeds``: absolute, wheels in corner order, then the vehicle's;
    ``secured``: 1 if the parking brake is applied or the ignition off, else 0;
    ``pressures``: primary, secondary, then wheels; ``acceleration`` along
    the motion; ``intervenes``: any system slows or spins single wheels;
    ``pressure_of``: per corner the index in ``pressures`` of
    the one that it uses; ``twin_low`` and ``twin_high`` are the pressures of
    the two brakes of the front and the rear axle and of the circuits;
    ``heat_known`` and ``at_risk`` per corner: whether its power is known, and
    whether there may be any.
    """

    now: int
    dt_s: float
    speed: float
    speed_known: bool
    braking: bool
    brake_switch: float
    esc_active: float
    intervenes: bool
    secured: float
    acceleration: float
    lateral: float
    yaw_rate: float
    ambient_k: float
    speeds: Speeds
    pressures: Pressures
    pressure_of: Annotated[list[int], PER_CORNER]
    twin_low: Twins
    twin_high: Twins
    heat_known: Annotated[list[bool], PER_CORNER]
    at_risk: Annotated[list[bool], PER_CORNER]

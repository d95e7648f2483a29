"""The roles of signals, and the quantity of each.

A role is an input of the model, whatever its name in a car's DBC. Its index
in :data:`ROLES` is its number in sample streams and in the compiled
per-sample pass, so the order below is part of the interface with it.
"""

from dataclasses import dataclass
from typing import Final

CORNERS: Final = ("FL", "FR", "RL", "RR")
"""Corner names, front axle first, left before right."""

MEASURED_NODES: Final = (
    "disc",
    "disc_2",
    "pad_front",
    "pad_back",
    "fluid",
    "caliper",
)
"""Nodes of a corner that a thermocouple may measure."""


@dataclass(frozen=True, slots=True)
class Role:
    """A role: its name, quantities it may be given in, and default ageing.

    ``timeout_s`` is how long a value counts as present after its frame. A
    speed over ground has ``ground_lag_s``, the largest delay of its receiver.
    It is compared with the wheel speeds and does not replace them.
    """

    name: str
    quantities: tuple[str, ...]
    timeout_s: float = 0.5
    ground_lag_s: float | None = None


def _corner_roles(prefix: str, *quantities: str) -> list[Role]:
    return [Role(f"{prefix}_{name.lower()}", quantities) for name in CORNERS]


ROLES: Final[tuple[Role, ...]] = (
    # a wheel speed may be angular: the configured wheel radius converts it
    *_corner_roles("wheel_speed", "speed", "angular_speed"),
    Role("vehicle_speed", ("speed",)),
    Role("primary_pressure", ("pressure",)),
    Role("secondary_pressure", ("pressure",)),
    *_corner_roles("wheel_pressure", "pressure"),
    Role("acceleration_longitudinal", ("acceleration",)),
    Role("acceleration_lateral", ("acceleration",)),
    Role("yaw_rate", ("angular_speed",)),
    Role("pitch", ("angle",)),
    Role("powertrain_torque", ("torque",)),
    Role("engine_torque", ("torque",)),
    Role("engine_speed", ("angular_speed",)),
    Role("gear", ("count",)),
    Role("clutch_open", ("flag", "fraction")),
    Role("motor_torque", ("torque",)),
    Role("brake_torque", ("torque",)),
    Role("external_force", ("force",)),
    Role("altitude", ("length",), 5.0),
    # receivers filter and send at 1 Hz
    Role("gnss_speed", ("speed",), 2.0, ground_lag_s=1.5),
    Role("ambient_temperature", ("temperature",), 60.0),
    Role("rain", ("fraction", "flag"), 60.0),
    Role("brake_switch", ("flag",)),
    Role("brake_pedal_travel", ("length", "fraction")),
    Role("park_brake", ("flag",), 5.0),
    Role("abs_active", ("flag",)),
    Role("esc_active", ("flag",)),
    Role("tc_active", ("flag",)),
    Role("ignition", ("flag", "count"), 5.0),
    Role("pads_new", ("flag",), 60.0),
    Role("pad_worn_1mm", ("flag",), 60.0),
    Role("pad_2mm_left", ("flag",), 60.0),
    Role("fluid_changed", ("flag",), 60.0),
    Role("fluid_water_percent", ("fraction",), 3600.0),
    Role("trailer_connected", ("flag",), 60.0),
    *(
        Role(f"temp_{corner.lower()}_{node}", ("temperature",), 5.0)
        for corner in CORNERS
        for node in MEASURED_NODES
    ),
)
"""All roles; a role's number is its index here."""

ROLE_INDEX: Final[dict[str, int]] = {
    role.name: index for index, role in enumerate(ROLES)
}
"""Role name to role number."""

GROUND_LAG_S: Final[dict[str, float]] = {
    role.name: role.ground_lag_s
    for role in ROLES
    if role.ground_lag_s is not None
}
"""Largest delay of each speed over ground [s]."""

GROUND_SPEED_ROLES: Final = tuple(ROLE_INDEX[name] for name in GROUND_LAG_S)
"""Role numbers of the speeds over ground."""

LONGITUDINAL: Final = "acceleration_longitudinal"
WHEELS: Final = tuple(f"wheel_speed_{name.lower()}" for name in CORNERS)
PRESSURES: Final = (
    *("primary_pressure", "secondary_pressure"),
    *(f"wheel_pressure_{name.lower()}" for name in CORNERS),
)


def pressure_roles(corner: str, circuit: str) -> list[str]:
    """Return the pressures that *corner* of *circuit* takes, its own first."""
    own = f"wheel_pressure_{corner.lower()}"
    return [*dict.fromkeys((own, f"{circuit}_pressure", "primary_pressure"))]

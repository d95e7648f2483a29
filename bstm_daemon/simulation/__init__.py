"""An independent reality: a car, its brakes and its bus, as test data.

Shares no physics code and no property table with the estimator, so that
agreement between the two is evidence. Entry points: :func:`load_drive`,
:func:`simulate`, :func:`march_lanes` and the recorder.
"""

from bstm_daemon.simulation.drives import (
    Drive,
    drive_names,
    load_drive,
    parse_drive,
    read_drive,
)
from bstm_daemon.simulation.parameters import (
    EFFECT_NAMES,
    CornerParameters,
    Effects,
    Mesh,
    preset_effects,
)
from bstm_daemon.simulation.reality import LaneInputs, LaneResult, march_lanes
from bstm_daemon.simulation.sensors import SENSOR_PRESETS
from bstm_daemon.simulation.simulate import SimulatedDrive, simulate
from bstm_daemon.simulation.vehicle import (
    NOMINAL,
    CarParameters,
    load_vehicle,
    vehicle_names,
)

__all__ = [
    "EFFECT_NAMES",
    "NOMINAL",
    "SENSOR_PRESETS",
    "CarParameters",
    "CornerParameters",
    "Drive",
    "Effects",
    "LaneInputs",
    "LaneResult",
    "Mesh",
    "SimulatedDrive",
    "drive_names",
    "load_drive",
    "load_vehicle",
    "march_lanes",
    "parse_drive",
    "preset_effects",
    "read_drive",
    "simulate",
    "vehicle_names",
]

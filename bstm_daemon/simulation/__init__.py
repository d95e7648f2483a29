"""An independent reality: a car, its brakes and its bus, as test data.

Shares no physics code and no property table with the estimator, so that
agreement between the two is earned. Entry points: :func:`load_drive`,
:func:`simulate`, :func:`march_lanes` and the recorder.
"""

from bstm_daemon.simulation.batch import march_lanes
from bstm_daemon.simulation.drives import (
    Drive,
    drive_names,
    load_drive,
    parse_drive,
    read_drive,
)
from bstm_daemon.simulation.march import LaneInputs, LaneResult
from bstm_daemon.simulation.parameters import (
    EFFECT_NAMES,
    CornerParameters,
    Effects,
    Mesh,
)
from bstm_daemon.simulation.simulate import SimulatedDrive, simulate
from bstm_daemon.simulation.vehicle import NOMINAL, CarParameters

__all__ = [
    "EFFECT_NAMES",
    "NOMINAL",
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
    "march_lanes",
    "parse_drive",
    "read_drive",
    "simulate",
]

"""Tables and limits that several effects share."""

from collections.abc import Callable

from bstm_daemon.config.sections import CornerConfig
from bstm_daemon.model.effects.model import Correction, InputModel, Parameter
from bstm_daemon.model.thermal.network import Factor, value
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.roles import MEASURED_NODES
from bstm_daemon.units import KELVIN_OFFSET

ROOM_K = 20.0 + KELVIN_OFFSET
FASTEST_MS = 120.0
"""End of the tables over speed."""

NEGLIGIBLE = 1e-6
"""Least strength; below it a part would be singular and is as good as absent.
"""

LEAST_FRICTION = 0.1
"""No law takes more than nine tenths of it away."""

AIR_REFERENCE_K = 500.0
AIR_CONDUCTIVITY = Table.from_function(
    lambda k: (k / AIR_REFERENCE_K) ** 0.79, 220.0, 1300.0, 109
)
"""Conductivity of air over that at the reference; 0.026 W/mK at 300 K, 0.041
at 500 K, 0.063 at 900 K."""

RELEASED = Table(0.0, 1.0, (1.0, 0.0))
"""1 with the brake off, 0 with it on, over ``brake_on``."""


def over_speed(share: Callable[[float], float]) -> Factor:
    """Return a factor *share* of the speed [m/s], tabulated."""
    return value("speed_ms", Table.from_function(share, 0.0, FASTEST_MS, 481))


def rising_with_speed(still: float, rise: float) -> Factor:
    """Return a factor *still* at rest and *rise* more for each m/s."""
    ends = (still, still + FASTEST_MS * rise)
    return value("speed_ms", Table(0.0, FASTEST_MS, ends))


def power_or_line(ratio: float, power: float, linear: float) -> float:
    """Return *ratio* to a *power*, or with *linear* 1 its tangent at 1."""
    line = max(1.0 + power * (ratio - 1.0), LEAST_FRICTION)
    return float((1.0 - linear) * ratio**power + linear * line)


SENSOR = Parameter(
    "sensor",
    *("1", 0.0, float(len(MEASURED_NODES)), 0.0),
    f"0 all, 1 {MEASURED_NODES[0]} ... {len(MEASURED_NODES)} "
    f"{MEASURED_NODES[-1]}",
)
"""Which thermocouple an error is of."""

EACH_SENSOR = tuple(
    {SENSOR.name: 1.0 + i}
    for i, node in enumerate(MEASURED_NODES)
    if node != "disc_2"
)
"""Forms of an error of one thermocouple."""


def sensors_of(number: float) -> tuple[str, ...]:
    """Return the nodes whose thermocouples :data:`SENSOR` means."""
    if number < 1.0:
        return MEASURED_NODES
    return (MEASURED_NODES[round(number) - 1],)


def excess_correction(
    inputs: InputModel,
    corner: CornerConfig,
    sensor: float,
    *,
    gain: float,
    offset_k: float = 0.0,
) -> InputModel:
    """Return *inputs* with readings of *corner* put right.

    Those of :data:`SENSOR` = *sensor*, which read *gain* times the excess over
    20 degC and *offset_k* [K] besides.
    """
    zero_k = ROOM_K + offset_k
    return inputs.with_correction(
        *(
            Correction(
                f"temp_{corner.name.lower()}_{node}",
                1.0 / gain,
                ROOM_K - zero_k / gain,
            )
            for node in sensors_of(sensor)
        )
    )

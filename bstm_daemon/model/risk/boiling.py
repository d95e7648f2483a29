"""Boiling points that a brake fluid grade guarantees.

The values are the minima of the equilibrium reflux boiling point (ERBP) that
a fluid of the grade must reach in the laboratory: dry as delivered, wet after
humidification to about 3.7 % water. They hold at ambient pressure, which is
the right condition here: vapour forms when the pedal is released or the car
is parked, not under brake pressure.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from bstm_daemon.errors import ConfigError
from bstm_daemon.units import KELVIN_OFFSET

FMVSS_116: Final = "49 CFR 571.116 (FMVSS 116), S5.1.1 dry, S5.1.2 wet"
ISO_4925: Final = "ISO 4925, class 6: ERBP and wet ERBP"


class BoilingPoints(NamedTuple):
    """Guaranteed boiling points of a grade, in kelvin, and their source."""

    dry_k: float
    wet_k: float
    source: str


BOILING_POINTS: Final[Mapping[str, BoilingPoints]] = MappingProxyType(
    {
        grade: BoilingPoints(dry + KELVIN_OFFSET, wet + KELVIN_OFFSET, source)
        for grade, dry, wet, source in (
            ("DOT3", 205, 140, FMVSS_116),
            ("DOT4", 230, 155, FMVSS_116),
            ("DOT5.1", 260, 180, FMVSS_116),
            ("CLASS6", 250, 165, ISO_4925),
        )
    }
)
"""Minima of every grade that ``[fluid] grade`` may name."""


def wet_boiling_point_k(grade: str) -> float:
    """Return the wet boiling point in kelvin that *grade* guarantees.

    Raises :class:`~bstm_daemon.errors.ConfigError` for an unknown grade.
    """
    points = BOILING_POINTS.get(grade)
    if points is None:
        known = ", ".join(BOILING_POINTS)
        raise ConfigError(
            [f'[fluid] grade = "{grade}": unknown grade, use one of {known}']
        )
    return points.wet_k

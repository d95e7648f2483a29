"""Brake applications: when the brake was on, and the work of each corner.

A press and the next one less than two seconds later are one application:
the thesis's pulsed stops (Fig 4.6) are stops.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.statistics.series import Column, Mask, runs

if TYPE_CHECKING:
    from bstm_daemon.analysis.identify.driving import Driving
    from bstm_daemon.config.sections import Config

JOINED_S: Final = 2.0
"""Presses closer than this belong to one application."""

SHORTEST_S: Final = 0.4
"""A shorter press is a touch of the pedal."""

STANDING_MS: Final = 0.5
"""At or below this nothing slides; sensors with a dead band read 0."""


@dataclass(frozen=True, slots=True)
class Span:
    """Points ``first`` to ``last``, both included, of a time axis."""

    first: int
    last: int

    @property
    def points(self) -> slice:
        """The points as a slice."""
        return slice(self.first, self.last + 1)


def applications(
    time_s: Column, speed_ms: Column, pressed: Mask
) -> list[Span]:
    """Return the applications, by rising time.

    Args:
        time_s: evenly spaced but for pauses, (n,).
        speed_ms: of the car, (n,).
        pressed: whether the brake is on, (n,).
    """
    on = pressed & (speed_ms > STANDING_MS)
    found: list[Span] = []
    for first, last in runs(on):
        if found and time_s[first] - time_s[found[-1].last] < JOINED_S:
            found[-1] = Span(found[-1].first, last)
        else:
            found.append(Span(first, last))
    return [
        span
        for span in found
        if time_s[span.last] - time_s[span.first] >= SHORTEST_S
    ]


def corner_pressures(driving: Driving, config: Config) -> dict[str, Column]:
    """Return the pressure that each corner goes by [Pa], (n,) each.

    Its wheel's own, else that of its circuit, behind the rear table: the
    rules of the estimator. A corner without any is left out.
    """
    known = driving.pressures
    found: dict[str, Column] = {}
    for corner in config.corner:
        own = f"wheel_pressure_{corner.name.lower()}"
        circuit = f"{corner.circuit}_pressure"
        if own in known:
            found[corner.name] = known[own]
            continue
        role = circuit if circuit in known else "primary_pressure"
        if role not in known:
            continue
        pressure = known[role]
        if corner.name[0] == "R" and config.heat.front_pressure_pa:
            pressure = np.interp(
                pressure,
                config.heat.front_pressure_pa,
                config.heat.rear_pressure_pa,
            )
        found[corner.name] = pressure
    return found

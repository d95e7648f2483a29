"""Inputs of the advice: the brakes' state, the car's motion, the driver.

Plain values, so that the estimator behind them can be exchanged. All SI; NaN
is unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isfinite, nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.channels import CORNER_PRESSURE, FLAGS
from bstm_daemon.estimate import RiskLevel, Validity

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.estimate import CornerEstimate
    from bstm_daemon.estimator.blocks import Instant


DRIVER_ROLES: Final = (
    "ignition",
    "gear",
    "clutch_open",
    "engine_speed",
    "brake_switch",
    "brake_pedal_travel",
    "acceleration_longitudinal",
    "pitch",
    "abs_active",
    "esc_active",
)
"""Roles that advice reads in addition to the estimate."""

FAR_US: Final = 10_000_000
"""A sample stamped further ahead has a wrong time."""


class HeldRoles:
    """The newest values of :data:`DRIVER_ROLES` at a time of the data."""

    def __init__(
        self, timeouts_us: Mapping[int, int], numbers: Mapping[str, int]
    ) -> None:
        """Hold the roles of *numbers* (name to role number).

        A value counts until it is older than its time-out.
        """
        self.names = {
            number: name
            for name, number in numbers.items()
            if name in DRIVER_ROLES and number in timeouts_us
        }
        """Names of the roles that are held, by number."""
        self._timeouts = {
            name: timeouts_us[number] for number, name in self.names.items()
        }
        self._held: dict[str, tuple[int, float]] = {}
        self.waiting: list[tuple[int, str, float]] = []
        """Time [us], name and value of samples that wait for their time."""

    def note(self, stamp_us: int, role: int, value: float) -> None:
        """Take a sample; it counts from *stamp_us* on."""
        self.waiting.append((stamp_us, self.names[role], value))

    def export(self) -> dict[str, list[float]]:
        """Return stamp [us] and value of each role as plain values."""
        return {name: list(held) for name, held in self._held.items()}

    def restore(self, saved: Mapping[str, Sequence[float]]) -> None:
        """Take over what :meth:`export` gave, on the same axis of time.

        Raises:
            TypeError, ValueError: it is nothing of that kind.
        """
        for name in self.names.values():
            if name in saved:
                stamp_us, value = saved[name]
                self._held[name] = int(stamp_us), float(value)

    def at(self, time_us: int) -> dict[str, float]:
        """Return the values that are fresh at *time_us*, not going back."""
        later = []
        for sample in self.waiting:
            stamp_us, name, value = sample
            if stamp_us <= time_us:
                self._held[name] = stamp_us, value
            elif stamp_us - time_us < FAR_US:
                later.append(sample)
        self.waiting = later
        return {
            name: value
            for name, (stamp_us, value) in self._held.items()
            if 0 <= time_us - stamp_us <= self._timeouts[name]
        }


@dataclass(frozen=True, slots=True)
class Conditions:
    """Inputs of the advice at one publication.

    ``corners`` are those with a thermal model, ``pressures_pa`` those of all
    corners, NaN if unknown; ``brake_power_w`` is that of all brakes;
    ``driver`` holds the fresh values of the roles of :data:`DRIVER_ROLES`.
    """

    time_us: int
    corners: Mapping[str, CornerEstimate]
    speed_ms: float = nan
    brake_power_w: float = nan
    pressures_pa: Mapping[str, float] = field(default_factory=dict)
    driver: Mapping[str, float] = field(default_factory=dict)

    @property
    def level(self) -> RiskLevel:
        """The worst level of a usable corner; unknown if there is none."""
        usable = [
            c.sure_level for c in self.corners.values() if c.validity.is_usable
        ]
        return max(
            usable, key=lambda one: one.severity, default=RiskLevel.UNKNOWN
        )

    @property
    def is_unsure(self) -> bool:
        """Whether the level of any corner is unknown."""
        return any(
            corner.sure_level is RiskLevel.UNKNOWN
            or not corner.validity.is_usable
            for corner in self.corners.values()
        )

    @property
    def validity(self) -> Validity:
        """The worst validity of the corners."""
        found = [corner.validity for corner in self.corners.values()]
        return max(found, default=Validity.NOT_AVAILABLE)

    @property
    def waiting_s(self) -> float:
        """How long until every corner is safe [s]; NaN where one is not known.

        Only corners that ask for waiting count.
        """
        times = [
            corner.waiting_s
            for corner in self.corners.values()
            if corner.is_at_least(RiskLevel.HIGH)
        ]
        if not times or not all(map(isfinite, times)):
            return nan
        return max(times)

    @property
    def highest_pressure_pa(self) -> float:
        """The highest known pressure [Pa]; NaN where none is."""
        known = [p for p in self.pressures_pa.values() if isfinite(p)]
        return max(known, default=nan)

    def is_known(self, axle: str) -> bool:
        """Whether every corner of *axle* "F" or "R" has a known margin.

        One without a thermal model is not known.
        """
        margins = self._margins_k(axle)
        return bool(margins) and all(map(isfinite, margins))

    def margin_k(self, axle: str = "") -> float:
        """Smallest margin of usable corners [K], of an *axle* "F" or "R".

        Infinite if there is none: a brake without a thermal model causes no
        request.
        """
        return min(filter(isfinite, self._margins_k(axle)), default=inf)

    def _margins_k(self, axle: str) -> list[float]:
        return [
            corner.cautious_margin_k if corner.validity.is_usable else nan
            for name, corner in self.corners.items()
            if name.startswith(axle)
        ]

    def flag(self, role: str) -> bool | None:
        """Return a switch, None where it is not known."""
        value = self.driver.get(role)
        return None if value is None else value > 0.5


def conditions_at(
    instant: Instant,
    corners: Mapping[str, CornerEstimate],
    driver: Mapping[str, float],
) -> Conditions:
    """Return the inputs of the advice at one publication.

    Args:
        instant: the publication.
        corners: the corners with a thermal model then.
        driver: fresh values of the driver's roles.
    """
    names = instant.block.layout.corners
    missing = instant.flags & FLAGS["speed_missing"]
    return Conditions(
        instant.time_us,
        corners,
        nan if missing else instant.vehicle("speed_ms"),
        sum(instant.channel(name, "brake_power_w") for name in names),
        {
            # the model takes a missing one as 0; advice must not
            name: nan
            if instant.flags & CORNER_PRESSURE << place
            else instant.channel(name, "pressure_pa")
            for place, name in enumerate(names)
        },
        driver,
    )

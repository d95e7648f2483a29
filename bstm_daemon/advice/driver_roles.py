"""The driver's roles: switches, gear and pedal as they are held."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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
"""Roles that advice reads besides the estimate."""

FAR_US: Final = 10_000_000
"""A sample stamped further ahead is one of a clock that went wrong."""


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

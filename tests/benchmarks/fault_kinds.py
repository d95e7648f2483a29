"""Single faults of sensors, senders, units and clocks, made in a recording.

A recording is a mapping from role to the values that its frames carry, nan
where no frame comes, all on one grid of times. A fault begins at an onset and
stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from bstm_daemon.simulation.materials import Array

RATE_HZ: Final = 50.0
WHEELS: Final = tuple(f"wheel_speed_{c}" for c in ("fl", "fr", "rl", "rr"))
SPEEDS: Final = (*WHEELS, "vehicle_speed")
BAR: Final = 1e5


@dataclass
class Recording:
    """What a bus carried: ``signals`` by role, at ``stamp_us``.

    ``second`` holds what another node sends of a role right after each frame.
    """

    stamp_us: np.ndarray[tuple[int], np.dtype[np.int64]]
    signals: dict[str, Array]
    second: dict[str, Array] = field(default_factory=dict)

    def copy(self) -> Recording:
        """Return one that may be changed by itself."""
        return Recording(
            self.stamp_us.copy(), dict(self.signals), dict(self.second)
        )


Make: TypeAlias = Callable[[Recording, int, np.random.Generator], None]
Change: TypeAlias = Callable[["Array", int, np.random.Generator], "Array"]


@dataclass(frozen=True)
class Fault:
    """A kind of fault; ``roles`` must be mapped for it to be one."""

    name: str
    roles: tuple[str, ...]
    make: Make


def _changed(name: str, roles: Iterable[str] | str, change: Change) -> Fault:
    names = (roles,) if isinstance(roles, str) else tuple(roles)

    def make(
        record: Recording, first: int, stream: np.random.Generator
    ) -> None:
        for role in names:
            if role in record.signals:
                values = record.signals[role].copy()
                values[first:] = change(values, first, stream)
                record.signals[role] = values

    return Fault(name, names[:1], make)


def constant(value: float) -> Change:
    """Stuck at *value*."""
    return lambda x, first, _: np.full(len(x) - first, value)


def frozen(x: Array, first: int, _: np.random.Generator) -> Array:
    """Stuck at what it was."""
    return np.full(len(x) - first, x[first])


def linear(gain: float, offset: float = 0.0) -> Change:
    """A wrong scale and zero."""
    return lambda x, first, _: gain * x[first:] + offset


def drift(per_s: float) -> Change:
    """An offset that grows."""
    return lambda x, first, _: (
        x[first:] + per_s / RATE_HZ * np.arange(len(x) - first)
    )


def noise(std: float) -> Change:
    """White noise beside the signal."""
    return lambda x, first, stream: (
        x[first:] + stream.normal(0.0, std, len(x) - first)
    )


def saturated(highest: float) -> Change:
    """Nothing beyond *highest*."""
    return lambda x, first, _: np.minimum(x[first:], highest)


def delayed(by_s: float) -> Change:
    """The values of *by_s* before."""
    by = round(by_s * RATE_HZ)
    return lambda x, first, _: np.concatenate([np.full(by, x[0]), x])[
        first : len(x)
    ]


def one_bit(step: float) -> Change:
    """Zero, but for one bit of noise."""
    return lambda x, first, stream: (
        step * stream.integers(0, 2, len(x) - first)
    )


def every_other_second(value: float) -> Change:
    """*value* in every second second."""

    def change(x: Array, first: int, _: np.random.Generator) -> Array:
        odd = (np.arange(len(x) - first) // round(RATE_HZ)) % 2 == 1
        return np.where(odd, value, x[first:])

    return change


def absent(x: Array, first: int, _: np.random.Generator) -> Array:
    """No frame any more."""
    return np.full(len(x) - first, np.nan)


def _second_sender(role: str) -> Fault:
    def make(record: Recording, first: int, _: np.random.Generator) -> None:
        other = np.zeros(len(record.stamp_us))
        other[:first] = np.nan
        record.second[role] = other

    return Fault(f"{role}: a second sender of zero", (role,), make)


def _swapped(one: str, two: str) -> Fault:
    def make(record: Recording, first: int, _: np.random.Generator) -> None:
        a, b = record.signals[one].copy(), record.signals[two].copy()
        a[first:], b[first:] = b[first:].copy(), a[first:].copy()
        record.signals[one], record.signals[two] = a, b

    return Fault(f"{one}: swapped with {two}", (one, two), make)


def _hole(seconds: float) -> Fault:
    def make(record: Recording, first: int, _: np.random.Generator) -> None:
        end = min(first + round(seconds * RATE_HZ), len(record.stamp_us))
        for role, values in record.signals.items():
            record.signals[role] = values.copy()
            record.signals[role][first:end] = np.nan

    return Fault(f"a hole of {seconds:.0f} s", (), make)


def _clock(seconds: float) -> Fault:
    def make(record: Recording, first: int, _: np.random.Generator) -> None:
        record.stamp_us[first:] += round(seconds * 1e6)

    return Fault(f"the clock steps by {seconds:+.0f} s", (), make)


def _pressure() -> list[Fault]:
    role = "primary_pressure"
    kinds: dict[str, Change] = {
        "reads 0": constant(0.0),
        "stuck at 0.3 bar": constant(0.3 * BAR),
        "stuck at 20 bar": constant(20 * BAR),
        "frozen": frozen,
        "0 with one bit of noise": one_bit(0.1 * BAR),
        "0 every other second": every_other_second(0.0),
        "a third": linear(1 / 3),
        "half": linear(0.5),
        "three quarters": linear(0.75),
        "double": linear(2.0),
        "in psi": linear(1 / 14.504),
        "-3 bar": linear(1.0, -3 * BAR),
        "-1 bar": linear(1.0, -1 * BAR),
        "+3 bar": linear(1.0, 3 * BAR),
        "+10 bar": linear(1.0, 10 * BAR),
        "drifts -10 bar in 25 min": drift(-10 * BAR / 1500),
        "drifts +10 bar in 25 min": drift(10 * BAR / 1500),
        "saturates at 8 bar": saturated(8 * BAR),
        "saturates at 20 bar": saturated(20 * BAR),
        "noise of 2 bar": noise(2 * BAR),
        "0.5 s late": delayed(0.5),
        "2 s late": delayed(2.0),
        "absent": absent,
    }
    other, few = "secondary_pressure", ("reads 0", "half", "three quarters")
    return [
        *(_changed(f"{role}: {k}", role, c) for k, c in kinds.items()),
        *(_changed(f"{other}: {k}", other, kinds[k]) for k in few),
    ]


def _wheels() -> list[Fault]:
    one: dict[str, Change] = {
        "reads 0": constant(0.0),
        "half": linear(0.5),
        "x0.75": linear(0.75),
        "x0.85": linear(0.85),
        "x1.3": linear(1.3),
        "frozen": frozen,
        "noise of 3 m/s": noise(3.0),
        "0 every other second": every_other_second(0.0),
        "2 s late": delayed(2.0),
        "absent": absent,
    }
    every: dict[str, Change] = {
        "read 0": constant(0.0),
        "half": linear(0.5),
        "in mph": linear(0.621),
        "x0.85": linear(0.85),
        "x1.15": linear(1.15),
        "in km/h": linear(3.6),
        "frozen": frozen,
        "absent": absent,
    }
    front = WHEELS[:2]
    return [
        *(_changed(f"one wheel: {k}", WHEELS[0], c) for k, c in one.items()),
        _changed("two wheels: half", front, linear(0.5)),
        _changed("two wheels: read 0", front, constant(0.0)),
        _changed("all wheels: half", WHEELS, linear(0.5)),
        _changed("all wheels: absent", WHEELS, absent),
        _changed("all wheels: x0.85", WHEELS, linear(0.85)),
        _changed("all wheels: read 0", WHEELS, constant(0.0)),
        _changed("all wheels: frozen", WHEELS, frozen),
        *(_changed(f"all speeds: {k}", SPEEDS, c) for k, c in every.items()),
        _changed("vehicle speed: half", SPEEDS[-1], linear(0.5)),
        _changed("vehicle speed: reads 0", SPEEDS[-1], constant(0.0)),
        _changed("vehicle speed: frozen", SPEEDS[-1], frozen),
        _changed("vehicle speed: x1.5", SPEEDS[-1], linear(1.5)),
        _changed("satellite speed: half", "gnss_speed", linear(0.5)),
        _changed("satellite speed: frozen", "gnss_speed", frozen),
    ]


def _motion() -> list[Fault]:
    accel: dict[str, Change] = {
        "reads 0": constant(0.0),
        "frozen": frozen,
        "reversed": linear(-1.0),
        "half": linear(0.5),
        "double": linear(2.0),
        "in g": linear(1 / 9.81),
        "+0.5 m/s2": linear(1.0, 0.5),
        "-0.5 m/s2": linear(1.0, -0.5),
        "+1.5 m/s2": linear(1.0, 1.5),
        "drifts +1 m/s2 in 25 min": drift(1.0 / 1500),
        "noise of 2 m/s2": noise(2.0),
        "2 s late": delayed(2.0),
        "absent": absent,
    }
    torque: dict[str, Change] = {
        "reads 0": constant(0.0),
        "frozen": frozen,
        "reversed": linear(-1.0),
        "half": linear(0.5),
        "double": linear(2.0),
        "-300 Nm": linear(1.0, -300.0),
        "+300 Nm": linear(1.0, 300.0),
        "noise of 300 Nm": noise(300.0),
        "2 s late": delayed(2.0),
        "absent": absent,
    }
    long, lateral = "acceleration_longitudinal", "acceleration_lateral"
    return [
        *(_changed(f"acceleration: {k}", long, c) for k, c in accel.items()),
        _swapped(long, lateral),
        *(
            _changed(f"torque: {k}", "powertrain_torque", c)
            for k, c in torque.items()
        ),
        _changed("yaw rate: x10", "yaw_rate", linear(10.0)),
        _changed("lateral: absent", lateral, absent),
    ]


def _others() -> list[Fault]:
    ambient: dict[str, Change] = {
        "stuck at -40 degC": constant(233.15),
        "stuck at 60 degC": constant(333.15),
        "-20 K": linear(1.0, -20.0),
        "+20 K": linear(1.0, 20.0),
        "absent": absent,
    }
    switch: dict[str, Change] = {
        "stuck off": constant(0.0),
        "stuck on": constant(1.0),
        "inverted": linear(-1.0, 1.0),
        "absent": absent,
    }
    flags = ("abs_active", "esc_active", "tc_active")
    return [
        *(
            _changed(f"ambient: {k}", "ambient_temperature", c)
            for k, c in ambient.items()
        ),
        *(
            _changed(f"brake switch: {k}", "brake_switch", c)
            for k, c in switch.items()
        ),
        *(
            _changed(f"{role}: stuck on", role, constant(1.0))
            for role in flags
        ),
        _changed("gear: frozen", "gear", frozen),
        _changed("rain: stuck on", "rain", constant(1.0)),
        _changed("brake torque: reads 0", "brake_torque", constant(0.0)),
        *(
            _second_sender(role)
            for role in (
                *("primary_pressure", "wheel_speed_fl", "powertrain_torque"),
                *("acceleration_longitudinal", "ambient_temperature"),
            )
        ),
        *(_hole(seconds) for seconds in (10.0, 75.0, 600.0)),
        *(_clock(seconds) for seconds in (-3600.0, 3000.0, 3700.0, 86400.0)),
        _clock(40 * 86400.0),
    ]


FAULTS: Final = (*_pressure(), *_wheels(), *_motion(), *_others())
"""All kinds, each by its name."""

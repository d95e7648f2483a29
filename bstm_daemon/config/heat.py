"""``[heat]``, which heat modes the roles allow, and which "auto" is."""

from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Set as AbstractSet
from typing import Final, Literal, Protocol

from bstm_daemon.config import section
from bstm_daemon.roles import CORNERS, LONGITUDINAL, WHEELS, pressure_roles

AUTOMATIC: Final = ("fused", "ff", "fb")
"""What "auto" tries, in this order: pressure and motion check each other; the
pressure alone knows where the heat goes; measured discs hold the model at what
is to be estimated, which is no default."""


class WheelBrake(Protocol):
    """What of a ``[[corner]]`` decides on its inputs."""

    @property
    def name(self) -> str:
        """FL, FR, RL or RR."""

    @property
    def type(self) -> str:
        """Disc or drum."""

    @property
    def circuit(self) -> str:
        """Primary or secondary."""


class HeatConfig(section.Section):
    """``[heat]``: which brake power heats the model, and how it is formed."""

    mode: Literal["auto", "ff", "fb", "fused", "measured"] = "auto"
    """Feed-Forward (pressure), Feed-Back (motion), both with the vehicle
    learned, or measured temperatures; `auto`: the first of `fused`, `ff`, `fb`
    that has what it needs, as `bstm check` shows"""
    brake_on_pressure_pa: section.NotNegative = 1.0e5
    """pressure above which the brake counts as on"""
    brake_on_force_n: section.NotNegative = 300.0
    """brake force above which it counts as on without a pressure"""
    primary_lag_s: section.NotNegative = 0.0
    """delay of wheel pressure behind the primary signal"""
    secondary_lag_s: section.NotNegative = 0.0
    """the same for corners of the secondary circuit"""
    derivative_filter_s: section.Positive = 0.3
    """time constant of the speed's derivative"""
    slope: Literal["accelerometer", "flat"] = "accelerometer"
    """road grade from the accelerometer if it is there, else none"""
    assume_powertrain_torque_nm: float | None = None
    """torque at the wheels while `powertrain_torque` is absent: a declared
    assumption, 0.0 = coasting"""
    front_pressure_pa: list[section.NotNegative] = []
    """front pressure of a proportioning valve's table, rising"""
    rear_pressure_pa: list[section.NotNegative] = []
    """rear pressure at each `front_pressure_pa`; empty = equal"""

    def _check(self) -> None:
        if self.front_pressure_pa or self.rear_pressure_pa:
            section.check_curve(
                self.front_pressure_pa,
                self.rear_pressure_pa,
                "front_pressure_pa",
                "rear_pressure_pa",
            )


def automatic_mode(
    heat: HeatConfig, corners: Sequence[WheelBrake], roles: AbstractSet[str]
) -> str:
    """Return the heat mode that "auto" is with *roles* configured.

    Raises:
        ValueError: no mode has its inputs.
    """
    for mode in AUTOMATIC:
        if not [*_missing(mode, heat, corners, roles)]:
            return mode
    raise ValueError("; ".join(heat_mode_problems(heat, corners, roles)))


def heat_mode_problems(
    heat: HeatConfig, corners: Sequence[WheelBrake], roles: AbstractSet[str]
) -> Iterator[str]:
    """Name each input that the heat mode needs and *roles* do not have."""
    where = f'[heat] mode = "{heat.mode}":'
    if heat.mode != "auto":
        for problem in _missing(heat.mode, heat, corners, roles):
            yield f"{where} {problem}"
        return
    missing = {m: [*_missing(m, heat, corners, roles)] for m in AUTOMATIC}
    if all(missing.values()):
        pressure, torque = missing["ff"], missing["fb"]
        for problem in pressure:
            yield f"{where} {problem}"
        if not set(pressure) <= set(torque):
            for problem in torque:
                if problem not in pressure:
                    yield f"{where} or {problem}"


def _missing(
    mode: str,
    heat: HeatConfig,
    corners: Sequence[WheelBrake],
    roles: AbstractSet[str],
) -> Iterator[str]:
    if mode == "measured":
        names = {corner.name for corner in corners}
        temperatures = [
            f"temp_{name.lower()}_disc" for name in CORNERS if name in names
        ]
        if roles.isdisjoint(temperatures):
            yield (
                "needs a disc temperature, configure one of "
                f"{_sections(temperatures)}"
            )
        return
    speeds = ["vehicle_speed", *WHEELS]
    if roles.isdisjoint(speeds):
        yield f"needs a speed, configure one of {_sections(speeds)}"
    if mode in {"ff", "fused"}:
        for corner in corners:
            pressures = pressure_roles(corner.name, corner.circuit)[::-1]
            if corner.type == "disc" and roles.isdisjoint(pressures):
                yield (
                    f"needs a pressure for corner {corner.name}, configure "
                    f"one of {_sections(pressures)}"
                )
    if mode == "fused" and LONGITUDINAL not in roles:
        yield (
            "needs the acceleration to learn from, configure "
            "[signals.acceleration_longitudinal]"
        )
    if (
        mode in {"fb", "fused"}
        and "powertrain_torque" not in roles
        and heat.assume_powertrain_torque_nm is None
    ):
        yield (
            "needs the torque at the wheels, configure "
            "[signals.powertrain_torque] or declare "
            "assume_powertrain_torque_nm (0.0 = coasting while braking)"
        )


def _sections(roles: Iterable[str]) -> str:
    return ", ".join(f"[signals.{role}]" for role in roles)

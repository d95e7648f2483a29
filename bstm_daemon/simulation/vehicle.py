"""The car: its masses, resistances, gears and brakes.

The defaults are the thesis's vehicle 1; brake torque of a corner is
``2 (p - p0) A n eta mu r_eff``.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib import resources
from importlib.resources.abc import Traversable
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from bstm_daemon.errors import ConfigError, UsageError, hint
from bstm_daemon.simulation import parameters
from bstm_daemon.simulation.materials import Array
from bstm_daemon.units import AIR_DENSITY_KG_M3, GRAVITY_MS2

Gears = npt.NDArray[np.intp]


# engine speed over wheel speed, neutral first: gearbox times final drive
_TOTAL_RATIO = np.array([0.0, 13.0, 7.6, 5.0, 3.8, 3.0, 2.5])
_ENGINE_DRAG_NM = 16.0
_ENGINE_DRAG_NM_S = 0.06
_IDLE_RAD_S = 75.0

# typical size of the effects that act on the car
_MASS_ERROR = 0.06
_SHARE_SHIFT = 0.10


@dataclass(frozen=True, slots=True, kw_only=True)
class CarParameters:
    """The car, SI; defaults are the thesis's vehicle 1.

    ``left_bias`` is by how much the left pads' mu lies above, and the right
    pads' below, the corner's value; ``left_shelter`` by how much less air the
    left calipers and parked discs get, and the right ones more.
    """

    mass_kg: float = 2194.0
    wheel_inertia_kg_m2: float = 3.0809
    wheel_radius_m: float = parameters.FRONT.wheel_radius_m
    rolling_resistance: float = 0.014
    friction_ns_m: float = 4.0
    drag_area_m2: float = 0.70
    left_bias: float = 0.0
    left_shelter: float = 0.0
    front: parameters.CornerParameters = parameters.FRONT
    rear: parameters.CornerParameters = parameters.REAR

    @property
    def corners(self) -> tuple[parameters.CornerParameters, ...]:
        """The four corners: FL, FR, RL, RR."""
        return (
            self._on_side(self.front, 1.0),
            self._on_side(self.front, -1.0),
            self._on_side(self.rear, 1.0),
            self._on_side(self.rear, -1.0),
        )

    def _on_side(
        self, corner: parameters.CornerParameters, left: float
    ) -> parameters.CornerParameters:
        air = 1.0 - left * self.left_shelter
        return replace(
            _scaled(corner, 1.0 + left * self.left_bias),
            caliper_natural_w_k=corner.caliper_natural_w_k * air,
            caliper_forced_w_k=corner.caliper_forced_w_k * air,
            natural_convection_w_m2k=corner.natural_convection_w_m2k * air,
            wheel_radius_m=self.wheel_radius_m,
        )

    @property
    def effective_mass_kg(self) -> float:
        """Mass with the wheels' rotational inertia."""
        rotating = self.wheel_inertia_kg_m2 / self.wheel_radius_m**2
        return self.mass_kg + rotating

    @property
    def gains(self) -> Array:
        """Brake force at the road over pressure [N/Pa] of the corners."""
        return np.array(
            [
                2
                * corner.piston_area_m2
                * corner.piston_count
                * corner.efficiency
                * corner.friction_coefficient
                * corner.effective_radius_m
                / self.wheel_radius_m
                for corner in self.corners
            ]
        )

    def brake_force(self, pressure_pa: float) -> float:
        """Return the brake force of all wheels [N] at nominal mu."""
        return float(self.gains.sum()) * pressure_pa

    def resistance(
        self,
        speed_ms: Array,
        slope_rad: Array,
        headwind_ms: Array | float = 0.0,
    ) -> Array:
        """Return rolling, air and friction resistance plus grade [N]."""
        weight = self.mass_kg * GRAVITY_MS2
        air = 0.5 * AIR_DENSITY_KG_M3 * self.drag_area_m2
        total: Array = (
            weight * np.sin(slope_rad)
            + weight * self.rolling_resistance * np.cos(slope_rad)
            + (air * speed_ms + self.friction_ns_m) * speed_ms
            + self.wind(speed_ms, headwind_ms)
        )
        return total

    def wind(self, speed_ms: Array, headwind_ms: Array | float) -> Array:
        """Return what a headwind adds to the air's resistance [N]."""
        air = 0.5 * AIR_DENSITY_KG_M3 * self.drag_area_m2
        met = speed_ms + headwind_ms
        added: Array = air * (met * np.abs(met) - speed_ms * speed_ms)
        return added

    def engine_speed(self, speed_ms: Array, gear: Gears) -> Array:
        """Return the engine speed [rad/s]; it idles with an open clutch."""
        turned = speed_ms / self.wheel_radius_m * _TOTAL_RATIO[gear]
        clutched: Array = np.maximum(turned, _IDLE_RAD_S)
        return clutched

    def engine_drag(self, speed_ms: Array, gear: Gears) -> Array:
        """Return the dragging engine's torque at the wheels [Nm], <= 0."""
        ratio = _TOTAL_RATIO[gear]
        turned = speed_ms / self.wheel_radius_m * ratio
        drag = ratio * (_ENGINE_DRAG_NM + _ENGINE_DRAG_NM_S * turned)
        # the clutch opens below idle
        return np.where(turned > _IDLE_RAD_S, -drag, 0.0)


NOMINAL: Final = CarParameters()
"""The nominal car."""


def real_car(car: CarParameters, effects: parameters.Effects) -> CarParameters:
    """Return the car that really drives: what *effects* change in *car*.

    The mass is above its nominal value, brake force shifts to the front axle.
    """
    shift = _SHARE_SHIFT * effects.brake_share
    front, _, rear, _ = car.gains
    rear_scale = 1.0 - shift * front / rear
    return replace(
        car,
        mass_kg=car.mass_kg * (1.0 + _MASS_ERROR * effects.mass_error),
        front=_scaled(car.front, 1.0 + shift),
        rear=_scaled(car.rear, rear_scale),
    )


def _scaled(
    corner: parameters.CornerParameters, factor: float
) -> parameters.CornerParameters:
    mu = corner.friction_coefficient * factor
    return replace(corner, friction_coefficient=mu)


Axle = Literal["front", "rear"]

_CAR_KEYS = {f.name for f in fields(CarParameters)} - {"front", "rear"}
_CORNER_KEYS = {f.name for f in fields(parameters.CornerParameters)} - {
    *("wheel_radius_m", "drawn_paths")
}


def packaged(kind: str) -> dict[str, Traversable]:
    """Return the packaged ``drives`` or ``vehicles`` by name, sorted."""
    folder = resources.files("bstm_daemon.simulation") / "_data" / kind
    found = {
        entry.name.removesuffix(".toml"): entry
        for entry in folder.iterdir()
        if entry.name.endswith(".toml")
    }
    return dict(sorted(found.items()))


def packaged_text(kind: str, name: str) -> str:
    """Return the text of the packaged *name* of *kind*.

    Raises :class:`~bstm_daemon.errors.UsageError` for an unknown name.
    """
    known = packaged(kind)
    if name not in known:
        what = kind.removesuffix("s")
        known_names = hint(name, known, "bstm simulate --list has them")
        msg = f"no {what} {name!r}: {known_names}"
        raise UsageError(msg)
    return known[name].read_text(encoding="utf-8")


def vehicle_names() -> list[str]:
    """Return the names of the packaged cars, sorted."""
    return list(packaged("vehicles"))


def load_vehicle(name: str) -> CarParameters:
    """Return the packaged car *name*.

    Raises :class:`~bstm_daemon.errors.UsageError` for an unknown name.
    """
    return parse_vehicle(packaged_text("vehicles", name), f"{name}.toml")


def parse_vehicle(text: str, file: str) -> CarParameters:
    """Return the car written in *text*: what differs from the nominal one.

    Tables ``[car]``, ``[front]`` and ``[rear]``. Raises
    :class:`~bstm_daemon.errors.ConfigError` naming *file* and key.
    """
    data = tomllib.loads(text)
    car = data.get("car", {})
    front, rear = data.get("front", {}), data.get("rear", {})
    problems = [
        f"{file}: {table}.{key}: unknown key"
        for table, given, known in (
            ("car", car, _CAR_KEYS),
            ("front", front, _CORNER_KEYS),
            ("rear", rear, _CORNER_KEYS),
        )
        for key in given
        if key not in known
    ]
    if problems:
        raise ConfigError(problems)
    return replace(
        NOMINAL,
        **car,
        front=replace(NOMINAL.front, **front),
        rear=replace(NOMINAL.rear, **rear),
    )


def scaled_car(
    car: CarParameters, factors: Mapping[Axle, Mapping[str, float]], file: str
) -> CarParameters:
    """Return *car* with corner parameters multiplied by *factors*.

    *factors* maps ``front`` and ``rear`` to parameter and factor. Raises
    :class:`~bstm_daemon.errors.ConfigError` for an unknown parameter.
    """
    problems = [
        f"{file}: drive.scale.{axle}.{key}: unknown parameter"
        for axle, given in factors.items()
        for key in given
        if key not in _CORNER_KEYS
    ]
    if problems:
        raise ConfigError(problems)
    axles: dict[str, Any] = {
        axle: replace(
            getattr(car, axle),
            **{
                key: getattr(getattr(car, axle), key) * factor
                for key, factor in given.items()
            },
        )
        for axle, given in factors.items()
    }
    return replace(car, **axles)

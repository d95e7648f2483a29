"""Cars that come with the package, as data."""

from __future__ import annotations

import tomllib
from dataclasses import fields, replace
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal

from bstm_daemon.errors import ConfigError, UsageError
from bstm_daemon.simulation.parameters import CornerParameters
from bstm_daemon.simulation.vehicle import NOMINAL, CarParameters

if TYPE_CHECKING:
    from collections.abc import Mapping
    from importlib.resources.abc import Traversable

Axle = Literal["front", "rear"]

_CAR_KEYS = {f.name for f in fields(CarParameters)} - {"front", "rear"}
_CORNER_KEYS = {f.name for f in fields(CornerParameters)} - {"wheel_radius_m"}


def _folder() -> Traversable:
    return resources.files("bstm_daemon.simulation") / "_data" / "vehicles"


def vehicle_names() -> list[str]:
    """Return the names of the packaged cars, sorted."""
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in _folder().iterdir()
        if entry.name.endswith(".toml")
    )


def load_vehicle(name: str) -> CarParameters:
    """Return the packaged car *name*.

    Raises :class:`~bstm_daemon.errors.UsageError` for an unknown name.
    """
    if name not in vehicle_names():
        msg = f"no vehicle {name!r}: one of {', '.join(vehicle_names())}"
        raise UsageError(msg)
    text = (_folder() / f"{name}.toml").read_text(encoding="utf-8")
    return parse_vehicle(text, f"{name}.toml")


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

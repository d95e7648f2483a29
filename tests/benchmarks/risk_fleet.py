"""A fleet of cars, each set up as a car is: drawn, driven twice, matched.

Every car has brakes of its own; half of the cars are of the preset *plain*,
half of *road*. Its configuration is the example's with the disc's mass from
the drawing; all else of the front axle is what `bstm match` makes of the
drives *simalp* and *rich*, recorded as CAN frames with the errors of its
sensors, heat from pressure.
"""

from __future__ import annotations

import pickle
import tempfile
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from population import KNOWN_TO_THE_OWNER, MATCHED_ON, Driven, matched
from recordings import SENSORS, encoder

from bstm_daemon.analysis.matching.drives import read_drive
from bstm_daemon.analysis.matching.tunables import Target
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.files import shipped_file
from bstm_daemon.simulation import NOMINAL, load_drive, simulate
from bstm_daemon.simulation.recorder import write_candump

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation.parameters import CornerParameters
    from bstm_daemon.simulation.vehicle import CarParameters

JUDGED: Final = ("FL",)
"""Corners that descents are judged by: those that may be the hottest. Of 100
descents with both the rear fluid was the hotter one in none."""

SPREAD: Final = 0.10
"""Every parameter of a brake lies so far around the nominal one's."""

GROUPS: Final = {
    "ring": ("ring_mass_kg",),
    "shim": ("shim_resistance_m2k_w",),
    "caliper": (
        "piston_capacity_j_k",
        "fluid_capacity_j_k",
        "body_capacity_j_k",
        "finger_capacity_j_k",
    ),
    "caliper_air": ("caliper_natural_w_k", "caliper_forced_w_k"),
    "disc_air": (
        "natural_convection_w_m2k",
        "forced_face_w_m2k",
        "forced_vent_w_m2k",
    ),
}

WIDE: Final = {
    "ring": (0.85, 1.20),
    "shim": (0.85, 1.20),
    "caliper": (0.85, 1.20),
    "caliper_air": (0.80, 1.25),
    "disc_air": (0.80, 1.25),
}
"""Range of a factor on a group, beyond :data:`SPREAD`: kinds of brakes."""

LEAST_VANES: Final = 0.05
"""Share of a disc's mass that its vanes must have; nominal 0.18 and 0.12.
Where the cheeks outweigh the ring there is no such disc: its march breaks
down, and the car is drawn again."""

FRONT: Final = ("FL", "FR")
STRUCTURES: Final = {"plain": "thesis", "road": "extended"}
"""Structure of the model on each preset of the reality; cars take turns."""


@dataclass(frozen=True, slots=True)
class FleetCar:
    """A car, its preset, and the configuration that matching gave it."""

    car: CarParameters
    preset: str
    config: Config


def fleet(count: int, seed: int, cache: Path | None = None) -> list[FleetCar]:
    """Return *count* matched cars; *cache* keeps them one a file."""
    presets = tuple(STRUCTURES)
    return [
        _kept((seed, number), presets[number % len(presets)], cache)
        for number in range(count)
    ]


def _kept(seed: tuple[int, int], preset: str, cache: Path | None) -> FleetCar:
    if cache is None:
        return matched_car(seed, preset)
    path = cache / f"car-{preset}-{seed[0]}-{seed[1]}.pickle"
    if path.exists():
        found: FleetCar = pickle.loads(path.read_bytes())  # noqa: S301
        return found
    made = matched_car(seed, preset)
    path.write_bytes(pickle.dumps(made))
    return made


def matched_car(seed: tuple[int, int], preset: str) -> FleetCar:
    """Draw a car and match its front axle."""
    rng = np.random.default_rng(seed)
    car, ring = _drawn_car(rng)
    target = Target(_unmatched(ring, STRUCTURES[preset]), FRONT)
    number = int(rng.integers(1 << 30))
    signal_map = load_vehicle(shipped_file("config/example_vehicle.toml"))[1]
    fit = None
    with tempfile.TemporaryDirectory() as folder:
        paths = [
            _recorded(Path(folder), name, car, preset, number)
            for name in MATCHED_ON
        ]
        # heat of a friction law follows the temperatures of the match
        for _ in range(1 if preset == "plain" else 2):
            drives = [
                Driven(read_drive(path, target.config, signal_map), {})
                for path in paths
            ]
            target, fit = matched(target, drives, after=fit)
    return FleetCar(car, preset, target.config)


def _drawn_car(rng: np.random.Generator) -> tuple[CarParameters, float]:
    """Return a car that can be, and the factor on its discs' mass."""
    while True:
        ring = rng.uniform(*WIDE["ring"])
        front = _drawn(rng, NOMINAL.front, ring)
        rear = _drawn(rng, NOMINAL.rear, ring)
        if min(vanes(front), vanes(rear)) >= LEAST_VANES:
            return replace(NOMINAL, front=front, rear=rear), ring


def vanes(corner: CornerParameters) -> float:
    """Return the share of a disc's mass that lies between its cheeks."""
    cheeks_kg = (
        2.0
        * corner.iron_density_kg_m3
        * corner.face_area_m2
        * corner.cheek_thickness_m
    )
    return 1.0 - cheeks_kg / corner.ring_mass_kg


def _unmatched(ring: float, structure: str) -> Config:
    """Return the example car with discs of *ring* times its mass."""
    config = load_vehicle(shipped_file("config/example_vehicle.toml"))[0]
    corners = []
    for corner in config.corner:
        assert corner.disc is not None
        mass_kg = corner.disc.mass_kg * ring
        disc = corner.disc.model_copy(update={"mass_kg": mass_kg})
        corners.append(corner.model_copy(update={"disc": disc}))
    changes: dict[str, Any] = {
        "corner": corners,
        "thermal": config.thermal.model_copy(update={"structure": structure}),
        # the form of a disc that is cooled by a film of air
        "cooling": config.cooling.model_copy(update={"form": "conductance"}),
    }
    return config.model_copy(update=changes)


def _drawn(
    rng: np.random.Generator, corner: CornerParameters, ring: float
) -> CornerParameters:
    factors = {
        f.name: rng.uniform(1.0 - SPREAD, 1.0 + SPREAD)
        for f in fields(corner)
        if f.name not in {*KNOWN_TO_THE_OWNER, "ring_mass_kg"}
        and isinstance(getattr(corner, f.name), float)
    }
    for group, span in WIDE.items():
        factor = ring if group == "ring" else rng.uniform(*span)
        for name in GROUPS[group]:
            factors[name] = factor * factors.get(name, 1.0)
    return scaled(corner, factors)


def scaled(
    corner: CornerParameters, factors: dict[str, float]
) -> CornerParameters:
    """Return *corner* with *factors* on its parameters."""
    changes = {
        name: min(getattr(corner, name) * factor, 0.98)
        if name.endswith("emissivity")
        else getattr(corner, name) * factor
        for name, factor in factors.items()
    }
    return replace(corner, **changes)


def _recorded(
    folder: Path, name: str, car: CarParameters, preset: str, seed: int
) -> Path:
    """Drive and return the log of the CAN frames."""
    whole = simulate(
        load_drive(name), car, preset=preset, sensors=SENSORS, seed=seed
    )
    path = folder / f"{name}.log"
    write_candump(path, whole, encoder())
    return path

"""Cars of the gap benchmark: drawn, matched, driven, and what is kept of them.

A car is drawn around the nominal one; its configuration is matched on two of
its drives without the hidden effect, its tunables then off by a little. What
its cases share, the pass over its samples and the sensitivities of its model,
is made once: where a hidden effect changes only temperatures, the same
samples of the bus come with other thermocouples.
"""

from __future__ import annotations

import pickle
from collections import Counter, defaultdict
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.analysis.gap.advising import MENU
from bstm_daemon.analysis.gap.comparison import HEAT_SCALE_PRIOR
from bstm_daemon.analysis.gap.recording import Recording, recorded
from bstm_daemon.analysis.gap.signatures import Sensed, candidates, sensed
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.refine import refine
from bstm_daemon.analysis.matching.targets import targets_of
from bstm_daemon.analysis.matching.thermocouples import thermocouples_of
from bstm_daemon.analysis.matching.tunables import (
    TUNABLES,
    Target,
    refined_keys,
    usable,
)
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.estimates import AccuracyConfig
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.files import shipped_file
from bstm_daemon.model.effects.catalogue import STRUCTURES
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.roles import CORNERS, ROLE_INDEX
from bstm_daemon.simulation import NOMINAL, load_drive, simulate
from bstm_daemon.simulation.parameters import (
    EFFECT_NAMES,
    UNHEARD_NAMES,
    preset_effects,
)
from bstm_daemon.simulation.reality import march_lanes
from bstm_daemon.simulation.sensors import (
    SENSOR_PRESETS,
    measured_temperatures,
    sensor_suite,
)
from bstm_daemon.simulation.simulate import (
    Prepared,
    prepare,
    real_temperatures,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from bstm_daemon.analysis.gap.comparison import Comparison
    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation.parameters import Effects
    from bstm_daemon.simulation.simulate import SimulatedDrive
    from bstm_daemon.simulation.vehicle import CarParameters

FITTED: Final = ("simalp", "rich")
HELD_OUT: Final = ("grossglockner", "city")
SPREAD: Final = 0.10
MISTUNED: Final = 0.3
"""Of a tunable's prior deviation: drawn for each car."""

OF_THERMOCOUPLES: Final = frozenset(
    {"thermocouple_offset", "thermocouple_lag"}
)
OF_TEMPERATURES: Final = OF_THERMOCOUPLES.union(
    ("residual_drag",),
    UNHEARD_NAMES,
    EFFECT_NAMES[
        EFFECT_NAMES.index("contact_conductance") : EFFECT_NAMES.index(
            "fluid_latent_heat"
        )
        + 1
    ],
)
"""Effects of which the bus tells nothing: its samples are the same."""

SPLITS: Final = {"reported": 70_000, "development": 10_000}
EVERY: Final = 10
"""Samples of the 100 Hz are kept at 10 Hz."""


@dataclass(frozen=True, slots=True)
class World:
    """What a set of cases shares: reality, model, sensors and seeds.

    With ``nodes`` only their thermocouples are there when an effect is
    searched: the drives are those of the world without.
    """

    preset: str = "plain"
    structure: str = "thesis"
    sensors: str = "n2"
    split: str = "reported"
    nodes: tuple[str, ...] = ()

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> World:
        """Return the world that JSON knows as *data*."""
        return cls(**{**data, "nodes": tuple(data.get("nodes", ()))})

    def __str__(self) -> str:
        """Return its name, which files bear."""
        name = f"{self.split}-{self.preset}-{self.structure}-{self.sensors}"
        return f"{name}-{'+'.join(self.nodes)}" if self.nodes else name

    @property
    def driven(self) -> World:
        """The world that its drives are from, with all thermocouples."""
        return replace(self, nodes=())

    @property
    def lacking(self) -> list[str]:
        """Effects that can be hidden: neither always on nor in the model."""
        known = set(STRUCTURES[self.structure])
        known.update(one.name for one in known_sensors(self.sensors))
        on = preset_effects(self.preset)
        return [
            name
            for name in EFFECT_NAMES
            if name not in known and not getattr(on, name)
        ]

    @property
    def always_on(self) -> set[str]:
        """Effects that the reality has and the model has not."""
        on = preset_effects(self.preset)
        return {
            name
            for name in EFFECT_NAMES
            if getattr(on, name) and name not in STRUCTURES[self.structure]
        }


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """One drive as it happened and as it was recorded."""

    drive: SimulatedDrive
    recording: Recording


class Garage:
    """One car with all that its cases share; kept in *folder*."""

    def __init__(self, world: World, number: int, folder: Path) -> None:
        self.world = world.driven
        self.number = number
        self.folder = folder
        self.seed = SPLITS[world.split] + 100 * number
        self.car = drawn_car(self.seed)
        self._driven: dict[str, Driven] = {}
        self._ready: dict[str, Prepared] = {}

    @cached_property
    def target(self) -> Target:
        """The configuration matched without what is hidden, mistuned."""
        kept = self.folder / f"{self.world}-car-{self.number}.pickle"
        if not kept.exists():
            keep(kept, pickle.dumps(self._matched()))
        target: Target = pickle.loads(kept.read_bytes())  # noqa: S301  (own)
        config = target.config.model_copy(
            update={"accuracy": known_accuracy(self.world.sensors)}
        )
        return mistuned(replace(target, config=config), self.seed)

    @cached_property
    def sensed(self) -> Sensed:
        """What the car's own drives, nothing hidden, make of the model."""
        kept = self.folder / f"{self.world}-sensed-{self.number}.pickle"
        if not kept.exists():
            found = sensed(self.comparison, candidates(self.target.config))
            keep(kept, pickle.dumps(found))
        result: Sensed = pickle.loads(kept.read_bytes())  # noqa: S301  (own)
        return result

    @cached_property
    def comparison(self) -> Comparison:
        """The car's own drives, nothing hidden."""
        drives = [self.driven(name).recording for name in FITTED]
        return compare(self.target, drives)

    @cached_property
    def prior(self) -> np.ndarray:
        """Standard deviations of the logarithms of its tunables, (p,)."""
        keys, _ = usable(self.target, refined_keys(self.target))
        return np.array([*(TUNABLES[k].prior for k in keys), HEAT_SCALE_PRIOR])

    def driven(self, name: str) -> Driven:
        """Return the drive *name* with nothing hidden."""
        if name not in self._driven:
            drive = self._simulated(name, preset_effects(self.world.preset))
            recording = recorded(
                name, [events_of(drive)], self.target.config, present()
            )
            self._driven[name] = Driven(drive, recording)
        return self._driven[name]

    def recording(
        self, name: str, hidden: Mapping[str, float], draw: int = 0
    ) -> Recording:
        """Return the drive *name* with *hidden* effects by strength.

        *draw* numbers the errors of the thermocouples.
        """
        effects = preset_effects(self.world.preset)
        for effect, strength in hidden.items():
            effects = effects.with_strength(effect, strength)
        base = self.driven(name)
        suite = sensor_suite(
            self.world.sensors, effects, self._noise(name) + 7 * draw
        )
        if not set(hidden) <= OF_TEMPERATURES:
            drive = self._simulated(name, effects)
            events = events_of(
                drive, measured_temperatures(drive.truth, suite)
            )
            return recorded(name, [events], self.target.config, present())
        truth = base.drive.truth
        if not set(hidden) <= OF_THERMOCOUPLES:
            truth = self._truth(name, effects)
        temperatures = measured_temperatures(truth, suite)
        own = base.recording.drive
        parts: dict[int, list[Any]] = defaultdict(list)
        for time_s, role, values in thermocouples(base.drive, temperatures):
            stamps = np.rint(time_s * 1e6).astype(np.int64) * 1e-6
            parts[role].append((stamps, values))
        measured = thermocouples_of(parts, own.corners, own.start_s)
        return replace(base.recording, drive=replace(own, measured=measured))

    def _truth(self, name: str, effects: Effects) -> dict[str, np.ndarray]:
        """Return the temperatures of *name* with *effects* in the brakes."""
        if name not in self._ready:
            plain = preset_effects(self.world.preset)
            self._ready[name] = prepare(load_drive(name), self.car, plain)
        ready = self._ready[name]
        result = march_lanes(
            ready.car.corners,
            [effects] * len(CORNERS),
            ready.inputs,
            start_k=np.full(len(CORNERS), ready.start_k),
        )
        slow_s = self.driven(name).drive.slow_time_s
        return real_temperatures(result, slow_s, ready.start_k)

    def _noise(self, name: str) -> int:
        return self.seed + (*FITTED, *HELD_OUT, *MENU).index(name)

    def _simulated(self, name: str, effects: Effects) -> SimulatedDrive:
        return simulate(
            load_drive(name),
            self.car,
            preset=effects,
            sensors=self.world.sensors,
            seed=self._noise(name),
        )

    def _matched(self) -> Target:
        config = structure_config(self.world.structure)
        known = known_sensors(self.world.sensors)
        config = config.model_copy(update={"effect": [*config.effect, *known]})
        without = preset_effects(self.world.preset)
        for name in self.world.always_on:
            without = without.with_strength(name, 0.0)
        drives = []
        for i, name in enumerate(FITTED):
            drive = simulate(
                load_drive(name),
                self.car,
                preset=without,
                sensors=self.world.sensors,
                seed=self.seed + 31 + i,
            )
            drives.append(
                recorded(name, [events_of(drive)], config, present()).drive
            )
        target = targets_of(config, ["FL", "FR"])[0]
        keys, _ = usable(target, refined_keys(target))
        return target.changed(refine(target, drives, keys).values)


def keep(file: Path, data: bytes) -> None:
    """Write *file*, whole or not at all."""
    part = file.with_suffix(file.suffix + ".part")
    part.write_bytes(data)
    part.replace(file)


def known_sensors(sensors: str) -> list[EffectConfig]:
    """Return what a data sheet says of them: their lag, where they have one.

    It is an effect that is there: unconfigured it is named in every case.
    """
    preset = SENSOR_PRESETS[sensors]
    lag_s = preset.thermocouple.lag_s if preset else 0.0
    if not lag_s:
        return []
    values = {"strength": 1.0, "time_s": lag_s}
    return [EffectConfig(name="thermocouple_lag", parameters=values)]


def known_accuracy(sensors: str) -> AccuracyConfig:
    """Return what a data sheet says of their offsets and drift."""
    preset = SENSOR_PRESETS[sensors]
    if preset is None:
        return AccuracyConfig()
    return AccuracyConfig(
        thermocouple_offset_k=preset.thermocouple.bias_sd,
        thermocouple_drift_k=preset.thermocouple.drift,
    )


def structure_config(structure: str) -> Config:
    """Return the example car in *structure*, heat by pressure."""
    config = load_vehicle(shipped_file("config/example_vehicle.toml"))[0]
    changes: dict[str, Any] = {
        "heat": config.heat.model_copy(update={"mode": "ff"}),
        "thermal": config.thermal.model_copy(update={"structure": structure}),
        "cooling": config.cooling.model_copy(update={"form": "conductance"}),
    }
    return config.model_copy(update=changes)


@cache
def present() -> dict[int, int]:
    """Return the roles of the example car."""
    signal_map = load_vehicle(shipped_file("config/example_vehicle.toml"))[1]
    return present_roles(signal_map)


def drawn_car(seed: int) -> CarParameters:
    """Return a car: what is not on a drawing varies."""
    rng = np.random.default_rng(seed)
    drawn = {
        f.name: 1.0 + SPREAD * (2.0 * rng.random() - 1.0)
        for f in fields(NOMINAL.front)
        if f.name.startswith(("forced_f", "forced_v", "shim", "ring"))
        or f.name.endswith(("conductivity_w_mk", "capacity_j_k", "w_k"))
        or f.name in {"friction_coefficient", "natural_convection_w_m2k"}
    }

    def scaled(corner: Any) -> Any:
        return replace(
            corner, **{n: getattr(corner, n) * f for n, f in drawn.items()}
        )

    return replace(
        NOMINAL, front=scaled(NOMINAL.front), rear=scaled(NOMINAL.rear)
    )


def mistuned(target: Target, seed: int) -> Target:
    """Return *target* with its tunables off by a little."""
    rng = np.random.default_rng(seed)
    keys, _ = usable(target, refined_keys(target))
    values = {}
    for key in keys:
        one = TUNABLES[key]
        off = MISTUNED * one.prior * rng.standard_normal()
        values[key] = float(
            np.clip(target.value(one) * np.exp(off), one.lower, one.upper)
        )
    return target.changed(values)


def thermocouples(
    drive: SimulatedDrive, temperatures: Mapping[str, np.ndarray]
) -> Sequence[tuple[np.ndarray, int, np.ndarray]]:
    """Return time [s], role and values [K] of what was logged."""
    logged = np.interp(drive.slow_time_s, drive.time_s, drive.logger_on) > 0.5
    return [
        (drive.slow_time_s[logged], ROLE_INDEX[name], values[logged])
        for name, values in temperatures.items()
        if ROLE_INDEX[name] in present()
    ]


def events_of(
    drive: SimulatedDrive,
    temperatures: Mapping[str, np.ndarray] | None = None,
) -> Events:
    """Return what the car's sensors said, in order of time."""
    parts = []
    bus = np.asarray(drive.bus_on)[::EVERY]
    for name, values in drive.roles.items():
        role = ROLE_INDEX[name]
        if role in present():
            time_s = drive.time_s[::EVERY][bus]
            parts.append((time_s, role, np.asarray(values)[::EVERY][bus]))
    parts += thermocouples(drive, temperatures or drive.temperatures)
    time_us = np.concatenate(
        [np.rint(time_s * 1e6).astype(np.int64) for time_s, _, _ in parts]
    )
    order = np.argsort(time_us, kind="stable")
    roles = np.concatenate(
        [np.full(len(t), role, np.int32) for t, role, _ in parts]
    )
    values = np.concatenate([value for _, _, value in parts])
    return Events(time_us[order], roles[order], values[order], Counter())

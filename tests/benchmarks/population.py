"""A population of cars: matched, and judged on drives that no match has seen.

Cars are drawn around the nominal one, each is driven through CAN frames with
the sensors' noise, matched on two drives and judged on five others against
the truth. *Unmatched* is the configuration that was matched once, on the
nominal car, applied to the others.
"""

from __future__ import annotations

import hashlib
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from recordings import kept, recorded

from bstm_daemon.analysis.matching.coarse import (
    Reading,
    driven_keys,
    read_with_fade,
)
from bstm_daemon.analysis.matching.drives import GRID_S, Drive, read_drive
from bstm_daemon.analysis.matching.march import initial_temperatures, march
from bstm_daemon.analysis.matching.refine import (
    NodeAccuracy,
    Refinement,
    refine,
)
from bstm_daemon.analysis.matching.targets import targets_of
from bstm_daemon.analysis.matching.tunables import Target, refined_keys, usable
from bstm_daemon.analysis.matching.verification import (
    NODES,
    NodeErrors,
    compared,
    phases_of,
)
from bstm_daemon.channels import CHANNELS
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.files import shipped_file
from bstm_daemon.simulation import NOMINAL
from bstm_daemon.simulation.recorder import START_STAMP_S
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation.vehicle import CarParameters

MATCHED_ON: Final = ("simalp", "rich")
HELD_OUT: Final = (
    *("alpine-descent", "city", "ams", "grossglockner", "long-run"),
)
SPREAD: Final = 0.10
CORNER: Final = "FL"

DRIVEN_BY: Final = (
    *("simulation/**/*.py", "simulation/**/*.toml", "model/**/*.py"),
    *("estimator/*.py", "analysis/matching/drives.py", "native/**/*.[ch]"),
)
"""Sources that a drive depends on."""

JUDGED_BY: Final = (*DRIVEN_BY, "analysis/**/*.py")
"""Sources that a match and its errors depend on."""

KNOWN_TO_THE_OWNER: Final = frozenset(
    {
        *("piston_area_m2", "piston_count", "piston_side_share"),
        *("effective_radius_m", "pad_area_m2", "pad_thickness_m"),
        *("face_area_m2", "iron_density_kg_m3", "forced_exponent"),
        *("efficiency", "wheel_radius_m"),
    }
)
"""Parameters of the brake that are not drawn: they are on its drawing, as in
the configuration, or natural constants."""

TOUCHING_W: Final = 1.0
"""Pads touch where a brake takes up more."""

HEATS: Final = ("known", "fused", "ff")


@dataclass(frozen=True, slots=True)
class Setting:
    """A structure of the model on a preset of the reality with a heat."""

    structure: str
    preset: str
    heat: str
    vehicle: str = "nominal"

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.structure} on {self.preset}, heat {self.heat}"

    def config(self) -> Config:
        """Return the example car in this structure and heat."""
        config = load_vehicle(shipped_file("config/example_vehicle.toml"))[0]
        mode = "fused" if self.heat == "fused" else "ff"
        changes: dict[str, Any] = {
            "heat": config.heat.model_copy(update={"mode": mode}),
            "thermal": config.thermal.model_copy(
                update={"structure": self.structure}
            ),
            # the form of a disc that is cooled by a film of air
            "cooling": config.cooling.model_copy(
                update={"form": "conductance"}
            ),
        }
        if self.vehicle == "second":
            # its papers say so
            changes["vehicle"] = config.vehicle.model_copy(
                update={"mass_kg": 1905.0, "drag_area_m2": 0.66}
            )
        return config.model_copy(update=changes)


@dataclass(frozen=True, slots=True, eq=False)
class Driven:
    """A drive as it was recorded, and the truth [degC] at its steps."""

    drive: Drive
    truth_c: dict[str, np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class CarResult:
    """One car: what the refinement found and all errors."""

    number: int
    fit: Refinement
    matched: list[NodeErrors]
    unmatched: list[NodeErrors]


def drawn_car(number: int) -> CarParameters:
    """Return car *number*; 0 is the nominal one."""
    if number == 0:
        return NOMINAL
    rng = np.random.default_rng(1000 + number)
    factors = {
        f.name: 1.0 + SPREAD * (2.0 * rng.random() - 1.0)
        for f in fields(NOMINAL.front)
        if f.name not in KNOWN_TO_THE_OWNER
        and isinstance(getattr(NOMINAL.front, f.name), float)
    }

    def scaled(corner: Any) -> Any:
        return replace(
            corner,
            **{
                name: min(getattr(corner, name) * factor, 0.99)
                if name.endswith("emissivity")
                else getattr(corner, name) * factor
                for name, factor in factors.items()
            },
        )

    return replace(
        NOMINAL, front=scaled(NOMINAL.front), rear=scaled(NOMINAL.rear)
    )


def follows_temperature(setting: Setting) -> bool:
    """Whether its heat comes from pressure by a law of friction."""
    return setting.heat != "known" and setting.structure == "extended"


def driven(
    number: int,
    name: str,
    setting: Setting,
    car: CarParameters | None = None,
    seed: int | None = None,
    *,
    first: bool = False,
    by: Config | None = None,
) -> Driven:
    """Return drive *name* of a car through its CAN frames.

    It is read with the model of *by*, as the commands read with the file that
    they are given: friction of a law is that at the model's temperatures.
    None is the example car. Kept in the folder that BSTM_POPULATION_CACHE
    names, if it names one.
    """
    # what is not formed from pressure or motion asks for no structure
    if setting.heat == "known":
        setting = replace(setting, structure="thesis")
    if not follows_temperature(setting):
        by = None

    def make() -> Driven:
        learned = None
        if setting.heat == "fused" and not first:
            learned = taught(number, setting, car, seed)
        return _driven(
            number, name, setting, car, seed, learned=learned, by=by
        )

    model = "" if by is None else f" {_digest(by)}"
    text = f"{number} {name} {setting!r} {car} {seed} {first}{model}"
    return kept(text, make, *DRIVEN_BY)


def _digest(config: Config) -> str:
    text = config.model_dump_json()
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _driven(
    number: int,
    name: str,
    setting: Setting,
    car: CarParameters | None,
    seed: int | None,
    *,
    learned: Sequence[float] | None,
    by: Config | None,
) -> Driven:
    config = setting.config()
    if by is not None:
        own = {"vehicle": config.vehicle, "heat": config.heat}
        config = by.model_copy(update=own)
    signal_map = load_vehicle(shipped_file("config/example_vehicle.toml"))[1]
    with recorded(
        name,
        # a drive may have a car of its own
        car or (None if number == 0 else drawn_car(number)),
        setting.preset,
        # sensors are the car's own: one accelerometer has one bias
        100 * number + 1 if seed is None else seed,
    ) as recording:
        drive = read_drive(recording.path, config, signal_map, learned=learned)
    end_s = drive.time_s + drive.start_s - START_STAMP_S
    if setting.heat == "known":
        at_s = np.concatenate(([end_s[0] - GRID_S], end_s))
        # the pads touch also where the pressure alone does not tell
        on, power = CHANNELS.index("brake_on"), CHANNELS.index("brake_power_w")
        for at, corner in enumerate(drive.corners):
            energy_j = recording.energy_j[corner]
            known = np.diff(np.interp(at_s, recording.time_s, energy_j))
            drive.inputs[:, at, power] = known / GRID_S
            drive.inputs[known / GRID_S > TOUCHING_W, at, on] = 1.0
    truth = {
        node: np.interp(
            end_s,
            recording.slow_time_s,
            recording.truth_c[f"{CORNER}.{node}"],
        )
        for node in NODES
    }
    return Driven(drive, truth)


def taught(
    number: int,
    setting: Setting,
    car: CarParameters | None,
    seed: int | None,
) -> Sequence[float] | None:
    """Return what fused heat has learned of the car on the rich drive."""
    made = driven(number, "rich", setting, car, seed, first=True)
    return made.drive.learned


def front(config: Config) -> Target:
    """Return both front corners of *config*."""
    return targets_of(config, ["FL", "FR"])[0]


def matched(
    target: Target,
    drives: Sequence[Driven],
    keys: Sequence[str] | None = None,
    after: Refinement | None = None,
) -> tuple[Target, Refinement]:
    """Return *target* refined on *drives*; all that is refined, or *keys*.

    *after* is what the drives taught when their heat was another.
    """
    logs = [one.drive for one in drives]
    wanted = keys or driven_keys(target, logs, refined_keys(target))[0]
    found, _ = usable(target, wanted)
    if after is None:
        fit = refine(target, logs, found)
    else:
        fit = refine(
            *(target, logs, found),
            start=after.values,
            noise=after.noise,
            rounds=1,
        )
    return target.changed(fit.values), fit


def matched_by(
    target: Target,
    setting: Setting,
    read: Callable[[str, Config | None], Driven],
    begin: Config | None,
) -> tuple[Target, Refinement]:
    """Return *target* matched on :data:`MATCHED_ON` as ``bstm match`` does.

    *read* gives a drive with the heat that a configuration forms, at first
    *begin*'s. Where heat asks for temperatures the drives are read again with
    the matched ones, and without fade.
    """
    found, fit = matched(target, [read(name, begin) for name in MATCHED_ON])
    if not follows_temperature(setting):
        return found, fit
    again = [read(name, found.config) for name in MATCHED_ON]
    fading = read_with_fade(
        Reading(None, [one.drive for one in again]),
        found.config,
        [target.linings],
        lambda config: [read(name, config).drive for name in MATCHED_ON],
    )
    pairs = zip(again, fading.drives, strict=True)
    again = [replace(one, drive=drive) for one, drive in pairs]
    return matched(target, again, after=fit)


def errors(
    target: Target,
    one: Driven,
    accuracy: dict[str, NodeAccuracy] | None = None,
) -> list[NodeErrors]:
    """Return the errors of *target* against the truth of a drive."""
    drive = one.drive
    program = compile_corner(target.config, target.corner)
    initial = initial_temperatures(program, drive, CORNER)
    every = round(1.0 / GRID_S)
    rows = slice(every - 1, None, every)
    result = march([program], drive, CORNER, initial)
    air_c = drive.channel(CORNER, "ambient_k")[rows] - KELVIN_OFFSET
    masks = {n: m[rows] for n, m in phases_of(drive, CORNER).items()}
    return [
        compared(
            (drive.name.removesuffix(".log"), CORNER, node, drive.duration_s),
            (
                drive.time_s[rows],
                one.truth_c[node][rows],
                result[node][rows, 0] - KELVIN_OFFSET,
                air_c,
            ),
            masks,
            (accuracy or {}).get(node),
        )
        for node in NODES
    ]


def nominal_target(setting: Setting) -> tuple[Target, Refinement]:
    """Return the configuration that is matched once, on the nominal car."""

    def make() -> tuple[Target, Refinement]:
        def read(name: str, by: Config | None) -> Driven:
            return driven(0, name, setting, by=by)

        return matched_by(front(setting.config()), setting, read, None)

    return kept(f"nominal {setting!r} twice", make, *JUDGED_BY)


def car_result(
    number: int, setting: Setting, names: Sequence[str] = HELD_OUT
) -> CarResult:
    """Match car *number* from the nominal one's configuration.

    Judge both on held-out drives.
    """

    def make() -> CarResult:
        base, _ = nominal_target(setting)

        def read(name: str, by: Config | None) -> Driven:
            return driven(number, name, setting, by=by)

        target, fit = matched_by(base, setting, read, base.config)
        own: list[NodeErrors] = []
        foreign: list[NodeErrors] = []
        for name in names:
            own += errors(target, read(name, target.config))
            foreign += errors(base, read(name, base.config))
        return CarResult(number, fit, own, foreign)

    return kept(f"car {number} {setting!r} {names} twice", make, *JUDGED_BY)


def population(
    setting: Setting, cars: int, names: Sequence[str] = HELD_OUT
) -> tuple[Refinement, list[CarResult]]:
    """Return the nominal match and the results of *cars* drawn cars."""
    _, fit = nominal_target(setting)
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        jobs = [
            pool.submit(car_result, number, setting, names)
            for number in range(1, cars + 1)
        ]
        return fit, [job.result() for job in jobs]

"""What is only guessed, found before the refinement starts there.

A first configuration has typical values: the mass of the disc, the drag area
and the cooling of another car may be off by factors. Local refinement does
not cross such a distance, and its priors would pull back. So a coarse search
comes first, over the discs alone, with wide priors and plain residuals; the
refinement goes on from what it found. Where pads or fluid are measured too,
that is the size of each guess only: what pads and hub take would else come
out as the shape of the cooling table, and be believed.

A value is a guess where its line in the file has the word ``typical`` in its
comment, as ``bstm init`` writes it, or where it is a default that belongs to
a car of its own.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass, replace
from itertools import pairwise, product
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.identify.guessed import BY_FORCES
from bstm_daemon.analysis.matching.effect_values import (
    effect_value,
    with_effect_values,
)
from bstm_daemon.analysis.matching.power_by import PowerBy
from bstm_daemon.analysis.matching.problem import Problem, whole_drives
from bstm_daemon.analysis.matching.tunables import (
    BEYOND_MS,
    DRAG,
    FADE,
    FADE_STRENGTH,
    FAST,
    LEVEL,
    MASS,
    NODES_MS,
    S_SPEEDS_MS,
    STILL,
)
from bstm_daemon.analysis.statistics.levenberg_marquardt import minimise
from bstm_daemon.analysis.statistics.series import rms
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.channels import CHANNELS
from bstm_daemon.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.tunables import Target
    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.config.sections import Config

FILTER: Final = "heat.derivative_filter_s"
CAPACITY: Final = "disc.heat_capacity_exponent"
CAR_MASS: Final = "vehicle.mass_kg"

DRAG_FACTORS: Final = (0.5, 1.0, 1.5, 2.2, 3.3, 5.0, 7.5, 11.0, 16.0)
"""Drag areas that the drives are read with, as a share of the configured."""

NEAR_FACTORS: Final = (0.8, 0.88, 0.94, 1.0, 1.06, 1.12, 1.2)
"""Areas around one that was found between two of the former: half-way
between those the power is wrong by some percent, here by tenths."""

FILTERS_S: Final = (0.1, 0.02)
"""Filters of the acceleration tried beside the configured one: at 400 K/s a
third of a second of delay is more than the model's other errors."""

STARTS: Final = {
    MASS: (0.15, 0.4, 1.0),
    LEVEL: (1.0, 4.0),
    DRAG: (1.0, 3.0, 9.0),
}
"""Factors that the search starts from, the best of all combinations."""

MUCH_LESS: Final = 0.9
"""Another form is taken where it leaves so much less of the error."""

OF_DISC: Final = frozenset({MASS, STILL, *NODES_MS})
"""What disc temperatures alone show."""

DRIVEN_SHARE: Final = 0.05
"""Least share of the time above the middle between two speeds for the upper
one to be matched."""

SAID_SHARE: Final = 0.005
"""Share of the time beyond the table from which on it is said."""

FINE_S: Final = 1.0
FINE_POINTS: Final = 2000
"""Points of discs alone; those of fast discs say more than one each 5 s."""

COHERENT: Final = 4.5
"""A residual goes on for some 20 s, so that as many points say what one does:
their noise counts so many times."""

WHITE_K: Final = 30.0
"""Standard deviation of a residual against priors in the search."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Drives as a filter of the acceleration gives them; None: as it is."""

    filter_s: float | None
    drives: Sequence[Drive]

    def of(self, drives: Sequence[tuple[int, slice]]) -> Reading:
        """Return the parts of its drives, by number and steps."""
        return replace(
            self,
            drives=[
                self.drives[i].part(*steps.indices(len(self.drives[i]))[:2])
                for i, steps in drives
            ],
        )


def guesses_of(path: Path) -> frozenset[str]:
    """Return the tunables and keys whose values in the file are guesses."""
    text = path.read_text("utf-8")
    said, section = set(), ""
    for line in text.splitlines():
        if head := re.match(r"\s*\[+\s*([\w.]+)\s*\]", line):
            section = head[1]
        elif (own := re.match(r"\s*([\w.]+)\s*=[^#]*#(.*)", line)) and (
            re.search(r"\btypical\b", own[2])
        ):
            said.add(f"{section}.{own[1]}")
    document = tomllib.loads(text)
    corners = document.get("corner", [])

    def given(name: str, key: str) -> bool:
        own = (one.get(name, {}) for one in (document, *corners))
        return any(key in one for one in own)

    found = said & (BY_FORCES | {CAR_MASS})
    if "corner.disc.mass_kg" in said and not given(*MASS.split(".")):
        found.add(MASS)
        if not given(*CAPACITY.split(".")):
            found.add(CAPACITY)
    if "cooling.s_per_s" in said or not given("cooling", "s_per_s"):
        found |= {LEVEL, *NODES_MS}
    if not given(*FILTER.split(".")):
        found.add(FILTER)
    return frozenset(found)


def check_mass(path: Path) -> None:
    """Check that the car of the file *path* was weighed.

    Raises:
        UsageError: its mass is a guess, and what forces show depends on it.
    """
    if CAR_MASS in guesses_of(path):
        msg = (
            f"{path}: {CAR_MASS} is a typical value, and what forces show "
            "depends on it: weigh the car and take the word out of the line, "
            "or give --anyway"
        )
        raise UsageError(msg)


def from_motion(config: Config) -> bool:
    """Whether heat comes from the motion and no pressure shows when."""
    return config.heat.mode == "fb" and not any(
        "pressure" in role for role in config.signals
    )


def driven_keys(
    target: Target, drives: Sequence[Drive], keys: Sequence[str]
) -> tuple[tuple[str, ...], list[str]]:
    """Return those of *keys* that *drives* can show, and remarks on the rest.

    With no thermocouple but in discs that is the disc alone: what pads and
    fluid do can not be known. With speeds beyond the table S gets further
    points; the share of the time that is faster still is said.
    """
    found, why = tuple(keys), []
    discs_only = _discs_only(target, drives)
    if discs_only:
        found = tuple(key for key in keys if key in OF_DISC)
        out = [key for key in keys if key not in OF_DISC]
        if out:
            why.append(
                "no thermocouple but in discs: left out, and as configured: "
                + ", ".join(out)
            )
    speed = np.concatenate(
        [drive.channel(target.corner.name, "speed_ms") for drive in drives]
    )
    speeds = list(NODES_MS.values())
    between = [0.5 * (a + b) for a, b in pairwise(speeds)][-len(BEYOND_MS) :]
    more = [
        key
        for key, least in zip(BEYOND_MS, between, strict=True)
        if FAST in found and np.mean(speed > least) > DRIVEN_SHARE
    ]
    end_ms = max(
        target.config.cooling_of(target.corner).speed_ms[-1],
        *(NODES_MS[key] for key in (FAST, *more)),
    )
    share = float(np.mean(speed > end_ms))
    if FAST in found and share > SAID_SHARE:
        why.append(
            f"{100.0 * share:.0f} % of the time is faster than the cooling "
            f"table's last point, {3.6 * end_ms:.0f} km/h: beyond it a power "
            "law"
        )
    by = {one.key for drive in drives for one in drive.power_by.values()}
    if DRAG in by or not discs_only:
        more += by
    return (*found, *more), why


def _discs_only(target: Target, drives: Sequence[Drive]) -> bool:
    """Whether discs alone have thermocouples."""
    there = {
        couple
        for drive in drives
        for corner in target.corners
        for couple in drive.measured.get(corner, {})
    }
    return there <= {"disc", "disc_2"}


def read_as_guessed(
    config: Config,
    guessed: frozenset[str],
    read: Callable[[Config], Sequence[Drive]],
    near_m2: Sequence[float] = (),
) -> list[Reading]:
    """Return what *read* gives of *config*, first as configured.

    Where the heat comes from the motion alone and the drag area is a guess,
    also with others, and with other filters of the acceleration if that is.
    Power is interpolated between the areas: where the car's is known to be
    near *near_m2*, they are read closely around it instead.
    """
    if DRAG not in guessed or not from_motion(config):
        return [Reading(None, read(config))]
    found = []
    area_m2 = config.vehicle.drag_area_m2
    areas_m2 = {factor * area_m2 for factor in DRAG_FACTORS}
    if near_m2:
        areas_m2 = {one * near for one in NEAR_FACTORS for near in near_m2}
    for filter_s in (None, *(FILTERS_S if FILTER in guessed else ())):
        heat = config.heat
        if filter_s is not None:
            heat = heat.model_copy(update={"derivative_filter_s": filter_s})
        of_area = {}
        for tried_m2 in {area_m2, *areas_m2}:
            area = {"drag_area_m2": tried_m2}
            vehicle = config.vehicle.model_copy(update=area)
            of_area[tried_m2] = read(
                config.model_copy(update={"heat": heat, "vehicle": vehicle})
            )
        drives = [
            replace(
                drive,
                power_by=_power_by(
                    DRAG, {area: of_area[area][i] for area in of_area}
                ),
            )
            for i, drive in enumerate(of_area[area_m2])
        ]
        found.append(Reading(filter_s, drives))
    return found


def read_with_fade(
    reading: Reading,
    config: Config,
    linings: Sequence[tuple[str, ...]],
    read: Callable[[Config], Sequence[Drive]],
) -> Reading:
    """Return *reading* of *config* with power by the fade of linings.

    Args:
        reading: the drives as *config* heats them.
        config: the vehicle.
        linings: groups of corners with the same linings.
        read: reads the drives as another configuration heats them.
    """
    drives = list(reading.drives)
    for corners in linings:
        strength = effect_value(config, corners[0], FADE_STRENGTH)
        if not strength:
            continue
        cold = read(with_effect_values(config, corners, {FADE_STRENGTH: 0.0}))
        for i, (drive, other) in enumerate(zip(drives, cold, strict=True)):
            by = _power_by(FADE, {0.0: other, strength: drive})
            own = {corner: by[corner] for corner in corners}
            drives[i] = replace(drive, power_by={**drive.power_by, **own})
    return replace(reading, drives=drives)


def _power_by(key: str, drives: Mapping[float, Drive]) -> dict[str, PowerBy]:
    """Return power by corner of a drive, read at each value of *key*."""
    index = CHANNELS.index("brake_power_w")
    values = sorted(drives)
    power_w = np.array([drives[one].inputs[:, :, index] for one in values])
    corners = drives[values[0]].corners
    return {
        corner: PowerBy(key, np.array(values), power_w[:, :, i])
        for i, corner in enumerate(corners)
    }


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The result of the search: where to refine, on which drives.

    ``noise`` is what the search left of discs alone, by node, for the
    refinement to start with; ``remarks`` say what was chosen.
    """

    target: Target
    reading: Reading
    noise: Mapping[str, SensorNoise]
    remarks: tuple[str, ...] = ()


def exponent_of(target: Target) -> float:
    """Return how much of its heat capacity's rise the disc has."""
    disc = target.corner.disc
    return 1.0 if disc is None else disc.heat_capacity_exponent


def search(target: Target, readings: Sequence[Reading]) -> Found:
    """Find what *target* only guesses in *readings*, the first as configured.

    Tried are the filters of the readings, and the disc's heat capacity as
    configured or constant, each with the best of all starts.
    """
    first = readings[0]
    keys = _keys(target, first.drives)
    if not keys:
        return Found(target, first, {})
    exponents = [exponent_of(target)]
    if CAPACITY in target.guessed:
        exponents.append(0.0)
    alone = _discs_only(target, first.drives)
    tried = []
    for exponent, reading in product(exponents, readings):
        start = _with_form(target, exponent, reading)
        fit = _Discs(start, reading.drives, keys)
        left_k, values = fit.solved()
        noise = fit.noise(values) if alone else {}
        if not alone:
            values = {k: v for k, v in values.items() if k in STARTS}
        tried.append((left_k, Found(start.changed(values), reading, noise)))
    best = min(tried, key=lambda one: one[0])
    # as configured, where another form is hardly better
    return best[1] if best[0] < MUCH_LESS * tried[0][0] else tried[0][1]


def _keys(target: Target, drives: Sequence[Drive]) -> list[str]:
    """Return what is searched for: guesses that discs show."""
    if not any(
        "disc" in d.measured.get(c, {}) for d in drives for c in target.corners
    ):
        return []
    wanted: list[str] = [key for key in (MASS, LEVEL) if key in target.guessed]
    if LEVEL in target.guessed:
        wanted += driven_keys(target, drives, [*S_SPEEDS_MS, STILL])[0]
    elif any(by.key == DRAG for one in drives for by in one.power_by.values()):
        wanted.append(DRAG)
    return wanted


def _with_form(target: Target, exponent: float, reading: Reading) -> Target:
    """Return *target* with that capacity and the filter of *reading*."""
    if exponent != exponent_of(target):
        target = target.with_disc(heat_capacity_exponent=exponent)
    if reading.filter_s is None:
        return target
    heat = target.config.heat.model_copy(
        update={"derivative_filter_s": reading.filter_s}
    )
    config = target.config.model_copy(update={"heat": heat})
    return replace(target, config=config)


class _Discs:
    """Residuals of the discs alone, plain, for the minimiser."""

    def __init__(
        self, target: Target, drives: Sequence[Drive], keys: Sequence[str]
    ) -> None:
        runs, terms = whole_drives(
            target, drives, point_s=FINE_S, most_points=FINE_POINTS
        )
        self.terms = [one for one in terms if one.node == "disc"]
        there = {(one.drive, one.corner) for one in self.terms}
        runs = [one for one in runs if (one.drive, one.corner) in there]
        self.problem = Problem(target, drives, keys, runs, self.terms, None)

    def __call__(self, points: Column) -> Column:
        apart = np.concatenate(self.problem.residuals_k(points)).T / WHITE_K
        prior = self.problem.of_priors(points)
        return np.concatenate((apart, prior), axis=1)

    def solved(self) -> tuple[float, dict[str, float]]:
        """Return what is left of the discs [K] (RMS) and the values."""
        problem = self.problem
        factors = [STARTS.get(key, (1.0,)) for key in problem.keys]
        starts = problem.start + np.log(list(product(*factors)))
        costs = np.nan_to_num((self(starts) ** 2).sum(axis=1), nan=np.inf)
        x = starts[np.argmin(costs)]
        for _ in range(2):
            x = minimise(self, x, problem.lower, problem.upper).x
        left = np.concatenate(problem.residuals_k(x[None]))
        return rms(left[:, 0]), problem.values(x)

    def noise(self, values: Mapping[str, float]) -> dict[str, SensorNoise]:
        """Return white noise of what is left, for points of one second."""
        x = np.log([[values[key] for key in self.problem.keys]])
        left_k = rms(np.concatenate(self.problem.residuals_k(x))[:, 0])
        return {
            "disc": SensorNoise(COHERENT * left_k, 0.0, 0.0, 0.0, 0.0, 0.0)
        }

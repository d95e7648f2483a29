"""Which cases the gap benchmark runs: by group, stratified, or a sample."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from gap_cars import OF_TEMPERATURES, World
from gap_cases import DRAWS, PAIRS, TWIN_NUMBERS, TWINS, Case

from bstm_daemon.simulation.parameters import EFFECT_NAMES, UNHEARD_NAMES

if TYPE_CHECKING:
    from collections.abc import Sequence

ADVISED: Final = 100
"""Number of the first case that is for the next drive."""

ADVISED_CASES: Final = 60
"""Of them in the protocol."""

SAMPLE_EFFECTS: Final = (
    *("gap_conduction", "hub_conduction", "shim_contact", "disc_hat"),
    *("disc_radiation_driving", "residual_drag", "pad_wear", "wet_disc"),
    *("backplate_loss", "contact_conductance", "pad_conductivity"),
    *("caliper_bypass", "disc_caliper_radiation", "friction_fade"),
    *("friction_history", "brake_share"),
)
SAMPLE_CARS: Final = 2
"""What `.ci/run` takes: these, and half as many effect-free."""


def sample() -> list[Case]:
    """Return the cases of the quick run."""
    world = World()
    cases = [Case(world, (one,), 0, SAMPLE_CARS) for one in SAMPLE_EFFECTS]
    quiet = len(SAMPLE_EFFECTS) // 2 // SAMPLE_CARS
    return cases + [
        Case(world, (), car * DRAWS + draw)
        for car in range(SAMPLE_CARS)
        for draw in range(quiet)
    ]


EXTENDED_PAIRS: Final = (
    ("contact_conductance", "shim_contact"),
    ("pad_wear", "shim_contact"),
    ("wet_disc", "pad_wear"),
    ("backplate_loss", "pad_conductivity"),
    ("hub_conduction", "shim_contact"),
    ("pushout_pressure", "contact_conductance"),
    ("friction_history", "pad_conductivity"),
    ("pushout_pressure", "pad_capacity"),
)
"""Where the model has most effects of the other pairs."""

STRATIFIED: Final = 120
"""Cases of a world beside the main one: a fifth effect-free, a tenth each
pairs and effects that no catalogue has, all kinds equally often."""


def stratified(world: World) -> list[Case]:
    """Return the cases of *world* where a full run is not worth its time."""
    tenth = STRATIFIED // 10
    lacking = world.lacking
    pairs = pairs_of(world)
    found = [Case(world, (), number) for number in range(2 * tenth)]
    for kinds, count in (
        ([(name,) for name in UNHEARD_NAMES], tenth),
        (pairs, min(tenth, len(pairs))),
    ):
        found += [
            Case(world, kinds[i % len(kinds)], i // len(kinds))
            for i in range(count)
        ]
    return found + [
        Case(world, (lacking[i % len(lacking)],), i // len(lacking))
        for i in range(STRATIFIED - len(found))
    ]


def pairs_of(world: World) -> list[tuple[str, str]]:
    """Return the pairs that can be hidden in *world*."""
    lacking = set(world.lacking)
    also = EXTENDED_PAIRS if world.structure == "extended" else ()
    return [pair for pair in (*PAIRS, *also) if set(pair) <= lacking]


def protocol(split: str) -> list[Case]:
    """Return every case that the tables of the documentation are of.

    Sensors `n2` half on ``plain`` with the structure ``thesis``, half on
    ``road`` with ``extended``; other sensors and fewer thermocouples
    stratified; the controls of strength 0 and of ten effects at once.
    """
    found = []
    for world in (
        World(split=split),
        World("road", "extended", split=split),
    ):
        for groups, count in (
            (("S1",), 8),
            (("S2", "SU"), 8),
            (("ST",), 10),
            (("S0",), 25),
        ):
            found += cases_of(world, groups, count, EFFECT_NAMES)
    found += cases_of(World(split=split), ("zero",), 1, EFFECT_NAMES)
    found += cases_of(World("road", split=split), ("RT",), 4, EFFECT_NAMES)
    for sensors in ("n1", "n3", "n4"):
        found += stratified(World(sensors=sensors, split=split))
    for nodes in (("disc", "fluid"), ("fluid",)):
        found += stratified(World(split=split, nodes=nodes))
    return found


def cases_of(
    world: World, groups: Sequence[str], count: int, effects: Sequence[str]
) -> list[Case]:
    """Return *count* cases of each effect, pair or effect-free car."""
    found = []
    lacking = [name for name in world.lacking if name in effects]
    for number in range(count):
        if "S1" in groups:
            found += [Case(world, (name,), number) for name in lacking]
        if "S2" in groups:
            found += [
                Case(world, pair, number)
                for pair in pairs_of(world)
                if set(pair) <= set(lacking)
            ]
        if "SU" in groups:
            found += [Case(world, (name,), number) for name in UNHEARD_NAMES]
        if "ST" in groups:
            found += [
                Case(world, (name,), TWIN_NUMBERS + number)
                for name in TWINS
                if name in lacking
            ]
        if "zero" in groups:
            found += [
                Case(world, (name,), number, absent=True) for name in lacking
            ]
        if {"S0", "RT"} & set(groups):
            first = number * DRAWS
            draws = DRAWS if "S0" in groups else 2
            found += [Case(world, (), first + i) for i in range(draws)]
    return found


def open_cases(world: World, count: int, effects: Sequence[str]) -> list[Case]:
    """Return *count* cases for the next drive, all of the same two cars.

    One of each effect in turn: every drive of the menu is driven by each
    car, which takes minutes.
    """
    names = [n for n in world.lacking if n in effects and n in OF_TEMPERATURES]
    turns = -(-count // max(len(names), 1))
    found = [
        Case(world, (name,), ADVISED + turn, SAMPLE_CARS)
        for turn in range(turns)
        for name in names
    ]
    return found[:count]

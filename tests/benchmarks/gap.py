"""Hidden effects: does ``bstm gap`` name what the reality has and hides.

Each case: a car drawn around the nominal one; a configuration matched on two
drives of it without the effect, its tunables then off by a few percent; two
drives with the effect switched on in the reality (other code and other forms
than the catalogue's) through sensors of preset n2; and two held-out drives of
another kind. S1: one effect, its strength log-uniform from 0.3 to 2. S0: none.

    python tests/benchmarks/gap.py --kind S1 --cases 4 --cache FOLDER

Results are kept in the folder, one file a case, so a run can be resumed.
Cars and seeds here are for reporting; develop on ``--split development``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import pickle
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from side_by_side import Outcome, Table

from bstm_daemon.bus.columns import Events
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.effects.catalogue import effects_of
from bstm_daemon.gap.fitting import fit
from bstm_daemon.gap.naming import name_effect
from bstm_daemon.gap.projector import Projector
from bstm_daemon.gap.recording import Recording, recorded
from bstm_daemon.gap.showing import BASELINES, EXTENDED, REFITTED, show
from bstm_daemon.gap.signatures import candidates, linearised
from bstm_daemon.gap.workflow import compare
from bstm_daemon.matching.refine import refine
from bstm_daemon.matching.tunables import (
    REFINED,
    TUNABLES,
    Target,
    targets_of,
    usable,
)
from bstm_daemon.replay import present_roles
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.shipped import shipped_file
from bstm_daemon.simulation import NOMINAL, load_drive, simulate
from bstm_daemon.simulation.parameters import EFFECT_NAMES, preset_effects

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.config import Config
    from bstm_daemon.simulation.simulate import SimulatedDrive
    from bstm_daemon.simulation.vehicle import CarParameters

HALVES: Final = {"plain": "thesis", "road": "extended"}
"""Preset of the reality to structure of the model."""

MATCHED_ON: Final = ("simalp", "rich")
FITTED: Final = ("simalp", "rich")
HELD_OUT: Final = ("grossglockner", "city")
SENSORS: Final = "n2"
CARS: Final = 6
SPREAD: Final = 0.10
MISTUNED: Final = 0.3
"""Of a tunable's prior deviation: drawn for each case."""

DETECTABLE: Final = 30.0
"""Expected squared distance from the re-fitted baseline, whitened."""

SPLITS: Final = {"reported": 70_000, "development": 10_000}
EVERY: Final = 10
"""Samples of the 100 Hz are kept at 10 Hz."""

BROAD: Final = frozenset({"thermocouple_offset", "thermocouple_lag"})
"""As cases they have three times what every sensor has."""

SAMPLE_EFFECTS: Final = (
    *("gap_conduction", "friction_fade", "hub_conduction", "shim_contact"),
    *("disc_radiation_driving", "residual_drag", "disc_hat", "pad_wear"),
    *("backplate_loss", "contact_conductance", "friction_speed"),
    *("pad_conductivity", "caliper_bypass", "disc_caliper_radiation"),
    *("wet_disc", "brake_share"),
)
SAMPLE: Final = tuple(
    case
    for i, name in enumerate(SAMPLE_EFFECTS)
    for case in (
        ("S1", name, 0),
        *((("S0", "", i // 2),) if i % 2 else ()),
    )
)
"""What `.ci/run` takes."""


@dataclass(frozen=True, slots=True)
class Case:
    """One case; ``effect`` is empty in S0."""

    kind: str
    effect: str
    number: int
    preset: str = "plain"
    split: str = "reported"

    @property
    def seed(self) -> int:
        """Seed of everything that is drawn for it."""
        text = f"{self.kind} {self.effect} {self.number} {self.preset}"
        digest = hashlib.sha256(text.encode()).hexdigest()
        return SPLITS[self.split] + int(digest[:6], 16) % 10_000

    @property
    def car(self) -> int:
        """Number of its car."""
        return SPLITS[self.split] + self.seed % CARS

    @property
    def strength(self) -> float:
        """Strength of the hidden effect."""
        if not self.effect:
            return 0.0
        drawn = float(
            np.exp(
                np.random.default_rng(self.seed).uniform(
                    np.log(0.3), np.log(2.0)
                )
            )
        )
        return max(drawn, 1.0) if self.effect in BROAD else drawn


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a case."""

    kind: str
    effect: str
    number: int
    strength: float
    distance2: float
    answer: str
    names: list[str]
    probability: float
    gate_z: float
    strength_found: float
    strength_sd: float
    shrink: dict[str, float]
    bends: dict[str, float]
    seconds: float

    @property
    def detectable(self) -> bool:
        """Whether the data could show it at all."""
        return self.distance2 >= DETECTABLE

    @property
    def score(self) -> float:
        """1 for the right name or a class of two with it, 1/size beyond."""
        if self.effect not in self.names:
            return 0.0
        if self.answer == "name":
            return 1.0
        if self.answer == "class":
            return 1.0 if len(self.names) <= 2 else 1.0 / len(self.names)
        return 0.0

    @property
    def wrong_name(self) -> bool:
        """Whether a single name was given and is wrong."""
        return self.answer == "name" and self.effect not in self.names


def structure_config(preset: str) -> Config:
    """Return the example car in the structure of this half."""
    config = load_vehicle(shipped_file("config/example_vehicle.toml"))[0]
    changes: dict[str, Any] = {
        "heat": config.heat.model_copy(update={"mode": "ff"}),
        "thermal": config.thermal.model_copy(
            update={"structure": HALVES[preset]}
        ),
        "cooling": config.cooling.model_copy(update={"form": "conductance"}),
    }
    return config.model_copy(update=changes)


@cache
def present() -> dict[int, int]:
    """Return the roles of the example car."""
    signal_map = load_vehicle(shipped_file("config/example_vehicle.toml"))[1]
    return present_roles(signal_map)


def drawn_car(number: int) -> CarParameters:
    """Return car *number*: what is not on a drawing varies."""
    rng = np.random.default_rng(number)
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


def events_of(drive: SimulatedDrive) -> Events:
    """Return what the car's sensors said, in order of time."""
    parts = []
    bus = np.asarray(drive.bus_on)[::EVERY]
    for name, values in drive.roles.items():
        role = ROLE_INDEX[name]
        if role in present():
            time_s = drive.time_s[::EVERY][bus]
            parts.append((time_s, role, np.asarray(values)[::EVERY][bus]))
    logged = np.interp(drive.slow_time_s, drive.time_s, drive.logger_on) > 0.5
    for name, values in drive.temperatures.items():
        role = ROLE_INDEX[name]
        if role in present():
            parts.append((drive.slow_time_s[logged], role, values[logged]))
    time_us = np.concatenate(
        [np.rint(time_s * 1e6).astype(np.int64) for time_s, _, _ in parts]
    )
    order = np.argsort(time_us, kind="stable")
    roles = np.concatenate(
        [np.full(len(t), role, np.int32) for t, role, _ in parts]
    )
    values = np.concatenate([value for _, _, value in parts])
    return Events(time_us[order], roles[order], values[order], Counter())


def record(
    name: str, config: Config, case: Case, strength: float, seed: int
) -> Recording:
    """Return drive *name* of the case's car as it was recorded."""
    effects = preset_effects(case.preset)
    if case.effect:
        effects = effects.with_strength(case.effect, strength)
    drive = simulate(
        load_drive(name),
        drawn_car(case.car),
        preset=effects,
        sensors=SENSORS,
        seed=seed,
    )
    return recorded(name, events_of(drive), config, present())


def matched(case: Case, folder: Path) -> Target:
    """Return the configuration matched on effect-free drives, kept."""
    kept = folder / f"car-{case.preset}-{case.car}.pickle"
    if kept.exists():
        target: Target = pickle.loads(kept.read_bytes())  # noqa: S301  (own)
        return target
    config = structure_config(case.preset)
    plain = replace(case, effect="")
    drives = [
        record(name, config, plain, 0.0, case.car + 31 * i).drive
        for i, name in enumerate(MATCHED_ON)
    ]
    target = targets_of(config, ["FL", "FR"])[0]
    keys, _ = usable(target, REFINED)
    found = refine(target, drives, keys)
    target = target.changed(found.values)
    kept.write_bytes(pickle.dumps(target))
    return target


def mistuned(target: Target, seed: int) -> Target:
    """Return *target* with its tunables off by a little."""
    rng = np.random.default_rng(seed)
    keys, _ = usable(target, REFINED)
    values = {}
    for key in keys:
        one = TUNABLES[key]
        off = MISTUNED * one.prior * rng.standard_normal()
        values[key] = float(
            np.clip(target.value(one) * np.exp(off), one.lower, one.upper)
        )
    return target.changed(values)


def result(case: Case, folder: Path) -> Result:
    """Run *case*, or return what is kept of it."""
    name = f"{case.split}-{case.preset}-{case.kind}-{case.effect}"
    kept = folder / f"{name}-{case.number}.json"
    if kept.exists():
        return Result(**json.loads(kept.read_text("utf-8")))
    found = _run(case, folder)
    kept.write_text(json.dumps(asdict(found)) + "\n", "utf-8")
    return found


def _run(case: Case, folder: Path) -> Result:
    target = mistuned(matched(case, folder), case.seed)
    config = target.config
    recordings = [
        record(name, config, case, case.strength, case.seed + i)
        for i, name in enumerate(FITTED)
    ]
    begin = time.perf_counter()
    comparison = compare(target, recordings)
    known = linearised(comparison, candidates(config))
    naming = name_effect(comparison, known)
    strength, deviation = float("nan"), float("nan")
    shrink: dict[str, float] = {}
    bends: dict[str, float] = {}
    seconds = time.perf_counter() - begin
    if naming.answer in {"name", "class"}:
        names = naming.names if naming.answer == "name" else naming.names[:1]
        start = {
            one.name: one.strength
            for one in naming.candidates
            if one.name in names
        }
        begin = time.perf_counter()
        extended = fit(comparison, start)
        seconds += time.perf_counter() - begin
        strength = extended.strengths[names[0]]
        deviation = extended.deviations[names[0]]
        held_out = [
            record(name, config, case, case.strength, case.seed + 50 + i)
            for i, name in enumerate(HELD_OUT)
        ]
        begin = time.perf_counter()
        shown = show(comparison, extended, held_out)
        seconds += time.perf_counter() - begin
        shrink = {name: shown.shrinks[name].factor for name in BASELINES}
        bends = dict(shown.bends)
    distance2 = 0.0
    if case.effect:
        clean = [
            record(name, config, case, 0.0, case.seed + i)
            for i, name in enumerate(FITTED)
        ]
        without = compare(target, clean)
        change = known.residual - without.whiten(
            without.apart_k(without.start[None])[:, 0]
        )
        project = Projector(known.jacobian, comparison.prior)
        distance2 = float(change @ project(change))
    return Result(
        case.kind,
        case.effect,
        case.number,
        case.strength,
        distance2,
        naming.answer,
        list(naming.names),
        naming.probability,
        naming.gate_z,
        strength,
        deviation,
        shrink,
        bends,
        seconds,
    )


def wilson(hits: float, count: int) -> str:
    """Return a share with its 95 % interval."""
    if not count:
        return "- (0 cases)"
    z = 1.96
    p = hits / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = (
        z
        * np.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
        / (1 + z * z / count)
    )
    low, high = max(middle - half, 0.0), min(middle + half, 1.0)
    return (
        f"{100 * p:.1f} % ({100 * low:.1f} to {100 * high:.1f}; {count} cases)"
    )


def figures(results: Sequence[Result]) -> list[tuple[str, str]]:
    """Return what was found, a name and a figure each."""
    hidden = [one for one in results if one.effect]
    clear = [one for one in hidden if one.detectable]
    strong = [one for one in hidden if one.strength >= 1.0]
    free = [one for one in results if not one.effect]

    def share(hits: float, among: Sequence[Result]) -> str:
        return wilson(hits, len(among))

    found = [
        ("top-1, detectable cases", share(sum(o.score for o in clear), clear)),
        (
            "detected, detectable cases",
            share(sum(o.answer != "nothing" for o in clear), clear),
        ),
        (
            "detected, strength >= 1",
            share(sum(o.answer != "nothing" for o in strong), strong),
        ),
        (
            "wrong single name, all hidden",
            share(sum(o.wrong_name for o in hidden), hidden),
        ),
        (
            "anything said, effect-free",
            share(sum(o.answer != "nothing" for o in free), free),
        ),
        (
            "name or class given, effect-free",
            share(sum(o.answer in {"name", "class"} for o in free), free),
        ),
    ]
    right = [o for o in hidden if o.answer == "name" and not o.wrong_name]
    if right:
        errors = [abs(o.strength_found / o.strength - 1.0) for o in right]
        found.append(
            ("strength error, median", f"{100.0 * np.median(errors):.0f} %")
        )
        for name in BASELINES:
            factors = [o.shrink[name] for o in right if name in o.shrink]
            worse = sum(f < 0.95 for f in factors)
            found.append(
                (
                    f"shrink against {name}",
                    (
                        f"median {np.median(factors):.2f}, "
                        f"below 0.95 in {worse} of {len(factors)}"
                    ),
                )
            )
        bent = [
            o.bends[REFITTED] / max(o.bends[EXTENDED], 1e-3) for o in right
        ]
        found.append(
            (
                "tunables less bent than by the full re-fit",
                f"median {np.median(bent):.1f} times",
            )
        )
    seconds = [o.seconds for o in results]
    found.append(("wall time a case", f"median {np.median(seconds):.0f} s"))
    return found


def misses(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return every case that did not come out right."""
    return [
        (
            one.effect or "none",
            f"{one.strength:.2f}",
            f"{one.distance2:.0f}",
            one.answer,
            ", ".join(one.names),
        )
        for one in results
        if (one.effect and one.score < 1.0)
        or (not one.effect and one.answer != "nothing")
    ]


def run(*, full: bool) -> Outcome:
    """Return the sample; *full*: four of each effect and 100 without."""
    cases = [Case(*one) for one in SAMPLE]
    if full:
        cases = hidden_cases("plain", "reported", EFFECT_NAMES, 4)
        cases += [Case("S0", "", number) for number in range(100)]
    kept = os.environ.get("BSTM_GAP_CACHE")
    with tempfile.TemporaryDirectory() as temporary:
        results = all_results(cases, Path(kept or temporary), os.cpu_count())
    return outcome(results)


def outcome(results: Sequence[Result]) -> Outcome:
    """Return *results* as tables."""
    return Outcome(
        "Hidden effects",
        f"{len(results)} cases on plain with structure thesis, sensors "
        f"{SENSORS}; 95 % intervals of Wilson.",
        [],
        [
            Table("figures", ("figure", "found"), tuple(figures(results))),
            Table(
                "not right",
                ("hidden", "strength", "distance2", "answer", "names"),
                tuple(misses(results)),
            ),
        ],
    )


def hidden_cases(
    preset: str, split: str, effects: Sequence[str], count: int
) -> list[Case]:
    """Return *count* cases of each effect that the structure lacks."""
    shipped = {one.name for one in effects_of(structure_config(preset))}
    return [
        Case("S1", effect, number, preset, split)
        for number in range(count)
        for effect in effects
        if effect not in shipped
    ]


def all_results(
    cases: Sequence[Case], folder: Path, jobs: int | None
) -> list[Result]:
    """Run *cases*, as many processes at once as *jobs*."""
    folder.mkdir(parents=True, exist_ok=True)
    # each car's match once, before the cases that share it
    cars = {case.car: case for case in cases}
    with ProcessPoolExecutor(jobs) as pool:
        list(pool.map(matched, cars.values(), [folder] * len(cars)))
        found = [pool.submit(result, case, folder) for case in cases]
        return [one.result() for one in found]


def main() -> None:
    """Run the cases that the arguments ask for and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--kind", choices=("S1", "S0", "sample"), default="sample"
    )
    parser.add_argument(
        "--cases",
        type=int,
        default=1,
        metavar="N",
        help="S1: of each effect; S0: in all",
    )
    parser.add_argument("--preset", choices=tuple(HALVES), default="plain")
    parser.add_argument("--split", choices=tuple(SPLITS), default="reported")
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--effects", nargs="*", default=EFFECT_NAMES)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    args = parser.parse_args()
    half = (args.preset, args.split)
    cases = [Case(*one, *half) for one in SAMPLE]
    if args.kind == "S1":
        cases = hidden_cases(*half, args.effects, args.cases)
    elif args.kind == "S0":
        cases = [Case("S0", "", n, *half) for n in range(args.cases)]
    results = all_results(cases, args.cache, args.jobs)
    for table in outcome(results).tables:
        for row in (table.header, *table.rows):
            sys.stdout.write("  ".join(row) + "\n")


if __name__ == "__main__":
    main()

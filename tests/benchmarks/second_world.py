"""The whole workflow in a car simulator that shares nothing with this project.

``second_world.py FOLDER [--release] [--first SEED] [--cars N] [--effects N]
[--controls N] [--unlisted] [--drives] [--out FILE.md]``.
``BSTM_SECOND_WORLD`` names the simulator: the folder of ``make_case.py``,
which writes drives with and without a hidden effect, and of
``sheet_to_config.py``, which writes a configuration from the car's sheet;
``BSTM_SECOND_WORLD_PYTHON`` is the interpreter that has what they need. Each
car is matched once with ``bstm match`` on drives without the effect; then
``bstm gap run`` answers on drives with it. FOLDER keeps what was made: a
second run does what is missing. ``--unlisted`` asks what is hidden with all
its right names taken out of the catalogue, and no controls; ``--drives``
compares the held-out drives with their truth, by the sheet alone and matched.

Seeds below 500 are for development. ``--release`` takes those that a hash of
the released version draws from 500 to 999: for figures that are reported, and
looked at once.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from measurements import markdown

import bstm_daemon
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.targets import measured_targets
from bstm_daemon.api import load_config, replay
from bstm_daemon.cli.vehicle import load_vehicle

if TYPE_CHECKING:
    from collections.abc import Sequence

CALIBRATION: Final = ("simalp", "rich", "coastdown")
WITH_EFFECT: Final = ("simalp", "rich")
HELD_OUT: Final = ("ams", "longrun")
CONTROLS: Final = (
    WITH_EFFECT,
    ("rich", "grossglockner"),
    ("simalp", "city"),
    ("grossglockner", "city"),
    ("rich", "ams"),
    ("longrun", "rich"),
)
"""Drives of the controls, car by car; the first are those of the effects."""

RELEASE_SEEDS: Final = range(500, 1000)

RIGHT: Final[dict[str, set[str]]] = {
    "mu_fade": {"friction_fade", "change.effect.friction_fade.strength"},
    "mu_progressive": {"friction_history", "friction_in_stop"},
    "pad_half_worn": {
        *("pad_wear", "change.heat_into_pads", "change.lining_capacity"),
        "change.lining_conductivity",
    },
    "disc_worn": {"disc_wear", "change.disc_mass"},
    "closed_rim": {
        *("change.wheel_air", "change.disc_air", "change.cooling.s_per_s"),
        *("change.effect.local_air.strength", "local_air"),
    },
    "dragging_caliper": {"residual_drag"},
    "extra_mass": {"mass_error"},
    "accel_offset": {"accelerometer_bias"},
    "shim_degraded": {"shim_contact", "change.shim_resistance"},
    "hammerhead_strong": {
        *("bracket_conduction", "change.effect.bracket_conduction.strength"),
    },
    "pad_k_rise": {"pad_conductivity", "change.lining_conductivity"},
    "engine_heat": {
        *("engine_heat", "local_air", "change.effect.local_air.strength"),
    },
    "tc_debonded": {"thermocouple_lag", "thermocouple_offset"},
    "hub_drum_heat": {"hub_heat"},
}
"""Hidden effect to right names."""

PLACES: Final[dict[str, tuple[str, ...]]] = {
    "mu_fade": ("brake heat",),
    "mu_progressive": ("brake heat",),
    "pad_half_worn": ("pad_front to pad_back",),
    "disc_worn": ("disc",),
    "closed_rim": ("to air", "carried by air"),
    "dragging_caliper": ("heat at pad_front", "heat at disc"),
    "extra_mass": ("brake heat",),
    "accel_offset": ("brake heat",),
    "shim_degraded": ("pad_back to", "backplate to fluid"),
    "hammerhead_strong": ("pad_back to",),
    "pad_k_rise": ("pad_front to pad_back",),
    "engine_heat": ("heat at",),
    "tc_debonded": (),
    "hub_drum_heat": ("heat at disc", "disc to"),
}
"""Hidden effect to the paths of a description without its names; an error of a
sensor has none."""

NAMED: Final = frozenset({"name", "class"})
"""Answers that give a name."""

NODES: Final = {
    "fluid": "fluid_c",
    "disc": "disc_c",
    "pad_front": "pad_front_c",
    "pad_back": "pad_back_c",
}
"""Nodes of the simulator that a thermocouple measures, and our columns."""

DETECTABLE: Final = 3.0
"""An effect is detectable where it moves a measured node by so many times what
the matched control is off there, both as RMS against the truth."""


SHRINKS: Final = ("as configured", "heat and cooling re-fitted")

HEADER: Final = (
    *("car", "hidden", "detectable", "answer", "worth"),
    *(f"shrink, {SHRINKS[0]}", "limit", SHRINKS[1], "limit"),
)
"""The limit is the shrink of a model that errs with the effect no more than
the matched one without it."""


DRIVES: Final = (
    *("car", "drive", "configured", "fluid, largest K", "RMS"),
    *("peak late, min", "disc, RMS"),
)


@dataclass(frozen=True)
class Case:
    """One car, one thing hidden in it or none, and the drives."""

    seed: int
    effect: str
    drives: tuple[str, ...]
    unlisted: bool = False

    @property
    def name(self) -> str:
        """Of its folder."""
        if self.effect == "none":
            return f"{self.seed}-none-{'-'.join(self.drives)}"
        return f"{self.seed}-{self.effect}"


class World:
    """The simulator, and what was made with it under *folder*."""

    def __init__(self, folder: Path) -> None:
        """Find the simulator by the environment.

        Raises:
            SystemExit: ``BSTM_SECOND_WORLD`` is not set.
        """
        where = os.environ.get("BSTM_SECOND_WORLD")
        if not where:
            sys.exit("BSTM_SECOND_WORLD: set it to the simulator's folder")
        self.where, self.folder = Path(where), folder
        self.python = os.environ.get("BSTM_SECOND_WORLD_PYTHON", "python3")
        self.leaves: dict[int, dict[tuple[str, str], tuple[float, int]]] = {}

    def run(self, script: str, *arguments: str) -> None:
        """Run one of its scripts."""
        subprocess.run(
            [self.python, str(self.where / script), *arguments],
            check=True,
            stdout=subprocess.DEVNULL,
            env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
        )

    def made(self, case: Case) -> Path:
        """Return the folder of *case*, made if it is not there.

        The first control of a car also has the drives to match it on.
        """
        target = self.folder / case.name
        if not (target / "runs.json").exists():
            shutil.rmtree(target, ignore_errors=True)
            first = case == Case(case.seed, "none", WITH_EFFECT)
            self.run(
                *("make_case.py", "--effect", case.effect),
                *("--seed", str(case.seed), "--out", str(target)),
                *("--calibration", *(CALIBRATION if first else ())),
                *("--manoeuvres", *case.drives),
                *("--heldout", *HELD_OUT, "--heldout-tc"),
            )
        return target

    def matched(self, seed: int) -> Path:
        """Return the configuration of car *seed* as matched."""
        folder = self.made(Case(seed, "none", WITH_EFFECT))
        sheet, matched = folder / "car.toml", folder / "matched.toml"
        if not matched.exists():
            self.run("sheet_to_config.py", str(folder), str(sheet))
            logs = sorted(map(str, folder.glob("cal*.log")))
            # its figures are of a match that adds nothing
            car = ("--plain", "-c", str(sheet), "-o", str(matched))
            bstm("match", *logs, *car)
        return matched

    def answered(self, case: Case) -> dict[str, Any]:
        """Return what ``bstm gap run`` says of *case*."""
        matched, folder = self.matched(case.seed), self.made(case)
        answer = folder / "answer.json"
        without: list[str] = []
        if case.unlisted:
            answer = folder / "answer_unlisted.json"
            without = ["--without", *sorted(RIGHT[case.effect])]
        if not answer.exists():
            logs = sorted(map(str, folder.glob("test*.log")))
            held = sorted(map(str, folder.glob("heldout*.log")))
            bstm(
                *("gap", "run", *logs, "--holdout", *held),
                *("-c", str(matched), "--force", "--json", str(answer)),
                *("-o", str(answer.with_suffix(".toml")), *without),
            )
        found: dict[str, Any]
        found, *_ = json.loads(answer.read_text("utf-8"))["corners"]
        return found

    def detectable(self, case: Case) -> bool:
        """Return whether the effect stands out of the match's own error."""
        matched = self.matched(case.seed)
        control = self.made(Case(case.seed, "none", WITH_EFFECT))
        vehicle = load_config(matched)
        worst = 0.0
        for log in sorted(control.glob("test*.log")):
            run = replay(log, vehicle, start="cold", every_s=1.0).columns
            # the truth counts from the start of the log
            time_s = run["time_s"] - run["time_s"][0]
            truth, changed = (
                np.load(folder / "truth" / f"{log.stem}.npz")
                for folder in (control, self.made(case))
            )
            for node, column in NODES.items():
                ours = np.interp(truth["t"], time_s, run[f"FL.{column}"])
                off_k = rms(ours - truth[node])
                own = np.interp(truth["t"], changed["t"], changed[node])
                worst = max(worst, rms(own - truth[node]) / off_k)
        return worst >= DETECTABLE

    def limits(self, case: Case, found: dict[str, Any]) -> list[str]:
        """Return by how much a gap as *found* can shrink at the most."""
        left = self.left(case.seed)
        errors = [
            (one["rms_k"], *left[one["drive"], one["node"]])
            for one in found["shown"]["errors"]
        ]
        least = sum(points * own_k**2 for _, own_k, points in errors)
        return [
            f"{np.sqrt(whole / least):.1f}"
            for of in SHRINKS
            for whole in [sum(n * rms_k[of] ** 2 for rms_k, _, n in errors)]
        ]

    def left(self, seed: int) -> dict[tuple[str, str], tuple[float, int]]:
        """Return what car *seed*'s match leaves on its held-out drives.

        RMS error [K] and number of points, by drive and node.
        """
        if seed not in self.leaves:
            matched = self.matched(seed)
            logs = sorted(matched.parent.glob("heldout*.log"))
            config, signals = load_vehicle(matched)
            drives = [read_recording(log, config, signals, {}) for log in logs]
            targets = measured_targets(config, [one.drive for one in drives])
            there = compare(targets[0], drives)
            apart_k = there.residuals_k(there.start[None])[:, 0]
            parts = np.split(apart_k, there.edges[1:-1])
            self.leaves[seed] = {
                (drives[one.drive].name, one.node): (rms(part), len(part))
                for one, part in zip(there.series, parts, strict=True)
            }
        return self.leaves[seed]

    def drives(self, seed: int) -> list[list[str]]:
        """Return what held-out drives of car *seed* are off their truth."""
        matched, rows = self.matched(seed), []
        sheet = matched.parent / "car.toml"
        for by, path in ("sheet", sheet), ("match", matched):
            vehicle = load_config(path)
            for log in sorted(matched.parent.glob("heldout*.log")):
                run = replay(log, vehicle, start="cold", every_s=1.0).columns
                time_s = run["time_s"] - run["time_s"][0]
                truth = np.load(matched.parent / "truth" / f"{log.stem}.npz")
                fluid, disc = (
                    np.interp(truth["t"], time_s, run[f"FL.{NODES[node]}"])
                    for node in ("fluid", "disc")
                )
                late_s = (
                    truth["t"][fluid.argmax()]
                    - truth["t"][truth["fluid"].argmax()]
                )
                off_k = fluid - truth["fluid"]
                rows.append(
                    [
                        *(str(seed), log.stem, by),
                        f"{off_k[np.abs(off_k).argmax()]:+.1f}",
                        f"{rms(off_k):.2f}",
                        f"{late_s / 60.0:+.1f}",
                        f"{rms(disc - truth['disc']):.1f}",
                    ]
                )
        return rows


def bstm(*arguments: str) -> None:
    """Run ``bstm``; exit codes above 1 are errors."""
    done = subprocess.run(
        [sys.executable, "-m", "bstm_daemon.cli.main", "-q", *arguments],
        check=False,
        stdout=subprocess.DEVNULL,
    )
    if done.returncode > 1:
        sys.exit(f"bstm {' '.join(arguments)}: exit code {done.returncode}")


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def verdict(effect: str, naming: dict[str, Any]) -> str:
    """Return what *naming* is worth where *effect* is hidden.

    ``right``; ``right among`` several; ``missing``, where it says that
    something is and gives no name; ``silent``; or ``wrong``: a name, which
    candidates that it does not decide between are not.
    """
    names, answer = set(naming["names"]), naming["answer"]
    if answer == "nothing":
        return "silent"
    named = answer in NAMED
    right = RIGHT.get(effect, set())
    if answer in {"unknown", "composed"} or not names & right:
        return "wrong" if named else "missing"
    return "right" if named and names <= right else "right among"


def verdict_unlisted(effect: str, naming: dict[str, Any]) -> str:
    """Return what *naming* is worth where no candidate describes *effect*.

    ``right`` without a name, or described at its place first; ``elsewhere``;
    ``missing`` where it does not decide.
    """
    answer = naming["answer"]
    if answer == "composed":
        first = naming["names"][0]
        there = any(path in first for path in PLACES[effect])
        return "right" if there else "elsewhere"
    if answer in NAMED:
        return "wrong"
    told = {"nothing": "silent", "unknown": "right"}
    return told.get(answer, "missing")


def figures(rows: Sequence[Sequence[str]]) -> str:
    """Return how often each verdict was given, in words."""
    controls = [row[4] for row in rows if row[2] == "-"]
    named = controls.count("wrong")
    told = len(controls) - controls.count("silent")
    text = f"Controls: {len(controls)}; a name in {named}, told something in "
    text += f"{told}."
    for which, kept in (("all", {"yes", "no"}), ("detectable", {"yes"})):
        found = Counter(row[4] for row in rows if row[2] in kept)
        text += f" Hidden, {which}: {found.total()}; "
        text += ", ".join(f"{one} {n}" for one, n in found.most_common())
        text += "."
    shrunk = np.array(
        [row[5:] for row in rows if row[2] != "-" and row[5] != "-"], float
    )
    if len(shrunk):
        medians = np.median(shrunk, axis=0)
        text += f" Shrink, median of {len(shrunk)}: "
        text += "; ".join(
            f"{of} {medians[2 * i]:.1f} of at most {medians[2 * i + 1]:.1f}"
            for i, of in enumerate(SHRINKS)
        )
        text += "."
    return text


def release_seeds(cars: int) -> list[int]:
    """Return the seeds of this version, the same on every computer."""
    digest = hashlib.sha256(bstm_daemon.__version__.encode()).digest()
    return random.Random(digest).sample(RELEASE_SEEDS, cars)  # noqa: S311


def cases(seed: int, effects: int, controls: int) -> list[Case]:
    """Return the controls of car *seed*, then its effects, drawn by it."""
    hidden = random.Random(seed).sample(sorted(RIGHT), effects)  # noqa: S311
    return [
        *(Case(seed, "none", drives) for drives in CONTROLS[:controls]),
        *(Case(seed, effect, WITH_EFFECT) for effect in hidden),
    ]


def row(world: World, case: Case) -> list[str]:
    """Return a line of the table: hidden, answered, worth, shrink."""
    found = world.answered(case)
    naming, shown = found["naming"], found.get("shown") or {}
    hidden = case.effect != "none"
    shrink = shown.get("shrink", {}) if found.get("strengths") else {}
    limits = world.limits(case, found) if shrink else ["-", "-"]
    factors = [f"{shrink[of][0]:.1f}" if shrink else "-" for of in SHRINKS]
    return [
        str(case.seed),
        case.effect if hidden else f"none ({', '.join(case.drives)})",
        ("yes" if world.detectable(case) else "no") if hidden else "-",
        ", ".join(naming["names"]) or naming["answer"],
        verdict_unlisted(case.effect, naming)
        if case.unlisted
        else verdict(case.effect, naming),
        *(one for pair in zip(factors, limits, strict=True) for one in pair),
    ]


def main() -> None:
    """Run the cases and write their table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--release", action="store_true")
    parser.add_argument("--first", type=int, default=101)
    parser.add_argument("--cars", type=int, default=10)
    parser.add_argument("--effects", type=int, default=6)
    parser.add_argument("--controls", type=int, default=6)
    parser.add_argument("--unlisted", action="store_true")
    parser.add_argument("--drives", action="store_true")
    parser.add_argument("--out", type=Path, metavar="FILE.md")
    args = parser.parse_args()
    world = World(args.folder.resolve())
    world.folder.mkdir(parents=True, exist_ok=True)
    seeds = (
        release_seeds(args.cars)
        if args.release
        else range(args.first, args.first + args.cars)
    )
    rows: list[list[str]] = []
    for seed in seeds:
        if args.drives:
            rows += world.drives(seed)
            continue
        controls = 0 if args.unlisted else args.controls
        for case in cases(seed, args.effects, controls):
            case = replace(case, unlisted=args.unlisted)  # noqa: PLW2901
            rows.append(row(world, case))
            print(*rows[-1], sep="  ", flush=True)  # noqa: T201
    table = {"header": DRIVES if args.drives else HEADER, "rows": rows}
    words = [] if args.drives else ["", figures(rows)]
    text = "\n".join([*markdown(table), *words]) + "\n"
    if args.out:
        args.out.write_text(text, "utf-8")
    else:
        sys.stdout.write(text)


if __name__ == "__main__":
    main()

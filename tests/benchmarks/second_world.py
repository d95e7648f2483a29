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
the released version draws from 500 to 999, and no earlier version drew: for
figures that are reported, and looked at once.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Final

from gap_world import DRIVES, HEADER, Case, World, figures, row
from measurements import markdown

import bstm_daemon

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
CHANGELOG: Final = Path(__file__).parents[2] / "CHANGELOG.md"
CARS: Final = 10

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

DRIVERS: Final[dict[str, frozenset[str]]] = {
    "mu_fade": frozenset({"temperature", "braking"}),
    "mu_progressive": frozenset({"time", "braking"}),
    "pad_half_worn": frozenset(),
    "disc_worn": frozenset(),
    "closed_rim": frozenset({"speed", "driving"}),
    "dragging_caliper": frozenset({"speed", "driving", "brake off"}),
    "extra_mass": frozenset({"braking"}),
    "accel_offset": frozenset({"braking"}),
    "shim_degraded": frozenset(),
    "hammerhead_strong": frozenset(),
    "pad_k_rise": frozenset({"temperature"}),
    "engine_heat": frozenset({"time", "speed", "driving", "parked"}),
    "tc_debonded": frozenset(),
    "hub_drum_heat": frozenset({"time", "driving", "braking"}),
}
"""And to the drivers and phases that it may be said to depend on."""


class SecondWorld(World):
    """The simulator, and what was made with it."""

    right, places, drivers = RIGHT, PLACES, DRIVERS

    def __init__(self, folder: Path) -> None:
        """Find the simulator by the environment.

        Raises:
            SystemExit: ``BSTM_SECOND_WORLD`` is not set.
        """
        super().__init__(folder)
        where = os.environ.get("BSTM_SECOND_WORLD")
        if not where:
            sys.exit("BSTM_SECOND_WORLD: set it to the simulator's folder")
        self.where = Path(where)
        self.python = os.environ.get("BSTM_SECOND_WORLD_PYTHON", "python3")

    def run(self, script: str, *arguments: str) -> None:
        """Run one of its scripts."""
        subprocess.run(
            [self.python, str(self.where / script), *arguments],
            check=True,
            stdout=subprocess.DEVNULL,
            env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
        )

    def control(self, seed: int) -> Case:
        """Return the pair of drives that effects are hidden in."""
        return Case(seed, "none", WITH_EFFECT)

    def made(self, case: Case) -> Path:
        """Return the folder of *case*, made if it is not there."""
        target = self.folder / case.name
        if not (target / "runs.json").exists():
            shutil.rmtree(target, ignore_errors=True)
            first = case == self.control(case.seed)
            self.run(
                *("make_case.py", "--effect", case.effect),
                *("--seed", str(case.seed), "--out", str(target)),
                *("--calibration", *(CALIBRATION if first else ())),
                *("--manoeuvres", *case.drives),
                *("--heldout", *HELD_OUT, "--heldout-tc"),
            )
        return target

    def write_sheet(self, folder: Path, out: Path) -> None:
        """Write what the sheet says."""
        self.run("sheet_to_config.py", str(folder), str(out))


def release_seeds(cars: int) -> list[int]:
    """Return the seeds of this version, the same on every computer.

    Without those of the :data:`CARS` of each earlier one.
    """
    text = CHANGELOG.read_text("utf-8")
    newest_first = re.findall(r"^## \[(\d[^]]*)\]", text, re.MULTILINE)
    used: list[int] = []
    for version in reversed(newest_first):
        if version == bstm_daemon.__version__:
            return _unused(version, cars, used)
        used += _unused(version, CARS, used)
    sys.exit(f"{CHANGELOG}: no version {bstm_daemon.__version__}")


def _unused(version: str, cars: int, used: list[int]) -> list[int]:
    """Return the first seeds that *version* draws and that are not *used*."""
    digest = hashlib.sha256(version.encode()).digest()
    drawn = random.Random(digest)  # noqa: S311  (no secret)
    seeds: list[int] = []
    while len(seeds) < cars:
        seed = drawn.choice(RELEASE_SEEDS)
        if seed not in {*used, *seeds}:
            seeds.append(seed)
    return seeds


def cases(seed: int, effects: int, controls: int) -> list[Case]:
    """Return the controls of car *seed*, then its effects, drawn by it."""
    hidden = random.Random(seed).sample(sorted(RIGHT), effects)  # noqa: S311
    return [
        *(Case(seed, "none", drives) for drives in CONTROLS[:controls]),
        *(Case(seed, effect, WITH_EFFECT) for effect in hidden),
    ]


def main() -> None:
    """Run the cases and write their table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--release", action="store_true")
    parser.add_argument("--first", type=int, default=101)
    parser.add_argument("--cars", type=int, default=CARS)
    parser.add_argument("--effects", type=int, default=6)
    parser.add_argument("--controls", type=int, default=6)
    parser.add_argument("--unlisted", action="store_true")
    parser.add_argument("--drives", action="store_true")
    parser.add_argument("--out", type=Path, metavar="FILE.md")
    args = parser.parse_args()
    world = SecondWorld(args.folder)
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

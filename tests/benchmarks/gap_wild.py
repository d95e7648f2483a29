"""Hidden effects in cars that nobody wrote for the catalogue: preset wild.

The packaged reality with what its other presets lack. Every car has its own
cp of iron and linings whose k and cp slope, its own mass, share of the axles
and friction law, and paths that the calibration drives have already. Every
case draws the form of what it hides from families that the catalogue does not
have, and its size from the literature. Drives are logs, and the commands
answer: ``bstm match --plain``, then ``bstm gap run --holdout``. The sheet has
the mass as weighed, everything else as it is of the nominal car.

*Detectable* is said by the truth: what is hidden moves a measured node, RMS,
by at least three times what the matched model is off there with nothing
hidden; a late clock moves what is logged, friction within a stop nothing.

    python tests/benchmarks/gap_wild.py FOLDER --cars 3
    python tests/benchmarks/gap_wild.py FOLDER --reported

Seeds of ``--reported`` are a hash of the release, and each release runs them
once; ``gap_wild_looks.json`` counts both kinds of looks.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from gap_cars import drawn_car, known_accuracy
from gap_world import HEADER, NODES, Case, World, figures, row
from measurements import markdown

from bstm_daemon import __version__
from bstm_daemon.files import shipped_file
from bstm_daemon.model.effects.catalogue import STRUCTURES
from bstm_daemon.simulation import Effects, load_drive, simulate
from bstm_daemon.simulation.lanes import (
    AIR,
    BODY,
    BRACKET,
    CENTRE,
    FINGER,
    FLUID,
    HUB,
    PISTON,
)
from bstm_daemon.simulation.parameters import LUMPS, DrawnPath
from bstm_daemon.simulation.recorder import Encoder, write_candump
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.simulation import SimulatedDrive
    from bstm_daemon.simulation.vehicle import CarParameters

    Draw = np.random.Generator

DBC: Final = "dbc/example_vehicle.dbc"
CALIBRATION: Final = ("rich", "simalp", "alpine-descent", "m04", "track")
SEARCHED: Final = ("rich", "m10", "grossglockner", "m14", "cooling", "m06")
HELD_OUT: Final = ("city", "m09", "ams", "m01")
"""Drives that the pairs of a car are drawn from; the first pair has the
soaks and stops that a match needs."""

SENSORS: Final = "n2"
DEVELOPMENT_SEED: Final = 20_000
REPORTED_CARS: Final = 30
LOOKS: Final = Path(__file__).with_name("gap_wild_looks.json")

# parts of a corner that a path begins at, and the air that it may end in
BACKPLATE, SURFACE = 0, 1
FIRST_LUMP, OPEN_AIR = 3, len(LUMPS)


@dataclass(frozen=True, slots=True)
class Hidden:
    """What a case hides.

    ``path`` and ``effects`` act in the brake, ``clock_s`` and ``in_stop`` in
    what is logged.
    """

    path: DrawnPath | None = None
    effects: dict[str, float] = field(default_factory=dict)
    clock_s: float = 0.0
    in_stop: tuple[float, float] = (0.0, 1.0)


def _sized(draw: Draw, least: float, most: float) -> float:
    """Return a size, log-uniform between what the literature has."""
    return float(np.exp(draw.uniform(np.log(least), np.log(most))))


def _path(
    draw: Draw,
    start: int,
    end: int,
    sizes: tuple[float, float],
    **form: float,
) -> DrawnPath:
    """Return a path of a drawn form: a power of temperature, or an S in it.

    The catalogue has constants, T^4 and tables between two temperatures.
    """
    if "onset_k" not in form:
        if draw.random() < 0.5:
            form["heat_exponent"] = draw.uniform(0.4, 1.6)
        else:
            form["onset_k"] = draw.uniform(330.0, 420.0)
            form["width_k"] = draw.uniform(15.0, 60.0)
    size = _sized(draw, *sizes)
    return DrawnPath(start=start, end=end, conductance_w_k=size, **form)


def _of_effect(name: str, least: float, most: float) -> Callable[[Draw], Any]:
    return lambda d: {"effects": {name: _sized(d, least, most)}}


FAMILIES: Final[dict[str, Callable[[Draw], dict[str, Any]]]] = {
    # bolted faces of 50 to 100 cm2 at 200 to 800 W/m2K with the hat's neck in
    # series (contact resistance of disc and carrier: Voller and others 2003)
    "hub_conduction": lambda d: {
        "path": _path(d, FIRST_LUMP + CENTRE, HUB, (0.8, 4.0))
    },
    # steel ears of 1 to 3 cm2 in dry contact, 500 to 3000 W/m2K
    "bracket_conduction": lambda d: {
        "path": _path(d, BACKPLATE, BRACKET, (0.1, 1.2), contact=0.0)
    },
    # 0.02 to 0.04 m2 of edges, 4 to 12 W/m2K
    "backplate_loss": lambda d: {
        "path": _path(d, BACKPLATE, AIR, (0.08, 0.5))
    },
    # boot, springs and pins: a steel section of 0.3 to 1.5 cm2 over 20 mm
    "caliper_bypass": lambda d: {
        "path": _path(d, BACKPLATE, BODY, (0.07, 0.4))
    },
    # 30 to 100 cm2 of disc in view at 500 to 800 K: 4 eps sigma A T^3
    "disc_caliper_radiation": lambda d: {
        "path": _path(
            d, SURFACE, BODY, (0.04, 0.25), heat_exponent=d.uniform(2.2, 4.0),
            onset_k=0.0,
        )
    },
    # friction that falls by a tenth to a third when hot (Limpert)
    "friction_fade": _of_effect("friction_fade", 0.3, 1.3),
    # a third of mu while green linings bed in (SAE J2522, section 3)
    "friction_history": _of_effect("friction_history", 0.4, 1.5),
    # drags of 2 to 12 Nm of calipers that stick
    "residual_drag": _of_effect("residual_drag", 0.4, 2.4),
    # h_c of 100 to 1000 W/m2K between lining and disc
    "contact_conductance": _of_effect("contact_conductance", 0.3, 2.5),
    # discs are worn out at 1.5 to 2 mm of 26
    "disc_wear": _of_effect("disc_wear", 0.4, 1.4),
    # half to four fifths of a lining
    "pad_wear": _of_effect("pad_wear", 0.5, 1.4),
    "shim_contact": _of_effect("shim_contact", 0.6, 2.0),
    # layers of rubber and steel that come apart: a quarter to two thirds of
    # the shim's conductance beyond 90 to 180 degC
    "layer_opening": lambda d: {
        "path": _path(
            d, BACKPLATE, PISTON, (0.36, 0.9),
            onset_k=d.uniform(360.0, 450.0), width_k=d.uniform(5.0, 40.0),
        )
    },
    # 20 to 50 % of the disc's 30 to 60 W/K where wake and wheel shed together
    "cooling_band": lambda d: {
        "path": _path(
            d, FIRST_LUMP + CENTRE, AIR, (6.0, 20.0), onset_k=0.0,
            heat_exponent=0.0, band_ms=d.uniform(12.0, 28.0),
            band_width_ms=d.uniform(3.0, 8.0),
        )
    },
    # loggers set by hand or by a GPS that is late
    "clock_offset": lambda d: {
        "clock_s": float(d.choice([-1.0, 1.0])) * _sized(d, 2.0, 20.0)
    },
    # mu of organic linings within a stop: +5 to +30 % (SAE J2522)
    "friction_in_stop": lambda d: {
        "in_stop": (_sized(d, 0.05, 0.30), _sized(d, 0.7, 5.0))
    },
}  # fmt: skip
"""What the catalogue lists; values are forms and sizes. Negative ones below.
"""

LOSSES: Final = frozenset({"layer_opening", "cooling_band"})
"""Families that take conductance away."""

UNLISTED: Final[dict[str, Callable[[Draw], dict[str, Any]]]] = {
    # the bracket stands 10 to 20 mm off the disc, 20 to 40 cm2
    "disc_to_bracket": lambda d: {
        "path": _path(d, SURFACE, BRACKET, (0.05, 0.4))
    },
    # caliper bolted to the knuckle, which the hub's bearing warms
    "caliper_to_hub": lambda d: {
        "path": _path(d, FIRST_LUMP + BODY, HUB, (0.3, 2.5))
    },
    # a duct that opens with speed, 5 to 20 cm2 of ram air
    "caliper_duct": lambda d: {
        "path": _path(
            d, FIRST_LUMP + BODY, OPEN_AIR, (0.5, 4.0),
            speed_exponent=d.uniform(0.9, 1.8), heat_exponent=0.0, onset_k=0.0,
        )
    },
    # heat along the brake line's first half metre, only while it is held
    "line_while_held": lambda d: {
        "path": _path(
            d, FIRST_LUMP + FLUID, OPEN_AIR, (0.2, 1.5), contact=1.0
        )
    },
    "fingers_to_bracket": lambda d: {
        "path": _path(d, FIRST_LUMP + FINGER, BRACKET, (0.3, 3.0))
    },
    "damper_heat": _of_effect("damper_heat", 0.7, 3.0),
    "dust_shield": _of_effect("dust_shield", 0.5, 2.0),
}  # fmt: skip
"""What no entry of the catalogue describes."""


def hidden_of(case: Case) -> Hidden:
    """Return what *case* hides, its form and size drawn for it alone."""
    if case.effect == "none":
        return Hidden()
    digest = hashlib.sha256(f"{case.seed} {case.effect}".encode()).hexdigest()
    return drawn(case.effect, np.random.default_rng(int(digest[:12], 16)))


def drawn(kind: str, draw: Draw) -> Hidden:
    """Return *kind* with the form and size that *draw* gives it."""
    made = {**FAMILIES, **UNLISTED}[kind](draw)
    if kind in LOSSES:
        path = made["path"]
        taken = replace(path, conductance_w_k=-path.conductance_w_k)
        made["path"] = taken
    return Hidden(**made)


SAME: Final = {
    "disc_wear": {"change.disc_mass"},
    "backplate_loss": {"change.pad_air"},
    "bracket_conduction": {"change.pad_air"},
    "shim_contact": {"change.shim_resistance"},
    "pad_wear": {
        *("change.lining_capacity", "change.lining_conductivity"),
        "change.heat_into_pads",
    },
    "friction_fade": {"change.effect.friction_fade.strength"},
}
"""Changes of a value that say the same (docs/effects.md), right as well."""

PLACES: Final[dict[str, tuple[str, ...]]] = {
    "disc_to_bracket": ("disc to",),
    "caliper_to_hub": ("caliper", "fluid"),
    "caliper_duct": ("caliper", "fluid"),
    "line_while_held": ("fluid",),
    "fingers_to_bracket": ("caliper", "fluid", "pad_back to"),
    "damper_heat": ("heat at", "to air"),
    "dust_shield": ("disc to", "to air"),
}
"""Of what no entry describes: the paths of a right description."""


class Car:
    """A drawn car; the drives of its match have effects already."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        draw = np.random.default_rng(seed)
        car = drawn_car(seed)
        share = 1.0 + draw.uniform(-0.08, 0.08)
        # linings lose or gain up to half of k until 400 degC, cp rises by up
        # to half; grey iron's cp differs by 20 % at 600 degC among handbooks
        slopes = {
            "iron_slope_j_kgk2": draw.uniform(-0.05, 0.2),
            "pad_capacity_slope_j_kgk2": draw.uniform(0.0, 1.3),
            "pad_conductivity_slope_1_k": draw.uniform(-8e-4, 8e-4),
        }
        own = [
            kind
            for kind in ("backplate_loss", "caliper_to_hub", "caliper_bypass")
            if draw.random() < 0.5
        ][:1]
        self.paths = tuple(
            path
            for kind in own
            if (path := drawn(kind, draw).path) is not None
        )
        self.own_kinds = set(own)
        self.car: CarParameters = replace(
            car,
            mass_kg=car.mass_kg * draw.uniform(0.93, 1.07),
            front=_with(car.front, share, slopes),
            rear=_with(car.rear, 2.0 - share, slopes),
        )
        self.structure = str(draw.choice(["thesis", "extended"]))
        on = {
            name: draw.uniform(0.3, 1.3)
            for name in STRUCTURES["extended"]
            if self.structure == "extended" and draw.random() < 0.8
        }
        # a friction law of its own, whatever the structure
        for name in ("friction_speed", "friction_pressure"):
            on[name] = draw.uniform(0.0, 1.2)
        self.effects = Effects(**on)
        self.calibration = _pair(draw, CALIBRATION)
        self.searched = _pair(draw, SEARCHED)
        self.held_out = _pair(draw, HELD_OUT)

    def drive(self, name: str, hidden: Hidden, number: int) -> SimulatedDrive:
        """Return the drive *name* with *hidden*, as logged."""
        paths = (*self.paths, *filter(None, [hidden.path]))
        driven = simulate(
            load_drive(name),
            replace(
                self.car,
                front=replace(self.car.front, drawn_paths=paths),
                rear=replace(self.car.rear, drawn_paths=paths),
            ),
            preset=replace(self.effects, **hidden.effects),
            sensors=SENSORS,
            seed=self.seed + number,
        )
        return _logged(driven, hidden)


class Wild(World):
    """Cases of drawn cars."""

    right: Final = {kind: {kind} | SAME.get(kind, set()) for kind in FAMILIES}
    places: Final = PLACES

    def control(self, seed: int) -> Case:
        """Return the drives that effects are hidden in, with none."""
        return Case(seed, "none", Car(seed).searched)

    def made(self, case: Case) -> Path:
        """Return the folder of *case*, made if it is not there."""
        target = self.folder / case.name
        if not target.exists():
            car = Car(case.seed)
            hidden = hidden_of(case)
            part = self.folder / f"{case.name}.part"
            shutil.rmtree(part, ignore_errors=True)
            (part / "truth").mkdir(parents=True)
            pairs = {"test": (case.drives, 51), "heldout": (car.held_out, 71)}
            if case == self.control(case.seed):
                pairs["cal"] = (car.calibration, 31)
            for what, (names, number) in pairs.items():
                for i, name in enumerate(names):
                    driven = car.drive(name, hidden, number + i)
                    _write(part, f"{what}{i + 1}_{name}", driven)
            part.rename(target)
        return target

    def write_sheet(self, folder: Path, out: Path) -> None:
        """Write the nominal car's configuration with the weighed mass."""
        car = Car(int(folder.name.partition("-")[0]))
        accuracy = known_accuracy(SENSORS)
        shipped = shipped_file("config/example_vehicle.toml")
        text = shipped.read_text("utf-8")
        for old, new in (
            (r'dbc = ".*"', f'dbc = "{shipped_file(DBC)}"'),
            (r"mass_kg = 2194.0", f"mass_kg = {car.car.mass_kg:.0f}"),
            (r'structure = "thesis"', f'structure = "{car.structure}"'),
            (r'form = "rate"', 'form = "conductance"'),
            (r'mode = "auto"', 'mode = "ff"'),
        ):
            text, count = re.subn(f"(?m)^{old}$", new, text)
            if count != 1:
                sys.exit(f"{shipped}: {count} lines {old}")
        text += (
            "\n[accuracy]\n"
            f"thermocouple_offset_k = {accuracy.thermocouple_offset_k}\n"
            f"thermocouple_drift_k = {accuracy.thermocouple_drift_k}\n"
        )
        out.write_text(text, "utf-8")


def _write(folder: Path, name: str, driven: SimulatedDrive) -> None:
    """Write the log of *driven*, and its truth from the start of the log."""
    write_candump(folder / f"{name}.log", driven, Encoder(shipped_file(DBC)))
    sent_s = driven.time_s[driven.bus_on]
    truth = {
        node: driven.truth[f"FL.{node}"] - KELVIN_OFFSET for node in NODES
    }
    time_s = driven.slow_time_s - sent_s[0]
    np.savez(folder / "truth" / f"{name}.npz", t=time_s, **truth)


def _with(corner: Any, share: float, slopes: dict[str, float]) -> Any:
    mu = corner.friction_coefficient * share
    return replace(corner, friction_coefficient=mu, **slopes)


def _pair(draw: Draw, pool: Sequence[str]) -> tuple[str, ...]:
    """Return two different drives, the first of *pool* twice as likely."""
    weights = np.array([2.0] + [1.0] * (len(pool) - 1))
    chosen = draw.choice(
        len(pool), 2, replace=False, p=weights / weights.sum()
    )
    if pool is CALIBRATION and 0 not in chosen:
        chosen[0] = 0  # a match needs stops and a soak
    return tuple(pool[i] for i in sorted(chosen))


def _logged(driven: SimulatedDrive, hidden: Hidden) -> SimulatedDrive:
    """Return *driven* with what *hidden* does to the log."""
    rise, time_s = hidden.in_stop
    roles = dict(driven.roles)
    if rise:
        held = driven.motion.pressure_pa > 0.0
        step_s = float(driven.time_s[1] - driven.time_s[0])
        since = np.zeros(len(held))
        count = 0
        for i, on in enumerate(held.tolist()):
            count = count + 1 if on else 0
            since[i] = count * step_s
        # the driver presses less as mu rises hyperbolically
        factor = 1.0 + rise * since / (since + time_s)
        roles = {
            name: values / factor if "pressure" in name else values
            for name, values in roles.items()
        }
    late_s = driven.slow_time_s - hidden.clock_s
    temperatures, truth = (
        {
            name: np.interp(late_s, driven.slow_time_s, values)
            for name, values in of.items()
        }
        for of in (driven.temperatures, driven.truth)
    )
    return replace(driven, roles=roles, temperatures=temperatures, truth=truth)


def cases_of(seed: int, count: int) -> list[Case]:
    """Return a control and *count* cases of the car *seed*, a third unlisted.

    Kinds go round, so that a few cars have all.
    """
    car = Car(seed)
    known = {*STRUCTURES[car.structure], *car.own_kinds}
    order = np.random.default_rng(seed + 1)
    many = -(-count // 3)
    cases = [Case(seed, "none", car.searched)]
    for pool, share in (FAMILIES, count - many), (UNLISTED, many):
        kinds = [kind for kind in pool if kind not in known]
        cases += [
            Case(seed, str(kind), car.searched, unlisted=pool is UNLISTED)
            for kind in order.permutation(kinds)[:share]
        ]
    return cases


def looked(*, reported: bool) -> dict[str, Any]:
    """Count this look and return all.

    Raises:
        SystemExit: the release has been reported already.
    """
    looks: dict[str, Any] = json.loads(LOOKS.read_text("utf-8"))
    if reported:
        if __version__ in looks["reported"]:
            msg = f"release {__version__} was reported: its seeds are used"
            raise SystemExit(msg)
        looks["reported"][__version__] = time.strftime("%Y-%m-%d")
    else:
        looks["development"] += 1
    LOOKS.write_text(json.dumps(looks, indent=2) + "\n", "utf-8")
    return looks


def seeds_of(*, reported: bool, cars: int) -> list[int]:
    """Return the seeds of the cars: of the release, or for development."""
    if not reported:
        return [DEVELOPMENT_SEED + 100 * i for i in range(cars)]
    digest = hashlib.sha256(f"bstm wild {__version__}".encode()).hexdigest()
    first = 100_000 + int(digest[:6], 16)
    return [first + 101 * i for i in range(REPORTED_CARS)]


def main() -> None:
    """Run the cases that the arguments ask for and print their table."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--cars", type=int, default=2)
    parser.add_argument("--each", type=int, default=6, help="cases of a car")
    parser.add_argument("--reported", action="store_true")
    args = parser.parse_args()
    looks = looked(reported=args.reported)
    world = Wild(args.folder)
    rows: dict[bool, list[list[str]]] = {False: [], True: []}
    for seed in seeds_of(reported=args.reported, cars=args.cars):
        for case in cases_of(seed, args.each):
            found = row(world, case)
            rows[case.unlisted].append(found)
            print(*found, sep="  ", flush=True)  # noqa: T201
    for unlisted, what in ((False, "Listed"), (True, "Unlisted")):
        own = rows[unlisted]
        table = "\n".join(markdown({"header": HEADER, "rows": own}))
        sys.stdout.write(f"\n{table}\n\n{what}. {figures(own)}\n")
    sys.stdout.write(f"looks: {json.dumps(looks)}\n")


if __name__ == "__main__":
    main()

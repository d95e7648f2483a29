"""Hidden effects in cars that nobody wrote for the catalogue: preset wild.

The packaged reality with what its other presets lack. Every car has its own
cp of iron and linings whose k and cp slope, its own mass, share of the axles
and friction law, and paths that the calibration drives have already. Every
case draws the form of what it hides from families that the catalogue does not
have, and its size from the literature. The car is matched as ``bstm match``
does it, then searched as ``bstm gap run`` does.

*Detectable* is said by the truth: what is hidden moves a measured node, RMS,
by at least three times what the matched model is off there with nothing
hidden. A name of an unlisted effect is a wrong name wherever it acts.

    python tests/benchmarks/gap_wild.py --cars 3 --cache FOLDER
    python tests/benchmarks/gap_wild.py --reported --cache FOLDER

Seeds of ``--reported`` are a hash of the release, and each release runs them
once; ``gap_wild_looks.json`` counts both kinds of looks.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import pickle
import sys
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from gap_cars import (
    drawn_car,
    events_of,
    keep,
    known_accuracy,
    present,
    structure_config,
)
from gap_rivals import lowest_error
from gap_shares import Share

from bstm_daemon import __version__
from bstm_daemon.analysis.gap.fitting import askable, directions, fit
from bstm_daemon.analysis.gap.form import with_form
from bstm_daemon.analysis.gap.holdout_comparison import CONFIGURED, show
from bstm_daemon.analysis.gap.recording import Recording, recorded
from bstm_daemon.analysis.gap.searching import search, starts
from bstm_daemon.analysis.gap.signatures import candidates, sensed
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.changes import learned
from bstm_daemon.analysis.matching.coarse import Reading
from bstm_daemon.analysis.matching.matcher import match_drives
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

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.analysis.gap.comparison import Comparison
    from bstm_daemon.analysis.matching.tunables import Target
    from bstm_daemon.simulation import SimulatedDrive
    from bstm_daemon.simulation.vehicle import CarParameters

    Draw = np.random.Generator

CALIBRATION: Final = ("rich", "simalp", "alpine-descent", "m04", "track")
SEARCHED: Final = ("rich", "m10", "grossglockner", "m14", "cooling", "m06")
HELD_OUT: Final = ("city", "m09", "ams", "m01")
"""Drives that the pairs of a car are drawn from; the first pair has the
soaks and stops that a match needs."""

SENSORS: Final = "n2"
DETECTABLE: Final = 3.0
DEVELOPMENT_SEED: Final = 20_000
REPORTED_CARS: Final = 30
LOOKS: Final = Path(__file__).with_name("gap_wild_looks.json")

# parts of a corner that a path begins at, and the air that it may end in
BACKPLATE, SURFACE = 0, 1
FIRST_LUMP, OPEN_AIR = 3, len(LUMPS)
CATALOGUED_TWINS: Final = {
    "disc_wear": "change.disc_mass",
    "backplate_loss": "change.pad_air",
    "bracket_conduction": "change.pad_air",
    "convection_exponent": "change.disc_air",
    "caliper_radiation": "change.caliper_air",
}
"""Changes of a value that say the same (docs/effects.md), right as well."""


@dataclass(frozen=True, slots=True)
class Hidden:
    """What a case hides.

    ``kind`` is its name; ``listed`` whether the catalogue has it. ``path``
    and ``effects`` act in the brake, ``clock_s`` and ``in_stop`` in what is
    logged.
    """

    kind: str
    listed: bool
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


def hidden_of(kind: str, draw: Draw) -> Hidden:
    """Return *kind* with the form and size that *draw* gives it."""
    made = {**FAMILIES, **UNLISTED}[kind](draw)
    if kind in LOSSES:
        path = made["path"]
        taken = replace(path, conductance_w_k=-path.conductance_w_k)
        made["path"] = taken
    return Hidden(kind, kind in FAMILIES, **made)


@dataclass(frozen=True, slots=True)
class Case:
    """A case of the car *seed*; without ``kind`` nothing is hidden."""

    seed: int
    kind: str = ""

    @property
    def draw(self) -> Draw:
        """What it is drawn with."""
        text = f"{self.seed} {self.kind}"
        digest = hashlib.sha256(text.encode()).hexdigest()
        return np.random.default_rng(int(digest[:12], 16))


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a case."""

    seed: int
    kind: str
    listed: bool
    ratio: float
    answer: str
    names: list[str]
    place: str
    gate_z: float
    baseline: list[str]
    shrink: float | None
    search_s: float

    @property
    def detectable(self) -> bool:
        """Whether the truth says that it can be seen."""
        return self.ratio >= DETECTABLE

    def right(self, answer: str, names: Sequence[str]) -> bool:
        """Whether *answer* with *names* is that of a listed effect."""
        allowed = {self.kind, CATALOGUED_TWINS.get(self.kind, self.kind)}
        if answer == "class":
            return len(names) <= 2 and bool(allowed & set(names))
        return answer == "name" and set(names) <= allowed

    def wrong(self, answer: str, names: Sequence[str]) -> bool:
        """Whether a name is given that is not what is hidden."""
        allowed = {self.kind, CATALOGUED_TWINS.get(self.kind, self.kind)}
        if not self.listed:
            allowed = set()
        return answer == "name" and not set(names) <= allowed


class Car:
    """A drawn car, matched to drives that have effects already."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.seed, self.folder = seed, folder
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
            if (path := hidden_of(kind, draw).path) is not None
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

    def drive(self, name: str, hidden: Hidden | None, number: int) -> Driven:
        """Return the drive *name* with *hidden*, as recorded."""
        paths, effects = self.paths, self.effects
        if hidden is not None and hidden.path is not None:
            paths = (*paths, hidden.path)
        if hidden is not None:
            effects = replace(effects, **hidden.effects)
        driven = simulate(
            load_drive(name),
            replace(
                self.car,
                front=replace(self.car.front, drawn_paths=paths),
                rear=replace(self.car.rear, drawn_paths=paths),
            ),
            preset=effects,
            sensors=SENSORS,
            seed=self.seed + number,
        )
        if hidden is not None:
            driven = _logged(driven, hidden)
        recording = recorded(name, [events_of(driven)], self.config, present())
        return Driven(driven, recording)

    @property
    def config(self) -> Any:
        """The configuration before its match."""
        config = structure_config(self.structure)
        return config.model_copy(update={"accuracy": known_accuracy(SENSORS)})

    def target(self) -> Target:
        """Return what ``bstm match`` hands on."""
        kept = self.folder / f"wild-{self.seed}.pickle"
        if not kept.exists():
            recordings = [
                self.drive(name, None, 31 + i).recording
                for i, name in enumerate(self.calibration)
            ]
            drives = [one.drive for one in recordings]
            match = match_drives(self.config, [Reading(None, drives)])[0]
            known = learned(match)
            plain = match.after.config.model_copy(update={"matched": [known]})
            found = replace(match.after, config=plain)
            comparison = compare(found, recordings)
            names = askable(found, candidates(plain))
            whole = with_form(known, comparison, sensed(comparison, names))
            config = plain.model_copy(update={"matched": [whole]})
            keep(kept, pickle.dumps(replace(found, config=config)))
        result: Target = pickle.loads(kept.read_bytes())  # noqa: S301  (own)
        return result


@dataclass(frozen=True, slots=True)
class Driven:
    """A drive as it happened and as it was recorded."""

    drive: SimulatedDrive
    recording: Recording


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
    temperatures = {
        name: np.interp(
            driven.slow_time_s - hidden.clock_s, driven.slow_time_s, values
        )
        for name, values in driven.temperatures.items()
    }
    return replace(driven, roles=roles, temperatures=temperatures)


def _truth_k(comparison: Comparison, drives: Sequence[Driven]) -> np.ndarray:
    """Return the real temperatures where *comparison* has residuals, (n,)."""
    parts = []
    for one in comparison.series:
        drive = drives[one.drive].drive
        start_s = drives[one.drive].recording.drive.start_s
        parts.append(
            np.mean(
                [
                    np.interp(
                        start_s + one.time_s,
                        drive.slow_time_s,
                        drive.truth[f"{corner}.{one.node}"],
                    )
                    for corner, _ in one.couples
                ],
                axis=0,
            )
        )
    return np.concatenate(parts)


def _shift_k(comparison: Comparison, with_k: np.ndarray) -> dict[str, float]:
    """Return the RMS of *with_k* (n,) by node."""
    nodes = {one.node for one in comparison.series}
    found = {}
    for node in nodes:
        own = np.repeat(
            [one.node == node for one in comparison.series],
            [len(one.time_s) for one in comparison.series],
        )
        found[node] = float(np.sqrt(np.mean(with_k[own] ** 2)))
    return found


class Searched:
    """What the cases of a car share: its match, and its control."""

    def __init__(self, car: Car) -> None:
        self.car, self.target = car, car.target()
        self.control = [
            car.drive(name, None, 51 + i)
            for i, name in enumerate(car.searched)
        ]
        comparison = compare(
            self.target, [one.recording for one in self.control]
        )
        self.truth_k = _truth_k(comparison, self.control)
        measured = np.concatenate([s.measured_k for s in comparison.series])
        apart = comparison.residuals_k(comparison.start[None])[:, 0]
        self.off_k = _shift_k(comparison, apart + measured - self.truth_k)

    def result(self, case: Case) -> Result:
        """Search *case*."""
        hidden = hidden_of(case.kind, case.draw) if case.kind else None
        drives = self.control
        if hidden is not None:
            drives = [
                self.car.drive(name, hidden, 51 + i)
                for i, name in enumerate(self.car.searched)
            ]
        begin_s = time.process_time()
        comparison = compare(self.target, [one.recording for one in drives])
        names = askable(self.target, candidates(self.target.config))
        simulated = sensed(comparison, names)
        _, naming = search(comparison, simulated, directions(comparison))
        search_s = time.process_time() - begin_s
        baseline: list[str] = []
        if naming.found:
            # the same gate; of sensed alone
            baseline = lowest_error(_Residuals(simulated))  # type: ignore[arg-type]
        shrink = None
        if naming.adoptable and hidden is not None:
            held_out = [
                self.car.drive(name, hidden, 71 + i).recording
                for i, name in enumerate(self.car.held_out)
            ]
            extended = fit(
                comparison, starts(naming), directions(comparison),
                known_k=simulated.jacobian_k,
            )  # fmt: skip
            shown = show(
                comparison, extended, held_out, known_k=simulated.jacobian_k
            )
            shrink = shown.shrinks[CONFIGURED].factor
        return Result(
            case.seed,
            case.kind,
            hidden is not None and hidden.listed,
            self._ratio(comparison, drives, hidden),
            naming.answer,
            list(naming.names),
            naming.unknown_place,
            naming.gate_z,
            baseline,
            shrink,
            search_s,
        )

    def _ratio(
        self,
        comparison: Comparison,
        drives: Sequence[Driven],
        hidden: Hidden | None,
    ) -> float:
        """Return by how much a node moves over what the control is off."""
        if hidden is None:
            return 0.0
        if hidden.clock_s:
            # what the thermocouples show moves, not the parts
            moved = np.concatenate(
                [hidden.clock_s * s.slope_k_s for s in comparison.series]
            )
        elif hidden.in_stop[0]:
            nothing = compare(
                self.target, [one.recording for one in self.control]
            )
            x = comparison.start[None]
            moved = (comparison.residuals_k(x) - nothing.residuals_k(x))[:, 0]
        else:
            moved = _truth_k(comparison, drives) - self.truth_k
        shifts = _shift_k(comparison, moved)
        return max(shifts[n] / max(self.off_k[n], 0.1) for n in shifts)


@dataclass(frozen=True, slots=True)
class _Residuals:
    """What the baseline reads of a case."""

    sensed: Any


def cases_of(seed: int, car: Car, count: int) -> list[Case]:
    """Return a control and *count* cases of the car *seed*, a third unlisted.

    Kinds go round, so that a few cars have all.
    """
    known = {*STRUCTURES[car.structure], *car.own_kinds}
    listed = [kind for kind in FAMILIES if kind not in known]
    unlisted = [kind for kind in UNLISTED if kind not in known]
    order = np.random.default_rng(seed + 1)
    many = -(-count // 3)
    chosen = [
        *order.permutation(listed)[: count - many],
        *order.permutation(unlisted)[:many],
    ]
    return [Case(seed), *(Case(seed, str(kind)) for kind in chosen)]


def looked(*, reported: bool) -> dict[str, Any]:
    """Count this look and return all.

    Raises:
        SystemExit: the release has been reported already.
    """
    looks: dict[str, Any] = {"development": 0, "reported": {}}
    if LOOKS.exists():
        looks = json.loads(LOOKS.read_text("utf-8"))
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
    return [first + 101 * i for i in range(cars)]


def table_of(results: Sequence[Result]) -> list[str]:
    """Return the figures as lines, over all cases and detectable ones."""

    def share(label: str, hits: Sequence[bool]) -> str:
        found = Share(float(sum(hits)), len(hits))
        return f"| {label} | {found} of {len(hits)} |"

    controls = [one for one in results if not one.kind]
    lines = [
        share("controls: a name", [o.answer == "name" for o in controls]),
        share("controls: anything", [o.answer != "nothing" for o in controls]),
    ]
    for label, kept in (("all", False), ("detectable", True)):
        own = [o for o in results if o.kind and (o.detectable or not kept)]
        listed = [o for o in own if o.listed]
        others = [o for o in own if not o.listed]
        lines += [
            share(
                f"listed, {label}: right",
                [o.right(o.answer, o.names) for o in listed],
            ),
            share(
                f"listed, {label}: a wrong name",
                [o.wrong(o.answer, o.names) for o in listed],
            ),
            share(
                f"listed, {label}: right, gated lowest RMS",
                [o.right("name", o.baseline) and bool(o.baseline)
                 for o in listed],
            ),
            share(
                f"unlisted, {label}: none of the known",
                [o.answer == "unknown" for o in others],
            ),
            share(
                f"unlisted, {label}: a wrong name",
                [o.wrong(o.answer, o.names) for o in others],
            ),
        ]  # fmt: skip
    shrinks = [one.shrink for one in results if one.shrink is not None]
    if shrinks:
        worse = np.mean(np.array(shrinks) < 1.0 / 1.05)
        lines.append(
            f"| shrink of what can be written | median "
            f"{np.median(shrinks):.2f}, worse in {100 * worse:.0f} % of "
            f"{len(shrinks)} |"
        )
    return lines


def main() -> None:
    """Run the cases that the arguments ask for and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cars", type=int, default=2)
    parser.add_argument("--each", type=int, default=6, help="cases of a car")
    parser.add_argument("--reported", action="store_true")
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument(
        "--seconds", type=float, default=float("inf"), help="of CPU"
    )
    args = parser.parse_args()
    args.cache.mkdir(parents=True, exist_ok=True)
    looks = looked(reported=args.reported)
    cars = REPORTED_CARS if args.reported else args.cars
    results = []
    for seed in seeds_of(reported=args.reported, cars=cars):
        if time.process_time() > args.seconds:
            break
        car = Car(seed, args.cache)
        shared = Searched(car)
        for case in cases_of(seed, car, args.each):
            if time.process_time() > args.seconds:
                break
            one = shared.result(case)
            results.append(one)
            sys.stderr.write(json.dumps(asdict(one)) + "\n")
    for line in table_of(results):
        sys.stdout.write(line + "\n")
    sys.stdout.write(f"looks: {json.dumps(looks)}\n")


if __name__ == "__main__":
    main()

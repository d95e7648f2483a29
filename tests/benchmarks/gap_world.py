"""Whole workflow on a car with something hidden: answered, and judged.

A :class:`World` makes cases as folders: ``cal*.log`` of the car without what
is hidden, ``test*.log`` and ``heldout*.log`` with it, and what really was as
``truth/<log>.npz`` [degC]. Each car is matched once by ``bstm match``, and
``bstm gap run`` answers, as a user has them.
"""

from __future__ import annotations

import json
import subprocess
import sys
from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.analysis.gap.naming import GATE_Z
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.targets import measured_targets
from bstm_daemon.api import load_config, replay
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.model.effects.composed import PREFIX, is_composed, read

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

NAMED: Final = frozenset({"name", "class"})
"""Answers that give a name."""

NODES: Final = {
    "fluid": "fluid_c",
    "disc": "disc_c",
    "pad_front": "pad_front_c",
    "pad_back": "pad_back_c",
}
"""Nodes of a truth that a thermocouple measures, and our columns."""

DETECTABLE: Final = 3.0
"""An effect is detectable where it moves a measured node by so many times what
the matched control is off there, both as RMS against the truth."""


SHRINKS: Final = ("as configured", "heat and cooling re-fitted")

HEADER: Final = (
    *("car", "hidden", "detectable", "answer", "worth", "best alone"),
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


class World(ABC):
    """Cases under *folder*, made as they are asked for.

    ``right`` are the right names of what is hidden; ``places`` the paths of a
    description without them, none for an error of a sensor; ``drivers`` what
    it may be said to depend on, anything where there is no entry.
    """

    right: Mapping[str, set[str]]
    places: Mapping[str, tuple[str, ...]]
    drivers: Mapping[str, frozenset[str]] = MappingProxyType({})

    def __init__(self, folder: Path) -> None:
        """Keep in *folder* what is made."""
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder.resolve()
        self.leaves: dict[int, dict[tuple[str, str], tuple[float, int]]] = {}
        self.errors: dict[int, dict[tuple[str, str], float]] = {}

    @abstractmethod
    def control(self, seed: int) -> Case:
        """Return the case of car *seed* that has the drives of its match."""

    @abstractmethod
    def made(self, case: Case) -> Path:
        """Return the folder of *case*, made if it is not there."""

    @abstractmethod
    def write_sheet(self, folder: Path, out: Path) -> None:
        """Write what the sheet of the car in *folder* says to *out*."""

    def matched(self, seed: int) -> Path:
        """Return the configuration of car *seed* as matched."""
        folder = self.made(self.control(seed))
        sheet, matched = folder / "car.toml", folder / "matched.toml"
        if not matched.exists():
            self.write_sheet(folder, sheet)
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
            names = sorted(self.right.get(case.effect, ()))
            without = ["--without", *names] if names else []
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
        control = self.made(self.control(case.seed))
        worst = 0.0
        for (log, node), off_k in self.off_k(case.seed).items():
            truth, changed = (
                np.load(folder / "truth" / f"{log}.npz")
                for folder in (control, self.made(case))
            )
            own = np.interp(truth["t"], changed["t"], changed[node])
            worst = max(worst, rms(own - truth[node]) / off_k)
        return worst >= DETECTABLE

    def off_k(self, seed: int) -> dict[tuple[str, str], float]:
        """Return the RMS error [K] of car *seed*'s match without an effect.

        By drive and node.
        """
        if seed not in self.errors:
            matched = self.matched(seed)
            control = self.made(self.control(seed))
            vehicle = load_config(matched)
            self.errors[seed] = found = {}
            for log in sorted(control.glob("test*.log")):
                run = replay(log, vehicle, start="cold", every_s=1.0).columns
                # the truth counts from the start of the log
                time_s = run["time_s"] - run["time_s"][0]
                truth = np.load(control / "truth" / f"{log.stem}.npz")
                for node, column in NODES.items():
                    ours = np.interp(truth["t"], time_s, run[f"FL.{column}"])
                    found[log.stem, node] = rms(ours - truth[node])
        return self.errors[seed]

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


def verdict(right: set[str], naming: dict[str, Any]) -> str:
    """Return what *naming* is worth where *right* are the right names.

    ``right``; ``right among`` several; ``missing``, where it says that
    something is and gives no name; ``silent``; or ``wrong``: a name, which
    candidates that it does not decide between are not.
    """
    names, answer = set(naming["names"]), naming["answer"]
    if answer == "nothing":
        return "silent"
    named = answer in NAMED
    if answer in {"unknown", "composed"} or not names & right:
        return "wrong" if named else "missing"
    return "right" if named and names <= right else "right among"


def verdict_unlisted(
    places: Sequence[str],
    naming: dict[str, Any],
    drivers: frozenset[str] | None = None,
) -> str:
    """Return what *naming* is worth where no candidate describes what is.

    ``right`` without a name, or described first at its place and by nothing
    but its *drivers* and phases; ``elsewhere``; ``missing`` where it does not
    decide.
    """
    answer = naming["answer"]
    if answer == "composed":
        first = read(naming["names"][0].removeprefix(PREFIX))
        there = any(path in first.path.text for path in places)
        said = [{form.driver, form.words} for form, _ in first.clauses]
        true = drivers is None or all(words & drivers for words in said)
        return "right" if there and true else "elsewhere"
    if answer in NAMED:
        return "wrong"
    told = {"nothing": "silent", "unknown": "right"}
    return told.get(answer, "missing")


def best_alone(right: set[str], naming: dict[str, Any]) -> str:
    """Return what the baseline is worth: the candidate of least squares alone.

    It is named from as many standard deviations on as an answer needs.
    """
    listed = [
        one
        for one in naming["candidates"]
        if not is_composed(one["name"]) and one["z"] >= GATE_Z
    ]
    if not listed:
        return "silent"
    best = max(listed, key=lambda one: float(one["z"]))
    return "right" if best["name"] in right else "wrong"


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
    for which, kept in (("controls", "-"), ("detectable", "yes")):
        found = Counter(row[5] for row in rows if row[2] == kept)
        told = ", ".join(f"{one} {n}" for one, n in found.most_common())
        text += f" The best alone, {which}: {told}." if told else ""
    shrunk = np.array(
        [row[6:] for row in rows if row[2] != "-" and row[6] != "-"], float
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


def row(world: World, case: Case) -> list[str]:
    """Return a line of the table: hidden, answered, worth, shrink."""
    found = world.answered(case)
    naming, shown = found["naming"], found.get("shown") or {}
    hidden = case.effect != "none"
    shrink = shown.get("shrink", {}) if found.get("strengths") else {}
    limits = world.limits(case, found) if shrink else ["-", "-"]
    right = set() if case.unlisted else world.right.get(case.effect, set())
    factors = [f"{shrink[of][0]:.1f}" if shrink else "-" for of in SHRINKS]
    return [
        str(case.seed),
        case.effect if hidden else f"none ({', '.join(case.drives)})",
        ("yes" if world.detectable(case) else "no") if hidden else "-",
        ", ".join(naming["names"]) or naming["answer"],
        verdict_unlisted(
            world.places[case.effect], naming, world.drivers.get(case.effect)
        )
        if case.unlisted
        else verdict(right, naming),
        best_alone(right, naming),
        *(one for pair in zip(factors, limits, strict=True) for one in pair),
    ]

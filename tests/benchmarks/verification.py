"""The protocol of matching and verification, one command.

``verification.py [--full] [--out docs/verification.md]``: car 1 is matched on
one SimAlp and one rich drive and verified on others, after chapter 6 of the
thesis; then a population of drawn cars. All through CAN frames with the noise
of the sensors n2, errors against the simulation's truth.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from conditions import conditions
from measurements import markdown, wrapped
from population import (
    CORNER,
    HELD_OUT,
    JUDGED_BY,
    NODES,
    CarResult,
    Driven,
    Setting,
    driven,
    errors,
    matched,
    matched_by,
    nominal_target,
    population,
)
from recordings import kept
from side_by_side import Goal, Outcome, Table
from verification_page import ABOUT, Sections

from bstm_daemon.analysis.matching.refine import NodeAccuracy, fitted
from bstm_daemon.analysis.matching.tunables import COOLING, Target
from bstm_daemon.analysis.matching.verification import FIXED_S, LIMITS, NINETY
from bstm_daemon.simulation import load_drive
from bstm_daemon.simulation.vehicle import load_vehicle as load_car

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from bstm_daemon.analysis.matching.refine import Refinement
    from bstm_daemon.analysis.matching.verification import NodeErrors
    from bstm_daemon.config.sections import Config

QUICK_DRIVES: Final = ("alpine-descent", "city", "ams")
OTHER_SEED: Final = 77
WORN_M: Final = 0.0065

CASE_HEAD: Final = (
    *("case (figure of the thesis)", "fluid, largest", "fluid, RMS"),
    *("peak height", "peak time, min", "disc, RMS", "pad back, RMS"),
    "last 20 min",
)

SETTINGS: Final = (
    Setting("thesis", "plain", "known"),
    Setting("thesis", "plain", "fused"),
    Setting("extended", "road", "known"),
    Setting("extended", "road", "fused"),
    Setting("thesis", "road", "known"),
    Setting("extended", "plain", "known"),
)
WITH_GOALS: Final = 4
"""The first four have goals; the other two stand beside."""


def run(*, full: bool) -> Outcome:
    """Run the protocol; quick: known heat, one car of the population."""
    outcome = Outcome(
        "Matching and verification",
        ABOUT,
    )
    for setting in SETTINGS if full else SETTINGS[:1]:
        for found, goals in tables_of(setting, full):
            outcome.tables.append(found)
            outcome.goals += goals
    return outcome


def tables_of(
    setting: Setting,
    full: bool,  # noqa: FBT001
    cars: int | None = None,
) -> Iterator[tuple[Table, list[Goal]]]:
    """Yield the tables of *setting* with their goals as they come."""
    fit, results = population(
        setting,
        cars or (10 if full else 1),
        HELD_OUT if full else QUICK_DRIVES,
    )
    judged = setting in SETTINGS[:WITH_GOALS]
    goals = _goals(setting, results) if judged else []
    yield _population_table(setting, fit, results), goals
    if judged:
        what = f"chapter 6 {setting!r} {full} twice"
        for table in kept(what, lambda: cases(setting, full=full), *JUDGED_BY):
            yield table, []


def cases(setting: Setting, *, full: bool) -> list[Table]:
    """Return the thesis's chapter 6 in *setting*."""
    base, fit = nominal_target(setting)
    worn = _worn(base)
    rows = [
        _row(
            "simalp, matched on it (5.2)", base, _of(base, setting, "simalp")
        ),
        _row(
            "another simalp",
            base,
            driven(0, "simalp", setting, seed=OTHER_SEED, by=base.config),
        ),
        _row(
            "half-worn pads (6.4)",
            worn,
            driven(
                *(0, "simalp", setting, load_car("half-worn"), OTHER_SEED),
                by=worn.config,
            ),
        ),
        _row("wind tunnel (6.5)", base, _of(base, setting, "wind-tunnel")),
    ]
    rims = driven(
        *(0, "wind-tunnel", setting, load_car("nominal"), OTHER_SEED),
        by=base.config,
    )
    again, _ = matched(base, [rims], COOLING)
    rows.append(
        _row(
            "wind tunnel, air of its rims matched on another run",
            again,
            _of(again, setting, "wind-tunnel"),
        )
    )
    second = Setting(setting.structure, setting.preset, setting.heat, "second")
    car = load_car("second")

    def read(name: str, by: Config | None) -> Driven:
        return driven(0, name, second, car, by=by)

    held = read("alpine-descent", base.config)
    rows.append(_row("car 2 before matching (6.6)", base, held))
    # its left and right brakes differ
    left = Target(base.config, (CORNER,))
    again, refit = matched_by(left, second, read, base.config)
    held = read("alpine-descent", again.config)
    rows.append(_row("car 2 after matching (6.7)", again, held))
    names = ("long-run", "grossglockner", "wet") if full else ("wet",)
    figure = {"long-run": " (6.8)"}
    rows += [
        _row(f"{name}{figure.get(name, '')}", base, _of(base, setting, name))
        for name in names
    ]
    return [
        Table(
            f"Chapter 6, structure {setting.structure} on {setting.preset}, "
            f"heat {setting.heat}",
            CASE_HEAD,
            tuple(rows),
        ),
        _moved(setting, fit, refit),
    ]


def _of(target: Target, setting: Setting, name: str) -> Driven:
    # the drive's own car where it names one
    car = load_drive(name).drive.vehicle
    return driven(0, name, setting, load_car(car), by=target.config)


def _worn(target: Target) -> Target:
    """Return *target* with the pad's thickness as its indicator says."""
    corners = [
        corner.model_copy(
            update={
                "pad": corner.pad.model_copy(update={"thickness_m": WORN_M})
            }
        )
        if corner.pad is not None and corner.name in target.corners
        else corner
        for corner in target.config.corner
    ]
    config = target.config.model_copy(update={"corner": corners})
    return Target(config, target.corners)


def _row(case: str, target: Target, one: Driven) -> tuple[str, ...]:
    of = {found.node: found for found in errors(target, one)}
    fluid = of["fluid"]
    late = fluid.peak.apart_s
    return (
        case,
        f"{fluid.largest_k:.1f}",
        f"{fluid.rms_k:.1f}",
        f"{fluid.peak.apart_k:+.1f}",
        "-" if isnan(late) else f"{late / 60.0:+.1f}",
        f"{of['disc'].rms_k:.1f}",
        f"{of['pad_back'].rms_k:.1f}",
        f"{fluid.last_k:+.1f}",
    )


def _moved(setting: Setting, one: Refinement, two: Refinement) -> Table:
    """Return what re-matching car 2 changed, against car 1."""
    rows = []
    for key in two.keys:
        # factors on the S-table count from that of car 1
        before = 1.0 if "s_per_s" in key else one.values[key]
        ratio = two.values[key] / before
        spread = two.standard_deviation(key) / two.values[key]
        far = abs(np.log(ratio)) / spread
        rows.append((key, f"{ratio:.3f}", f"{spread:.3f}", f"{far:.0f}"))
    return Table(
        f"What re-matching car 2 moved, heat {setting.heat}: car 2 over car 1",
        ("value", "ratio", "standard deviation", "deviations from 1"),
        tuple(rows),
    )


def _population_table(
    setting: Setting, fit: Refinement, results: Sequence[CarResult]
) -> Table:
    rows = [
        (
            one.name,
            f"{one.share_95:.1f}",
            f"{one.worst:.1f}",
            "-" if one.goal is None else f"{one.goal:g}",
            "-" if one.floor is None else f"{one.floor:g}",
        )
        for one in figures_of(results)
    ]
    inside, counted = coverage(results)
    share = f"{100.0 * inside / counted:.0f} %" if counted else "-"
    rows.append(
        (f"90 % interval, {counted} counted", share, "-", "85 to 95 %", "-")
    )
    rms = ", ".join(f"{node} {k:.1f}" for node, k in fit.rms_k.items())
    return Table(
        f"Population of {len(results)}, structure {setting.structure} on "
        f"{setting.preset}, heat {setting.heat}, {len(fit.keys)} values. RMS "
        f"of the nominal match to the thermocouples: {rms}",
        ("figure, K", "95th percentile", "worst", "goal", "floor"),
        tuple(rows),
    )


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure over all drives of all cars, beside its limits."""

    name: str
    share_95: float
    worst: float
    goal: float | None
    floor: float | None


def figures_of(results: Sequence[CarResult]) -> list[Figure]:
    """Return all figures of a population that it has."""
    goal, floor = LIMITS["goal"], LIMITS["floor"]
    own = [one for car in results for one in car.matched]
    foreign = [one for car in results for one in car.unmatched]
    asked = (
        ("fluid, largest", own, "fluid", "largest_k", goal.fluid_max_k,
         floor.fluid_max_k),
        ("fluid, RMS", own, "fluid", "rms_k", goal.fluid_rms_k,
         floor.fluid_rms_k),
        ("fluid, peak time, min", own, "fluid", "late_min", 1.0, 2.0),
        ("disc, RMS", own, "disc", "rms_k", goal.disc_rms_k,
         floor.disc_rms_k),
        ("pad back, RMS", own, "pad_back", "rms_k", goal.pad_back_rms_k,
         floor.pad_back_rms_k),
        ("fluid, last 20 min of long-run", own, "fluid", "last_k",
         goal.last_k, floor.last_k),
        ("unmatched: fluid, largest", foreign, "fluid", "largest_k", 20.0,
         20.0),
        ("unmatched: disc, RMS", foreign, "disc", "rms_k", None, None),
    )  # fmt: skip
    found = []
    for name, errors_k, node, what, limit, least in asked:
        values = _values(errors_k, node, what)
        if values:
            share_95 = float(np.percentile(values, 95.0))
            found.append(Figure(name, share_95, max(values), limit, least))
    return found


def _values(found: Sequence[NodeErrors], node: str, what: str) -> list[float]:
    """Return the sizes of a figure over all drives of all cars."""
    values = []
    for one in found:
        if one.node != node:
            continue
        if what == "late_min":
            value = one.peak.apart_s / 60.0
        elif what == "last_k" and one.drive != "long-run":
            continue
        else:
            value = getattr(one, what)
        if not isnan(value):
            values.append(abs(value))
    return values


def _goals(setting: Setting, results: Sequence[CarResult]) -> list[Goal]:
    """Return the goals over what is reached; missed below the floors."""
    return [
        Goal(
            f"{setting.structure} on {setting.preset}, heat {setting.heat}: "
            f"{one.goal:g} over {one.name}",
            one.goal / one.share_95,
            1.0,
            1.0 - one.goal / one.floor,
        )
        for one in figures_of(results)
        if one.goal is not None and one.floor is not None
    ]


def coverage(results: Sequence[CarResult]) -> tuple[int, int]:
    """Count what the interval covers that the other half of cars taught.

    Returns how often it does, of how many. Once a drive and node at the peak
    and at fixed times.
    """
    inside = counted = 0
    for half in (0, 1):
        taught = [one for one in results if one.number % 2 != half]
        judged = [one for one in results if one.number % 2 == half]
        if not taught or not judged:
            continue
        accuracy = _learned(taught)
        for car in judged:
            for one in car.matched:
                flags = _covered(one, accuracy[one.node])
                inside += sum(flags)
                counted += len(flags)
    return inside, counted


def _learned(results: Sequence[CarResult]) -> dict[str, NodeAccuracy]:
    return {
        node: fitted(
            [
                (one.error_k[::20], one.rise_k[::20], 0.0)
                for car in results
                for one in car.matched
                if one.node == node
            ]
        )
        for node in NODES
    }


def _covered(one: NodeErrors, accuracy: NodeAccuracy) -> list[bool]:
    rows = [
        int(np.searchsorted(one.time_s, at))
        for at in FIXED_S
        if at <= one.time_s[-1]
    ]
    rows.append(int(np.argmax(one.measured_c)))
    deviation = accuracy.deviation_k(one.rise_k)
    return [
        bool(abs(one.error_k[row]) <= NINETY * deviation[row]) for row in rows
    ]


def main() -> int:
    """Run and show or write the protocol."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="ten cars")
    parser.add_argument("--cars", type=int, help="fewer or more cars")
    parser.add_argument(
        "--only",
        action="append",
        metavar="TEXT",
        help='settings whose name has it, such as "on road, heat known"; '
        "repeatable; the document keeps what it has of the others",
    )
    parser.add_argument("--out", type=Path, metavar="FILE.md")
    args = parser.parse_args()
    taken = conditions()
    measured = (
        f"{taken['date']}, commit {taken['commit']}; {taken['machine']}."
    )
    sections = Sections(map(str, SETTINGS), args.out)
    for setting in SETTINGS if args.full else SETTINGS[:1]:
        if any(text in str(setting) for text in args.only or [""]):
            lines: list[str] = [measured, ""]
            for table, _ in tables_of(setting, args.full, args.cars):
                data = {"header": table.header, "rows": table.rows}
                lines += [wrapped(f"{table.title}:"), "", *markdown(data), ""]
                # what is there is kept if the rest is interrupted
                sections.take(str(setting), lines)
    if args.out is None:
        sys.stdout.write(sections.text())
    return 0


if __name__ == "__main__":
    sys.exit(main())

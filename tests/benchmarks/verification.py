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
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from conditions import conditions
from measurements import markdown
from population import (
    CORNER,
    HELD_OUT,
    JUDGED_BY,
    MATCHED_ON,
    NODES,
    CarResult,
    Driven,
    Setting,
    driven,
    errors,
    matched,
    nominal_target,
    population,
)
from recordings import kept
from side_by_side import Goal, Outcome, Table

from bstm_daemon.matching.accuracy import NodeAccuracy, fitted
from bstm_daemon.matching.tunables import COOLING, Target
from bstm_daemon.matching.verification import FIXED_S, LIMITS, NINETY
from bstm_daemon.simulation import load_drive
from bstm_daemon.simulation.vehicles import load_vehicle as load_car

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from bstm_daemon.matching.refine import Refinement
    from bstm_daemon.matching.verification import NodeErrors

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


ABOUT: Final = (
    "Car 1 (nominal) matched on simalp and rich; sensors "
    f"n2, through CAN frames. Corner {CORNER}, errors in K against the "
    "truth, the disc below 650 degC. Heat known: the true brake power, "
    "as a push rod and wheel torque sensors would give it; fused: from "
    "pressure and motion."
)
"""What is measured."""


def run(*, full: bool) -> Outcome:
    """Run the protocol; quick: known heat, one car of the population."""
    outcome = Outcome(
        "Matching and verification",
        ABOUT,
    )
    for found, goals in tables(full=full):
        outcome.tables.append(found)
        outcome.goals += goals
    return outcome


def tables(
    *, full: bool, reached: dict[Setting, list[CarResult]] | None = None
) -> Iterator[tuple[Table, list[Goal]]]:
    """Yield the tables with their goals as they come, *reached* by setting."""
    for number, setting in enumerate(SETTINGS if full else SETTINGS[:1]):
        fit, results = population(
            setting,
            10 if full else 1,
            HELD_OUT if full else QUICK_DRIVES,
        )
        if reached is not None:
            reached[setting] = results
        goals = _goals(setting, results) if number < WITH_GOALS else []
        yield _population_table(setting, fit, results), goals
        if number < WITH_GOALS:

            def make(setting: Setting = setting) -> list[Table]:
                return cases(setting, full=full)

            what = f"chapter 6 {setting} {full}"
            for table in kept(what, make, *JUDGED_BY):
                yield table, []


def summary(reached: dict[Setting, list[CarResult]]) -> dict[str, Any]:
    """Return 95th percentiles by setting beside the goals."""
    settings = [one for one in SETTINGS[:WITH_GOALS] if one in reached]
    found = {one: figures_of(reached[one]) for one in settings}
    rows = []
    for number, first in enumerate(found[settings[0]]):
        if first.goal is not None:
            rows.append(
                (
                    first.name,
                    f"{first.goal:g}",
                    *(found[one][number].verdict() for one in settings),
                )
            )
    shares = []
    for one in settings:
        inside, counted = coverage(reached[one])
        shares.append(f"{100.0 * inside / max(counted, 1):.0f} %")
    rows.append(("90 % interval", "85 to 95 %", *shares))
    names = [f"{o.structure} on {o.preset}, {o.heat}" for o in settings]
    return {"header": ("95th percentile, K", "goal", *names), "rows": rows}


def cases(setting: Setting, *, full: bool) -> list[Table]:
    """Return the thesis's chapter 6 in *setting*."""
    base, fit = nominal_target(setting)
    rows = [
        _row("simalp, matched on it (5.2)", base, _of(setting, "simalp")),
        _row(
            "another simalp",
            base,
            driven(0, "simalp", setting, seed=OTHER_SEED),
        ),
        _row(
            "half-worn pads (6.4)",
            _worn(base),
            driven(0, "simalp", setting, load_car("half-worn"), OTHER_SEED),
        ),
        _row("wind tunnel (6.5)", base, _of(setting, "wind-tunnel")),
    ]
    rims = driven(0, "wind-tunnel", setting, load_car("nominal"), OTHER_SEED)
    again, _ = matched(base, [rims], COOLING)
    rows.append(
        _row(
            "wind tunnel, air of its rims matched on another run",
            again,
            _of(setting, "wind-tunnel"),
        )
    )
    second = Setting(setting.structure, setting.preset, setting.heat, "second")
    car = load_car("second")
    on = [driven(0, name, second, car) for name in MATCHED_ON]
    held = driven(0, "alpine-descent", second, car)
    rows.append(_row("car 2 before matching (6.6)", base, held))
    # its left and right brakes differ
    left = Target(base.config, (CORNER,))
    again, refit = matched(left, on)
    rows.append(_row("car 2 after matching (6.7)", again, held))
    names = ("long-run", "grossglockner", "wet") if full else ("wet",)
    figure = {"long-run": " (6.8)"}
    rows += [
        _row(f"{name}{figure.get(name, '')}", base, _of(setting, name))
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


def _of(setting: Setting, name: str) -> Driven:
    # the drive's own car where it names one
    car = load_drive(name).drive.vehicle
    return driven(0, name, setting, load_car(car))


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

    def verdict(self) -> str:
        """Return the figure, and whether it meets its goal."""
        text = f"{self.share_95:.1f}"
        if self.goal is None or self.share_95 <= self.goal:
            return text
        if self.floor is not None and self.share_95 <= self.floor:
            return f"**{text}**, within the floor"
        return f"**{text}**, missed"


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


HEAD: Final = """# Verification

Written by `tests/benchmarks/verification.py --full --out`; do not edit. How
to match and verify a car: [matching.md](matching.md). Everything here is
simulated: the reality shares no physics code with the estimator
([reality.md](reality.md)), but no figure below was measured on a car. On one
the 20 K between two thermocouples of a disc bound what can be proved.

Goals and floors are those of the project; the thesis asks for fluid within
30 K and its peak within 5 min (section 1.3). A population is ten cars with
every parameter of the brake that is not on its drawing drawn +-10 % around
the nominal one, each matched on `simalp` and `rich` and judged on five drives
that it was not matched on: `alpine-descent`, `city`, `ams` (ten hard stops),
`grossglockner`, `long-run` (2 h 50 min). *Unmatched* is the configuration
that was matched once, on the nominal car. The interval is that of
`[accuracy]`, learned from the held-out drives of one half of the cars and
counted on the other, once a drive and node at the peak and at fixed times.
With the structure `extended` the strengths of its seven thermal effects are
matched too. The two structures on the other's preset have no goals and stand
at the end: what `thesis` leaves on `road` is the gap between model and car
that `bstm gap` looks for.

Known heat also tells when the pads touch; else a pressure does, and the last
tenths of a bar are within its sensor's offset. Sensors are a car's own: an
accelerometer has one bias in all drives, and fused heat begins each with what
it learned on `rich`. Half-worn pads have the thickness that their indicator
tells.

The start is known: estimates begin as measured. `cooling.form` is
`"conductance"`: with the thesis's `"rate"` the disc of this reality can not be
matched as well ([matching.md](matching.md)).
"""


def main() -> int:
    """Run and show or write the protocol."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="ten cars")
    parser.add_argument("--out", type=Path, metavar="FILE.md")
    args = parser.parse_args()
    taken = conditions()
    measured = (
        f"{taken['date']}, commit {taken['commit']}; {taken['machine']}."
    )
    parts: list[str] = []
    reached: dict[Setting, list[CarResult]] = {}
    text = ""
    for table, _ in tables(full=args.full, reached=reached):
        data = {"header": table.header, "rows": table.rows}
        parts += ["", f"{table.title}:", "", *markdown(data), ""]
        text = "\n".join(
            [
                HEAD,
                *markdown(summary(reached)),
                "",
                ABOUT,
                "",
                measured,
                "",
                *parts,
            ]
        )
        # what is there is kept if the rest is interrupted
        if args.out is not None:
            args.out.write_text(text, "utf-8")
    if args.out is None:
        sys.stdout.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())

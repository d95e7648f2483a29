"""The benchmarks: ``run.py [NAME ...] [--full] [--json FILE]``.

Quick sizes by default, a minute in all; ``--full`` takes the sizes and rounds
of ``docs/measurements.md``. Exits 1 where a ratio misses its goal by more
than its tolerance.
"""

from __future__ import annotations

import argparse
import json
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from conditions import conditions

if TYPE_CHECKING:
    from side_by_side import Goal, Outcome, Table

BENCHMARKS = (
    *("kernel", "sample_pass", "reality", "log_decode", "replay"),
    *("live", "feed", "heat_population"),
)
OTHERS = (
    *("physics", "accuracy", "radau", "memory", "identification"),
    *("structures", "effects", "pad_life", "risk", "risk_cost"),
    *("matching", "verification", "gap", "faults", "mutants"),
)
"""Figures without a comparison in time; run when named."""


def main(arguments: list[str] | None = None) -> int:
    """Run what was asked for; 1 where a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help=f"{', '.join(BENCHMARKS)} (default: these), {', '.join(OTHERS)}",
    )
    parser.add_argument("--full", action="store_true", help="longer, for docs")
    parser.add_argument("--json", type=Path, metavar="FILE")
    args = parser.parse_args(arguments)
    names = args.names or list(BENCHMARKS)
    unknown = sorted(set(names).difference(BENCHMARKS, OTHERS))
    if unknown:
        parser.error(f"no benchmark {', '.join(unknown)}")
    found = {}
    missed = 0
    for name in names:
        outcome: Outcome = import_module(name).run(full=args.full)
        show(outcome)
        missed += sum(not goal.reached for goal in outcome.goals)
        found[name] = outcome.as_data()
    if args.json is not None:
        taken = {"conditions": conditions()}
        found = {name: data | taken for name, data in found.items()}
        args.json.write_text(json.dumps(found, indent=1) + "\n", "utf-8")
    if missed:
        say(f"{missed} goals missed")
    return int(missed > 0)


def show(outcome: Outcome) -> None:
    """Print *outcome*."""
    say(f"\n{outcome.title}: {outcome.about}")
    for table in outcome.tables:
        say(f"  {table.title}")
        for line in aligned(table):
            say(f"    {line}")
    for goal in outcome.goals:
        say(f"  {verdict(goal)}")


def verdict(goal: Goal) -> str:
    """Return a goal and whether it is reached, in one line."""
    word = "within tolerance" if goal.reached else "MISSED"
    if goal.ratio >= goal.at_least:
        word = "reached"
    return (
        f"{goal.name}: {goal.ratio:.3g}x, goal {goal.at_least:g}x "
        f"less {goal.tolerance:.0%}: {word}"
    )


def aligned(table: Table) -> list[str]:
    """Return the lines of *table*, columns under each other."""
    rows = [table.header, *table.rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if i else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]


def say(line: str) -> None:
    """Write *line* at once; a benchmark takes its time."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())

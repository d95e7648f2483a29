"""Fused heat over a population of cars, and the table of ``docs/heat.md``.

``heat_population.py docs/heat.md [FILE.json]`` writes the table, from what
``run.py heat_population --full --json FILE`` has found or, without a file,
from a run of its own. Quick sizes draw other cars than full ones do: what the
observer was developed on is not what it is judged on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import textwrap
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from conditions import ROOT, conditions
from heat_case import examine, hypercube
from heat_figures import (
    LEARNING,
    by_preset,
    coverage,
    flags,
    goals,
    grades,
    heat,
    kinds,
    learned,
    verdicts,
)
from heat_roads import TESTS
from measurements import markdown
from side_by_side import Goal, Outcome

if TYPE_CHECKING:
    from heat_figures import Found

FULL: Final = 200, 7043
QUICK: Final = 8, 1
"""Cars and the seed that draws them."""

CACHE: Final = ROOT / ".ci" / "cache"
SOURCES: Final = (
    *("bstm_daemon/*.[ch]", "bstm_daemon/*.py", "bstm_daemon/heat/*.py"),
    *("bstm_daemon/thermal/*.py", "bstm_daemon/simulation/*.py"),
    *("config/*.toml", "tests/benchmarks/heat_case.py"),
    "tests/benchmarks/heat_roads.py",
)
"""What a case's figures come from; a change begins the cache anew."""

BEGIN: Final = "<!-- population -->"
END: Final = "<!-- end of population -->"
WIDTH: Final = 98
"""Of lines of text."""

PRINTED: Final = (
    "Error of fused heat by preset",
    "False alarms",
    "Between two drives",
    "Error of the road",
    "Errors within their 90",
)
"""How tables of a run begin that the document sums up in words."""


def run(*, full: bool) -> Outcome:
    """Examine the population, quick or full."""
    count, seed = FULL if full else QUICK
    return outcome_of(examined(count, seed, kept=full), seed, full=full)


def outcome_of(found: list[Found], seed: int, *, full: bool) -> Outcome:
    """Return tables and goals of what was *found*."""
    count = len(found)
    drives = count * (len(LEARNING) + len(TESTS))
    outcome = Outcome(
        "Fused heat over a population",
        f"{count} cars on {drives} drives in the independent reality, drawn "
        f"from a Latin hypercube (seed {seed}): mass 1600 to 2900 kg, bias of "
        "the accelerometer +-0.3 m/s2, roads of up to +-12 %, friction 0.7 to "
        "1.3, drag to +40 %, wind to 8 m/s, torque signal +-3 %, rolling "
        "resistance +-0.002, sensors n1 to n3; presets plain and road and "
        "satellite height in half of the cars. Configuration of the example "
        "car for all.",
    )
    outcome.tables = [
        heat(found),
        kinds(found),
        by_preset(found),
        learned(found),
        grades(found),
        coverage(found),
        flags(found),
    ]
    reached = list(goals(found, full=full))
    outcome.tables.insert(0, verdicts(reached))
    outcome.goals = [
        Goal(name, fit, 1.0, 0.0 if full else 0.6)
        for name, _, _, fit in reached
    ]
    return outcome


def examined(count: int, seed: int, *, kept: bool) -> list[Found]:
    """Return the figures of all cases, those *kept* of an earlier run too."""
    done: dict[int, Found] = {}
    file = CACHE / f"heat_population-{count}-{seed}-{key()}.jsonl"
    if kept and file.exists():
        for line in file.read_text("utf-8").splitlines():
            one = json.loads(line)
            done[one["case"]["number"]] = one
    missing = [c for c in hypercube(count, seed) if c.number not in done]
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for one in workers.map(examine, missing):
            done[one["case"]["number"]] = one
            if kept:
                file.parent.mkdir(parents=True, exist_ok=True)
                (CACHE / ".gitignore").write_text("*\n", "utf-8")
                with file.open("a", encoding="utf-8") as lines:
                    lines.write(json.dumps(one) + "\n")
    return [done[number] for number in sorted(done)]


def key() -> str:
    """Return a hash over the text of all that the figures come from."""
    digest = hashlib.sha256()
    for pattern in SOURCES:
        for path in sorted(ROOT.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def write(document: Path, outcome: dict[str, Any]) -> None:
    """Put *outcome* between the marks of *document*.

    Raises:
        ValueError: the document has no marks.
    """
    text = document.read_text("utf-8")
    head, mark, rest = text.partition(BEGIN)
    _, end, tail_ = rest.partition(END)
    if not (mark and end):
        msg = f"{document}: no {BEGIN} and {END}"
        raise ValueError(msg)
    taken = outcome["conditions"]
    lines = [textwrap.fill(outcome["about"], WIDTH), ""]
    lines += [f"{taken['date']}, commit {taken['commit']}.", ""]
    for table in outcome["tables"]:
        if table["title"].startswith(PRINTED):
            continue
        shown = paired(table) if table["title"] == "Goals" else table
        title = textwrap.fill(f"{shown['title']}:", WIDTH)
        lines += [title, "", *markdown(shown), ""]
    body = "\n".join(lines)
    document.write_text(f"{head}{BEGIN}\n\n{body}\n{END}{tail_}", "utf-8")


def paired(goals: dict[str, Any]) -> dict[str, Any]:
    """Return the table of *goals* with median and percentile in one row.

    A figure says so where it is missed.
    """
    values: dict[str, list[str]] = {}
    limits: dict[str, list[str]] = {}
    for name, value, limit, reached in goals["rows"]:
        figure = name.removesuffix(", median")
        figure = figure.removesuffix(", 95th percentile")
        missed = "" if reached == "yes" else " missed"
        values.setdefault(figure, []).append(value + missed)
        limits.setdefault(figure, []).append(limit)
    return {
        "title": "Goals, median / 95th percentile",
        "header": ("figure", "found", "goal"),
        "rows": [
            (figure, joined(found), joined(limits[figure]))
            for figure, found in values.items()
        ],
    }


def joined(values: list[str]) -> str:
    """Return *values* in one cell, a unit that they share once."""
    *others, last = values
    unit = last.partition(" ")[2]
    return " / ".join(
        [*(one.removesuffix(f" {unit}") for one in others), last]
    )


def main(arguments: list[str] | None = None) -> int:
    """Write the table of the document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("document", type=Path, metavar="HEAT.md")
    parser.add_argument("file", type=Path, nargs="?", metavar="FILE.json")
    args = parser.parse_args(arguments)
    if args.file is None:
        outcome = run(full=True).as_data() | {"conditions": conditions()}
    else:
        found = json.loads(args.file.read_text("utf-8"))
        outcome = found["heat_population"]
    write(args.document, outcome)
    return 0


if __name__ == "__main__":
    sys.exit(main())

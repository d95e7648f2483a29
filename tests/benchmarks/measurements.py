"""Write the figures of ``run.py --json`` files as a Markdown document.

``measurements.py OUT.md FILE.json ...``: one section a benchmark, in the
order of the files, each with its date and commit; the machine where they
differ, else above.
"""

from __future__ import annotations

import argparse
import json
import sys
import textwrap
from pathlib import Path
from typing import Any

HEAD = (
    "# Measurements\n\n"
    "Written by `.ci/full`; do not edit. A commit has a + where sources had "
    "changes that were not committed. Times are CPU time of one process, "
    "medians of rounds in which everything that is compared takes its turn. "
    "They move by up to a factor of two with the load of a machine; the "
    "ratios hold, and goals are set on ratios: the least ratio, less the part "
    "that may be missing before a run fails. A section shows its first "
    "table; `python tests/benchmarks/run.py NAME --full` prints all."
)


def main(arguments: list[str] | None = None) -> int:
    """Write the document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, metavar="OUT.md")
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE.json")
    args = parser.parse_args(arguments)
    found = [
        outcome
        for path in args.files
        for outcome in json.loads(path.read_text("utf-8")).values()
    ]
    machines = {outcome["conditions"]["machine"] for outcome in found}
    is_one = len(machines) == 1
    head = f"{HEAD} All on {machines.pop()}." if is_one else HEAD
    sections = [section(outcome, with_machine=not is_one) for outcome in found]
    text = "\n".join([f"{wrapped(head)}\n", *sections])
    args.out.write_text(text, "utf-8")
    return 0


def wrapped(text: str) -> str:
    """Return the paragraphs of *text* in lines of at most 99 characters."""
    return "\n\n".join(
        textwrap.fill(part, 99, break_on_hyphens=False)
        for part in text.split("\n\n")
    )


def verdict(goal: dict[str, Any]) -> str:
    """Return the ratio of *goal*, and how it is missed where it is."""
    ratio = goal["ratio"]
    text = f"{ratio:.3g}" if ratio < 1e3 else f"{ratio:.0f}"
    if ratio >= goal["at_least"]:
        return text
    least = goal["at_least"] * (1.0 - goal["tolerance"])
    return f"{text}, {'within tolerance' if ratio >= least else 'missed'}"


def section(outcome: dict[str, Any], *, with_machine: bool) -> str:
    """Return one benchmark as Markdown."""
    taken = outcome["conditions"]
    machine = f"; {taken['machine']}" if with_machine else ""
    lines = [
        f"## {outcome['title']}",
        "",
        wrapped(outcome["about"]),
        "",
        wrapped(f"{taken['date']}, commit {taken['commit']}{machine}."),
        "",
    ]
    for table in outcome["tables"][:1]:
        lines += [wrapped(f"{table['title']}:"), "", *markdown(table), ""]
    if outcome["goals"]:
        lines += ["Ratios:", ""]
        for goal in outcome["goals"]:
            least = f"{goal['at_least']:g}"
            if goal["tolerance"]:
                least += f" less {goal['tolerance']:.0%}"
            lines.append(f"- {verdict(goal)} (goal {least}): {goal['name']}")
        lines.append("")
    return "\n".join(lines)


def markdown(table: dict[str, Any]) -> list[str]:
    """Return the lines of *table*; all columns but the first to the right."""
    head, *rows = (
        f"| {' | '.join(row)} |" for row in (table["header"], *table["rows"])
    )
    return [head, f"|---{'|---:' * (len(table['header']) - 1)}|", *rows]


if __name__ == "__main__":
    sys.exit(main())

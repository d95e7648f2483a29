"""``docs/verification.md``: figures and runs, a column and a line a setting.

A setting that is not measured anew stays as it is, with its own date and
commit.
"""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING, Final

from measurements import markdown, wrapped

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

ABOUT: Final = (
    "Sensors n2, through CAN frames; corner FL, errors against the truth, the "
    "disc below 650 degC. Heat known: the true brake power, as a push rod and "
    "wheel torque sensors would give it; fused: from pressure and motion."
)
"""What is measured."""

HEAD: Final = """# Verification

Written by `tests/benchmarks/verification.py --full --out`; do not edit. How
to match and verify a car: [matching.md](matching.md). Everything here is
simulated, in a [reality](reality.md) that shares no physics code with the
estimator. On a real car the 20 K between two thermocouples of a disc limit
the verification.

Goals and floors are those of the project; the thesis asks for fluid within
30 K and its peak within 5 min (section 1.3). A population is ten cars, every
brake parameter that is not on a drawing drawn +-10 % around the nominal car.
Each is matched on `simalp` and `rich` and verified on `alpine-descent`,
`city`, `ams` (ten hard stops), `grossglockner` and `long-run` (2 h 50 min).
*Unmatched* is the configuration matched once, on the nominal car. The 90 %
interval uses an `[accuracy]` from one half of the cars and is counted on the
other half. With the structure `extended` more is matched
([matching.md](matching.md)). The last two settings, a structure on the other's
preset, need not meet the goals: their errors are the gap between model and
car that `bstm gap` explains.

## Goals

95th percentile / worst, in K where no unit is named:
"""

RUNS: Final = "## Runs"
RUNS_ABOUT: Final = (
    "Each setting with its date and commit, the number of matched values, and "
    "the RMS of the nominal match to the thermocouples:"
)
CHAPTER_6: Final = "## Chapter 6"
SHOWN: Final = "extended on road, heat fused"
"""The setting whose single cases are shown: a usual car's."""

INTERVAL: Final = "90 % interval"
MARKED: Final = re.compile(r"\*\*(.+)\*\*.*")
RUN: Final = re.compile(r"^- (.+?): (.+(?:\n  .+)*)$", re.MULTILINE)
TAKEN: Final = re.compile(
    r"(?P<when>\d{4}-\S+ commit \w+\+?).*?(?P<values>\d+ values)\. RMS of "
    r"the nominal match to the thermocouples: (?P<rms>[^:]+):"
)
"""The lines above the first table of a setting."""


class Sections:
    """The document: settings by name, those of *path* to begin with."""

    def __init__(self, names: Iterable[str], path: Path | None) -> None:
        """Take all *names* in their order, and where it is written."""
        self.names = tuple(names)
        self.path = path
        self.figures: dict[str, dict[str, str]] = {}
        self.limits: dict[str, tuple[str, ...]] = {}
        self.runs: dict[str, str] = {}
        self.cases = ""
        if path is not None and path.exists():
            text, _, self.cases = path.read_text("utf-8").partition(
                f"{CHAPTER_6}\n"
            )
            self.cases = self.cases.strip()
            head, _, runs = text.partition(f"{RUNS}\n")
            self.runs = {
                name: " ".join(run.split()) for name, run in RUN.findall(runs)
            }
            header, *rows = _rows(head, "| figure")
            self.limits = {row[0]: row[1:3] for row in rows}
            for column, name in enumerate(header[3:], 3):
                self.figures[name] = {
                    row[0]: MARKED.sub(r"\1", row[column]) for row in rows
                }

    def take(self, name: str, lines: Sequence[str]) -> None:
        """Put what *lines* say of the setting *name*; write the document."""
        body = "\n".join(lines)
        taken = TAKEN.search(" ".join(body.split()))
        assert taken is not None, body
        self.figures[name] = {}
        for figure, share_95, worst, *limits in _rows(body, "| figure")[1:]:
            key = INTERVAL if figure.startswith(INTERVAL) else figure
            both = share_95 if worst == "-" else f"{share_95} / {worst}"
            self.figures[name][key] = both
            self.limits[key] = tuple(limits)
        self.runs[name] = "; ".join(taken.group("when", "values", "rms"))
        cases = body.partition("\nChapter 6, ")[2]
        if name == SHOWN and cases:
            title, _, table = cases.partition("\n\n")
            table = table.partition("\n\n")[0].strip()
            self.cases = f"{' '.join(title.split()).capitalize()}\n\n{table}"
        if self.path is not None:
            self.path.write_text(self.text(), "utf-8")

    def text(self) -> str:
        """Return the whole document."""
        there = [name for name in self.names if name in self.runs]
        return "\n".join(
            [
                HEAD,
                *markdown(self._summary(there)),
                "",
                wrapped(ABOUT),
                "",
                RUNS,
                "",
                wrapped(RUNS_ABOUT),
                "",
                *(_item(f"{name}: {self.runs[name]}") for name in there),
                "",
                CHAPTER_6,
                "",
                self.cases,
                "",
            ]
        )

    def _summary(self, names: Sequence[str]) -> dict[str, object]:
        """Return the figures of *names* beside the goals."""
        return {
            "header": ("figure", "goal", "floor", *names),
            "rows": [
                (
                    figure,
                    *limits,
                    *(
                        _verdict(self.figures[name].get(figure, "-"), *limits)
                        for name in names
                    ),
                )
                for figure, limits in self.limits.items()
            ],
        }


def _item(text: str) -> str:
    """Return *text* as an item of a list, in lines as those of a page."""
    return textwrap.fill(
        f"- {text}", 99, subsequent_indent="  ", break_on_hyphens=False
    )


def _rows(body: str, head: str) -> list[tuple[str, ...]]:
    """Return the table of *body* that begins with *head*: cells of each row.

    The first row is its header.
    """
    table = f"{head}{body.partition(head)[2]}".partition("\n\n")[0]
    rows = [
        tuple(cell.strip() for cell in line.strip("| ").split("|"))
        for line in table.splitlines()
    ]
    return [row for row in rows if not row[0].startswith("---")]


def _verdict(both: str, goal: str, floor: str) -> str:
    """Return a figure in words: met, within its floor or missed.

    The limits are of the 95th percentile, which stands before the worst.
    """
    if "-" in (both, goal):
        return both
    value = float(both.partition("/")[0].rstrip(" %"))
    if "to" in goal:
        least, most = (float(one) for one in goal.rstrip(" %").split(" to "))
        return both if least <= value <= most else f"**{both}** missed"
    if value <= float(goal):
        return both
    kind = "within floor" if value <= float(floor) else "missed"
    return f"**{both}** {kind}"

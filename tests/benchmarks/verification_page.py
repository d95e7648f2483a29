"""``docs/verification.md``: a section a setting, and their summary.

A section that is not measured anew stays as it is, with its own date and
commit; the summary is read from the sections.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from measurements import markdown, wrapped

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

ABOUT: Final = (
    "Car 1 (nominal) matched on simalp and rich; sensors "
    "n2, through CAN frames. Corner FL, errors in K against the "
    "truth, the disc below 650 degC. Heat known: the true brake power, "
    "as a push rod and wheel torque sensors would give it; fused: from "
    "pressure and motion."
)
"""What is measured."""

HEAD: Final = """# Verification

Written by `tests/benchmarks/verification.py --full --out`; do not edit. How
to match and verify a car: [matching.md](matching.md). Everything here is
simulated: the reality shares no physics code with the estimator
([reality.md](reality.md)), but no figure below was measured on a car. On a
real car the 20 K between two thermocouples of a disc limit the verification.

Goals and floors are those of the project; the thesis asks for fluid within
30 K and its peak within 5 min (section 1.3). A population is ten cars, every
brake parameter that is not on a drawing drawn +-10 % around the nominal car.
Each is matched on `simalp` and `rich` and verified on `alpine-descent`,
`city`, `ams` (ten hard stops), `grossglockner` and `long-run` (2 h 50 min).
*Unmatched* is the configuration matched once, on the nominal car. The 90 %
interval uses an `[accuracy]` from one half of the cars and is counted on the
other half. With the structure `extended` the strengths of its seven thermal
effects are matched too. The two structures on the other's preset, at the end,
need not meet the goals: their errors are the gap between model and car that
`bstm gap` explains. Each section states its commit.
"""

TITLE: Final = re.compile(r"^## Structure (.+)$", re.MULTILINE)
SHOWN_WHOLE: Final = ("extended on road, heat fused",)
"""Settings whose single cases are shown: a usual car's."""

CHAPTER_6: Final = re.compile(
    r"^Chapter 6, structure.*?(?=^#|^What|\Z)", re.MULTILINE | re.DOTALL
)
RE_MATCHED: Final = re.compile(
    r"^What re-matching car 2 moved.*?(?=^#|^[A-Z]|\Z)",
    re.MULTILINE | re.DOTALL,
)
INTERVAL: Final = "90 % interval"
CONDITIONS: Final = re.compile(r"^(\d{4}-\S+ commit \w+\+?);.*", re.MULTILINE)
LIMITS: Final = re.compile(
    r"^(\|[^|\n]+\|[^|\n]+\|[^|\n]+\|)([^|\n]+)\|([^|\n]+)\|$", re.MULTILINE
)
"""A row of a population's first table: figure, two values, goal and floor,
which are the same in each section and stand in the summary."""


class Sections:
    """The document: sections by setting, those of *path* to begin with."""

    def __init__(self, names: Iterable[str], path: Path | None) -> None:
        """Take all *names* in their order, and where it is written."""
        self.names = tuple(names)
        self.path = path
        self.body: dict[str, str] = {}
        self.limits: dict[str, tuple[str, ...]] = {}
        if path is not None and path.exists():
            head, *rest = TITLE.split(path.read_text("utf-8"))
            found = dict(zip(rest[::2], rest[1::2], strict=True))
            self.body = {k: v.strip() for k, v in found.items()}
            goals = _rows(head, "| 95th percentile").items()
            self.limits = {figure: cells[:2] for figure, cells in goals}

    def take(self, name: str, lines: Sequence[str]) -> None:
        """Put *lines* as the section *name*, and write the document."""
        body = "\n".join(lines).strip()
        if name not in SHOWN_WHOLE:
            body = CHAPTER_6.sub("", body)
        if name not in SHOWN_WHOLE:
            # of what a second car moves one table is enough
            body = RE_MATCHED.sub("", body)
        before, mark, table = body.partition("| figure")
        table, gap, behind = f"{mark}{table}".partition("\n\n")
        self.limits.update(
            (figure, cells[2:]) for figure, cells in _rows(table).items()
        )
        before = CONDITIONS.sub(r"\1.", before)
        table = LIMITS.sub(r"\1", table)
        body = f"{before}{table}{gap}{behind}"
        self.body[name] = body.strip()
        if self.path is not None:
            self.path.write_text(self.text(), "utf-8")

    def text(self) -> str:
        """Return the whole document."""
        there = [name for name in self.names if name in self.body]
        return "\n".join(
            [
                HEAD,
                "## Goals",
                "",
                *markdown(self._summary(there)),
                "",
                wrapped(ABOUT),
                "",
                *(
                    f"## Structure {name}\n\n{self.body[name]}\n"
                    for name in there
                ),
            ]
        )

    def _summary(self, names: Sequence[str]) -> dict[str, object]:
        """Return the 95th percentiles of *names* beside the goals."""
        found = {name: _rows(self.body[name]) for name in names}
        rows = []
        for figure, limits in self.limits.items():
            if limits[0] != "-":
                values = [found[name].get(figure, "-")[0] for name in names]
                cells = [_verdict(value, *limits) for value in values]
                rows.append((figure, *limits, *cells))
        return {
            "header": ("95th percentile, K", "goal", "floor", *names),
            "rows": rows,
        }


def _rows(body: str, head: str = "| figure") -> dict[str, tuple[str, ...]]:
    """Return the table of *body* below *head*: figure to its cells."""
    lines = iter(body.splitlines())
    found = {}
    for line in lines:
        if line.startswith(head):
            break
    for line in lines:
        if not line.startswith("|"):
            break
        name, *cells = (cell.strip() for cell in line.strip("| ").split("|"))
        if not name.startswith("---"):
            key = INTERVAL if name.startswith(INTERVAL) else name
            found[key] = tuple(cells)
    return found


def _verdict(value: str, goal: str, floor: str) -> str:
    """Return a figure in words: met, within its floor or missed."""
    if value == "-":
        return value
    if "to" in goal:
        least, most = (float(one) for one in goal.rstrip(" %").split(" to "))
        inside = least <= float(value.rstrip(" %")) <= most
        return value if inside else f"**{value}** missed"
    if float(value) <= float(goal):
        return value
    kind = "within floor" if float(value) <= float(floor) else "missed"
    return f"**{value}** {kind}"

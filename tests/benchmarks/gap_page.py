"""The figures of the gap benchmark in a Markdown page."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import defaultdict
from dataclasses import replace
from statistics import median
from typing import TYPE_CHECKING, Final

from gap_cars import World
from gap_figures import figures
from gap_held_out import worth
from gap_judge import Result
from gap_shares import Figure, Share
from gap_tables import WAYS, markdown, named, rivals, tables
from side_by_side import Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

BEGIN: Final = "<!-- gap benchmark -->"
END: Final = "<!-- end of gap benchmark -->"

CONTROL: Final = "control"
"""How the names of controls begin."""

PRINTED: Final = (
    *("figures", "held-out drives, right names", "answers"),
    *("against strength", "stated probability"),
    "other ways, same cases and library",
)
"""Tables that a run prints and the page has shorter or side by side."""

MINOR: Final = (
    "S1, twins in these data: true class, no false name",
    "S1, something is missing",
    "S2, at least one of both named",
    "localisation, right where anything is reported",
    "SO, none of the known",
    "SU, none of the known",
    "ST, structural twins: no false single name",
    "AD, several left: named after the advised drive",
    "AD, several left: named after one at random",
    "AD, nothing seen yet: named after the advised drive",
    "AD, nothing seen yet: named after one at random",
)
"""Figures that a run prints and the page leaves out."""

CHIEF: Final = (
    "S0, anything reported",
    "S1, right name or class of two",
    "S1, wrong single name, all cases",
    "localisation, F1 of node and phase",
    "SO, true kind unknown: none of the known, or right place",
    "S2, both and only both",
)
"""Figures of other sensors."""


def write(folder: Path, file: Path, split: str, search: str) -> None:
    """Put the figures of all that is kept in *folder* into *file*.

    Of the *split*, and only answers of the *search* with that fingerprint.
    """
    by_world: dict[World, list[Result]] = defaultdict(list)
    count: dict[World, int] = defaultdict(int)
    seconds: dict[World, list[list[float | None]]] = defaultdict(list)
    stale = 0
    for kept in sorted(folder.glob(f"{split}-*.json")):
        data = json.loads(kept.read_text("utf-8"))
        if "search" not in data:
            continue
        if data["search"] != search:
            stale += 1
            continue
        world = World.of(data["world"])
        advised = kept.stem.endswith("-next")
        count[world] += not advised
        if not advised:
            seconds[world].append(data["seconds"])
        by_world[world] += [Result(**one) for one in data["results"]]
    if stale:
        sys.stderr.write(f"{stale} cases of another search left out\n")
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"],
        capture_output=True, text=True, check=True,
    ).stdout.strip()  # fmt: skip
    parts = [
        BEGIN,
        (
            f"Of {time.strftime('%Y-%m-%d')}, commit {commit}, split {split}: "
            f"{sum(count.values())} simulated cases.\n"
            "Shares with 95 % intervals of Wilson, and the number of cases."
        ),
    ]
    aside = {w: own for w, own in by_world.items() if is_aside(w)}
    main = {
        w: own
        for w, own in by_world.items()
        if w not in aside and not w.always_on
    }
    parts += together(main)
    everyone = [one for own in main.values() for one in own]
    rest = [
        "### Other ways, same cases and library",
        markdown(Table("", WAYS, tuple(rivals(everyone)))),
        "### Effects, one hidden",
        markdown(named_in(main)),
    ]
    for world, results in main.items():
        rest += alone(world, results, seconds[world])
    rest += ["### All effects at once", "`road` with `thesis`."]
    for world, results in by_world.items():
        if world.always_on:
            rest.append(shares({label(world): figures(results)}))
    # what a reader does not decide by is printed only
    sys.stdout.write("\n\n".join(rest) + "\n")
    if aside:
        columns = {label(w): figures(own) for w, own in aside.items()}
        parts += ["### Other sensors, hits/cases", shares(columns, CHIEF)]
    parts.append(END)
    text = file.read_text("utf-8")
    before, _, old = text.partition(BEGIN)
    _, _, after = old.partition(END)
    file.write_text(before + "\n\n".join(parts) + after, "utf-8")


def named_in(by_world: Mapping[World, Sequence[Result]]) -> Table:
    """Return which effects were named where each was hidden alone."""
    return named(
        {f"`{w.preset}`, `{w.structure}`": r for w, r in by_world.items()}
    )


def together(by_world: Mapping[World, Sequence[Result]]) -> list[str]:
    """Return the tables of all main worlds together."""
    own = {f"`{w.preset}`, `{w.structure}`": r for w, r in by_world.items()}
    results = [one for r in own.values() for one in r]
    held_out = worth(results)
    usual = held_out[0][1] if held_out else "0"
    rows = tuple(
        (figure if cases == usual else f"{figure} ({cases})", found, goal)
        for figure, cases, found, goal in held_out
    )
    return [
        "### Figures",
        shares({"found, %": pooled(own)}, interval=True),
        "### Held-out drives, right names",
        (
            f"{usual} cases, where no other number stands. Shrink: median "
            "(quartiles),\nshare below 0.95."
        ),
        markdown(Table("", ("figure", "found", "goal"), rows)),
    ]


def alone(
    world: World,
    results: Sequence[Result],
    seconds: Sequence[Sequence[float | None]],
) -> list[str]:
    """Return the tables of one world that are not beside those of others."""
    parts = [
        f"### `{world.preset}` with structure `{world.structure}`",
        costs(seconds),
    ]
    for table in tables(results):
        if table.title in PRINTED:
            continue
        parts += [f"**{table.title}**", markdown(table)]
    return parts


def is_aside(world: World) -> bool:
    """Whether *world* has other sensors than the main ones."""
    return bool(world.nodes) or world.sensors != World().sensors


def label(world: World) -> str:
    """Return in short what is special about the sensors of *world*."""
    text = " and ".join(world.nodes) + " only" if world.nodes else ""
    text = ", ".join(filter(None, (f"`{world.sensors}`", text)))
    if world.preset != World().preset:
        text += f", `{world.preset}` with `{world.structure}`"
    return text


def pooled(own: Mapping[str, Sequence[Result]]) -> list[Figure]:
    """Return the figures of all worlds together.

    Controls compare answers within a world, so their shares are added up.
    """
    both = [one for results in own.values() for one in results]
    found = {
        one.name: one
        for one in figures(both)
        if not one.name.startswith(CONTROL)
    }
    for one in (f for results in own.values() for f in figures(results)):
        if one.name.startswith(CONTROL):
            before = found.get(one.name, replace(one, share=Share(0.0, 0)))
            total = Share(
                before.share.hits + one.share.hits,
                before.share.count + one.share.count,
            )
            found[one.name] = replace(one, share=total)
    return list(found.values())


def shares(
    by_label: Mapping[str, Sequence[Figure]],
    chief: Sequence[str] = (),
    *,
    interval: bool = False,
) -> str:
    """Return figures side by side, in a Markdown table.

    Args:
        by_label: Figures of each column.
        chief: Names of the figures to take; all but the minor ones
            if empty.
        interval: Whether to write shares with their intervals, or hits.
    """
    of = {
        column: {one.name: one for one in found}
        for column, found in by_label.items()
    }
    names = chief or tuple(
        name
        for name in dict.fromkeys(n for found in of.values() for n in found)
        if name not in MINOR
    )
    rows = []
    for name in names:
        cells, goal = [], "-"
        for found in of.values():
            one = found.get(name)
            if one is None or not one.share.count:
                cells.append("-")
                continue
            goal = one.row()[3].removesuffix(" %")
            count = one.share.count
            value = str(one.share).replace(" %", "").replace(" to ", "..")
            cells.append(
                f"{value} of {count}"
                if interval
                else f"{one.share.hits:.3g}/{count}"
            )
        if any(cell != "-" for cell in cells):
            rows.append((name, goal, *cells))
    return markdown(Table("", ("figure", "goal, %", *of), tuple(rows)))


def costs(seconds: Sequence[Sequence[float | None]]) -> str:
    """Return in words what a case has cost, medians and highest."""
    texts = []
    for label, column in (
        ("drives and what they show of every effect", 0),
        ("answers of all groups, controls and other ways", 1),
    ):
        known = [s for one in seconds if (s := one[column]) is not None]
        if known:
            texts.append(
                f"{label} {median(known):.1f} s, at most {max(known):.1f} s"
            )
    return "CPU time a case: " + ";\n".join(texts) + "."

"""The figures of the gap benchmark in a Markdown page."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import defaultdict
from statistics import median
from typing import TYPE_CHECKING, Final

from gap_cars import World
from gap_figures import figures
from gap_held_out import worth
from gap_judge import Result
from gap_shares import HEADER
from gap_tables import markdown, tables
from side_by_side import Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

BEGIN: Final = "<!-- gap benchmark -->"
END: Final = "<!-- end of gap benchmark -->"


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
            f"{sum(count.values())} simulated cases. Shares with 95 % "
            "intervals of Wilson."
        ),
    ]
    aside = {w: own for w, own in by_world.items() if is_aside(w)}
    if aside:
        table = compared(aside)
        parts += [f"### {table.title}", markdown(table)]
        parts += [f"{label(w)}: {costs(seconds[w])}" for w in aside]
    main = [w for w in by_world if w not in aside and not w.always_on]
    if len(main) > 1:
        parts += together({world: by_world[world] for world in main})
    for world, results in by_world.items():
        if world not in aside:
            parts += alone(world, results, count[world], seconds[world])
    parts.append(END)
    text = file.read_text("utf-8")
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    file.write_text(before + "\n\n".join(parts) + after, "utf-8")


def alone(
    world: World,
    results: Sequence[Result],
    count: int,
    seconds: Sequence[Sequence[float | None]],
) -> list[str]:
    """Return all tables of one world."""
    title = f"`{world.preset}` with structure `{world.structure}`"
    parts = [
        f"### {title}, sensors `{world.sensors}`: {count} cases",
        costs(seconds),
    ]
    for table in tables(results):
        parts += [f"**{table.title}**", markdown(table)]
    return parts


def together(by_world: Mapping[World, Sequence[Result]]) -> list[str]:
    """Return the figures of the main worlds as one."""
    names = " and ".join(
        f"`{w.preset}` with `{w.structure}`" for w in by_world
    )
    results = [one for own in by_world.values() for one in own]
    rows = [one.row() for one in figures(results)]
    return [
        f"### {names} together, sensors `{World().sensors}`",
        "**figures**",
        # controls compare answers within a world
        markdown(
            Table(
                "figures",
                HEADER,
                tuple(r for r in rows if not r[0].startswith("control")),
            )
        ),
        "**held-out drives, right names**",
        markdown(
            Table("", ("figure", "cases", "found", "goal"), worth(results))
        ),
    ]


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


def compared(by_world: Mapping[World, Sequence[Result]]) -> Table:
    """Return the figures of worlds side by side."""
    of = {
        world: {one.name: one for one in figures(results)}
        for world, results in by_world.items()
    }
    names = dict.fromkeys(name for found in of.values() for name in found)
    rows = []
    for name in names:
        cells = []
        for found in of.values():
            one = found.get(name)
            if one is None or not one.share.count:
                cells.append("-")
            else:
                cells.append(f"{one.share} of {one.share.count}")
        rows.append((name, *cells))
    return Table(
        "other sensors, stratified cases",
        ("figure", *map(label, of)),
        tuple(rows),
    )


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
    return f"CPU time a case: {'; '.join(texts)}."

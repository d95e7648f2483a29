"""Results of the gap benchmark as figures, goals and tables."""

from __future__ import annotations

from collections import Counter, defaultdict
from statistics import NormalDist
from typing import TYPE_CHECKING, Final

import numpy as np
from gap_figures import figures, said
from gap_held_out import by_node, worth
from gap_judge import DETECTABLE, Result
from gap_rivals import LABELS
from gap_shares import HEADER, Figure, share
from side_by_side import Table

from bstm_daemon.analysis.gap.holdout_comparison import BASELINES, EXTENDED

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

BINS: Final = ((0.3, 0.5), (0.5, 0.8), (0.8, 1.25), (1.25, 2.0))
"""Of strength."""

MODELS: Final = (*BASELINES, EXTENDED, "nothing hidden, re-fitted")

FALSE_ALARMS: Final = 0.0075
"""At which the limits of detection are told: the goal of S0."""


WAYS: Final = (
    "way",
    "detectable, effect-free",
    "right, detectable",
    "wrong name, all hidden",
    "named, effect-free",
)
"""Columns of other ways."""


def limit(
    results: Sequence[Result], distance2: Callable[[Result], float]
) -> str:
    """Return how many a test that knows what it looks for would see.

    One-sided, at :data:`FALSE_ALARMS`, tunables re-fitted; *distance2* is
    the squared distance of the effect by the noise that it knows.
    """
    normal = NormalDist()
    least = normal.inv_cdf(1.0 - FALSE_ALARMS)
    power = [normal.cdf(distance2(o) ** 0.5 - least) for o in results]
    return f"{100 * sum(power) / len(power):.0f} %"


def by_strength(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return detection and names against strength."""
    rows = []
    for low, high in BINS:
        own = [
            o
            for o in results
            if o.group == "S1" and low <= o.strengths[0] <= high
        ]
        if own:
            rows.append(
                (
                    f"{low:g} to {high:g}",
                    str(len(own)),
                    str(sum(o.detectable for o in own)),
                    str(share(own, said)),
                    limit(own, lambda o: o.distance2),
                    limit(own, lambda o: o.sensor_distance2),
                    str(share(own, lambda o: o.score)),
                )
            )
    return rows


def reliability(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return how often stated probabilities of names and classes hold."""
    rows = []
    apart, total = 0.0, 0
    said = [
        o
        for o in results
        if o.group in {"S0", "S1"} and o.answer in {"name", "class"}
    ]
    for low, high in ((0.0, 0.95), (0.95, 0.99), (0.99, 0.999), (0.999, 1.1)):
        own = [o for o in said if low <= o.probability < high]
        if own:
            mean = float(np.mean([o.probability for o in own]))
            right = share(own, lambda o: o.effect in o.names)
            apart += len(own) * abs(mean - right.value)
            total += len(own)
            rows.append(
                (
                    f"{low:g} to {min(high, 1.0):g}",
                    str(len(own)),
                    f"{mean:.3f}",
                    str(right),
                )
            )
    if total:
        rows.append(("ECE", str(total), f"{apart / total:.3f}", "<= 0.05"))
    return rows


def confusion(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return what was answered for each effect, detectable cases of S1."""
    by: dict[str, Counter[str]] = defaultdict(Counter)
    for one in results:
        if one.group == "S1":
            said = one.answer
            if said in {"name", "class", "undecided"}:
                said = " | " if said == "class" else " + "
                said = said.join(one.names)
                if one.answer == "undecided":
                    said = f"undecided ({said})"
            if not one.detectable:
                said = "(not detectable) " + (
                    "nothing" if one.answer == "nothing" else said
                )
            by[one.effect][said] += 1
    rows = []
    for effect, counts in sorted(by.items()):
        texts = [
            f"{said} {n}" if n > 1 else said
            for said, n in counts.most_common()
        ]
        rows.append((effect, str(sum(counts.values())), "; ".join(texts)))
    return rows


def named(
    by_label: Mapping[str, Sequence[Result]],
) -> Table:
    """Return named and detectable of each effect of S1, by column.

    Without the effects that are detectable in no case.
    """
    rows: dict[str, list[str]] = defaultdict(lambda: ["-"] * len(by_label))
    for column, results in enumerate(by_label.values()):
        by: dict[str, list[Result]] = defaultdict(list)
        for one in results:
            if one.group == "S1":
                by[one.effect].append(one)
        for effect, own in by.items():
            detectable = [o for o in own if o.detectable]
            right = sum(
                o.answer in {"name", "class"} and effect in o.names
                for o in detectable
            )
            if detectable:
                rows[effect][column] = f"{right} of {len(detectable)}"
    return Table(
        "",
        ("hidden: named of detectable", *by_label),
        tuple((effect, *cells) for effect, cells in sorted(rows.items())),
    )


def rivals(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return this search beside other ways, on the same cases."""
    rows = []
    for label in ("this search", *LABELS):
        hidden = [
            o
            for o in results
            if o.group == ("S1" if label == "this search" else label)
            and o.effects
        ]
        free = [
            o
            for o in results
            if o.group == ("S0" if label == "this search" else label)
            and not o.effects
        ]
        if not hidden and not free:
            continue
        clear = [o for o in hidden if o.detectable]
        rows.append(
            (
                label,
                f"{len(clear)}, {len(free)}",
                str(share(clear, lambda o: o.score)),
                str(share(hidden, lambda o: o.wrong_name)),
                str(share(free, lambda o: o.answer in {"name", "class"})),
            )
        )
    return rows if any(o.group == "S1" for o in results) else []


def tables(results: Sequence[Result]) -> list[Table]:
    """Return all tables of one world."""
    found = [
        Table(
            "figures",
            HEADER,
            tuple(figure.row() for figure in figures(results)),
        )
    ]
    for title, header, rows in (
        (
            "held-out drives, right names",
            ("figure", "cases", "found", "goal"),
            worth(results),
        ),
        (
            "held-out drives, right names: RMS error by node, median [K]",
            ("node", *MODELS),
            by_node(results),
        ),
        (
            "against strength",
            (
                "strength",
                "cases",
                "detectable",
                "reported",
                "a test that knows effect and form",
                "and also the model error",
                "right",
            ),
            by_strength(results),
        ),
        (
            "stated probability",
            ("stated", "answers", "mean", "right"),
            reliability(results),
        ),
        (
            "other ways, same cases and library",
            WAYS,
            rivals(results),
        ),
        ("answers", ("hidden", "cases", "answered"), confusion(results)),
    ):
        if rows:
            found.append(Table(title, header, tuple(rows)))
    return found


def markdown(table: Table) -> str:
    """Return *table* as Markdown."""
    head, *rows = (
        "| " + " | ".join(cell.replace("|", "or") for cell in row) + " |"
        for row in (table.header, *table.rows)
    )
    return "\n".join([head, "|---" * len(table.header) + "|", *rows])


__all__ = ["DETECTABLE", "Figure", "figures", "markdown", "tables"]

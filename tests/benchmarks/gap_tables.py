"""Results of the gap benchmark as figures, goals and tables."""

from __future__ import annotations

from collections import Counter, defaultdict
from statistics import NormalDist
from typing import TYPE_CHECKING, Final

import numpy as np
from gap_held_out import by_node, worth
from gap_judge import DETECTABLE, Result
from gap_rivals import RIVALS
from gap_shares import HEADER, Figure, Share, share
from side_by_side import Table

from bstm_daemon.gap.showing import BASELINES, EXTENDED
from bstm_daemon.simulation.parameters import ROAD_EFFECTS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

BINS: Final = ((0.3, 0.5), (0.5, 0.8), (0.8, 1.25), (1.25, 2.0))
"""Of strength."""

MODELS: Final = (*BASELINES, EXTENDED, "nothing hidden, re-fitted")

FALSE_ALARMS: Final = 0.0075
"""At which the limits of detection are told: the goal of S0."""


def figures(results: Sequence[Result]) -> list[Figure]:
    """Return the figures of one world."""
    by = defaultdict(list)
    for one in results:
        by[one.group].append(one)
    clear = {
        name: [o for o in own if o.detectable] for name, own in by.items()
    }
    found = []
    if by["S0"]:
        found += [
            Figure(
                "S0, a name or class although nothing is hidden",
                share(by["S0"], lambda o: o.answer in {"name", "class"}),
                0.0075, 0.05, at_most=True,
            ),
            Figure(
                "S0, anything said",
                share(by["S0"], lambda o: o.answer != "nothing"),
                0.01, 0.05, at_most=True,
            ),
        ]  # fmt: skip
    if by["S1"]:
        found += _single(by["S1"], clear["S1"])
    if by["SO"]:
        found += [
            Figure(
                "SO, true kind unknown: none of the known, or right place",
                share(
                    clear["SO"],
                    lambda o: o.answer == "unknown" or o.right_place,
                ),
                0.90, 0.70,
            ),
            Figure(
                "SO, none of the known",
                share(clear["SO"], lambda o: o.answer == "unknown"),
            ),
        ]  # fmt: skip
    if by["SX"]:
        found.append(
            Figure(
                "SX, one drive: no false single name",
                share(by["SX"], lambda o: not o.wrong_name),
                0.95, 0.90,
            )
        )  # fmt: skip
    if by["S2"]:
        found += _pairs(clear["S2"])
    if by["AD"]:
        found += _advised(by["AD"])
    found += _controls(by)
    if by["RT"]:
        named = [o for o in by["RT"] if o.answer in {"name", "class"}]
        found += [
            Figure("road, anything said", share(by["RT"], _said)),
            Figure(
                "road, every name given is on",
                share(named, lambda o: set(o.names) <= set(ROAD_EFFECTS)),
                1.0, 0.9,
            ),
            Figure(
                "road, effects named of those that are on",
                Share(
                    sum(len(set(o.names) & set(ROAD_EFFECTS)) for o in named),
                    len(by["RT"]) * len(ROAD_EFFECTS),
                ),
            ),
        ]  # fmt: skip
    return found


def _single(every: Sequence[Result], clear: Sequence[Result]) -> list[Figure]:
    strong = [o for o in clear if o.strengths[0] >= 1.0]
    twins = [o for o in clear if o.twins]
    named = [o for o in clear if o.answer in {"name", "class", "unknown"}]
    return [
        Figure(
            "S1, right name or class of two",
            share(clear, lambda o: o.score), 0.95, 0.85,
        ),
        Figure(
            "S1, right one among three best",
            share(clear, lambda o: o.effect in o.leading), 0.99, 0.95,
        ),
        Figure("S1, something is missing", share(clear, _said)),
        Figure(
            "S1, something is missing, strength 1 and more",
            share(strong, _said), 0.97, 0.85,
        ),
        Figure(
            "S1, wrong single name, all cases",
            share(every, lambda o: o.wrong_name), 0.02, 0.06, at_most=True,
        ),
        Figure(
            "ST, twins in these data: true class, no false name",
            share(
                twins,
                lambda o: o.effect in o.names
                and o.answer in {"name", "class"},
            ),
            0.95, 0.90,
        ),
        Figure("localisation, F1 of node and phase", _located(clear), 0.95,
               0.85),
        Figure(
            "localisation, right where anything is said",
            share(named, lambda o: o.right_place),
        ),
    ]  # fmt: skip


def _pairs(clear: Sequence[Result]) -> list[Figure]:
    return [
        Figure(
            "S2, both and only both",
            share(clear, lambda o: o.score), 0.80, 0.50,
        ),
        Figure(
            "S2, at least one of both named",
            share(clear, lambda o: bool(set(o.names) & set(o.effects))),
        ),
        Figure(
            "S2, a name that is neither",
            share(clear, lambda o: o.wrong_name),
        ),
    ]  # fmt: skip


def _advised(cases: Sequence[Result]) -> list[Figure]:
    """Return what the next drive tells, of cases that one left open."""

    def at_random(one: Result) -> float:
        named = one.shown["named"].values()
        return float(sum(named) / len(named))

    def by_advice(one: Result) -> float:
        return float(one.shown["named"][one.shown["advised"]])

    several = [o for o in cases if o.answer != "nothing"]
    unseen = [o for o in cases if o.answer == "nothing"]
    can = [o for o in cases if any(o.shown["named"].values())]
    return [
        Figure(
            "AD, several left: named after the advised drive",
            share(several, by_advice), 0.90,
        ),
        Figure(
            "AD, several left: named after one at random",
            share(several, at_random),
        ),
        Figure(
            "AD, nothing seen yet: named after the advised drive",
            share(unseen, by_advice),
        ),
        Figure(
            "AD, nothing seen yet: named after one at random",
            share(unseen, at_random),
        ),
        Figure(
            "AD, where any drive does: named after the advised drive",
            share(can, by_advice), 0.90,
        ),
        Figure(
            "AD, where any drive does: named after one at random",
            share(can, at_random),
        ),
        Figure(
            "AD, a wrong name after the advised drive",
            share(cases, lambda o: o.shown["wrong"][o.shown["advised"]]),
            0.02, 0.06, at_most=True,
        ),
    ]  # fmt: skip


def _controls(by: Mapping[str, Sequence[Result]]) -> list[Figure]:
    found = []
    plain = {(o.effect, o.number): o for o in by.get("S1", ())}
    if by.get("shuffled"):
        found.append(
            Figure(
                "control, catalogue shuffled: the same answer",
                share(
                    by["shuffled"],
                    lambda o: (
                        o.answer == plain[o.effect, o.number].answer
                        and set(o.names)
                        == set(plain[o.effect, o.number].names)
                    ),
                ),
                1.0,
            )
        )
    if by.get("permuted"):
        found.append(
            Figure(
                "control, signatures exchanged: still the true name",
                share(
                    [o for o in by["permuted"] if o.detectable],
                    lambda o: o.score,
                ),
                0.03, 0.06, at_most=True,
            )
        )  # fmt: skip
    return found


def _said(one: Result) -> bool:
    return one.answer != "nothing"


def _located(clear: Sequence[Result]) -> Share:
    """Return F1 as hits among cases: 2 right over said and true."""
    right = sum(o.right_place for o in clear)
    said = sum(o.answer in {"name", "class", "unknown"} for o in clear)
    count = len(clear)
    both = said + count
    return Share(2.0 * right * count / both if both else 0.0, count)


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
                    str(share(own, _said)),
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


def rivals(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return this search beside other ways, on the same cases."""
    rows = []
    for label in ("this search", *RIVALS):
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
                "said",
                "a test told effect and form",
                "and told what the model is off by",
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
            (
                "way",
                "detectable, effect-free",
                "right, detectable",
                "wrong name, all hidden",
                "named, effect-free",
            ),
            rivals(results),
        ),
        ("answers", ("hidden", "cases", "answered"), confusion(results)),
    ):
        if rows:
            found.append(Table(title, header, tuple(rows)))
    return found


def markdown(table: Table) -> str:
    """Return *table* as Markdown."""
    rows = [table.header, ("---",) * len(table.header), *table.rows]
    lines = ["| " + " | ".join(r.replace("|", "or") for r in row) + " |"
             for row in rows]  # fmt: skip
    return "\n".join(lines)


__all__ = ["DETECTABLE", "Figure", "figures", "markdown", "tables"]

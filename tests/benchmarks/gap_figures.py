"""What share of the gap benchmark's cases came out right, group by group."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

from gap_shares import Figure, Share, share

from bstm_daemon.simulation.parameters import ROAD_EFFECTS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from gap_judge import Result


def figures(results: Sequence[Result]) -> list[Figure]:
    """Return the figures of one world."""
    by = defaultdict(list)
    for one in results:
        by[one.group].append(one)
    found = []
    for group, told in _GROUPS.items():
        if own := by[group]:
            found += told(own, [o for o in own if o.detectable])
    return found + _controls(by)


def _quiet(every: Sequence[Result], _: Sequence[Result]) -> list[Figure]:
    return [
        Figure(
            "S0, a name or class although nothing is hidden",
            share(every, lambda o: o.answer in {"name", "class"}),
            0.0075, 0.05, at_most=True,
        ),
        Figure(
            "S0, anything reported",
            share(every, said),
            0.01,
            0.05,
            at_most=True,
        ),
    ]  # fmt: skip


def _open(_: Sequence[Result], clear: Sequence[Result]) -> list[Figure]:
    return [
        Figure(
            "SO, true kind unknown: none of the known, or right place",
            share(clear, lambda o: o.answer == "unknown" or o.right_place),
            0.90, 0.70,
        ),
        Figure(
            "SO, limit: anything detected by all other effects and heats",
            share(clear, lambda o: o.limit),
        ),
        Figure(
            "SO, none of the known",
            share(clear, lambda o: o.answer == "unknown"),
        ),
    ]  # fmt: skip


def _poor(every: Sequence[Result], _: Sequence[Result]) -> list[Figure]:
    return [
        Figure(
            "SX, one drive: no false single name",
            share(every, lambda o: not o.wrong_name),
            0.95, 0.90,
        )
    ]  # fmt: skip


def _road(every: Sequence[Result], _: Sequence[Result]) -> list[Figure]:
    named = [o for o in every if o.answer in {"name", "class"}]
    return [
        Figure("road, anything reported", share(every, said)),
        Figure(
            "road, every named effect is on",
            share(named, lambda o: set(o.names) <= set(ROAD_EFFECTS)),
            1.0, 0.9,
        ),
        Figure(
            "road, effects named of those that are on",
            Share(
                sum(len(set(o.names) & set(ROAD_EFFECTS)) for o in named),
                len(every) * len(ROAD_EFFECTS),
            ),
        ),
    ]  # fmt: skip


def _single(every: Sequence[Result], clear: Sequence[Result]) -> list[Figure]:
    strong = [o for o in clear if o.strengths[0] >= 1.0]
    twins = [o for o in clear if o.twins]
    return [
        Figure(
            "S1, right name or class of two",
            share(clear, lambda o: o.score), 0.95, 0.85,
        ),
        Figure(
            "S1, limit: exact form of the true kind known",
            share(clear, lambda o: o.limit),
        ),
        Figure(
            "S1, right one among three best",
            share(clear, lambda o: o.effect in o.leading), 0.99, 0.95,
        ),
        Figure("S1, something is missing", share(clear, said)),
        Figure(
            "S1, something is missing, strength 1 and more",
            share(strong, said), 0.97, 0.85,
        ),
        Figure(
            "S1, wrong single name, all cases",
            share(every, lambda o: o.wrong_name), 0.02, 0.06, at_most=True,
        ),
        Figure(
            "S1, twins in these data: true class, no false name",
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
            "localisation, right where anything is reported",
            share(list(filter(said, clear)), lambda o: o.right_place),
        ),
    ]  # fmt: skip


def _unheard(_: Sequence[Result], clear: Sequence[Result]) -> list[Figure]:
    return [
        Figure(
            "SU, in no catalogue: none of the known, or right place",
            share(
                clear, lambda o: o.answer == "unknown" or o.right_place
            ),
            0.90, 0.70,
        ),
        Figure(
            "SU, limit: anything detected by all effects and heats",
            share(clear, lambda o: o.limit),
        ),
        Figure(
            "SU, none of the known",
            share(clear, lambda o: o.answer == "unknown"),
        ),
        Figure(
            "SU, a single name, which must be wrong",
            share(clear, lambda o: o.answer == "name"),
        ),
    ]  # fmt: skip


def _twins(_: Sequence[Result], clear: Sequence[Result]) -> list[Figure]:
    return [
        Figure(
            "ST, structural twins: true class or name",
            share(
                clear,
                lambda o: o.effect in o.names
                and o.answer in {"name", "class"},
            ),
            0.95, 0.90,
        ),
        Figure(
            "ST, structural twins: no false single name",
            share(clear, lambda o: not o.wrong_name),
        ),
    ]  # fmt: skip


def _pairs(_: Sequence[Result], clear: Sequence[Result]) -> list[Figure]:
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


def _advised(cases: Sequence[Result], _: Sequence[Result]) -> list[Figure]:
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
    if by.get("absent"):
        found.append(
            Figure(
                "control, strength 0: something reported",
                share(by["absent"], said), 0.01, 0.05, at_most=True,
            )
        )  # fmt: skip
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


def said(one: Result) -> bool:
    """Whether the answer is not that nothing is missing."""
    return one.answer != "nothing"


def _located(clear: Sequence[Result]) -> Share:
    """Return F1 as hits among cases: 2 right over said and true."""
    right = sum(o.right_place for o in clear)
    count = len(clear)
    both = sum(map(said, clear)) + count
    return Share(2.0 * right * count / both if both else 0.0, count)


_GROUPS: Final[Mapping[str, Callable[..., list[Figure]]]] = {
    "S0": _quiet,
    "S1": _single,
    "SO": _open,
    "SU": _unheard,
    "SX": _poor,
    "ST": _twins,
    "S2": _pairs,
    "AD": _advised,
    "RT": _road,
}
"""Figures by group, told of all its cases and the detectable ones."""

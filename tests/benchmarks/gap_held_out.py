"""Tables of what a name is worth: strength, tunables, held-out drives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from gap_shares import Share
from gap_shown import FLOOR, TRUE

from bstm_daemon.analysis.gap.fitting import Fit
from bstm_daemon.analysis.gap.holdout_comparison import (
    BASELINES,
    CONFIGURED,
    EXTENDED,
    NOISE_FLOOR,
    REFITTED,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gap_judge import Result

NEVER_WORSE: Final = 0.95
"""A shrink factor below it is a worsening."""

LEAST_BIAS: Final = 0.02
"""Of the tunables, in deviations of their priors: nothing counts as less."""

NODES: Final = ("disc", "pad_front", "pad_back", "fluid")
GOALS: Final = (">= 5", ">= 2.5", "below 0.95 in <= 5 %")


def square(one: Result, model: str, nodes: Sequence[str]) -> float:
    """Return the error of *model* at *nodes* [K2], noise taken off."""
    own = sum(one.shown["squares_k2"][model].get(n, 0.0) for n in nodes)
    noise = sum(one.shown["noise_k2"].get(n, 0.0) for n in nodes)
    return max(own - noise, NOISE_FLOOR * noise)


def shrink(
    one: Result,
    baseline: str,
    improved: str = EXTENDED,
    nodes: Sequence[str] = NODES,
) -> float:
    """Return the error of *baseline* over that of *improved*."""
    return float(
        np.sqrt(square(one, baseline, nodes) / square(one, improved, nodes))
    )


def worth(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return rows of what names do, right ones and all that were visible."""
    fitted = [o for o in results if o.group == "S1" and o.shown]
    right = [o for o in fitted if o.answer == "name" and o.score == 1.0]
    visible = [o for o in fitted if o.detectable]
    rows = []
    if right:
        rows += _shrinks(right)
    if visible:
        rows += _limits(visible)
    if right:
        rows += _tunables(right) + _strengths(right)
    return rows


def _shrinks(right: Sequence[Result]) -> list[tuple[str, ...]]:
    rows = []
    for label, nodes in (("all nodes", NODES), ("fluid", ("fluid",))):
        for name, goal in zip(BASELINES, GOALS, strict=True):
            factors = [shrink(o, name, EXTENDED, nodes) for o in right]
            rows.append(
                (
                    f"shrink against {name}, {label}",
                    str(len(right)),
                    _spread(factors),
                    goal,
                )
            )
    return rows


def _limits(visible: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return rows of the two limits, of all detectable cases."""
    count = str(len(visible))
    bound = [shrink(o, CONFIGURED, FLOOR) for o in visible]
    best = [shrink(o, CONFIGURED, TRUE) for o in visible]
    share = [
        shrink(o, REFITTED, EXTENDED) / shrink(o, REFITTED, TRUE)
        for o in visible
    ]
    return [
        (
            "detectable cases: shrink against as configured, as answered",
            count,
            _spread([shrink(o, CONFIGURED) for o in visible]),
            "-",
        ),
        ("the same with the true kind known", count, _spread(best), "-"),
        (
            "the same if nothing were hidden: the floor of the model",
            count,
            _spread(bound),
            "-",
        ),
        (
            "fraction of the shrink with the true kind known",
            count,
            f"median {np.median(share):.2f}, mean {np.mean(share):.2f}",
            ">= 0.9",
        ),
    ]


def _tunables(right: Sequence[Result]) -> list[tuple[str, ...]]:
    before = np.array([o.shown["bias"][REFITTED] for o in right])
    after = np.array([o.shown["bias"][EXTENDED] for o in right])
    ratio = before / np.maximum(after, LEAST_BIAS)
    return [
        (
            "bias of the tunables, re-fit over re-fit with the effect",
            str(len(right)),
            (
                f"median {np.median(ratio):.1f} times, from "
                f"{np.median(before):.2f} to {np.median(after):.2f}"
            ),
            ">= 5",
        )
    ]


def fit_of(one: Result) -> Fit:
    """Return what was fitted as far as strengths go."""
    own = one.shown
    return Fit(np.zeros(0), own["strengths"], own["noise_deviations"], np.nan)


def _strengths(right: Sequence[Result]) -> list[tuple[str, ...]]:
    found = np.array([o.shown["strengths"][o.effect] for o in right])
    true = np.array([o.strengths[0] for o in right])
    ends = np.array([fit_of(o).interval(o.effect) for o in right])
    inside = (ends[:, 0] <= true) & (true <= ends[:, 1])
    return [
        (
            "strength error",
            str(len(right)),
            f"median {100 * np.median(np.abs(found / true - 1.0)):.0f} %",
            "<= 10 %",
        ),
        (
            "its 90 % interval covers",
            str(len(right)),
            str(Share(float(inside.sum()), len(right))),
            "85 to 95 %",
        ),
        (
            "CPU time of fits and held-out drives",
            str(len(right)),
            f"median {np.median([o.shown['seconds'] for o in right]):.1f} s",
            "about 10 s a case",
        ),
    ]


def by_node(results: Sequence[Result]) -> list[tuple[str, ...]]:
    """Return the error of each model at each node, right names."""
    right = [
        o
        for o in results
        if o.group == "S1"
        and o.shown
        and o.answer == "name"
        and o.score == 1.0
    ]
    rows = []
    for node in NODES:
        own = [o for o in right if node in o.shown["noise_k2"]]
        if own:
            cells = [
                f"{np.median([_rms(o, model, node) for o in own]):.2f}"
                for model in (*BASELINES, EXTENDED, FLOOR)
            ]
            rows.append((node, *cells))
    return rows


def _rms(one: Result, model: str, node: str) -> float:
    count = one.shown["points"][node]
    return float(np.sqrt(square(one, model, (node,)) / count))


def _spread(factors: Sequence[float]) -> str:
    low, high = np.quantile(factors, (0.25, 0.75))
    worse = 100 * np.mean(np.array(factors) < NEVER_WORSE)
    return f"{np.median(factors):.2f} ({low:.2f}..{high:.2f}), {worse:.0f} %"

"""``bstm match`` in words: tables for terminal and page, and JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bstm_daemon.matching.identifiability import (
    correlations,
    ratios,
    strong_pairs,
    verdicts,
)
from bstm_daemon.matching.tunables import TUNABLES
from bstm_daemon.report.verify_words import table

if TYPE_CHECKING:
    from bstm_daemon.matching.matcher import Match
    from bstm_daemon.matching.refine import Refinement

STAGE_HEAD = ("stage", "section", "value", "before", "matched", "RMS [K]")
VALUE_HEAD = ("value", "configured", "matched", "sd", "of prior", "verdict")
SHOWN_RATIOS = 8


def short(key: str) -> str:
    """Return *key* without the section that needs no saying."""
    return key.removeprefix("thermal.")


def stage_rows(match: Match) -> list[tuple[str, ...]]:
    """Return a row for each value of each stage."""
    rows: list[tuple[str, ...]] = []
    for one in match.stages:
        head = (one.stage.title, one.stage.section)
        if one.why:
            rows.append((*head, "left out", "", "", one.why))
            continue
        before, after = one.rms_k
        for key, value in one.values.items():
            rows.append(
                (
                    *head,
                    short(key),
                    f"{one.before[key]:.4g}",
                    f"{value:.4g}",
                    f"{before:.2f} to {after:.2f}",
                )
            )
    return rows


def value_rows(fit: Refinement) -> list[tuple[str, ...]]:
    """Return a row for each value of a joint fit."""
    return [
        (
            short(one.key),
            f"{fit.start[one.key]:.4g}",
            f"{one.value:.4g} {TUNABLES[one.key].unit}".removesuffix(" -"),
            f"{one.deviation:.2g}",
            f"{100.0 * one.share:.0f} %",
            one.reason or "settled",
        )
        for one in verdicts(fit)
    ]


def fit_line(fit: Refinement) -> str:
    """Return count of values and RMS by node."""
    rms = ", ".join(f"{node} {k:.1f}" for node, k in fit.rms_k.items())
    return f"{len(fit.keys)} free values, {fit.points} points, RMS [K]: {rms}"


def notes(match: Match) -> list[str]:
    """Return what else there is to say: ratios, pairs, held-out drives."""
    lines = []
    fit = match.joint
    for ratio in ratios(fit)[:SHOWN_RATIOS]:
        sign = "x" if ratio.product else "/"
        lines.append(
            f"{short(ratio.first)} {sign} {short(ratio.second)} is known to "
            f"{100.0 * ratio.deviation:.1f} %, better than either"
        )
    for first, second, correlation in strong_pairs(fit):
        lines.append(
            f"{short(first)} and {short(second)} are correlated "
            f"{correlation:+.2f}"
        )
    if match.accuracy.drives:
        rms = ", ".join(
            f"{node} {k:.1f}" for node, k in match.accuracy.rms_k.items()
        )
        lines.append(
            f"each of {match.accuracy.drives} drives left out in turn: RMS "
            f"[K] on it: {rms}"
        )
    else:
        lines.append(
            "a single drive: nothing is held out, so [accuracy] is too good"
        )
    lines += list(match.remarks)
    return lines


def match_text(match: Match) -> str:
    """Return the whole result for a terminal."""
    lines = [f"corners {', '.join(match.corners)}", ""]
    lines += table(STAGE_HEAD, stage_rows(match))
    lines += ["", "joint refinement: " + fit_line(match.joint)]
    lines += table(VALUE_HEAD, value_rows(match.joint))
    if match.table_4_1 is not None:
        lines += [
            "",
            "Table 4.1 alone beside it: " + fit_line(match.table_4_1),
        ]
        lines += table(VALUE_HEAD, value_rows(match.table_4_1))
    lines += ["", *notes(match)]
    return "\n".join(lines)


def match_json(match: Match) -> dict[str, Any]:
    """Return the result for machines; covariances are of logarithms."""
    return {
        "corners": list(match.corners),
        "stages": [
            {
                "title": one.stage.title,
                "section": one.stage.section,
                "values": one.values,
                "before": one.before,
                "rms_k": None if one.why else list(one.rms_k),
                "left_out": one.why or None,
            }
            for one in match.stages
        ],
        "joint": _fit_json(match.joint),
        "table_4_1": (
            None if match.table_4_1 is None else _fit_json(match.table_4_1)
        ),
        "held_out_drives": match.accuracy.drives,
        "held_out_rms_k": dict(match.accuracy.rms_k),
        "accuracy": {
            node: {"floor_k": one.floor_k, "share": one.share}
            for node, one in match.accuracy.nodes.items()
        },
        "remarks": list(match.remarks),
    }


def _fit_json(fit: Refinement) -> dict[str, Any]:
    return {
        "free_values": len(fit.keys),
        "points": fit.points,
        "rms_k": fit.rms_k,
        "values": {
            one.key: {
                "configured": fit.start[one.key],
                "matched": one.value,
                "standard_deviation": one.deviation,
                "share_of_prior": one.share,
                "settled": one.settled,
                "reason": one.reason or None,
            }
            for one in verdicts(fit)
        },
        "at_bound": list(fit.at_bound),
        "covariance": fit.covariance.tolist(),
        "correlations": np.round(correlations(fit), 4).tolist(),
        "ratios": [
            {"what": str(one), "relative_deviation": one.deviation}
            for one in ratios(fit)
        ],
        "noise": {
            node: {
                "white_k": float(one.white_k),
                "drift_k": float(one.drift_k),
                "offset_k": one.offset_k,
                "lag_s": one.lag_s,
            }
            for node, one in fit.noise.items()
        },
    }

"""``bstm match``: its result in words, as page and as JSON.

The page has figure 5.2 of the thesis.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bstm_daemon.analysis.gap.calibration import Step
from bstm_daemon.analysis.matching import identifiability
from bstm_daemon.analysis.matching.curves import curves_of
from bstm_daemon.analysis.matching.matcher import Match
from bstm_daemon.analysis.matching.refine import Accuracy, Refinement
from bstm_daemon.analysis.matching.tunables import TUNABLES
from bstm_daemon.report.gap import answer_line, called
from bstm_daemon.report.json_file import picked
from bstm_daemon.report.plots import NODE_COLOURS, NodeCurve
from bstm_daemon.report.shell import Page, Section, Table, node_section
from bstm_daemon.report.text import table

STAGE_HEAD = ("stage", "section", "value", "before", "matched", "RMS [K]")
VALUE_HEAD = ("value", "configured", "matched", "sd", "of prior", "verdict")
SHOWN_RATIOS = 8


def short(key: str) -> str:
    """Return *key* without the section ``thermal``."""
    return key.removeprefix("thermal.")


def stage_rows(match: Match) -> list[tuple[str, ...]]:
    """Return a row for each value of each stage."""
    rows: list[tuple[str, ...]] = []
    for one in match.stages:
        head = (one.stage.title, one.stage.section)
        if one.why:
            rows.append((*head, "left out", "", "", one.why))
            continue
        rms_k = "{:.2f} to {:.2f}".format(*one.rms_k)
        rows += [
            (
                *head,
                short(key),
                f"{one.before[key]:.4g}",
                f"{value:.4g}",
                rms_k,
            )
            for key, value in one.values.items()
        ]
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
        for one in identifiability.verdicts(fit)
    ]


def fit_line(fit: Refinement) -> str:
    """Return count of values and RMS by node."""
    return (
        f"{len(fit.keys)} free values, {fit.points} points, RMS [K]: "
        f"{_by_node(fit.rms_k)}"
    )


def _by_node(rms_k: Mapping[str, float]) -> str:
    return ", ".join(f"{node} {k:.1f}" for node, k in rms_k.items())


def _moved(before_k: Mapping[str, float], after_k: Mapping[str, float]) -> str:
    return ", ".join(
        f"{node} {before_k[node]:.1f} to {after:.1f} K"
        for node, after in after_k.items()
    )


def notes(match: Match) -> list[str]:
    """Return remarks: ratios, correlated pairs, held-out drives."""
    fit, accuracy = match.joint, match.accuracy
    lines = [
        f"{short(ratio.first)} {ratio.sign} "
        f"{short(ratio.second)} is known to {100.0 * ratio.deviation:.1f} %, "
        "better than either"
        for ratio in identifiability.ratios(fit)[:SHOWN_RATIOS]
    ]
    lines += [
        f"{short(first)} and {short(second)} are correlated {correlation:+.2f}"
        for first, second, correlation in identifiability.strong_pairs(fit)
    ]
    if not accuracy.left_out:
        lines.append(
            "a single drive, too short to leave a part out: [accuracy] is too "
            "optimistic"
        )
    return [*lines, *match.remarks]


def headline(match: Match) -> str:
    """Return RMS before and after on what was left out, and the verdict."""
    accuracy = match.accuracy
    what = ", ".join(match.corners)
    text = (
        f"{what}: nothing left out, {_by_node(match.joint.rms_k)} K in the fit"
    )
    if accuracy.left_out:
        change = _moved(accuracy.before_k, accuracy.rms_k)
        text = (
            f"{what}: RMS on {accuracy.left_out}, left out: {change}"
            f"{_of_one_node(accuracy)}"
        )
    if match.verdict:
        why = "; ".join(map(short, match.verdict))
        text += f": a part of the model may be missing: run bstm gap ({why})"
    return text


def _of_one_node(accuracy: Accuracy) -> str:
    if not accuracy.baseline_k > 0.0:
        return ""
    return f" (a disc of one node: {accuracy.baseline_k:.1f} K)"


def match_text(match: Match) -> str:
    """Return the whole result for a terminal."""
    lines = [f"corners {', '.join(match.corners)}", ""]
    lines += table(STAGE_HEAD, stage_rows(match))
    fits = [("joint refinement", match.joint)]
    if match.table_4_1 is not None:
        fits.append(("Table 4.1 alone, for comparison", match.table_4_1))
    for what, fit in fits:
        lines += ["", f"{what}: {fit_line(fit)}"]
        lines += table(VALUE_HEAD, value_rows(fit))
    return "\n".join([*lines, "", *notes(match)])


def step_lines(steps: Sequence[Step]) -> list[str]:
    """Return a line for each step from the first match to the last."""
    lines = []
    for number, step in enumerate(steps, 1):
        text = (
            f"step {number}, {', '.join(step.corners)}: "
            f"{answer_line(step.naming, 'this data')}"
        )
        if step.added:
            what = called(step.naming, step.added)
            text += (
                f"; on what was left out, with {what}: "
                f"{_moved(step.before_k, step.after_k)}: "
                f"{'kept' if step.kept else f'dropped, {step.why}'}"
            )
        elif step.naming.found:
            text += ": not added"
        lines.append(text)
    return lines


def step_json(step: Step) -> dict[str, Any]:
    """Return *step* for machines."""
    return picked(
        step,
        *("corners", "added", "kept", "why"),
        answer="naming.answer",
        names="naming.names",
        probability="naming.probability",
        held_out_before_k="before_k",
        held_out_after_k="after_k",
    )


def match_json(match: Match) -> dict[str, Any]:
    """Return the result for machines; covariances are of logarithms."""
    return picked(
        match,
        *("corners", "remarks", "verdict"),
        held_out_drives="accuracy.drives",
        left_out="accuracy.left_out",
        held_out_before_k="accuracy.before_k",
        held_out_rms_k="accuracy.rms_k",
        baseline_rms_k="accuracy.baseline_k",
        accuracy="accuracy.nodes",
    ) | {
        "stages": [
            picked(
                one,
                *("values", "before"),
                title="stage.title",
                section="stage.section",
            )
            | {
                "rms_k": None if one.why else one.rms_k,
                "left_out": one.why or None,
            }
            for one in match.stages
        ],
        "joint": _fit_json(match.joint),
        "table_4_1": match.table_4_1 and _fit_json(match.table_4_1),
    }


def _fit_json(fit: Refinement) -> dict[str, Any]:
    return picked(fit, "points", "rms_k", "at_bound", "covariance") | {
        "free_values": len(fit.keys),
        "values": {
            one.key: picked(
                one,
                "settled",
                matched="value",
                standard_deviation="deviation",
                share_of_prior="share",
            )
            | {"configured": fit.start[one.key], "reason": one.reason or None}
            for one in identifiability.verdicts(fit)
        },
        "correlations": np.round(identifiability.correlations(fit), 4),
        "ratios": [
            {"what": str(one), "relative_deviation": one.deviation}
            for one in identifiability.ratios(fit)
        ],
        "noise": {
            node: picked(one, "white_k", "drift_k", "offset_k", "lag_s")
            for node, one in fit.noise.items()
        },
    }


def match_page(
    matches: Sequence[Match], subtitle: str, steps: Sequence[Step] = ()
) -> Page:
    """Return the page of what *matches* found, in which *steps*."""
    sections = []
    if steps:
        sections.append(Section("Steps", lines=step_lines(steps)))
    for match in matches:
        prefix = f"{', '.join(match.corners)}: "
        sections += [
            *_drawn(match),
            Section(
                f"{prefix}matched values",
                Table(VALUE_HEAD, value_rows(match.joint)),
                lines=(fit_line(match.joint), *notes(match)),
                note="sd: standard deviation after the fit; of prior: as a "
                "share of the prior's. Values without the name "
                "of a section are keys of [thermal].",
                folded=True,
            ),
            Section(
                f"{prefix}stages (thesis chapter 5)",
                Table(STAGE_HEAD, stage_rows(match)),
                note="Neighbours of the fitted part follow their measured "
                "temperatures; the joint refinement begins at these values.",
                folded=True,
            ),
        ]
        if match.table_4_1 is not None:
            sections.append(
                Section(
                    f"{prefix}Table 4.1 alone",
                    Table(VALUE_HEAD, value_rows(match.table_4_1)),
                    lines=(fit_line(match.table_4_1),),
                    folded=True,
                )
            )
        sections.append(
            Section(
                f"{prefix}correlations of the matched values",
                _correlations(match.joint),
                folded=True,
            )
        )
    worst: dict[str, tuple[float, str]] = {}
    for match in matches:
        where = f", {', '.join(match.corners)}" if len(matches) > 1 else ""
        for node, rms_k in match.joint.rms_k.items():
            told = f"RMS {node.replace('_', ' ')} in the fit{where}"
            worst[node] = max(worst.get(node, (0.0, "")), (rms_k, told))
    tiles = [(f"{rms_k:.1f} K", told) for rms_k, told in worst.values()]
    lead = ". ".join(sentence(match) for match in matches)
    return Page("Match", sections, tiles, f"{lead}.", subtitle=subtitle)


def sentence(match: Match) -> str:
    """Return for a person what the match changed, without the last dot."""
    accuracy = match.accuracy
    what = ", ".join(match.corners)
    if accuracy.left_out:
        change = _moved(accuracy.before_k, accuracy.rms_k).replace("_", " ")
        text = (
            f"{what}: on what the fit did not use ({accuracy.left_out}) the "
            f"RMS error changed: {change}{_of_one_node(accuracy)}"
        )
    else:
        text = (
            f"{what}: the model follows the drives of the fit to "
            f"{_by_node(match.joint.rms_k)} K; nothing was left out to prove "
            "it"
        )
    if match.verdict:
        text += ". A part of the model may be missing: run bstm gap"
    return text


def _correlations(fit: Refinement) -> Table:
    found = identifiability.correlations(fit)
    places = range(len(fit.keys))
    names = [str(i + 1) for i in places]
    rows = [
        (
            f"{i + 1} {short(fit.keys[i])}",
            *(f"{found[i, j]:+.2f}" if j < i else "" for j in places),
        )
        for i in places
    ]
    return Table(("value", *names), rows)


def _drawn(match: Match) -> list[Section]:
    sections = []
    for drive in match.drives:
        for corner in match.corners:
            own = [
                NodeCurve(
                    one.couple,
                    drive.time_s,
                    one.measured_c,
                    one.after_c,
                    _smooth(one.after_c - one.measured_c),
                    one.before_c,
                )
                for one in curves_of(match, drive, corner)
                if one.couple in NODE_COLOURS
            ]
            if own:
                sections.append(
                    node_section(
                        f"{drive.name}, {corner}: measured and matched "
                        "(thesis figure 5.2)",
                        own,
                        ("matched minus measured", "error [K], mean of 10 s"),
                        "Thick: measured; thin: matched; dashed: as "
                        "configured before.",
                    )
                )
    return sections


def _smooth(error: np.ndarray) -> np.ndarray:
    """Return the running mean over 10 s, (n,)."""
    return np.convolve(error, np.full(21, 1.0 / 21.0), "same")

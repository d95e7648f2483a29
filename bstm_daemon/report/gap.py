"""``bstm gap``: what temperatures or forces show, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.gap.changes import (
    factor_of,
    is_change,
    is_listed,
    largest,
    name_of,
    said,
    said_percent,
)
from bstm_daemon.analysis.gap.holdout_comparison import (
    BASELINES,
    CONFIGURED,
    EXTENDED,
    Shown,
    Shrink,
)
from bstm_daemon.analysis.statistics.series import rms
from bstm_daemon.model.effects.catalogue import effect_class
from bstm_daemon.model.effects.composed import is_composed, read
from bstm_daemon.report.text import Columns, table

if TYPE_CHECKING:
    from bstm_daemon.analysis.gap.advising import Advice
    from bstm_daemon.analysis.gap.evidence import Candidate
    from bstm_daemon.analysis.gap.fitting import Fit
    from bstm_daemon.analysis.gap.heat_only import ForceGap
    from bstm_daemon.analysis.gap.naming import Naming
    from bstm_daemon.analysis.gap.residual_heat import Cell, Located
    from bstm_daemon.analysis.gap.workflow import Gap
    from bstm_daemon.config.sections import Config

CANDIDATE_HEAD: Final = (
    *("effect", "strength", "sd", "score in sd"),
    *("ln Bayes factor", "probability"),
)
MODELS: Final = (*BASELINES, EXTENDED)
ERROR_HEAD: Final = ("drive", "node", *MODELS)
MATCH_FIRST: Final = (
    "the tunables, within their priors, can explain the residual heat: match "
    "the model to these drives (bstm match) and search again"
)
UNMATCHED: Final = (
    "no [accuracy] in the configuration: an error that bstm match would "
    "correct may be mistaken for an effect"
)
WIDE: Final = 2.5
"""Deviation of a change that says nothing."""

SHOWN_PLACES: Final = 4
SHOWN_CANDIDATES: Final = 8


def gap_text(gap: Gap) -> str:
    """Return what was found as lines for a terminal."""
    lines: list[str] = []
    if gap.located is not None:
        lines += place_lines(gap.located)
    if gap.naming is not None:
        lines += naming_lines(gap.naming)
        lines += table(CANDIDATE_HEAD, candidate_rows(gap.naming))
        lines += unnamed_lines(gap)
        if gap.silent:
            silent = ", ".join(map(name_of, gap.silent))
            lines.append(f"not excited: {silent}")
    if gap.advice:
        lines += advice_lines(gap)
    if gap.fit is not None:
        for name, strength in gap.fit.strengths.items():
            low, high = gap.fit.interval(name)
            if is_change(name):
                ends = [said_percent(name, end) for end in (low, high)]
                lines.append(
                    f"{said(name, strength)} (90 % interval {ends[0]} to "
                    f"{ends[1]})"
                )
                continue
            if gap.naming is not None and is_composed(name):
                ends = [
                    said_term(gap.naming, name, end).rpartition(": ")[2]
                    for end in (low, high)
                ]
                lines.append(
                    f"{said_term(gap.naming, name, strength)} (90 % interval "
                    f"{ends[0]} to {ends[1]})"
                )
                continue
            lines.append(
                f"{name}: strength {strength:.2f} +- "
                f"{gap.fit.deviations[name]:.2f} with the error of its form, "
                f"90 % interval {low:.2f} to {high:.2f}"
            )
    if gap.shown is not None:
        lines += shown_lines(gap.shown)
    head = f"{', '.join(gap.corners)}: {headline(gap)}"
    return "\n  ".join([head, *lines])


def remarks_on(config: Config) -> tuple[str, ...]:
    """Return what in *config* limits the answer."""
    given = config.accuracy.model_fields_set
    of_model = {name for name in given if not name.startswith("thermocouple")}
    return () if of_model else (UNMATCHED,)


def headline(gap: Gap) -> str:
    """Return the answer in one line."""
    if gap.naming is None:
        return "where model and thermocouples disagree"
    return answer_line(gap.naming, "this data")


def sentence(gap: Gap) -> str:
    """Return what was found for a person: where, why, what it changes."""
    parts = []
    if gap.located is not None and gap.located.places:
        place = gap.located.places[0]
        where = f"the {place.node.replace('_', ' ')}"
        if place.other:
            where = f"between {where} and the {place.other.replace('_', ' ')}"
        else:
            where = f"at {where}"
        energy_kj = 1e-3 * abs(place.energy_j)
        lack = "too little" if place.energy_j > 0.0 else "too much"
        parts.append(
            f"while {place.regime} the model has {energy_kj:.0f} kJ {lack} "
            f"heat {where}"
        )
    if gap.naming is not None:
        parts.append(cause(gap.naming))
    if gap.shown is not None:
        before, after = (
            rms(np.array([one.rms_k[k] for one in gap.shown.errors]))
            for k in (CONFIGURED, EXTENDED)
        )
        move = "falls" if after < before else "rises"
        it = "it"
        if gap.naming is not None and gap.naming.answer == "undecided":
            it = " and ".join(map(name_of, gap.adopted))
        parts.append(
            f"with {it} the error on {shown_where(gap.shown)} {move} from "
            f"{before:.1f} to {after:.1f} K"
        )
    if gap.advice:
        parts.append(advice_headline(gap))
    return as_sentence(parts)


def cause(naming: Naming) -> str:
    """Return the likely cause in words that need no catalogue."""
    causes = []
    for name in naming.names:
        text = called(naming, name)
        if is_listed(name):
            text = effect_class(name).description
        causes.append(f"{text[0].lower()}{text[1:]}".rstrip(".?"))
    unnamed = naming.unknown_place.replace("_", " ")
    return {
        "nothing": "no missing effect is visible",
        "name": f"likely cause: {' and '.join(causes)}",
        "class": f"likely cause, not to be told apart: {' or '.join(causes)}",
        "composed": (
            "none of the known effects explains it; best description: "
            f"{' and '.join(causes)}"
        ),
        "unknown": (
            "none of the known effects explains it"
            f"{'; most like it: ' * bool(unnamed)}{unnamed}"
        ),
        "undecided": "the drives do not decide which effect is missing",
    }[naming.answer]


def as_sentence(parts: Sequence[str]) -> str:
    """Return *parts* as one sentence."""
    text = "; ".join(parts) or "nothing was searched"
    return f"{text[0].upper()}{text[1:]}."


def answer_line(naming: Naming, what: str) -> str:
    """Return the answer of *naming*, found in *what*, in one line."""
    comma = "; " if naming.answer == "composed" else ", "
    names = comma.join(called(naming, name) for name in naming.names)
    share = percent(naming.probability)
    which = "missing" if any_effect(naming) else "changed"
    return {
        "nothing": f"no missing effect visible (nothing missing: {share})",
        "name": f"{which}: {names} (probability {share})",
        "class": f"{which}: one of {names}; {what} cannot distinguish them",
        "composed": (
            f"missing: none of the known effects; best description: {names}"
        ),
        "unknown": f"missing: none of the known effects{_place(naming)}",
        "undecided": (
            f"something is missing, but not named; possible: {names}"
        ),
    }[naming.answer]


def _place(naming: Naming) -> str:
    """Return where what has no name explains most, if that is known."""
    return f", {naming.unknown_place}" if naming.unknown_place else ""


def any_effect(naming: Naming) -> bool:
    """Whether an effect is among the names, or there are none."""
    return not naming.names or not all(map(is_change, naming.names))


def called(naming: Naming, name: str) -> str:
    """Return what *name* is called in an answer: a change in plain words."""
    if is_listed(name):
        return name
    own = next(one for one in naming.candidates if one.name == name)
    if is_composed(name):
        return said_term(naming, name, own.strength)
    return said(name, own.strength, cause=len(naming.names) == 1)


def said_term(naming: Naming, name: str, strength: float) -> str:
    """Return the composed term *name* with its size at *strength*."""
    term = read(name_of(name), naming.sizes[name] * strength)
    return f"{term}: {term.said}"


def answer_tile(naming: Naming) -> tuple[str, str]:
    """Return the answer for the head of a page: a figure, its meaning."""
    names = [called(naming, name).replace("_", " ") for name in naming.names]
    either = " or ".join(names)
    meaning = "missing effect" if any_effect(naming) else "change"
    return {
        "nothing": ("nothing visible", meaning),
        "unknown": ("not in the catalogue", meaning),
        "undecided": ("not decided", f"{meaning}; possible: {either}"),
        "class": (either, meaning),
        "composed": (" and ".join(names), f"{meaning}, in no catalogue"),
        "name": (" and ".join(names), meaning),
    }[naming.answer]


def probability_tile(naming: Naming) -> tuple[str, str]:
    """Return how probable the answer is, for the head of a page."""
    of = " that nothing is missing" * (naming.answer == "nothing")
    return percent(naming.probability), f"probability{of}"


def strength_tiles(found: Fit | ForceGap) -> list[tuple[str, str]]:
    """Return the strengths that were *found* for the head of a page."""
    return [
        (
            f"{strength:.2f} ± {found.deviations[name]:.2f}",
            f"strength of {name_of(name).replace('_', ' ')}, 1 = typical",
        )
        if not is_change(name)
        else (said_percent(name, strength), name_of(name))
        for name, strength in found.strengths.items()
    ]


def percent(probability: float) -> str:
    """Return *probability*; nothing measured is certain."""
    if probability > 0.999:
        return "> 99.9 %"
    return f"{100.0 * probability:.1f} %"


def place_lines(located: Located) -> list[str]:
    """Return where the gap is, plainest first."""
    if not located.places:
        return ["no residual heat beyond the noise"]
    return [
        f"residual heat at {place}: {1e-3 * place.energy_j:+.0f} kJ "
        f"({place.z:.1f} sd)"
        for place in located.places[:SHOWN_PLACES]
    ]


def naming_lines(naming: Naming) -> list[str]:
    """Return why the answer is what it is."""
    lines = [naming.reason]
    if naming.answer == "name":
        lines += [
            f"{k}: {effect_class(k).description}"
            for k in naming.names
            if is_listed(k)
        ]
    if naming.names or np.isfinite(naming.best_placebo_z):
        lines.append(
            f"explains {100.0 * naming.explained:.0f} % of what all effects "
            f"together could; best placebo {naming.best_placebo_z:.1f} sd "
            f"against {naming.gate_z:.1f} sd"
        )
        for drive, gain in naming.cross_validated.items():
            lines.append(
                f"{drive}, predicted by the other drives: ln Bayes factor "
                f"{gain:+.1f}"
            )
    return lines


def candidate_rows(naming: Naming) -> list[tuple[str, ...]]:
    """Return a row for each of the likeliest candidates."""
    return [
        (
            *strength_cells(one),
            f"{one.z:.1f}",
            # adding 0.0 turns -0.0 into 0.0
            f"{round(one.log_evidence, 1) + 0.0:.1f}",
            percent(naming.odds[one.name]),
        )
        for one in naming.candidates[:SHOWN_CANDIDATES]
    ]


def strength_cells(one: Candidate) -> tuple[str, str, str]:
    """Return name, strength and its deviation; of a change its percents."""
    if not is_change(one.name):
        return name_of(one.name), f"{one.strength:.2f}", f"{one.deviation:.2f}"
    deviation = 100.0 * (factor_of(one.name, min(one.deviation, WIDE)) - 1.0)
    return (
        name_of(one.name),
        said_percent(one.name, one.strength),
        f"{deviation:.0f} %" if one.deviation < WIDE else "unknown",
    )


def unnamed_lines(gap: Gap) -> list[str]:
    """Return what to make of a search that found nothing."""
    if gap.naming is None or gap.naming.found:
        return []
    lines = reach_lines(gap.naming)
    if gap.located is not None and gap.located.places and not gap.matched:
        lines.insert(0, MATCH_FIRST)
    return lines


def reach_lines(naming: Naming) -> list[str]:
    """Return from which strength each effect would have been detected.

    Effects that would have to be stronger than they can be come last.
    """
    near, far = [], []
    for one in sorted(naming.candidates, key=lambda one: one.reach):
        if one.reach > largest(one.name):
            far.append(name_of(one.name))
        elif is_change(one.name):
            near.append(
                f"{name_of(one.name)} {said_percent(one.name, one.reach)}"
            )
        else:
            near.append(f"{one.name} {one.reach:.2f}")
    shown = ", ".join(near) or "none"
    lines = [f"could have been shown, from the strength of: {shown}"]
    if far:
        lines.append(
            f"too weak in these drives at any strength: {', '.join(far)}"
        )
    return lines


CELLS: Final[Columns[Cell]] = Columns(
    ("node", lambda one: one.node),
    ("regime", lambda one: one.regime),
    ("bin", lambda one: one.bin),
    ("missing heat", lambda one: f"{1e-3 * one.energy_j:+.1f} kJ"),
    ("in sd", lambda one: f"{one.z:+.1f}"),
)


def shown_lines(shown: Shown) -> list[str]:
    """Return the shrink factors and how far the tunables moved."""
    lines = []
    for name in BASELINES:
        one = shown.shrinks[name]
        text = f"gap on {shown_where(shown)}, against {name}: {times(one)}"
        if name in shown.fluid_shrinks:
            text += f", fluid {shown.fluid_shrinks[name].factor:.1f}"
        lines.append(text)
    moved = ", ".join(
        f"{name} {bend:.2f}" for name, bend in shown.bends.items() if bend
    )
    moved = f"tunables moved, in deviations of their priors: {moved}"
    if not shown.better:
        lines.append(
            "what was found does not make the gap clearly smaller there"
        )
    return [*lines, moved]


def shown_where(shown: Shown) -> str:
    """Return which drives before and after are shown on."""
    return "held-out drives" if shown.held_out else "the fitted drives"


def times(shrink: Shrink) -> str:
    """Return by how much a gap has become smaller, or larger."""
    word, one = change(shrink)
    return (
        f"{one.factor:.1f} times {word} ({one.lower:.1f} to {one.upper:.1f})"
    )


def change(shrink: Shrink) -> tuple[str, Shrink]:
    """Return ``smaller`` or ``larger``, and that many times it is."""
    if shrink.factor >= 1.0:
        return "smaller", shrink
    return "larger", Shrink(
        1.0 / shrink.factor, 1.0 / shrink.upper, 1.0 / shrink.lower
    )


def adopted_text(gaps: Sequence[Gap | ForceGap]) -> str:
    """Return what is written into a configuration, in a few words."""
    found = []
    for gap in gaps:
        names = ", ".join(map(name_of, gap.adopted))
        if names and gap.naming is not None and gap.naming.answer == "class":
            alike = ", ".join(map(name_of, gap.naming.names))
            names += f" (one of {alike}; these drives cannot distinguish them)"
        if names:
            found.append(names)
    return ", ".join(found)


def error_rows(shown: Shown) -> list[tuple[str, ...]]:
    """Return the RMS error of each node over each drive, by model."""
    return [
        (one.drive, one.node, *(f"{one.rms_k[k]:.1f} K" for k in MODELS))
        for one in shown.errors
    ]


def advice_lines(gap: Gap) -> list[str]:
    """Return which drive would distinguish the members, as lines."""
    return [advice_headline(gap), *ADVICE.lines(gap.advice, None)]


def advice_headline(gap: Gap) -> str:
    """Return the advice in one line."""
    best = gap.advice[0]
    if best.named < 0.01:
        return "next drive: none of the menu would give a name"
    names = ", ".join(gap.members)
    if len(gap.members) > 1:
        names = f"the right one of {names}"
    return (
        f"next drive: {best.drive}, {best.description} (most right names a "
        f"minute); with it {names} would be named in "
        f"{100.0 * best.named:.0f} % of cases"
    )


def no_advice_line(gap: Gap) -> str:
    """Return why no drive is advised, and how to ask for one."""
    why = "no candidate of the catalogue is left to distinguish"
    if gap.naming is not None and gap.naming.answer == "name":
        names = " and ".join(gap.naming.names)
        why = f"{names} named, nothing left to distinguish"
    return f"no next drive: {why}; ask with --among EFFECT..."


ADVICE: Final[Columns[Advice]] = Columns(
    ("drive", lambda one: one.drive),
    ("min", lambda one: f"{one.duration_s / 60.0:.0f}"),
    ("right name", lambda one: f"{100.0 * one.named:.0f} %"),
    ("a minute", lambda one: f"{100.0 * one.named_per_min:.1f} %"),
    ("wrong name", lambda one: f"{100.0 * one.wrong:.0f} %"),
    ("ln Bayes factor", lambda one: signed(one.log_bayes_factor)),
    ("description", lambda one: one.description),
)
"""The drives of the menu, the best first."""


def signed(log_bayes_factor: float) -> str:
    """Return a logarithm with its sign; adding 0.0 turns -0.0 into 0.0."""
    return f"{round(log_bayes_factor, 1) + 0.0:+.1f}"

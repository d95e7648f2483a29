"""``bstm gap``: what was found in words and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.analysis.gap.holdout_comparison import (
    ADOPTED,
    BASELINES,
    EXTENDED,
    Shrink,
)
from bstm_daemon.model.effects.catalogue import effect_class
from bstm_daemon.report.json_file import picked
from bstm_daemon.report.text import table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.analysis.gap.fitting import Fit
    from bstm_daemon.analysis.gap.heat_only import ForceGap
    from bstm_daemon.analysis.gap.holdout_comparison import Shown
    from bstm_daemon.analysis.gap.naming import Naming
    from bstm_daemon.analysis.gap.residual_heat import Cell, Located
    from bstm_daemon.analysis.gap.workflow import Gap
    from bstm_daemon.config.sections import Config

CELL_HEAD: Final = ("node", "regime", "bin", "missing heat", "in sd")
CANDIDATE_HEAD: Final = (
    "effect",
    "strength",
    "sd",
    "score in sd",
    "ln Bayes factor",
    "probability",
)
ADVICE_HEAD: Final = (
    "drive",
    "min",
    "right name",
    "wrong name",
    "ln Bayes factor",
    "what it is",
)
MODELS: Final = (*BASELINES, EXTENDED, ADOPTED)
ERROR_HEAD: Final = ("drive", "node", *MODELS)
MATCH_FIRST: Final = (
    "the tunables, within their priors, can take up the residual heat: match "
    "the model to these drives (bstm match) and ask again"
)
UNMATCHED: Final = (
    "no [accuracy] in the configuration: what bstm match would mend may be "
    "taken for an effect"
)
SHOWN_PLACES: Final = 4
SHOWN_CANDIDATES: Final = 8


def gap_text(gap: Gap) -> str:
    """Return what was found as lines for a terminal."""
    lines = []
    if gap.located is not None:
        lines += place_lines(gap.located)
    if gap.naming is not None:
        lines += naming_lines(gap.naming)
        lines += table(CANDIDATE_HEAD, candidate_rows(gap.naming))
        lines += unnamed_lines(gap)
        if gap.silent:
            lines.append(f"not excited: {', '.join(gap.silent)}")
    if gap.advice:
        lines += advice_lines(gap)
    if gap.fit is not None:
        for name, strength in gap.fit.strengths.items():
            low, high = gap.fit.interval(name)
            lines.append(
                f"{name}: strength {strength:.2f} +- "
                f"{gap.fit.deviations[name]:.2f} with the error of its form, "
                f"90 % interval {low:.2f} to {high:.2f}"
            )
    if gap.shown is not None:
        lines += shown_lines(gap.shown)
    return headed(f"{', '.join(gap.corners)}: {headline(gap)}", lines)


def headed(head: str, lines: Sequence[str]) -> str:
    """Return *lines*, indented, below *head*."""
    return "\n".join((head, *(f"  {line}" for line in lines)))


def remarks_on(config: Config) -> tuple[str, ...]:
    """Return what in *config* limits the answer."""
    given = config.accuracy.model_fields_set
    of_model = {name for name in given if not name.startswith("thermocouple")}
    return () if of_model else (UNMATCHED,)


def headline(gap: Gap) -> str:
    """Return the answer in one line."""
    if gap.naming is None:
        return "where model and thermocouples disagree"
    text = answer_line(gap.naming, "this data")
    if gap.naming.answer == "unknown":
        text += f", heat at {gap.naming.unknown_place}"
    return text


def answer_line(naming: Naming, what: str) -> str:
    """Return the answer of *naming*, found in *what*, in one line."""
    names = ", ".join(naming.names)
    share = percent(naming.probability)
    return {
        "nothing": f"no missing effect visible (nothing missing: {share})",
        "name": f"missing: {names} (probability {share})",
        "class": f"missing: one of {names}; {what} cannot tell which",
        "unknown": "missing: none of the known effects",
        "undecided": f"something is missing, but not named; possible: {names}",
    }[naming.answer]


def answer_tile(naming: Naming) -> tuple[str, str]:
    """Return the answer for the head of a page: a figure, its meaning."""
    if naming.answer == "nothing":
        return "nothing visible", "missing effect"
    if naming.answer == "unknown":
        return "not in the catalogue", "missing effect"
    names = " or ".join(naming.names).replace("_", " ")
    if naming.answer == "undecided":
        return "not decided", f"missing effect; possible: {names}"
    if naming.answer == "name":
        names = names.replace(" or ", " and ")
    return names, "missing effect"


def probability_tile(naming: Naming) -> tuple[str, str]:
    """Return how probable the answer is, for the head of a page."""
    of = " that nothing is missing" * (naming.answer == "nothing")
    return percent(naming.probability), f"probability{of}"


def strength_tiles(found: Fit | ForceGap) -> list[tuple[str, str]]:
    """Return the strengths that were *found* for the head of a page."""
    return [
        (
            f"{strength:.2f} ± {found.deviations[name]:.2f}",
            f"strength of {name.replace('_', ' ')}, 1 = typical",
        )
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
            f"{name}: {effect_class(name).description}"
            for name in naming.names
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
            one.name,
            f"{one.strength:.2f}",
            f"{one.deviation:.2f}",
            f"{one.z:.1f}",
            signed_zero_free(one.log_evidence),
            percent(naming.odds[one.name]),
        )
        for one in naming.candidates[:SHOWN_CANDIDATES]
    ]


def signed_zero_free(value: float) -> str:
    """Return *value* with one decimal, never as -0.0."""
    return f"{round(value, 1) + 0.0:.1f}"


def unnamed_lines(gap: Gap) -> list[str]:
    """Return what to make of a search that found nothing."""
    if gap.naming is None or gap.naming.found:
        return []
    lines = reach_lines(gap.naming)
    if gap.located is not None and gap.located.places:
        lines.insert(0, MATCH_FIRST)
    return lines


def reach_lines(naming: Naming) -> list[str]:
    """Return from which strength each effect would have been detected.

    Effects that would have to be stronger than they can be come last.
    """
    ordered = sorted(naming.candidates, key=lambda one: one.reach)
    near = [one for one in ordered if one.reach <= _strongest(one.name)]
    far = [one.name for one in ordered if one.reach > _strongest(one.name)]
    shown = ", ".join(f"{one.name} {one.reach:.2f}" for one in near)
    lines = [f"could have been shown, from the strength of: {shown or 'none'}"]
    if far:
        lines.append(
            f"too weak in these drives at any strength: {', '.join(far)}"
        )
    return lines


def _strongest(name: str) -> float:
    return effect_class(name).parameters()[0].upper


def cell_rows(cells: Sequence[Cell]) -> list[tuple[str, ...]]:
    """Return a row for each cell, the plainest first."""
    return [
        (
            one.node,
            one.regime,
            one.bin,
            f"{1e-3 * one.energy_j:+.1f} kJ",
            f"{one.z:+.1f}",
        )
        for one in sorted(cells, key=lambda one: -abs(one.z))
    ]


def shown_lines(shown: Shown) -> list[str]:
    """Return the shrink factors and how far the tunables moved."""
    where = "held-out drives" if shown.held_out else "the fitted drives"
    lines = []
    for name in BASELINES:
        one = shown.shrinks[name]
        text = f"gap on {where}, against {name}: {times(one)}"
        if name in shown.fluid_shrinks:
            text += f", fluid {shown.fluid_shrinks[name].factor:.1f}"
        lines.append(text)
    one = shown.adopted
    text = f"as adopted, the tunables as configured: {times(one)}"
    if one.factor < 1.0:
        text += "; match them anew (bstm match)"
    lines.append(text)
    moved = ", ".join(
        f"{name} {bend:.2f}" for name, bend in shown.bends.items() if bend
    )
    lines.append(f"tunables moved, in deviations of their priors: {moved}")
    return lines


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
    said = []
    for gap in gaps:
        names = ", ".join(effect.name for effect in gap.effects())
        if names and gap.naming is not None and gap.naming.answer == "class":
            alike = ", ".join(gap.naming.names)
            names += f" (one of {alike}; these drives cannot tell which)"
        if names:
            said.append(names)
    return ", ".join(said)


def error_rows(shown: Shown) -> list[tuple[str, ...]]:
    """Return the RMS error of each node over each drive, by model."""
    return [
        (
            one.drive,
            one.node,
            *(f"{one.rms_k[name]:.1f} K" for name in MODELS),
        )
        for one in shown.errors
    ]


def advice_lines(gap: Gap) -> list[str]:
    """Return which drive would distinguish the members, as lines."""
    return [advice_headline(gap), *table(ADVICE_HEAD, advice_rows(gap))]


def advice_headline(gap: Gap) -> str:
    """Return the advice in one line."""
    best = gap.advice[0]
    if best.named < 0.01:
        return "next drive: none of the menu would give a name"
    names = ", ".join(gap.members)
    if len(gap.members) > 1:
        names = f"the right one of {names}"
    return (
        f"next drive: {best.drive}, {best.description}; with it {names} "
        f"would be named in {100.0 * best.named:.0f} % of cases"
    )


def no_advice_line(gap: Gap) -> str:
    """Return why no drive is advised, and how to ask for one."""
    naming = gap.naming
    if naming is not None and naming.answer == "name":
        why = (
            f"{' and '.join(naming.names)} named, nothing left to distinguish"
        )
    else:
        why = "no candidate of the catalogue is left to distinguish"
    return f"no next drive: {why}; ask with --among EFFECT..."


def advice_rows(gap: Gap) -> list[tuple[str, ...]]:
    """Return a row for each drive of the menu, the best first."""
    return [
        (
            one.drive,
            f"{one.duration_s / 60.0:.0f}",
            f"{100.0 * one.named:.0f} %",
            f"{100.0 * one.wrong:.0f} %",
            f"{one.log_bayes_factor:+.1f}",
            one.description,
        )
        for one in gap.advice
    ]


def gap_json(gap: Gap) -> dict[str, Any]:
    """Return everything that was found as plain data."""
    found = picked(gap, "corners", "recordings", "points")
    found["headline"] = headline(gap)
    if gap.located is not None:
        found["places"] = [
            picked(one, "node", "regime", "energy_j", standard_deviations="z")
            | {"other": one.other or None}
            for one in gap.located.places
        ]
        for name in ("cells", "by_speed", "by_pressure", "by_time"):
            found[name] = getattr(gap.located, name)
    if gap.naming is not None:
        found["naming"] = naming_json(gap.naming)
        found["not_excited"] = gap.silent
    if gap.advice:
        found["advice"] = advice_json(gap)
    if gap.fit is not None:
        found["strengths"] = gap.fit.strengths
        found["strength_deviations"] = gap.fit.deviations
        found["strength_noise_deviations"] = gap.fit.noise_deviations
        found["strength_intervals"] = {
            name: gap.fit.interval(name) for name in gap.fit.strengths
        }
    if gap.shown is not None:
        found["shown"] = _shown_json(gap.shown)
    return found


def naming_json(naming: Naming) -> dict[str, Any]:
    """Return the answer as plain data."""
    return picked(
        naming,
        *("answer", "names", "probability", "reason", "explained"),
        *("unknown_place", "best_placebo_z", "cross_validated"),
        unknown_log_bayes_factor="unknown_evidence",
    ) | {
        "candidates": [
            picked(
                one,
                *("name", "strength", "deviation", "z"),
                log_bayes_factor="log_evidence",
                detectable_strength="reach",
            )
            | {"probability": naming.odds[one.name]}
            for one in naming.candidates
        ],
    }


def _shown_json(shown: Shown) -> dict[str, Any]:
    def factors(shrinks: Mapping[str, Shrink]) -> dict[str, list[float]]:
        return {
            name: [one.factor, one.lower, one.upper]
            for name, one in shrinks.items()
        }

    return picked(shown, "held_out", "bends") | {
        "errors": [
            picked(
                one,
                *("drive", "node", "rms_k", "peak_error_k", "peak_late_s"),
            )
            for one in shown.errors
        ],
        "shrink": factors(shown.shrinks),
        "fluid_shrink": factors(shown.fluid_shrinks),
        **factors({"adopted": shown.adopted}),
        "moved": {
            name: dict(zip(shown.keys, moved, strict=True))
            for name, moved in shown.moved.items()
        },
    }


def advice_json(gap: Gap) -> dict[str, Any]:
    """Return the advice as plain data."""
    return {
        "members": gap.members,
        "log_bayes_factor_now": gap.advice[0].now,
        "drives": [
            picked(
                one,
                *("drive", "description", "duration_s", "log_bayes_factor"),
                named_right="named",
                named_wrong="wrong",
            )
            for one in gap.advice
        ],
    }

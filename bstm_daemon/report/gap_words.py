"""``bstm gap`` in words: for the terminal, the page, and JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.effects.catalogue import effect_class
from bstm_daemon.gap.showing import ADOPTED, BASELINES, EXTENDED, Shrink
from bstm_daemon.report.advice_words import advice_json, advice_lines
from bstm_daemon.report.verify_words import table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.config import Config
    from bstm_daemon.gap.heat_only import ForceGap
    from bstm_daemon.gap.locating import Cell, Located
    from bstm_daemon.gap.naming import Naming
    from bstm_daemon.gap.showing import Shown
    from bstm_daemon.gap.workflow import Gap

CELL_HEAD: Final = ("node", "regime", "bin", "missing heat", "in sd")
CANDIDATE_HEAD: Final = (
    "effect",
    "strength",
    "sd",
    "score in sd",
    "ln Bayes factor",
    "probability",
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
    lines = [f"{', '.join(gap.corners)}: {headline(gap)}"]
    if gap.located is not None:
        lines += [f"  {line}" for line in place_lines(gap.located)]
    if gap.naming is not None:
        lines += [f"  {line}" for line in naming_lines(gap.naming)]
        rows = candidate_rows(gap.naming)
        lines += [f"  {line}" for line in table(CANDIDATE_HEAD, rows)]
        lines += [f"  {line}" for line in unnamed_lines(gap)]
        if gap.silent:
            lines.append(f"  not excited: {', '.join(gap.silent)}")
    if gap.advice:
        lines += [f"  {line}" for line in advice_lines(gap)]
    if gap.fit is not None:
        for name, strength in gap.fit.strengths.items():
            low, high = gap.fit.interval(name)
            lines.append(
                f"  {name}: strength {strength:.2f} +- "
                f"{gap.fit.deviations[name]:.2f} with the error of its form, "
                f"90 % interval {low:.2f} to {high:.2f}"
            )
    if gap.shown is not None:
        lines += [f"  {line}" for line in shown_lines(gap.shown)]
    return "\n".join(lines)


def remarks_on(config: Config) -> tuple[str, ...]:
    """Return what a reader has to know of *config* beside the answer."""
    told = config.accuracy.model_fields_set
    of_model = {name for name in told if not name.startswith("thermocouple")}
    return () if of_model else (UNMATCHED,)


def headline(gap: Gap) -> str:
    """Return the answer in one line."""
    naming = gap.naming
    if naming is None:
        return "where model and thermocouples disagree"
    share = percent(naming.probability)
    names = ", ".join(naming.names)
    if naming.answer == "nothing":
        return f"no missing effect visible (nothing missing: {share})"
    if naming.answer == "name":
        return f"missing: {names} (probability {share})"
    if naming.answer == "class":
        return f"missing: one of {names}; this data cannot tell which"
    if naming.answer == "unknown":
        return (
            "missing: none of the known effects, heat at "
            f"{naming.unknown_place}"
        )
    return f"something is missing, but not named; possible: {names}"


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


def strength_tile(
    name: str, strength: float, deviation: float
) -> tuple[str, str]:
    """Return a strength for the head of a page."""
    meaning = f"strength of {name.replace('_', ' ')}, 1 = typical"
    return f"{strength:.2f} ± {deviation:.2f}", meaning


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

    What would have to be stronger than an effect can be is told apart.
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


def gap_json(gap: Gap) -> dict[str, Any]:
    """Return everything that was found, for a file."""
    found: dict[str, Any] = {
        "corners": list(gap.corners),
        "recordings": list(gap.recordings),
        "points": gap.points,
        "headline": headline(gap),
    }
    if gap.located is not None:
        found["places"] = [
            {
                "node": one.node,
                "other": one.other or None,
                "regime": one.regime,
                "energy_j": one.energy_j,
                "standard_deviations": one.z,
            }
            for one in gap.located.places
        ]
        for name in ("cells", "by_speed", "by_pressure", "by_time"):
            found[name] = [
                {
                    "node": one.node,
                    "regime": one.regime,
                    "bin": one.bin,
                    "energy_j": one.energy_j,
                    "deviation_j": one.deviation_j,
                    "windows": one.windows,
                }
                for one in getattr(gap.located, name)
            ]
    if gap.naming is not None:
        found["naming"] = naming_json(gap.naming)
        found["not_excited"] = list(gap.silent)
    if gap.advice:
        found["advice"] = advice_json(gap)
    if gap.fit is not None:
        found["strengths"] = gap.fit.strengths
        found["strength_deviations"] = gap.fit.deviations
        found["strength_noise_deviations"] = gap.fit.noise_deviations
        found["strength_intervals"] = {
            name: list(gap.fit.interval(name)) for name in gap.fit.strengths
        }
    if gap.shown is not None:
        found["shown"] = _shown_json(gap.shown)
    return found


def naming_json(naming: Naming) -> dict[str, Any]:
    """Return the answer for a file."""
    return {
        "answer": naming.answer,
        "names": list(naming.names),
        "probability": naming.probability,
        "reason": naming.reason,
        "explained": _number(naming.explained),
        "unknown_log_bayes_factor": naming.unknown_evidence,
        "unknown_place": naming.unknown_place,
        "best_placebo_z": _number(naming.best_placebo_z),
        "cross_validated": naming.cross_validated,
        "candidates": [
            {
                "name": one.name,
                "strength": one.strength,
                "deviation": one.deviation,
                "z": one.z,
                "log_bayes_factor": one.log_evidence,
                "probability": naming.odds[one.name],
                "detectable_strength": one.reach,
            }
            for one in naming.candidates
        ],
    }


def _shown_json(shown: Shown) -> dict[str, Any]:
    return {
        "held_out": shown.held_out,
        "shrink": {
            name: [one.factor, one.lower, one.upper]
            for name, one in shown.shrinks.items()
        },
        "fluid_shrink": {
            name: [one.factor, one.lower, one.upper]
            for name, one in shown.fluid_shrinks.items()
        },
        "adopted": [
            shown.adopted.factor,
            shown.adopted.lower,
            shown.adopted.upper,
        ],
        "bends": dict(shown.bends),
        "moved": {
            name: dict(zip(shown.keys, moved.tolist(), strict=True))
            for name, moved in shown.moved.items()
        },
        "errors": [
            {
                "drive": one.drive,
                "node": one.node,
                "rms_k": dict(one.rms_k),
                "peak_error_k": dict(one.peak_error_k),
                "peak_late_s": dict(one.peak_late_s),
            }
            for one in shown.errors
        ],
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None

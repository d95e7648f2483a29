"""``bstm gap`` without a thermocouple: what forces show, in every form."""

from typing import Any

import numpy as np

from bstm_daemon.analysis.gap.forces import Forces
from bstm_daemon.analysis.gap.heat_only import ForceGap
from bstm_daemon.report import gap as words
from bstm_daemon.report import plots
from bstm_daemon.report.gap_page import candidate_sections, naming_json
from bstm_daemon.report.shell import Page, Section
from bstm_daemon.report.text import table


def force_sentence(gap: ForceGap) -> str:
    """Return what the forces show for a person."""
    ratio = gap.pressed_j / gap.motion_j if gap.motion_j else np.nan
    work = f"pressure shows {ratio:.2f} of the braking work by motion"
    parts = [work, words.cause(gap.naming)]
    if gap.adopted:
        where = "held-out drives" if gap.held_out else "the same drives"
        parts.append(
            f"with it the error of the acceleration on {where} goes from "
            f"{acceleration(gap.before_ms2)} to {acceleration(gap.after_ms2)}"
        )
    return words.as_sentence(parts)


def force_text(gap: ForceGap) -> str:
    """Return what was found as lines for a terminal."""
    answer = words.answer_line(gap.naming, "forces")
    return "\n  ".join(
        [
            f"forces of the whole car: {answer}",
            *force_lines(gap),
            *table(words.CANDIDATE_HEAD, words.candidate_rows(gap.naming)),
            *sight_lines(gap),
        ]
    )


def force_lines(gap: ForceGap) -> list[str]:
    """Return the answer of the forces, and errors before and after."""
    pressed_kj, motion_kj = 1e-3 * gap.pressed_j, 1e-3 * gap.motion_j
    sources = "pressure (Feed-Forward) against motion (Feed-Back)"
    work = f"{pressed_kj:.0f} kJ by pressure, {motion_kj:.0f} kJ by motion"
    lines = [
        f"no thermocouple: {sources}, {gap.windows} windows",
        f"braking work: {work}",
        *words.naming_lines(gap.naming),
    ]
    for name in gap.adopted:
        strength, deviation = gap.strengths[name], gap.deviations[name]
        lines.append(f"{name}: strength {strength:.2f} +- {deviation:.2f}")
    if gap.adopted:
        kind = "held-out drives" if gap.held_out else "the same drives"
        lines.append(
            f"error of the car's acceleration on {kind}, without noise: "
            f"{acceleration(gap.before_ms2)} before, "
            f"{acceleration(gap.after_ms2)} after"
        )
    return lines


def acceleration(error_ms2: float) -> str:
    """Return an error that is left; the search gives 0 within the noise."""
    return f"{error_ms2:.3f} m/s2" if error_ms2 > 0.0 else "none"


def sight_lines(gap: ForceGap) -> list[str]:
    """Return which effects these forces can show, and which not."""
    seen = ", ".join(f"{name} {reach:.2f}" for name, reach in gap.seen.items())
    by_reason: dict[str, list[str]] = {}
    for name, why in gap.unseen.items():
        by_reason.setdefault(why.partition(":")[0], []).append(name)
    return [
        f"detectable, from a strength of: {seen or 'none'}",
        *(
            f"not detectable ({why}): {', '.join(names)}"
            for why, names in by_reason.items()
        ),
    ]


def force_json(gap: ForceGap) -> dict[str, Any]:
    """Return everything that was found, for a file."""
    return {
        "corners": [],
        "path": "forces",
        "recordings": gap.recordings,
        "windows": gap.windows,
        "headline": words.answer_line(gap.naming, "forces"),
        "naming": naming_json(gap.naming),
        "strengths": gap.strengths,
        "strength_deviations": gap.deviations,
        "can_be_seen_from": gap.seen,
        "can_not_be_seen": gap.unseen,
        "shown": {
            "held_out": gap.held_out,
            "drives": gap.shown_on,
            "acceleration_error_ms2": [gap.before_ms2, gap.after_ms2],
        },
        "braking_work_j": {"pressure": gap.pressed_j, "motion": gap.motion_j},
    }


def force_page(gap: ForceGap, subtitle: str) -> Page:
    """Return the page of what the forces show."""
    naming = gap.naming
    sections = [
        *(_force_section(one) for one in gap.curves),
        *candidate_sections(
            words.answer_line(naming, "forces"), naming, force_lines(gap)
        ),
        Section("visible in forces", lines=sight_lines(gap), folded=True),
    ]
    moved_mj = 1e-6 * gap.motion_j
    tiles = (
        words.answer_tile(naming),
        words.probability_tile(naming),
        *(words.strength_tiles(gap) if gap.adopted else ()),
        (
            f"{1e-6 * gap.pressed_j:.1f} MJ",
            f"braking work by pressure; {moved_mj:.1f} MJ by motion",
        ),
    )
    lead = force_sentence(gap)
    return Page("Gap", sections, tiles, lead, subtitle=subtitle)


def _force_section(one: Forces) -> Section:
    """Return both forces over time, and their difference over the force."""
    span = (0.0, max(float(one.time_s[-1]), 1.0))
    motion_kn, pressed_kn = 1e-3 * one.motion_n, 1e-3 * one.whole_n
    over_time = [
        plots.curve(one.time_s, motion_kn, "by motion", plots.BLUE),
        plots.curve(one.time_s, pressed_kn, "by pressure", plots.VERMILION),
    ]
    difference = [
        plots.cloud(motion_kn, pressed_kn - motion_kn, "", plots.VERMILION)
    ]
    return Section(
        f"brake force of the car on {one.drive}",
        plots=(
            (
                "over time",
                plots.time_plot(over_time, "force [kN]", span, height=340),
            ),
            (
                "how much more by pressure than by motion",
                plots.plot(
                    difference,
                    "force by motion [kN]",
                    "difference [kN]",
                    height=340,
                    yaxis={"zerolinecolor": plots.GREY},
                ),
            ),
        ),
        note="A point is a window of 1 s or more. With nothing missing the "
        "difference is zero at every force.",
    )

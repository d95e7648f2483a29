"""``bstm gap`` without a thermocouple: what forces show, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.report.gap import (
    CANDIDATE_HEAD,
    answer_line,
    as_sentence,
    candidate_rows,
    cause,
    naming_lines,
)
from bstm_daemon.report.text import table

if TYPE_CHECKING:
    from bstm_daemon.analysis.gap.heat_only import ForceGap


def force_sentence(gap: ForceGap) -> str:
    """Return what the forces show for a person."""
    ratio = gap.pressed_j / gap.motion_j if gap.motion_j else np.nan
    work = f"pressure shows {ratio:.2f} of the braking work by motion"
    parts = [work, cause(gap.naming)]
    if gap.strengths:
        where = "held-out drives" if gap.held_out else "the same drives"
        parts.append(
            f"with it the error of the acceleration on {where} goes from "
            f"{acceleration(gap.before_ms2)} to {acceleration(gap.after_ms2)}"
        )
    return as_sentence(parts)


def force_text(gap: ForceGap) -> str:
    """Return what was found as lines for a terminal."""
    return "\n  ".join(
        [
            f"forces of the whole car: {answer_line(gap.naming, 'forces')}",
            *force_lines(gap),
            *table(CANDIDATE_HEAD, candidate_rows(gap.naming)),
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
        *naming_lines(gap.naming),
    ]
    for name, strength in gap.strengths.items():
        lines.append(
            f"{name}: strength {strength:.2f} +- {gap.deviations[name]:.2f}"
        )
    if gap.strengths:
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

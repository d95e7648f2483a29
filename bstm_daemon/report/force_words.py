"""The gap by forces alone, in words, for the page and JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bstm_daemon.report.gap_words import (
    CANDIDATE_HEAD,
    candidate_rows,
    naming_json,
    naming_lines,
    percent,
)
from bstm_daemon.report.verify_words import table

if TYPE_CHECKING:
    from bstm_daemon.gap.heat_only import ForceGap


def force_text(gap: ForceGap) -> str:
    """Return what was found as lines for a terminal."""
    lines = [f"forces of the whole car: {force_headline(gap)}"]
    lines += [f"  {line}" for line in force_lines(gap)]
    rows = candidate_rows(gap.naming)
    lines += [f"  {line}" for line in table(CANDIDATE_HEAD, rows)]
    lines += [f"  {line}" for line in sight_lines(gap)]
    return "\n".join(lines)


def force_headline(gap: ForceGap) -> str:
    """Return the answer in one line."""
    naming = gap.naming
    names = ", ".join(naming.names)
    share = percent(naming.probability)
    if naming.answer == "nothing":
        return f"no missing effect visible (nothing missing: {share})"
    if naming.answer == "name":
        return f"missing: {names} (probability {share})"
    if naming.answer == "class":
        return f"missing: one of {names}; forces cannot tell which"
    if naming.answer == "unknown":
        return "missing: none of the known effects"
    return f"something is missing, but not named; possible: {names}"


def force_lines(gap: ForceGap) -> list[str]:
    """Return what the forces say, before and after."""
    lines = [
        (
            "no thermocouple: pressure (Feed-Forward) against motion "
            f"(Feed-Back), {gap.windows} windows"
        ),
        (
            f"braking work: {1e-3 * gap.pressed_j:.0f} kJ by pressure, "
            f"{1e-3 * gap.motion_j:.0f} kJ by motion"
        ),
    ]
    lines += naming_lines(gap.naming)
    for name, strength in gap.strengths.items():
        lines.append(
            f"{name}: strength {strength:.2f} +- {gap.deviations[name]:.2f}"
        )
    if gap.strengths:
        kind = "held-out drives" if gap.held_out else "the same drives"
        lines.append(
            f"error of the car's acceleration on {kind}, noise taken off: "
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
        f"can be seen, from the strength of: {seen or 'none'}",
        *(
            f"can not be seen ({why}): {', '.join(names)}"
            for why, names in by_reason.items()
        ),
    ]


def force_json(gap: ForceGap) -> dict[str, Any]:
    """Return everything that was found, for a file."""
    return {
        "corners": [],
        "path": "forces",
        "recordings": list(gap.recordings),
        "windows": gap.windows,
        "headline": force_headline(gap),
        "naming": naming_json(gap.naming),
        "strengths": gap.strengths,
        "strength_deviations": gap.deviations,
        "can_be_seen_from": gap.seen,
        "can_not_be_seen": gap.unseen,
        "shown": {
            "held_out": gap.held_out,
            "drives": list(gap.shown_on),
            "acceleration_error_ms2": [gap.before_ms2, gap.after_ms2],
        },
        "braking_work_j": {"pressure": gap.pressed_j, "motion": gap.motion_j},
    }

"""``bstm gap`` without a thermocouple: in words, as page and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bstm_daemon.report.gap import (
    CANDIDATE_HEAD,
    answer_line,
    answer_tile,
    candidate_rows,
    headed,
    naming_json,
    naming_lines,
    probability_tile,
    strength_tiles,
)
from bstm_daemon.report.gap_page import naming_section
from bstm_daemon.report.plots import (
    BLUE,
    GREY,
    VERMILION,
    cloud,
    curve,
    plot,
    time_plot,
)
from bstm_daemon.report.shell import Page, Section
from bstm_daemon.report.text import table

if TYPE_CHECKING:
    from bstm_daemon.analysis.gap.force_balance import Forces
    from bstm_daemon.analysis.gap.heat_only import ForceGap


def force_text(gap: ForceGap) -> str:
    """Return what was found as lines for a terminal."""
    return headed(
        f"forces of the whole car: {answer_line(gap.naming, 'forces')}",
        [
            *force_lines(gap),
            *table(CANDIDATE_HEAD, candidate_rows(gap.naming)),
            *sight_lines(gap),
        ],
    )


def force_lines(gap: ForceGap) -> list[str]:
    """Return the answer of the forces, and errors before and after."""
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
        "recordings": gap.recordings,
        "windows": gap.windows,
        "headline": answer_line(gap.naming, "forces"),
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
        naming_section(answer_line(naming, "forces"), naming, force_lines(gap))
    ]
    sections += [_drive_section(one) for one in gap.curves]
    sections.append(Section("what forces can show", lines=sight_lines(gap)))
    moved_mj = 1e-6 * gap.motion_j
    tiles = (
        answer_tile(naming),
        probability_tile(naming),
        *strength_tiles(gap),
        (
            f"{1e-6 * gap.pressed_j:.1f} MJ",
            f"braking work by pressure; {moved_mj:.1f} MJ by motion",
        ),
    )
    return Page("Gap", sections, tiles, subtitle=subtitle)


def _drive_section(one: Forces) -> Section:
    """Return both forces over time, and their difference over the force."""
    span = (0.0, max(float(one.time_s[-1]), 1.0))
    motion_kn, pressed_kn = 1e-3 * one.motion_n, 1e-3 * one.whole_n
    over_time = [
        curve(one.time_s, motion_kn, "by motion", BLUE),
        curve(one.time_s, pressed_kn, "by pressure", VERMILION),
    ]
    apart = [cloud(motion_kn, pressed_kn - motion_kn, "", VERMILION)]
    return Section(
        f"brake force of the car on {one.drive}",
        plots=(
            (
                "over time",
                time_plot(over_time, "force [kN]", span, height=340),
            ),
            (
                "how much more by pressure than by motion",
                plot(
                    apart,
                    "force by motion [kN]",
                    "difference [kN]",
                    height=340,
                    yaxis={"zerolinecolor": GREY},
                ),
            ),
        ),
        note="A point is a window of 1 s or more. With nothing missing the "
        "difference is nothing at every force.",
    )

"""What the search for a gap found, as plain data for a JSON file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bstm_daemon.report.gap import answer_line, headline
from bstm_daemon.report.json_file import picked

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.analysis.gap.heat_only import ForceGap
    from bstm_daemon.analysis.gap.holdout_comparison import Shown, Shrink
    from bstm_daemon.analysis.gap.naming import Naming
    from bstm_daemon.analysis.gap.workflow import Gap


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
        ]
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
                one, *("drive", "node", "rms_k", "peak_error_k", "peak_late_s")
            )
            for one in shown.errors
        ],
        "shrink": factors(shown.shrinks),
        "fluid_shrink": factors(shown.fluid_shrinks),
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

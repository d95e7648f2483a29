"""The figures of a check of a log in the units and words that people read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.units import UNITS

if TYPE_CHECKING:
    from bstm_daemon.quality.finding import (
        Comparison,
        ModeVerdict,
        Quality,
        RoleQuality,
    )

MODE_NAMES: Final = {
    "ff": "ff, Feed-Forward from pressure",
    "fb": "fb, Feed-Back from motion",
    "fused": "fused, both (when the estimator has it)",
    "measured": "measured disc temperature",
}


@dataclass(frozen=True, slots=True)
class FitWords:
    """A fit's figures as text, in the units of its comparison."""

    scale: str
    offset: str
    lag: str
    correlation: str
    residual: str
    samples: str


def fit_words(comparison: Comparison) -> FitWords | None:
    """Return the figures of *comparison*, None where it has no fit."""
    fit = comparison.fit
    if fit is None:
        return None
    reference_unit, reference_si = comparison.reference_scale
    scale = fit.scale * reference_si / comparison.unit_si
    text = f"{scale:.4g}"
    if reference_unit != comparison.unit:
        text += f" {comparison.unit} a {reference_unit}"
    return FitWords(
        text,
        f"{fit.offset / comparison.unit_si:+.3g} {comparison.unit}",
        "-" if fit.lag_s is None else f"{round(fit.lag_s, 2) + 0.0:+.2f} s",
        f"{fit.correlation:.4f}",
        f"{fit.residual_rms / comparison.unit_si:.3g} {comparison.unit}",
        f"{fit.samples}",
    )


def role_value(role: RoleQuality, value: float) -> float:
    """Return *value* (SI) in the configured unit of *role*."""
    unit = UNITS[role.unit]
    if unit.quantity == "angular_speed" and role.role.startswith("wheel"):
        return value  # wheel speeds are m/s inside, whatever they came in
    return (value - unit.offset) / unit.factor


def role_unit(role: RoleQuality) -> str:
    """Return the unit that :func:`role_value` gives."""
    angular = UNITS[role.unit].quantity == "angular_speed"
    return "m/s" if angular and role.role.startswith("wheel") else role.unit


def headline(quality: Quality) -> str:
    """Return the verdict on the configured heat mode as one line."""
    mode = quality.configured_mode
    wrong = sum(1 for finding in quality.findings if finding.wrong)
    text = (
        f'usable for heat mode "{mode}"'
        if quality.usable
        else f'NOT usable for heat mode "{mode}"'
    )
    if wrong:
        text += f", {wrong} fault{'s' * (wrong != 1)} named"
    return text


def mode_words(mode: ModeVerdict) -> str:
    """Return what a heat mode lacks, or that it lacks nothing."""
    parts = []
    if mode.missing:
        parts.append("missing: " + "; ".join(mode.missing))
    parts += mode.problems
    parts += [f"note: {remark}" for remark in mode.remarks]
    return "; ".join(parts) or "nothing is missing"


def quality_json(quality: Quality) -> dict[str, Any]:
    """Return *quality* as plain data; values in SI, names as in the code."""
    return {
        "duration_s": quality.duration_s,
        "usable": quality.usable,
        "configured_mode": quality.configured_mode,
        "findings": [
            {
                "fault": finding.fault,
                "roles": list(finding.roles),
                "wrong": finding.wrong,
                "text": finding.text,
            }
            for finding in quality.findings
        ],
        "modes": [
            {
                "mode": mode.mode,
                "usable": mode.usable,
                "problems": list(mode.problems),
                "missing": list(mode.missing),
                "remarks": list(mode.remarks),
            }
            for mode in quality.modes
        ],
        "comparisons": [_comparison(one) for one in quality.comparisons],
        "not_judged": list(quality.not_judged),
        "roles": [_role(role) for role in quality.roles],
        "refused": dict(quality.refused),
    }


def _comparison(comparison: Comparison) -> dict[str, Any]:
    fit = comparison.fit
    return {
        "title": comparison.title,
        "reference": comparison.reference_name,
        "channel": comparison.channel_name,
        "verdict": comparison.verdict,
        "agrees": comparison.agrees,
        "fit": None
        if fit is None
        else {
            "scale": fit.scale,
            "scale_low": fit.scale_low,
            "scale_high": fit.scale_high,
            "offset": fit.offset,
            "lag_s": fit.lag_s,
            "correlation": fit.correlation,
            "residual_rms": fit.residual_rms,
            "samples": fit.samples,
            "outliers": fit.outliers,
        },
    }


def _role(role: RoleQuality) -> dict[str, Any]:
    data: dict[str, Any] = {
        "role": role.role,
        "source": role.source,
        "unit": role.unit,
        "timeout_s": role.timeout_s,
        "found": role.statistics is not None,
    }
    known = role.statistics
    if known is None:
        data["why_missing"] = role.why_missing
        return data
    return data | {
        "samples": known.samples,
        "rate_hz": known.rate_hz,
        "minimum": known.minimum,
        "maximum": known.maximum,
        "median": known.median,
        "longest_gap_s": known.longest_gap_s,
        "gaps_over_timeout": known.gaps_over_timeout,
        "missing_share": known.missing_share,
        "constant_share": known.constant_share,
        "longest_constant_s": known.longest_run.length_s,
        "distinct": known.distinct,
        "step": known.step,
        "backwards": known.backwards,
    }

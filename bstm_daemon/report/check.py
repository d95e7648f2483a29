"""``bstm check --log``: the judgement as text, page and JSON."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from bstm_daemon.analysis.quality.channels import shifted
from bstm_daemon.analysis.quality.finding import (
    Comparison,
    ModeVerdict,
    Quality,
    RoleQuality,
)
from bstm_daemon.analysis.quality.limits import GRID_S
from bstm_daemon.analysis.quality.recording import ChannelStatistics
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.report import plots
from bstm_daemon.report.json_file import own_fields, picked
from bstm_daemon.report.shell import Cell, Page, Section, Table
from bstm_daemon.report.text import columns, percent, wrapped
from bstm_daemon.report.timescale import duration
from bstm_daemon.units import UNITS

MODE_NAMES: Final = {
    "ff": "ff, Feed-Forward from pressure",
    "fb": "fb, Feed-Back from motion",
    "fused": "fused, both",
    "measured": "measured disc temperature",
}

_ROLE_HEAD: Final = (
    *("rate", "min", "max", "unit"),
    *("longest gap", "gaps", "one value"),
)

PAIRS_NOTE: Final = (
    "First both readings over time, then one over the other with the fitted "
    "line, without the lag. Scale, offset and rms residual are those of the "
    "channel against the reference; a positive lag means that the channel is "
    "late."
)


def fit_text(comparison: Comparison) -> dict[str, str]:
    """Return the figures of *comparison* by name, none where it has no fit."""
    fit = comparison.fit
    if fit is None:
        return {}
    unit = comparison.unit
    reference_unit, reference_si = comparison.reference_scale
    scale = f"{fit.scale * reference_si / comparison.unit_si:.4g}"
    if reference_unit != unit:
        scale += f" {unit} a {reference_unit}"
    elif fit.leans:
        scale += f" (median ratio {fit.ratio:.4g})"
    return {
        "scale": scale,
        "offset": f"{fit.offset / comparison.unit_si:+.3g} {unit}",
        "lag": "-"
        if fit.lag_s is None
        else f"{round(fit.lag_s, 2) + 0.0:+.2f} s",
        "r": f"{fit.correlation:.4f}",
        "rms": f"{fit.residual_rms / comparison.unit_si:.3g} {unit}",
        "samples": f"{fit.samples}",
    }


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
    text = f'{"" if quality.usable else "NOT "}usable for heat mode "{mode}"'
    return text + f", {wrong} fault{'s' * (wrong != 1)} named" * bool(wrong)


def mode_text(mode: ModeVerdict) -> str:
    """Return what a heat mode lacks, or that it lacks nothing."""
    parts = []
    if mode.missing:
        parts.append("missing: " + "; ".join(mode.missing))
    parts += mode.problems
    parts += [f"note: {remark}" for remark in mode.remarks]
    return "; ".join(parts) or "nothing is missing"


def _role_cells(
    role: RoleQuality, known: ChannelStatistics
) -> tuple[str, ...]:
    """Return the figures of a role that is in the log, as _ROLE_HEAD."""
    return (
        f"{known.rate_hz:.3g} Hz",
        f"{role_value(role, known.minimum):.4g}",
        f"{role_value(role, known.maximum):.4g}",
        role_unit(role),
        f"{known.longest_gap_s:.2f} s",
        str(known.gaps_over_timeout),
        percent(known.constant_share),
    )


def _findings(quality: Quality, *, wrong: bool) -> list[str]:
    """Return the findings that are faults, or those that are not."""
    return [
        f"{', '.join(one.roles)}: {one.text}" if one.roles else one.text
        for one in quality.findings
        if one.fault != "missing" and one.wrong is wrong
    ]


# ------------------------------------------------------------------- text


def quality_text(quality: Quality) -> str:
    """Return *quality* as lines of text: roles, pairs, faults, heat modes."""
    rows = [
        (role.role, *_role_cells(role, known))
        for role in quality.roles
        if (known := role.statistics) is not None
    ]
    absent = [
        f"{role.role}: {role.why_missing}"
        for role in quality.roles
        if role.statistics is None
    ]
    modes = [
        f"{mode.mode}: {'yes' if mode.usable else 'no'}, {mode_text(mode)}"
        for mode in quality.modes
    ]
    blocks = [
        duration(quality.duration_s),
        "\n".join(columns([("role", *_ROLE_HEAD), *rows])),
        _pair_lines(quality.comparisons),
    ]
    for heading, lines in (
        ("not in the log", absent),
        ("not judged in this log", list(quality.not_judged)),
        ("to know", _findings(quality, wrong=False)),
        ("FAULTS", _findings(quality, wrong=True)),
        ("heat modes", modes),
    ):
        if lines:
            blocks.append("\n".join([heading, *wrapped(lines, "  ", "    ")]))
    blocks.append(headline(quality))
    return "\n\n".join(block for block in blocks if block)


def _pair_lines(comparisons: Sequence[Comparison]) -> str:
    """Return the comparisons, each with its figures under its verdict."""
    lines: list[str] = []
    for comparison in comparisons:
        mark = {True: "ok ", False: "BAD", None: " - "}[comparison.agrees]
        verdict = f"{comparison.title}: {comparison.verdict}"
        lines += wrapped([verdict], mark=f"{mark} ", indent="    ")
        figures = [f"{k} {v}" for k, v in fit_text(comparison).items()]
        if figures:
            lines.append(f"    {', '.join(figures)}")
    return "\n".join(lines)


# ------------------------------------------------------------------- JSON


def quality_json(quality: Quality) -> dict[str, Any]:
    """Return *quality* as plain data; values in SI, names as in the code."""
    return own_fields(quality) | {
        "usable": quality.usable,
        "comparisons": [
            picked(
                one,
                *("title", "verdict", "agrees", "fit"),
                reference="reference_name",
                channel="channel_name",
            )
            for one in quality.comparisons
        ],
        "roles": [_role_json(role) for role in quality.roles],
    }


def _role_json(role: RoleQuality) -> dict[str, Any]:
    known = role.statistics
    data = own_fields(role, "statistics") | {"found": known is not None}
    if known is None:
        return data
    return (
        data
        | own_fields(known, "longest_run")
        | {"longest_constant_s": known.longest_run.length_s}
    )


# ------------------------------------------------------------------- page


def quality_page(quality: Quality, *, title: str, subtitle: str) -> Page:
    """Return the page: verdict, faults, heat modes, pairs, channels."""
    sections = [
        Section(heading, lines=lines, kind=kind)
        for heading, wrong, kind in (
            ("Faults", True, "faults"),
            ("To know", False, "warnings"),
        )
        if (lines := _findings(quality, wrong=wrong))
    ]
    sections.append(Section("Heat modes", _modes(quality)))
    if quality.comparisons:
        sections.append(Section("Pairs", note=PAIRS_NOTE))
    # faults first, else in the order of the checks
    sections += [
        _pair(one, quality.duration_s)
        for one in sorted(
            quality.comparisons, key=lambda one: one.agrees is not False
        )
    ]
    if quality.not_judged:
        sections.append(
            Section("Not judged in this log", lines=quality.not_judged)
        )
    sections.append(_channels(quality.roles))
    return Page(
        title,
        sections,
        lead=Cell(
            f"This recording is {headline(quality)}.",
            tone=_tone(quality.usable),
        ),
        subtitle=f"{subtitle} · {duration(quality.duration_s)}",
    )


def _tone(good: bool | None) -> str:  # noqa: FBT001
    return "none" if good is None else "good" if good else "bad"


def _modes(quality: Quality) -> Table:
    return Table(
        ("mode", "usable", "why"),
        [
            (
                MODE_NAMES.get(mode.mode, mode.mode)
                + " (configured)" * (mode.mode == quality.configured_mode),
                Cell("yes" if mode.usable else "no", tone=_tone(mode.usable)),
                mode_text(mode),
            )
            for mode in quality.modes
        ],
    )


def _pair(comparison: Comparison, duration_s: float) -> Section:
    badges = {True: "agrees", False: "fault", None: "no verdict"}
    agrees = comparison.agrees
    verdict = comparison.verdict
    return Section(
        comparison.title,
        lines=() if verdict == "agrees" else (verdict,),
        plots=comparison_plots(comparison, duration_s),
        note=" · ".join(f"{k} {v}" for k, v in fit_text(comparison).items()),
        badge=Cell(badges[agrees], tone=_tone(agrees)),
    )


def _channels(roles: Sequence[RoleQuality]) -> Section:
    return Section(
        "Channels",
        Table(
            (
                "role",
                "source",
                *_ROLE_HEAD[:-2],
                "gaps over timeout",
                "one value",
            ),
            [
                (role.role, role.source, *_role_cells(role, known))
                for role in roles
                if (known := role.statistics) is not None
            ],
        ),
        lines=[
            f"{role.role} ({role.source}): {role.why_missing}"
            for role in roles
            if role.statistics is None
        ],
        note="One value: share of the samples that are the most frequent "
        "exact value.",
    )


def comparison_plots(
    comparison: Comparison, duration_s: float
) -> list[tuple[str, plots.Plot]]:
    """Return both channels over time, then one over the other."""
    unit, unit_si = comparison.reference_scale
    reference = comparison.reference / unit_si
    channel = comparison.channel / comparison.unit_si
    own_axis = unit != comparison.unit
    name = f"{comparison.reference_name} [{unit}]"
    other = f"{comparison.channel_name} [{comparison.unit}]"
    time_s = comparison.time_s
    curves = [
        plots.curve(time_s, reference, name, plots.BLUE, width=2.2),
        plots.curve(
            time_s, channel, other, plots.ORANGE, width=1.3, second=own_axis
        ),
    ]
    changes: dict[str, Any] = {}
    if own_axis:
        right = plots.right_axis(comparison.unit)
        changes["yaxis2"] = right | {"rangemode": "normal"}
    over_time = plots.time_plot(
        curves,
        unit,
        (0.0, duration_s),
        hovermode="x unified",
        xaxis={"range": _seen(comparison, duration_s), "nticks": 9},
        **changes,
    )
    points = _scatter(comparison, reference, channel)
    beside = plots.plot(points, name, _short(comparison.channel_name))
    return [("over time", over_time), ("one over the other", beside)]


def _scatter(
    comparison: Comparison, reference: Column, channel: Column
) -> list[dict[str, Any]]:
    """Return the points of one channel over the other, and the line."""
    fit = comparison.fit
    if fit is not None and fit.lag_s is not None:
        reference = shifted(reference, round(fit.lag_s / GRID_S))
    both = np.flatnonzero(np.isfinite(reference) & np.isfinite(channel))
    if not len(both):
        return []
    # spread over the reference, not over time: hours of standing are one dot
    order = both[np.argsort(reference[both], kind="stable")]
    rank = np.linspace(
        reference[order[0]], reference[order[-1]], plots.CLOUD_POINTS // 4 * 3
    )
    by_value = np.searchsorted(reference[order], rank).clip(0, len(order) - 1)
    evenly = np.linspace(0, len(order) - 1, plots.CLOUD_POINTS // 4).astype(
        int
    )
    chosen = order[np.unique(np.concatenate((by_value, evenly)))]
    x, y = reference[chosen], channel[chosen]
    found = [plots.cloud(x, y, "", plots.BLUE, size=3)]
    if fit is not None:
        ends = np.array([x.min(), x.max()])
        # an absurd channel has an absurd fit; what is no number is not drawn
        with np.errstate(over="ignore", invalid="ignore"):
            line = (
                fit.scale * ends * comparison.reference_scale[1] + fit.offset
            ) / comparison.unit_si
        found.append(
            plots.curve(ends, line, "", plots.VERMILION, legend=False)
        )
    return [one | {"hoverinfo": "skip"} for one in found]


def _seen(comparison: Comparison, duration_s: float) -> list[str]:
    """Return the time in which both channels are present."""
    both = np.isfinite(comparison.reference) & np.isfinite(comparison.channel)
    known_s = comparison.time_s[both]
    if len(known_s) < 2:
        return [plots.stamp(0.0), plots.stamp(max(duration_s, 1.0))]
    return [
        plots.stamp(max(float(known_s[0]), 0.0)),
        plots.stamp(float(known_s[-1])),
    ]


def _short(name: str) -> str:
    longest = 28
    return name if len(name) <= longest else f"{name[: longest - 1]}…"

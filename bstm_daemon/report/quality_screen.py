"""The check of a log as plain text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from bstm_daemon.report.check import (
    fit_text,
    headline,
    mode_text,
    role_unit,
    role_value,
)
from bstm_daemon.report.screen import percent
from bstm_daemon.report.text import columns, wrapped
from bstm_daemon.report.timescale import duration

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.analysis.quality.finding import (
        Comparison,
        Quality,
        RoleQuality,
    )

_ROLES: Final = (
    *("role", "rate", "min", "max", "unit"),
    *("longest gap", "gaps", "one value"),
)


def quality_table(quality: Quality) -> str:
    """Return *quality* as lines of text: roles, pairs, faults, heat modes."""
    found = [role for role in quality.roles if role.statistics is not None]
    blocks = [
        duration(quality.duration_s),
        "\n".join(columns([_ROLES, *map(_role_row, found)])),
        _pairs(quality.comparisons),
    ]
    absent = [
        f"{role.role}: {role.why_missing}"
        for role in quality.roles
        if role.statistics is None
    ]
    named = [
        finding for finding in quality.findings if finding.fault != "missing"
    ]
    faults = [
        f"{_listed(finding.roles)}{finding.text}"
        for finding in named
        if finding.wrong
    ]
    notes = [
        f"{_listed(finding.roles)}{finding.text}"
        for finding in named
        if not finding.wrong
    ]
    modes = [
        f"{mode.mode}: {'yes' if mode.usable else 'no'}, {mode_text(mode)}"
        for mode in quality.modes
    ]
    for heading, lines in (
        ("not in the log", absent),
        ("not judged in this log", list(quality.not_judged)),
        ("to know", notes),
        ("FAULTS", faults),
        ("heat modes", modes),
    ):
        if lines:
            blocks.append("\n".join([heading, *wrapped(lines, "  ", "    ")]))
    blocks.append(headline(quality))
    return "\n\n".join(block for block in blocks if block)


def _role_row(role: RoleQuality) -> tuple[str, ...]:
    known = role.statistics
    if known is None:  # the caller leaves those out
        return (role.role,)
    return (
        role.role,
        f"{known.rate_hz:.3g} Hz",
        f"{role_value(role, known.minimum):.4g}",
        f"{role_value(role, known.maximum):.4g}",
        role_unit(role),
        f"{known.longest_gap_s:.2f} s",
        str(known.gaps_over_timeout),
        percent(known.constant_share),
    )


def _pairs(comparisons: Sequence[Comparison]) -> str:
    """Return the comparisons, each with its figures under its verdict."""
    lines: list[str] = []
    for comparison in comparisons:
        mark = {True: "ok ", False: "BAD", None: " - "}[comparison.agrees]
        verdict = f"{comparison.title}: {comparison.verdict}"
        lines += wrapped([verdict], mark=f"{mark} ", indent="    ")
        figures = fit_text(comparison)
        if figures:
            pairs = (f"{name} {value}" for name, value in figures.items())
            lines.append(f"    {', '.join(pairs)}")
    return "\n".join(lines)


def _listed(roles: tuple[str, ...]) -> str:
    return f"{', '.join(roles)}: " if roles else ""

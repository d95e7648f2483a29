"""The check of a log as plain text."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING, Final

from bstm_daemon.report.quality_words import (
    fit_words,
    headline,
    mode_words,
    role_unit,
    role_value,
)
from bstm_daemon.report.screen import percent
from bstm_daemon.report.timescale import duration

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.quality.finding import Comparison, Quality, RoleQuality

WIDTH: Final = 100

_ROLES: Final = (
    *("role", "rate", "min", "max", "unit"),
    *("longest gap", "gaps", "one value"),
)
_PAIRS: Final = ("scale", "offset", "lag", "r", "rms", "samples")


def quality_table(quality: Quality) -> str:
    """Return *quality* as lines of text: roles, pairs, faults, heat modes."""
    found = [role for role in quality.roles if role.statistics is not None]
    blocks = [
        duration(quality.duration_s),
        _columns(_ROLES, [_role_row(role) for role in found], left=1),
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
        f"{mode.mode}: {'yes' if mode.usable else 'no'}, {mode_words(mode)}"
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
            blocks.append("\n".join([heading, *_items(lines)]))
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
    lines = []
    for comparison in comparisons:
        mark = {True: "ok ", False: "BAD", None: " - "}[comparison.agrees]
        lines += wrap(
            f"{mark} {comparison.title}: {comparison.verdict}",
            WIDTH,
            subsequent_indent="    ",
        )
        words = fit_words(comparison)
        if words is not None:
            values = (
                *(words.scale, words.offset, words.lag),
                *(words.correlation, words.residual, words.samples),
            )
            lines.append(
                "    "
                + ", ".join(
                    f"{name} {value}"
                    for name, value in zip(_PAIRS, values, strict=True)
                )
            )
    return "\n".join(lines)


def _listed(roles: tuple[str, ...]) -> str:
    return f"{', '.join(roles)}: " if roles else ""


def _items(lines: Sequence[str]) -> list[str]:
    return [
        part
        for line in lines
        for part in wrap(
            line, WIDTH, initial_indent="  ", subsequent_indent="    "
        )
    ]


def _columns(
    head: tuple[str, ...], rows: list[tuple[str, ...]], *, left: int
) -> str:
    table = [head, *rows]
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if i < left else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in table
    )

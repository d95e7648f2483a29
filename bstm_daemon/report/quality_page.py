"""The check of a log as one HTML page that needs no network."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Final

from bstm_daemon.files import replacing
from bstm_daemon.report.layout import EPOCH
from bstm_daemon.report.page import (
    hash_source,
    plotly_js,
    script_safe_json,
)
from bstm_daemon.report.page_parts import STYLE
from bstm_daemon.report.quality_figure import comparison_plot
from bstm_daemon.report.quality_parts import QUALITY_SCRIPT, QUALITY_STYLE
from bstm_daemon.report.quality_words import (
    MODE_NAMES,
    fit_words,
    headline,
    mode_words,
    role_unit,
    role_value,
)
from bstm_daemon.report.screen import percent
from bstm_daemon.report.timescale import duration

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from bstm_daemon.quality.finding import Comparison, Quality, RoleQuality

_BADGES: Final = {
    True: '<span class="badge good">agrees</span>',
    False: '<span class="badge bad">fault</span>',
    None: '<span class="badge none">no verdict</span>',
}


def write_quality_report(
    path: Path,
    quality: Quality,
    *,
    title: str,
    subtitle: str,
    version: str,
) -> None:
    """Write *quality* as one HTML page to *path*, whole or not at all.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    page = quality_page(
        quality, title=title, subtitle=subtitle, version=version
    )
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")


def quality_page(
    quality: Quality, *, title: str, subtitle: str, version: str
) -> str:
    """Return the page of *quality*; every text in it is escaped.

    Raises:
        MissingExtraError: plotly is not installed.
    """
    library = plotly_js()
    policy = (
        "default-src 'none'; style-src 'unsafe-inline'; "
        "img-src data: blob:; script-src "
        + " ".join(hash_source(script) for script in (library, QUALITY_SCRIPT))
    )
    # faults first, else in the order of the checks
    comparisons = sorted(
        quality.comparisons, key=lambda one: one.agrees is not False
    )
    plots = [
        comparison_plot(comparison, quality.duration_s)
        for comparison in comparisons
    ]
    data = script_safe_json({"epoch": f"{EPOCH.isoformat()}Z", "plots": plots})
    tone = "good" if quality.usable else "bad"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{STYLE}{QUALITY_STYLE}</style>
</head>
<body>
<main>
<h1>{escape(title)}</h1>
<p class="under">{escape(subtitle)} · {duration(quality.duration_s)}</p>
<p class="verdict {tone}">{escape(headline(quality))}</p>
{_findings(quality)}
<section class="plain"><h2>Heat modes</h2>{_modes(quality)}</section>
<section><h2>Pairs</h2>
{_pairs(comparisons)}
<noscript>The plots need JavaScript.</noscript>
<p class="note">Left: both readings over time. Right: one over the other with
the fitted line, the lag taken out. Scale, offset and residual are those of
the channel against the reference; a positive lag means that the channel is
late.</p></section>
{_list("Not judged in this log", quality.not_judged)}
<section class="plain"><h2>Channels</h2>{_roles(quality.roles)}</section>
<footer>bstm-daemon {escape(version)}. Estimate and advice, not a
safety function.</footer>
</main>
<script type="application/json" id="check">{data}</script>
<script>{library}</script>
<script>{QUALITY_SCRIPT}</script>
</body>
</html>
"""


def _findings(quality: Quality) -> str:
    named = [f for f in quality.findings if f.fault != "missing"]
    lines = {
        wrong: [
            f"{', '.join(f.roles)}: {f.text}" if f.roles else f.text
            for f in named
            if f.wrong is wrong
        ]
        for wrong in (True, False)
    }
    return _list("Faults", lines[True], "faults") + _list(
        "To know", lines[False], "warnings"
    )


def _list(heading: str, lines: Iterable[str], kind: str = "plain") -> str:
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    if not items:
        return ""
    return (
        f'<section class="{kind}"><h2>{escape(heading)}</h2>'
        f"<ul>{items}</ul></section>"
    )


def _modes(quality: Quality) -> str:
    rows = "".join(
        f"<tr><th>{escape(MODE_NAMES[mode.mode])}"
        f"{' (configured)' * (mode.mode == quality.configured_mode)}</th>"
        f'<td class="{"good" if mode.usable else "bad"}">'
        f"{'yes' if mode.usable else 'no'}</td>"
        f"<td>{escape(mode_words(mode))}</td></tr>"
        for mode in quality.modes
    )
    return (
        '<div class="scroll"><table><thead><tr><th>mode</th><th>usable</th>'
        f"<th>why</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _pairs(comparisons: Iterable[Comparison]) -> str:
    return "".join(
        f'<div class="pair"><h3>{_BADGES[comparison.agrees]}'
        f"{escape(comparison.title)}</h3>"
        + f"<p>{escape(comparison.verdict)}</p>"
        * (comparison.verdict != "agrees")
        + f'<p class="figures">{escape(_figures(comparison))}</p>'
        f'<div class="plot" id="plot-{i}"></div></div>'
        for i, comparison in enumerate(comparisons)
    )


def _figures(comparison: Comparison) -> str:
    words = fit_words(comparison)
    if words is None:
        return ""
    return (
        f"scale {words.scale} · offset {words.offset} · lag {words.lag} · "
        f"r = {words.correlation} · residual {words.residual} rms · "
        f"{words.samples} samples"
    )


def _roles(roles: Iterable[RoleQuality]) -> str:
    heads = ("rate", "min", "max", "unit", "longest gap", "gaps over timeout")
    head = "".join(
        f'<th class="number">{name}</th>' for name in (*heads, "one value")
    )
    body = "".join(_role(role) for role in roles)
    return (
        '<div class="scroll"><table><thead><tr><th>role</th><th>source</th>'
        f"{head}</tr></thead><tbody>{body}</tbody></table></div>"
        '<p class="note">One value: share of the samples that are the most '
        "frequent exact value.</p>"
    )


def _role(role: RoleQuality) -> str:
    start = f"<tr><th>{escape(role.role)}</th><td>{escape(role.source)}</td>"
    known = role.statistics
    if known is None:
        why = escape(role.why_missing)
        return f'{start}<td colspan="7" class="bad">{why}</td></tr>'
    cells = (
        f"{known.rate_hz:.3g} Hz",
        f"{role_value(role, known.minimum):.4g}",
        f"{role_value(role, known.maximum):.4g}",
        escape(role_unit(role)),
        f"{known.longest_gap_s:.2f} s",
        str(known.gaps_over_timeout),
        escape(percent(known.constant_share)),
    )
    return (
        start
        + "".join(f'<td class="number">{cell}</td>' for cell in cells)
        + "</tr>"
    )

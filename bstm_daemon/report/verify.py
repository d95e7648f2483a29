"""``bstm verify``: its result in words, as page and as JSON.

The page has figures 5.2 and 6.4 to 6.8 of the thesis.
"""

from collections.abc import Sequence
from math import isnan
from typing import Any, Final

from bstm_daemon.analysis.matching.verification import (
    BASELINE,
    LIMITS,
    LONG_S,
    NodeErrors,
    Verdict,
    coverage,
    decisive,
)
from bstm_daemon.report.json_file import picked
from bstm_daemon.report.plots import NodeCurve
from bstm_daemon.report.shell import Cell, Page, Section, Table, node_section
from bstm_daemon.report.text import Columns

LIMIT_WORDS = {
    "thesis": "fluid within 30 K, peak within 5 min",
    "floor": "this project's least: fluid within 10 K, 2 min",
    "goal": "this project's aim: fluid within 6 K, 1 min",
}
"""The sets of limits in a few words."""

MEANINGS = {
    "fitted to": "the model's disc errs less than a disc of one node",
    "largest error": "the farthest that the estimate ever was from the sensor",
    "RMS": "the typical error over the drive",
    "peak time": "how much later the estimated peak is, negative: earlier",
    "last 20 min": "mean error at the end of a long drive: its drift",
}
"""What a requirement asks, by a part of its name."""


def _place(one: NodeErrors) -> str:
    return one.node.replace("_", " ")


def _phase(one: NodeErrors, name: str) -> str:
    if name not in one.phase_rms_k:
        return "-"
    return f"{one.phase_rms_k[name]:.1f} / {one.phase_max_k[name]:.1f}"


def _minutes(seconds: float, form: str) -> str:
    return "-" if isnan(seconds) else format(seconds / 60.0, form)


ERRORS: Final[Columns[NodeErrors]] = Columns(
    ("drive", lambda one: one.drive),
    ("corner", lambda one: one.corner),
    ("node", _place),
    ("RMS", lambda one: f"{one.rms_k:.1f}"),
    ("largest", lambda one: f"{one.largest_k:.1f}"),
    ("braking", lambda one: _phase(one, "braking")),
    ("driving", lambda one: _phase(one, "driving")),
    ("soak", lambda one: _phase(one, "soak")),
    ("last 20 min", lambda one: f"{one.last_k:+.1f}"),
)
"""RMS and largest error of each node, RMS by phase [K]."""

PEAKS: Final[Columns[NodeErrors]] = Columns(
    ("drive", lambda one: one.drive),
    ("corner", lambda one: one.corner),
    ("node", _place),
    ("measured [degC]", lambda one: f"{one.peak.measured_c:.1f}"),
    ("estimated [degC]", lambda one: f"{one.peak.estimated_c:.1f}"),
    ("error [K]", lambda one: f"{one.peak.apart_k:+.1f}"),
    ("at [min]", lambda one: _minutes(one.peak.measured_s, ".1f")),
    ("error [min]", lambda one: _minutes(one.peak.apart_s, "+.1f")),
)
"""Height and time of each node's peak."""

VERDICTS: Final[Columns[Verdict]] = Columns(
    ("limits", lambda one: one.limits),
    ("drive", lambda one: one.drive),
    ("corner", lambda one: one.corner),
    ("requirement", lambda one: one.what),
    ("value", lambda one: f"{one.value:.1f} of {one.limit:.3g}"),
    ("verdict", lambda one: "met" if one.passed else "NOT MET"),
)


def summary_line(
    errors: Sequence[NodeErrors], verdicts: Sequence[Verdict]
) -> str:
    """Return which sets of limits are met, and the coverage."""
    parts = []
    for name in (*LIMITS, BASELINE):
        own = [one for one in verdicts if one.limits == name]
        met = sum(one.passed for one in own)
        parts.append(f"{name}: {met} of {len(own)} met")
    bare = {one.corner for one in errors} - {
        one.corner for one in verdicts if one.limits == BASELINE
    }
    if bare:
        corners = ", ".join(sorted(bare))
        parts.append(f"no baseline at {corners}: its disc is not measured")
    inside, counted = coverage(errors)
    if counted:
        parts.append(
            f"90 % interval covers {inside} of {counted} "
            f"({100.0 * inside / counted:.0f} %)"
        )
    else:
        parts.append("no 90 % interval: the configuration has no [accuracy]")
    return "; ".join(parts)


def verify_text(
    errors: Sequence[NodeErrors], verdicts: Sequence[Verdict]
) -> str:
    """Return the whole result for a terminal."""
    return "\n".join(
        [
            "error, estimated minus measured [K]; by phase RMS / largest",
            *ERRORS.lines(errors, None),
            "\nhighest temperatures",
            *PEAKS.lines(errors, None),
            "",
            *VERDICTS.lines(verdicts, None),
            f"\n{summary_line(errors, verdicts)}",
        ]
    )


def verify_json(
    errors: Sequence[NodeErrors], verdicts: Sequence[Verdict]
) -> dict[str, Any]:
    """Return the result as plain data; null where a number is not known."""
    inside, counted = coverage(errors)
    return {
        "nodes": [
            picked(
                one,
                *("drive", "corner", "node", "rms_k", "largest_k"),
                *("phase_rms_k", "phase_max_k", "covered"),
                peak_measured_c="peak.measured_c",
                peak_estimated_c="peak.estimated_c",
                peak_measured_s="peak.measured_s",
                peak_apart_s="peak.apart_s",
                last_20_min_k="last_k",
            )
            for one in errors
        ],
        "verdicts": [
            picked(
                one,
                *("limits", "drive", "corner", "value", "limit"),
                requirement="what",
                met="passed",
            )
            for one in verdicts
        ],
        "covered": inside,
        "counted": counted,
    }


def verify_page(
    errors: Sequence[NodeErrors],
    verdicts: Sequence[Verdict],
    required: str,
    subtitle: str,
) -> Page:
    """Return the page of *errors*: every drive, then errors and verdicts."""
    sections = []
    for drive, corner in dict.fromkeys((e.drive, e.corner) for e in errors):
        own = [e for e in errors if (e.drive, e.corner) == (drive, corner)]
        nodes = [
            NodeCurve(
                *(e.node, e.time_s, e.measured_c, e.estimated_c, e.error_k)
            )
            for e in own
        ]
        heading = f"{drive}, {corner}: measured and estimated"
        sections.append(
            node_section(
                f"{heading} (thesis {_figure(own)})",
                nodes,
                ("estimated minus measured", "error [K]"),
                "Thick: measured; thin: estimated.",
            )
        )
    rows = [
        (*VERDICTS.rows([one])[0], _meaning(one.what))
        for one in verdicts
        if one.limits == BASELINE or not one.passed
    ]
    sections += [
        Section(
            "Requirements that are not met, and the baseline",
            Table((*VERDICTS.head, "what it means"), rows) if rows else None,
            lines=(summary_line(errors, verdicts),),
            note="thesis: section 1.3; floor and goal: the project's own, "
            "narrower limits; baseline: a fit to the measured disc, without "
            "the model.",
            folded=True,
        ),
        Section(
            "Error, estimated minus measured [K]",
            Table.of(ERRORS, errors),
            note="By phase RMS / largest. Pad back and fluid are compared as "
            "means over 30 s, the disc below 650 degC.",
            folded=True,
        ),
        Section("Highest temperatures", Table.of(PEAKS, errors), folded=True),
    ]
    passed = all(one.passed for one in decisive(verdicts, required))
    lead = Cell(
        sentence(errors, verdicts, required), tone="good" if passed else "bad"
    )
    tiles = _tiles(errors, verdicts)
    return Page("Verification", sections, tiles, lead, subtitle=subtitle)


def sentence(
    errors: Sequence[NodeErrors], verdicts: Sequence[Verdict], required: str
) -> str:
    """Return for a person how far the estimate was from the sensors."""
    judged = [one for one in errors if one.node == "fluid"] or list(errors)
    worst = max(judged, key=lambda one: one.largest_k)
    drives = len({one.drive for one in errors})
    failed = [one for one in decisive(verdicts, required) if not one.passed]
    text = (
        f"On {drives} drive{'s' * (drives != 1)} the estimate of the "
        f"{worst.node.replace('_', ' ')} was at most {worst.largest_k:.1f} K "
        f"off ({worst.drive}, {worst.corner}); the {required} limits are "
    )
    if not failed:
        missed = {one.limits: one for one in verdicts if not one.passed}
        others = [name for name in LIMIT_WORDS if name in missed]
        return f"{text}met" + (
            f", those of {' and '.join(others)} are not." if others else "."
        )
    what = "; ".join(dict.fromkeys(one.what for one in failed))
    return f"{text}not met: {what}."


def _meaning(requirement: str) -> str:
    """Return what *requirement* asks, in words."""
    found = [text for end, text in MEANINGS.items() if end in requirement]
    return found[0] if found else ""


def _figure(errors: Sequence[NodeErrors]) -> str:
    """Return which figures of the thesis show this kind of drive.

    6.4 to 6.7 differ from 5.2 by the car and its wheels, which no log
    contains; 6.8 is a long drive.
    """
    long = max(one.time_s[-1] for one in errors) >= LONG_S
    return "figure 6.8" if long else "figures 5.2, 6.4 to 6.7"


def _tiles(
    errors: Sequence[NodeErrors], verdicts: Sequence[Verdict]
) -> list[tuple[str, str]]:
    tiles = []
    for name, asks in LIMIT_WORDS.items():
        own = [one for one in verdicts if one.limits == name]
        missed = sum(not one.passed for one in own)
        text = f"{missed} of {len(own)} missed" if missed else "met"
        tiles.append((text if own else "not judged", f"{name}: {asks}"))
    fluid = [one for one in errors if one.node == "fluid"]
    if fluid:
        largest = max(one.largest_k for one in fluid)
        tiles.append((f"{largest:.1f} K", "fluid, largest error"))
    late = [
        abs(one.peak.apart_s) for one in fluid if not isnan(one.peak.apart_s)
    ]
    if late:
        tiles.append((f"{max(late) / 60.0:.1f} min", "fluid, peak time"))
    inside, counted = coverage(errors)
    if counted:
        share = f"{100.0 * inside / counted:.0f} %"
        tiles.append((share, f"of {counted} within the 90 % interval"))
    return tiles

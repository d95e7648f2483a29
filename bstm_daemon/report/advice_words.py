"""Which drive to drive next, in words, for the page and JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.report.verify_words import table

if TYPE_CHECKING:
    from bstm_daemon.gap.workflow import Gap

ADVICE_HEAD: Final = (
    "drive",
    "min",
    "right name",
    "wrong name",
    "ln Bayes factor",
    "what it is",
)


def advice_lines(gap: Gap) -> list[str]:
    """Return which drive would tell the members apart, as lines."""
    return [advice_headline(gap), *table(ADVICE_HEAD, advice_rows(gap))]


def advice_headline(gap: Gap) -> str:
    """Return the advice in one line."""
    best = gap.advice[0]
    if best.named < 0.01:
        return "next drive: none of the menu would give a name"
    names = ", ".join(gap.members)
    if len(gap.members) > 1:
        names = f"the right one of {names}"
    return (
        f"next drive: {best.drive}, {best.description}; with it {names} "
        f"would be named in {100.0 * best.named:.0f} % of cases"
    )


def no_advice_line(gap: Gap) -> str:
    """Return why no drive is advised, and how to be told of one."""
    naming = gap.naming
    if naming is not None and naming.answer == "name":
        why = f"{' and '.join(naming.names)} named, nothing left to tell apart"
    else:
        why = "no candidate of the catalogue is left to tell apart"
    return f"no next drive: {why}; ask with --among EFFECT..."


def advice_rows(gap: Gap) -> list[tuple[str, ...]]:
    """Return a row for each drive of the menu, the best first."""
    return [
        (
            one.drive,
            f"{one.duration_s / 60.0:.0f}",
            f"{100.0 * one.named:.0f} %",
            f"{100.0 * one.wrong:.0f} %",
            f"{one.log_bayes_factor:+.1f}",
            one.description,
        )
        for one in gap.advice
    ]


def advice_json(gap: Gap) -> dict[str, Any]:
    """Return the advice for a file."""
    return {
        "members": list(gap.members),
        "log_bayes_factor_now": gap.advice[0].now,
        "drives": [
            {
                "drive": one.drive,
                "description": one.description,
                "duration_s": one.duration_s,
                "named_right": one.named,
                "named_wrong": one.wrong,
                "log_bayes_factor": one.log_bayes_factor,
            }
            for one in gap.advice
        ],
    }

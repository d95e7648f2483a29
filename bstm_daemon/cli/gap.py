"""``bstm gap``: find, name, add and show an effect that the model lacks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.analysis.gap.advising import MENU
from bstm_daemon.analysis.gap.heat_only import find_force_gap
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.gap.workflow import (
    STEPS,
    Question,
    advise_before,
    find_gap,
    is_unmatched,
)
from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.cli.arguments import option
from bstm_daemon.cli.log_command import (
    add_log_arguments,
    heading,
    open_vehicle,
    write_results,
)
from bstm_daemon.cli.progress import Progress
from bstm_daemon.errors import LogError, UsageError
from bstm_daemon.model.effects.catalogue import effect_names
from bstm_daemon.model.heat.needs import (
    INPUTS,
    check_heat_inputs,
    check_inputs,
)
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.report import gap as words
from bstm_daemon.report.gap_page import force_page, gap_page
from bstm_daemon.simulation import drive_names

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from bstm_daemon.analysis.gap.heat_only import ForceGap
    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.gap.workflow import Gap
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.report.shell import Page

WRITERS = ("adopt", "show", "run")
"""Steps that fit what they name, so that it can be written."""

FAILED: Final = 1

NOT_MATCHED: Final = (
    "not matched: names are not given; run bstm match on drives without the "
    "fault, or give --anyway"
)

SHOWERS = ("show", "run")
"""Steps that show before and after."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the step, the logs and where results go."""
    option(
        parser,
        "step",
        "run: all steps; locate: where model and measurement disagree; gate: "
        "whether anything is missing; name: which effect; adopt: fit it and "
        "write it into NEW.toml; show: before and after; advise: which drive "
        "of a menu would separate the remaining candidates",
        choices=("run", *STEPS),
    )
    what = "drives; a folder is a record that the service has kept"
    add_log_arguments(parser, what, nargs="*", new_config=True)
    what = "drives not used for fitting, for before and after"
    option(parser, "--holdout LOG...", what, Path)
    what = "name effects though no bstm match is in the configuration"
    option(parser, "--anyway", what)
    option(
        parser,
        "--form",
        "also name what the model lacked already when it was matched, not "
        "only what is new since",
    )
    option(
        parser,
        "--menu DRIVE...",
        "drives that advise compares, from bstm simulate --list (m01 to m15)",
        default=list(MENU),
        choices=drive_names(),
    )
    option(
        parser,
        "--among EFFECT...",
        "effects that advise should separate; also without logs, before any "
        "drive",
        choices=effect_names(),
    )


def run(args: argparse.Namespace) -> int:
    """Search, print, and write what was asked for.

    All files are written before a line is printed: the reader may stop early.
    """
    logs = _check(args)
    config, signal_map = open_vehicle(args, logs)
    code = 0
    if args.logs:
        recordings = _read(args, args.logs, config, signal_map)
        held_out = _read(args, args.holdout, config, signal_map)
        by_forces = not any(one.drive.measured for one in recordings)
        search = _by_forces if by_forces else _by_temperatures
        lines, code = search(args, config, recordings, held_out)
    else:
        lines = _before_any_drive(args, config, signal_map)
    print("\n".join(lines))
    return code


def _by_temperatures(
    args: argparse.Namespace,
    config: Config,
    recordings: list[Recording],
    held_out: list[Recording],
) -> tuple[list[str], int]:
    """Search by thermocouples; return the lines to print and the result."""
    lines = [
        f"{one.name}: no measured temperature, left out"
        for one in (*recordings, *held_out)
        if not one.drive.measured
    ]
    recordings = [one for one in recordings if one.drive.measured]
    held_out = [one for one in held_out if one.drive.measured]
    if args.holdout and not held_out:
        msg = (
            "--holdout: no measured temperature in these logs (roles "
            "temp_<corner>_<node>), so there is no before and after to show"
        )
        raise LogError(msg)
    for one in (*recordings, *held_out):
        mode = config.heat.mode
        check_heat_inputs(one.name, one.drive.roles, one.present, mode)
    until = "show" if args.step == "run" else args.step
    if args.form:
        bare = [one.model_copy(update={"form": {}}) for one in config.matched]
        config = config.model_copy(update={"matched": bare})
    unmatched = (
        until != "locate"
        and not args.anyway
        and is_unmatched(config, recordings)
    )
    if unmatched:
        until = "locate"
    with Progress("gap") as progress:
        gaps = find_gap(
            config,
            recordings,
            held_out,
            until=until,
            question=_question(args),
            progress=progress.show,
        )
    names = ", ".join(one.name for one in recordings)
    remarks = words.remarks_on(config)
    lines += [heading(args, config, names), *remarks]
    if unmatched:
        lines.append(NOT_MATCHED)
    for gap in gaps:
        lines.append(words.gap_text(gap))
        if args.step == "advise" and not gap.advice:
            lines.append(f"  {words.no_advice_line(gap)}")
    lines += _written(
        args,
        (names, config.vehicle.id),
        [words.gap_json(gap) for gap in gaps],
        gaps,
        lambda subtitle: gap_page(gaps, subtitle, remarks),
    )
    failed = unmatched or any(gap.worse for gap in gaps)
    return lines, FAILED if failed else 0


def _by_forces(
    args: argparse.Namespace,
    config: Config,
    recordings: list[Recording],
    held_out: list[Recording],
) -> tuple[list[str], int]:
    """Search by pressure against motion; return lines and the result."""
    if args.step in {"locate", "advise"}:
        msg = (
            f"gap {args.step}: no measured temperature in these logs (roles "
            "temp_<corner>_<node>); without one only gate, name, adopt, show "
            "and run work, from forces"
        )
        raise UsageError(msg)
    for one in (*recordings, *held_out):
        what = "pressure against motion"
        check_inputs(
            one.name, one.drive.roles, one.present, INPUTS["ff"], what
        )
    with Progress("gap") as progress:
        progress.show(0.1)
        gap = find_force_gap(config, recordings, held_out)
    names = ", ".join(one.name for one in recordings)
    lines = [
        heading(args, config, names),
        words.force_text(gap),
        *_written(
            args,
            (names, config.vehicle.id),
            [words.force_json(gap)],
            [gap],
            lambda subtitle: force_page(gap, subtitle),
        ),
    ]
    return lines, FAILED if gap.worse else 0


def _before_any_drive(
    args: argparse.Namespace, config: Config, signal_map: SignalMap
) -> list[str]:
    """Advise by the model alone; return the lines to print."""
    with Progress("gap") as progress:
        present = present_roles(signal_map)
        gap = advise_before(config, present, _question(args), progress.show)
    subject = "before any drive"
    return [
        heading(args, config, subject),
        f"{', '.join(gap.corners)}:",
        *(f"  {line}" for line in words.advice_lines(gap)),
        *_written(
            args,
            (subject, config.vehicle.id),
            [{"advice": words.advice_json(gap)}],
            [],
            lambda subtitle: gap_page([gap], subtitle),
        ),
    ]


def _question(args: argparse.Namespace) -> Question:
    """Return what is asked, each drive and effect once."""
    return Question(
        tuple(dict.fromkeys(args.menu)), tuple(dict.fromkeys(args.among))
    )


def _check(args: argparse.Namespace) -> set[Path]:
    """Refuse arguments that do not go together; return all logs."""
    if not args.logs and args.holdout:
        msg = (
            "gap: --holdout took every LOG that follows it: the drives to fit "
            "stand before it, gap run LOG... --holdout LOG..."
        )
        raise UsageError(msg)
    if not args.logs and not (args.step == "advise" and args.among):
        msg = (
            "gap: logs are required; only advise works without, with --among "
            "EFFECT..."
        )
        raise UsageError(msg)
    if args.step == "adopt" and args.out is None:
        msg = "gap adopt: give -o NEW.toml"
        raise UsageError(msg)
    if args.out is not None and args.step not in WRITERS:
        msg = f"gap {args.step}: -o is an option of {', '.join(WRITERS)}"
        raise UsageError(msg)
    if args.holdout and args.step not in SHOWERS:
        msg = (
            f"gap {args.step}: --holdout is an option of {', '.join(SHOWERS)}"
        )
        raise UsageError(msg)
    seen: set[Path] = set()
    for log in (*args.logs, *args.holdout):
        if log.resolve() in seen:
            msg = (
                f"{log}: given twice; each drive counts once, and a held-out "
                "one is not searched"
            )
            raise UsageError(msg)
        seen.add(log.resolve())
    return seen


def _read(
    args: argparse.Namespace,
    logs: list[Path],
    config: Config,
    signal_map: SignalMap,
) -> list[Recording]:
    found = []
    for log in logs:
        with Progress(f"read {log.name}") as progress:
            found.append(
                read_recording(
                    log,
                    config,
                    signal_map,
                    dict(args.map),
                    progress=progress.show,
                )
            )
    return found


def _written(
    args: argparse.Namespace,
    subtitle: tuple[str, ...],
    corners: list[dict[str, Any]],
    gaps: Sequence[Gap | ForceGap],
    page: Callable[[str], Page],
) -> list[str]:
    """Write NEW.toml, JSON and page; return a line for each."""
    result = {
        "files": [str(log) for log in args.logs],
        "held_out": [str(log) for log in args.holdout],
        "corners": corners,
    }
    lines = write_results(args, subtitle, lambda: result, page)
    if args.out is None:
        return lines
    if not any(gap.adopted for gap in gaps):
        return [f"nothing to adopt: {args.out} not written", *lines]
    if any(gap.worse for gap in gaps) and not args.force:
        why = "it does not make the gap smaller (--force writes it)"
        return [f"{args.out} not written: {why}", *lines]
    entries = Entries(
        [one for gap in gaps for one in gap.entries.effects],
        [one for gap in gaps for one in gap.entries.changes],
        [one for gap in gaps for one in gap.entries.matched],
    )
    values = [one for gap in gaps for one in gap.values]
    write_changed(args.config, args.out, values, "bstm gap", "", entries)
    return [f"{args.out}: {words.adopted_text(gaps)}", *lines]

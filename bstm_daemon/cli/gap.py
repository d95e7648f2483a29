"""``bstm gap``: find, name, add and show an effect that the model lacks."""

import argparse
import ctypes
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

from bstm_daemon.analysis.gap import workflow
from bstm_daemon.analysis.gap.advising import MENU
from bstm_daemon.analysis.gap.changes import change_names
from bstm_daemon.analysis.gap.heat_only import ForceGap, find_force_gap
from bstm_daemon.analysis.gap.recording import Recording, read_recording
from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.analysis.matching.coarse import check_mass
from bstm_daemon.cli.arguments import option
from bstm_daemon.cli.log_command import LogCommand, add_log_arguments
from bstm_daemon.cli.progress import Progress
from bstm_daemon.errors import LogError, UsageError
from bstm_daemon.model.effects.catalogue import effect_names
from bstm_daemon.model.heat import needs
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.report import gap as words
from bstm_daemon.report.gap_forces import force_json, force_page, force_text
from bstm_daemon.report.gap_page import advice_json, gap_json, gap_page
from bstm_daemon.report.shell import Page
from bstm_daemon.simulation import drive_names

WRITERS = ("adopt", "show", "run")
"""Steps that fit what they name, so that it can be written."""

FAILED: Final = 1

M_ARENA_MAX: Final = -8
"""Of glibc's ``malloc.h``."""

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
        choices=("run", *workflow.STEPS),
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
    option(
        parser,
        "--without NAME...",
        "what it is known not to be: effects, and changes as the JSON result "
        "names them",
        choices=[*effect_names(), *change_names()],
    )


class Found(NamedTuple):
    """What was searched, in every form; ``before`` stands above its head."""

    subject: str
    lines: list[str]
    corners: list[dict[str, Any]]
    gaps: Sequence[workflow.Gap | ForceGap]
    page: Callable[[str], Page]
    before: Sequence[str] = ()
    failed: bool = False


def run(args: argparse.Namespace) -> int:
    """Search, print, and write what was asked for.

    All files are written before a line is printed: the reader may stop early.
    """
    _check(args)
    _share_heap()
    command = LogCommand.opened(args, *args.holdout)
    if args.logs:
        recordings = _read(command, args.logs)
        held_out = _read(command, args.holdout)
        by_forces = not any(one.drive.measured for one in recordings)
        search = _by_forces if by_forces else _by_temperatures
        found = search(command, recordings, held_out)
    else:
        found = _before_any_drive(command)
    head = command.heading(found.subject)
    written = _written(command, found)
    print("\n".join([*found.before, head, *found.lines, *written]))
    failed = found.failed or any(gap.worse for gap in found.gaps)
    return FAILED if failed else 0


def _share_heap() -> None:
    """Let all threads allocate from one heap.

    glibc gives each its own, of which 90 MiB stay in use after a search.
    """
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)


def _by_temperatures(
    command: LogCommand, recordings: list[Recording], held_out: list[Recording]
) -> Found:
    """Search by thermocouples."""
    args, config = command.args, command.config
    bare = [
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
        needs.check_heat_inputs(one.name, one.drive.roles, one.present, mode)
    until = "show" if args.step == "run" else args.step
    if args.form:
        matched = [m.model_copy(update={"form": {}}) for m in config.matched]
        config = config.model_copy(update={"matched": matched})
    unmatched = (
        until != "locate"
        and not args.anyway
        and workflow.is_unmatched(config, recordings)
    )
    with Progress("gap") as progress:
        gaps = workflow.find_gap(
            config,
            recordings,
            held_out,
            until="locate" if unmatched else until,
            question=_question(args),
            progress=progress.show,
        )
    remarks = words.remarks_on(config)
    lines = [*remarks, *[NOT_MATCHED] * unmatched]
    for gap in gaps:
        lines.append(words.gap_text(gap))
        if args.step == "advise" and not gap.advice:
            lines.append(f"  {words.no_advice_line(gap)}")
    return Found(
        ", ".join(one.name for one in recordings),
        lines,
        [gap_json(gap) for gap in gaps],
        gaps,
        lambda subtitle: gap_page(gaps, subtitle, remarks),
        bare,
        unmatched,
    )


def _by_forces(
    command: LogCommand, recordings: list[Recording], held_out: list[Recording]
) -> Found:
    """Search by pressure against motion."""
    step = command.args.step
    if step in {"locate", "advise"}:
        msg = (
            f"gap {step}: no measured temperature in these logs (roles "
            "temp_<corner>_<node>); without one only gate, name, adopt, show "
            "and run work, from forces"
        )
        raise UsageError(msg)
    if not command.args.anyway:
        check_mass(command.args.config)
    with Progress("gap") as progress:
        progress.show(0.1)
        gap = find_force_gap(
            *(command.config, recordings, held_out, command.args.without)
        )
    return Found(
        ", ".join(one.name for one in recordings),
        [force_text(gap)],
        [force_json(gap)],
        [gap],
        lambda subtitle: force_page(gap, subtitle),
    )


def _before_any_drive(command: LogCommand) -> Found:
    """Advise by the model alone."""
    with Progress("gap") as progress:
        gap = workflow.advise_before(
            command.config,
            present_roles(command.signal_map),
            _question(command.args),
            progress.show,
        )
    return Found(
        "before any drive",
        [
            f"{', '.join(gap.corners)}:",
            *(f"  {line}" for line in words.advice_lines(gap)),
        ],
        [{"advice": advice_json(gap)}],
        [],
        lambda subtitle: gap_page([gap], subtitle),
    )


def _question(args: argparse.Namespace) -> workflow.Question:
    """Return what is asked, each drive and effect once."""
    return workflow.Question(
        tuple(dict.fromkeys(args.menu)),
        tuple(dict.fromkeys(args.among)),
        frozenset(args.without),
    )


def _check(args: argparse.Namespace) -> None:
    """Refuse arguments that do not go together."""
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
    for given, flag, steps in (
        (args.out, "-o", WRITERS),
        (args.holdout, "--holdout", SHOWERS),
    ):
        if given and args.step not in steps:
            msg = f"gap {args.step}: {flag} is an option of {', '.join(steps)}"
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


def _read(command: LogCommand, logs: list[Path]) -> list[Recording]:
    found = []
    for log in logs:
        with Progress(f"read {log.name}") as progress:
            found.append(
                command.read(read_recording, log, progress=progress.show)
            )
    return found


def _written(command: LogCommand, found: Found) -> list[str]:
    """Write NEW.toml, JSON and page; return a line for each."""
    args, gaps = command.args, found.gaps
    result = {
        "files": command.files,
        "held_out": [str(log) for log in args.holdout],
        "corners": found.corners,
    }
    lines = command.written(lambda: result, found.page, found.subject)
    if args.out is None:
        return lines
    if not any(gap.adopted for gap in gaps):
        return [f"nothing to adopt: {args.out} not written", *lines]
    if any(gap.worse for gap in gaps) and not args.force:
        why = "it does not make the gap clearly smaller (--force writes it)"
        return [f"{args.out} not written: {why}", *lines]
    entries = Entries(
        *(
            [one for gap in gaps for one in getattr(gap.entries, kind)]
            for kind in ("effects", "changes", "matched")
        )
    )
    values = [one for gap in gaps for one in gap.values]
    write_changed(args.config, args.out, values, "bstm gap", "", entries)
    return [f"{args.out}: {words.adopted_text(gaps)}", *lines]

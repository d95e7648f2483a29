"""``bstm gap``: find what the model lacks, name it, add it, show it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bstm_daemon.analysis.gap.advising import MENU
from bstm_daemon.analysis.gap.heat_only import find_force_gap
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.gap.workflow import (
    STEPS,
    Question,
    advise_before,
    find_gap,
)
from bstm_daemon.analysis.identify.writing import adopt
from bstm_daemon.cli.arguments import (
    add_bus_map,
    add_config,
    add_json,
    add_new_config,
    add_report,
    check_new,
    check_targets,
)
from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.errors import LogError, UsageError
from bstm_daemon.model.effects.catalogue import effect_names
from bstm_daemon.model.heat.needs import (
    INPUTS,
    check_heat_inputs,
    check_inputs,
)
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.report.gap import (
    adopted_text,
    advice_json,
    advice_lines,
    gap_json,
    gap_text,
    no_advice_line,
    remarks_on,
)
from bstm_daemon.report.gap_forces import force_json, force_page, force_text
from bstm_daemon.report.gap_page import gap_page
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.shell import write_page
from bstm_daemon.simulation import drive_names

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from bstm_daemon.analysis.gap.heat_only import ForceGap
    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.gap.workflow import Gap
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

WRITERS = ("adopt", "show", "run")
"""Steps that fit what they name, so that it can be written."""

SHOWERS = ("show", "run")
"""Steps that show before and after."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the step, the logs and where results go."""
    parser.add_argument(
        "step",
        choices=("run", *STEPS),
        help="run: all steps; locate: where model and measurement disagree; "
        "gate: whether anything is missing; name: which effect; adopt: fit it "
        "and write it into NEW.toml; show: before and after; advise: which "
        "drive of a menu would tell what is left apart",
    )
    parser.add_argument(
        "logs",
        nargs="*",
        type=Path,
        metavar="LOG",
        help="drives; a folder is a record that the service has kept",
    )
    add_config(parser)
    parser.add_argument(
        "--holdout",
        nargs="+",
        type=Path,
        default=[],
        metavar="LOG",
        help="drives that nothing is fitted to, for before and after",
    )
    parser.add_argument(
        "--menu",
        nargs="+",
        default=list(MENU),
        choices=drive_names(),
        metavar="DRIVE",
        help="drives that advise asks about, those of bstm simulate --list "
        "(m01 to m15)",
    )
    parser.add_argument(
        "--among",
        nargs="+",
        default=[],
        choices=effect_names(),
        metavar="EFFECT",
        help="what advise is to tell apart; without logs, before any drive",
    )
    add_new_config(parser)
    add_json(parser)
    add_report(parser)
    add_bus_map(parser)


def run(args: argparse.Namespace) -> int:
    """Search, print, and write what was asked for."""
    _check(args)
    config, signal_map = load_vehicle(args.config)
    if not args.logs:
        return _before_any_drive(args, config, signal_map)
    recordings = _read(args, args.logs, config, signal_map)
    held_out = _read(args, args.holdout, config, signal_map)
    if not any(one.drive.measured for one in recordings):
        return _by_forces(args, config, recordings, held_out)
    lines = [
        f"{one.name}: no measured temperature, left out"
        for one in (*recordings, *held_out)
        if not one.drive.measured
    ]
    recordings = [one for one in recordings if one.drive.measured]
    if args.holdout:
        held_out = [one for one in held_out if one.drive.measured]
        if not held_out:
            msg = (
                "--holdout: no measured temperature in these logs (roles "
                "temp_<corner>_<node>), nothing to show before and after on"
            )
            raise LogError(msg)
    for one in (*recordings, *held_out):
        mode = config.heat.mode
        check_heat_inputs(one.name, one.drive.roles, one.present, mode)
    until = "show" if args.step == "run" else args.step
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
    remarks = remarks_on(config)
    lines += [f"{names}  ({config.vehicle.id}, {args.config})", *remarks]
    for gap in gaps:
        lines.append(gap_text(gap))
        if args.step == "advise" and not gap.advice:
            lines.append(f"  {no_advice_line(gap)}")
    lines += _written(args, [gap_json(gap) for gap in gaps], gaps)
    lines += _reported(args, gaps, f"{names} · {config.vehicle.id}", remarks)
    return _told(lines)


def _told(lines: Sequence[str]) -> int:
    """Print *lines*, all files written: who reads may close early."""
    print("\n".join(lines))
    return 0


def _before_any_drive(
    args: argparse.Namespace, config: Config, signal_map: SignalMap
) -> int:
    """Advise by the model alone."""
    with Progress("gap") as progress:
        gap = advise_before(
            config,
            present_roles(signal_map),
            _question(args),
            progress.show,
        )
    return _told(
        [
            f"before any drive  ({config.vehicle.id}, {args.config})",
            f"{', '.join(gap.corners)}:",
            *(f"  {line}" for line in advice_lines(gap)),
            *_written(args, [{"advice": advice_json(gap)}], []),
            *_reported(args, [gap], f"before any drive · {config.vehicle.id}"),
        ]
    )


def _question(args: argparse.Namespace) -> Question:
    """Return what is asked, each drive and effect once."""
    return Question(
        tuple(dict.fromkeys(args.menu)), tuple(dict.fromkeys(args.among))
    )


def _reported(
    args: argparse.Namespace,
    gaps: Sequence[Gap],
    subject: str,
    remarks: Sequence[str] = (),
) -> list[str]:
    """Write the page that was asked for; return what to say of it."""
    if not args.report:
        return []
    page = gap_page(gaps, f"{subject} · {args.config.name}", remarks)
    write_page(args.report, page)
    return [str(args.report)]


def _by_forces(
    args: argparse.Namespace,
    config: Config,
    recordings: list[Recording],
    held_out: list[Recording],
) -> int:
    """Search without a thermocouple: pressure against motion."""
    if args.step in {"locate", "advise"}:
        msg = (
            f"gap {args.step}: no measured temperature in these logs (roles "
            "temp_<corner>_<node>); without one there are gate, name, adopt, "
            "show and run, by forces"
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
        f"{names}  ({config.vehicle.id}, {args.config})",
        force_text(gap),
        *_written(args, [force_json(gap)], [gap]),
    ]
    if args.report:
        subtitle = f"{names} · {config.vehicle.id} · {args.config.name}"
        write_page(args.report, force_page(gap, subtitle))
        lines.append(str(args.report))
    return _told(lines)


def _check(args: argparse.Namespace) -> None:
    if not args.logs and not (args.step == "advise" and args.among):
        msg = (
            "gap: give logs; only advise goes without, with --among EFFECT..."
        )
        raise UsageError(msg)
    if args.step == "adopt" and args.out is None:
        msg = "gap adopt: give -o NEW.toml"
        raise UsageError(msg)
    if args.out is not None and args.step not in WRITERS:
        msg = f"gap {args.step}: -o goes with {', '.join(WRITERS)}"
        raise UsageError(msg)
    if args.holdout and args.step not in SHOWERS:
        msg = f"gap {args.step}: --holdout goes with {', '.join(SHOWERS)}"
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
    check_new(args.out, force=args.force)
    check_targets((args.out, args.json, args.report), (args.config, *seen))


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
    corners: list[dict[str, Any]],
    gaps: Sequence[Gap | ForceGap],
) -> list[str]:
    """Write the result and NEW.toml; return what to say of them."""
    if args.json:
        result = {
            "files": [str(log) for log in args.logs],
            "held_out": [str(log) for log in args.holdout],
            "corners": corners,
        }
        write_json(args.json, result)
    if args.out is None:
        return []
    effects = [effect for gap in gaps for effect in gap.effects()]
    if not effects:
        return [f"nothing to adopt: {args.out} not written"]
    adopt(args.config, args.out, effects)
    return [f"{args.out}: {adopted_text(gaps)}"]

"""``bstm replay``: brake temperatures from recorded logs."""

from __future__ import annotations

from argparse import ArgumentTypeError
from math import inf, isclose, nan
from pathlib import Path
from typing import TYPE_CHECKING

from bstm_daemon import __version__
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.cli.arguments import (
    add_bus_map,
    add_config,
    add_out,
    add_report,
)
from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.errors import MissingExtraError, UsageError
from bstm_daemon.files import make_folder
from bstm_daemon.replay import Replay, publish_log, replay_log
from bstm_daemon.report.gaps import input_gaps
from bstm_daemon.report.screen import summary_table
from bstm_daemon.results import has_parquet, write_csv, write_parquet

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from bstm_daemon.config import Config

BYTES_PER_LINE = 44
"""A candump line of eight bytes; only the progress line depends on it."""

PUBLICATION_S = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``bstm replay``."""
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG")
    add_config(parser)
    add_out(parser, "folder for the estimates (default: none written)", "DIR")
    parser.add_argument(
        "--format",
        choices=("csv", "parquet", "both"),
        help="files in DIR (default: both, CSV alone without pyarrow)",
    )
    parser.add_argument(
        "--every",
        type=_every_s,
        default=PUBLICATION_S,
        metavar="S",
        help="seconds from row to row, a multiple of 0.1 (default: 0.1)",
    )
    parser.add_argument(
        "--publish",
        type=Path,
        metavar="OUT.log",
        help="write the frames that the daemon would send as a candump log",
    )
    add_report(parser)
    add_bus_map(parser)


def run(args: argparse.Namespace) -> int:
    """Replay every log and write what was asked for."""
    stems = [_stem(path) for path in args.logs]
    _check_targets(args, stems)
    formats = _formats(args.format) if args.out is not None else ()
    config, signal_map = load_vehicle(args.config)
    overrides = dict(args.map)
    if args.out is not None:
        make_folder(args.out)
    for path, stem in zip(args.logs, stems, strict=True):
        with Progress(f"replay {path.name}") as progress:
            replay = replay_log(
                config,
                signal_map,
                path,
                overrides,
                round(args.every * 1e6),
                _share_of(path, progress),
            )
        print(f"{path}  ({config.vehicle.id}, {args.config})")
        print(summary_table(replay.results))
        for line in _remarks(replay, config.heat.mode):
            print(line)
        for form in formats:
            target = args.out / f"{stem}.estimates.{form}"
            (write_csv if form == "csv" else write_parquet)(
                target, replay.results
            )
            print(f"{target}: {len(replay.results)} rows")
        if args.report is not None:
            _write_report(args, config, path, replay)
        if args.publish is not None:
            count = publish_log(
                config, signal_map, path, args.publish, overrides
            )
            print(f"{args.publish}: {count} frames")
    return 0


def _check_targets(args: argparse.Namespace, stems: list[str]) -> None:
    """Refuse targets that would overwrite each other or the log."""
    if len(args.logs) > 1 and (args.publish or args.report):
        msg = "--publish and --report take one LOG at a time"
        raise UsageError(msg)
    if args.out is not None and len(set(stems)) < len(stems):
        msg = f"two logs would write the same files in {args.out}: {stems}"
        raise UsageError(msg)
    targets = [path for path in (args.publish, args.report) if path]
    if args.out is not None:
        targets += [
            args.out / f"{stem}.estimates.{form}"
            for stem in stems
            for form in ("csv", "parquet")
        ]
    places = [target.resolve() for target in targets]
    if len(set(places)) < len(places):
        msg = "two results would be written to one file"
        raise UsageError(msg)
    log = args.logs[0]
    for target in (args.publish, args.report):
        if (
            target
            and target.exists()
            and log.exists()
            and (target.samefile(log))
        ):
            msg = f"{target}: would overwrite the log"
            raise UsageError(msg)


def _write_report(
    args: argparse.Namespace, config: Config, path: Path, replay: Replay
) -> None:
    from bstm_daemon.report.page import (  # noqa: PLC0415
        ReportFacts,
        write_replay_report,
    )

    facts = ReportFacts(
        title=f"Brake temperatures: {path.name}",
        logs=(path.name,),
        vehicle_id=config.vehicle.id,
        configuration=args.config.name,
        heat_mode=config.heat.mode,
        lines=replay.lines,
        frames=replay.frames,
        refused=dict(replay.refused),
        counts=replay.counts,
        kernel="compiled" if replay.compiled else "pure Python",
        version=__version__,
        warnings=tuple(_remarks(replay, config.heat.mode)),
    )
    write_replay_report(args.report, replay.results, facts)
    print(args.report)


def _remarks(replay: Replay, heat_mode: str) -> list[str]:
    """What the reader of a result has to know of its input."""
    hours = replay.settling_s / 3600
    start = (
        f"the brakes' temperatures before the log are unknown: degraded for "
        f"its first {hours:.1f} h"
    )
    remarks = [start]
    remarks += [
        f"{gap.name} missing for {gap.total_s:.0f} s, longest "
        f"{gap.longest_s:.0f} s from {gap.longest_from_s:.0f} s on: taken as "
        f"0, marked degraded"
        for gap in input_gaps(replay.results, heat_mode)
    ]
    if replay.truncated:
        remarks.append("the log is cut short: its end is missing")
    listed = ", ".join(
        f"{count} {reason.replace('_', ' ')}"
        for reason, count in replay.refused.most_common()
        if reason != Refusal.UNKNOWN_ID
    )
    if listed:
        remarks.append(f"refused: {listed}")
    said = {
        "late": "samples out of order, counted from when they came",
        "dropped": "samples dropped, their stamps far from their neighbours'",
        "jumps": "jumps of the clock",
    }
    remarks += [
        f"{text}: {replay.counts[key]}"
        for key, text in said.items()
        if replay.counts[key]
    ]
    return remarks


def _formats(asked: str | None) -> tuple[str, ...]:
    if asked == "csv":
        return ("csv",)
    if asked is None and not has_parquet():
        print("CSV only: Parquet needs pip install 'bstm-daemon[parquet]'")
        return ("csv",)
    if not has_parquet():
        raise MissingExtraError(
            package="pyarrow", extra="parquet", purpose=f"--format {asked}"
        )
    return ("parquet",) if asked == "parquet" else ("csv", "parquet")


def _stem(path: Path) -> str:
    name = path.name.removesuffix(".gz")
    return Path(name).stem


def _share_of(
    path: Path, progress: Progress
) -> Callable[[int, float | None], None]:
    try:
        size = max(path.stat().st_size, 1)
    except OSError:  # the replay itself reports a missing file
        size = 1
    return lambda lines, share: progress.show(
        min(lines * BYTES_PER_LINE / size, 1.0) if share is None else share
    )


def _every_s(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = nan
    tenths = seconds / PUBLICATION_S
    if not (
        0 < seconds < inf and isclose(tenths, round(tenths), abs_tol=1e-6)
    ):
        msg = f"{text!r} is not a positive multiple of {PUBLICATION_S} s"
        raise ArgumentTypeError(msg)
    return seconds

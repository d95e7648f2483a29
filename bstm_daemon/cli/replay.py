"""``bstm replay``: brake temperatures from recorded logs."""

import argparse
import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from math import isinf
from pathlib import Path

import numpy as np

from bstm_daemon.bus.logs.reader import UNWANTED
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.bus.tables.table_plan import TableMap
from bstm_daemon.cli.arguments import (
    add_out,
    check_targets,
    number,
    option,
    refuse_overwriting,
    shared,
)
from bstm_daemon.cli.log_command import write_pages
from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle, read_state
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import MissingExtraError, UsageError
from bstm_daemon.estimator.start import PUBLISHED_NODES
from bstm_daemon.estimator.verified import unverified_of_car
from bstm_daemon.files import make_folder
from bstm_daemon.replay.columns import Run, StartState, stream_log
from bstm_daemon.replay.frames import publications, write_frames
from bstm_daemon.replay.results import (
    WRITERS,
    Chosen,
    Collector,
    Part,
    Sink,
    is_one_of_few,
    require_format,
)
from bstm_daemon.report.drive_curves import DriveCurves
from bstm_daemon.report.drive_statistics import DriveStatistics, summary_table
from bstm_daemon.report.replay_page import ReplayFacts, replay_page
from bstm_daemon.report.timescale import clock
from bstm_daemon.service.state_file import encode, save
from bstm_daemon.watch.board import Board
from bstm_daemon.watch.replay_view import DEFAULT_SPEED, watch_log
from bstm_daemon.watch.terminal_text import raw_stream
from bstm_daemon.watch.view import open_view

WEAR_MOVED_K = 5.0
"""Wear that moves the estimate by more is worth a line."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``bstm replay``."""
    option(parser, "logs LOG...", "", Path)
    shared(parser, "config")
    add_out(parser, "folder for the estimates (default: none written)", "DIR")
    option(
        parser,
        "--format",
        "files in DIR (default: both CSV and Parquet, CSV alone without "
        "pyarrow); mf4 is on the log's own time",
        choices=(*WRITERS, "both"),
    )
    option(
        parser,
        "--columns",
        "columns of these files: all, or speed, temperatures, margin, risk "
        "and validity (default: %(default)s)",
        choices=("all", "few"),
        default="all",
    )
    shared(parser, "every")
    what = "write the frames that the daemon would send as a candump log"
    option(parser, "--publish OUT.log", what, Path)
    start = parser.add_mutually_exclusive_group()
    option(
        start,
        "--start",
        "how warm the brakes are where the log begins: as cold as the air, or "
        "unknown, and degraded until that has no effect any more (default: "
        "%(default)s)",
        choices=("unknown", "cold"),
        default="unknown",
    )
    what = "state file of the daemon to start from; it is only read"
    option(start, "--state FILE", what, Path)
    what = "write the state at the end of the log, for the drive after it"
    option(parser, "--state-out FILE", what, Path)
    what = "show the published temperatures as they come; q leaves"
    option(parser, "--watch", what)
    what = (
        "with --watch: seconds of the log per second, 0 for as fast as it "
        f"goes (default: {DEFAULT_SPEED:g})"
    )
    option(parser, "--speed N", what, number(0.0))
    shared(parser, "no-forecast", "report", "figures", "map")


def run(args: argparse.Namespace) -> int:
    """Replay every log and write what was asked for."""
    stems = [_stem(path) for path in args.logs]
    _check_targets(args, stems)
    view = open_view(raw_stream(sys.stdout)) if args.watch else None
    formats = _formats(args.format) if args.out is not None else ()
    config, signal_map = _vehicle(args)
    state: StartState = "cold" if args.start == "cold" else None
    if args.state is not None:
        state = read_state(args.state, "--state")
    if args.out is not None:
        make_folder(args.out)
    check_targets((args.publish, args.report, args.state_out), ())
    for path, stem in zip(args.logs, stems, strict=True):
        published = partial(
            publications,
            config,
            signal_map,
            path,
            dict(args.map),
            state,
            forecast=args.forecast,
        )
        if view is not None:
            corners = [corner.name for corner in config.corner]
            board = Board(config.publish.id_base, corners)
            speed = DEFAULT_SPEED if args.speed is None else args.speed
            watch_log(published(), board, path.name, view, speed)
        targets = {
            args.out / f"{stem}.estimates.{form}": form for form in formats
        }
        _replay(args, path, (config, signal_map), state, targets)
        if args.publish is not None:
            channel = config.bus[config.publishing_bus].channel
            with Progress(f"publish {path.name}") as progress:
                ticks = published(progress=progress.show)
                count = write_frames(ticks, channel, args.publish)
            print(f"{args.publish}: {count} frames")
    return 0


def _replay(
    args: argparse.Namespace,
    path: Path,
    vehicle: tuple[Config, SignalMap],
    state: StartState,
    targets: dict[Path, str],
) -> None:
    """Replay the log *path* into *targets*, print and draw what it shows.

    *targets* is the format by file.
    """
    config, signal_map = vehicle
    drawn = bool(args.report or args.figures)
    # a state has the forecast's memory, whatever else is written
    parts = Part.ALL if args.state_out else Part.VALIDITY
    statistics, curves = DriveStatistics(parts), DriveCurves()
    worn = Collector(Part.NONE)
    # whole tables or none: all are replaced when the last row is written
    with Progress(f"replay {path.name}") as progress, ExitStack() as files:
        tables = [
            files.enter_context(WRITERS[form](target))
            for target, form in targets.items()
        ]
        if args.columns == "few":
            tables = [Chosen(table, is_one_of_few) for table in tables]
        summaries: list[Sink] = [statistics, *[curves] * drawn]
        if config.wear.model_follows:
            summaries.append(Chosen(worn, _is_published))
        replayed = partial(
            stream_log,
            signal_map=signal_map,
            path=path,
            overrides=dict(args.map),
            every_us=round(args.every * 1e6),
            progress=progress.show,
            state=state,
            forecast=args.forecast,
        )
        log_run = replayed(config, sinks=tables, summaries=summaries)
        of_wear = _wear_remarks(config, worn, replayed)
    summary = statistics.summary()
    print(f"{path}  ({config.vehicle.id}, {args.config})")
    print(summary_table(summary))
    unverified = unverified_of_car(config, signal_map.roles())
    remarks = [
        *(f"unverified: nothing checks the {one}" for one in unverified.words),
        *_start_remarks(args.start, log_run.start_known_s),
        *_remarks(log_run, statistics, config.heat.mode),
        *of_wear,
    ]
    lines = [*remarks, *(f"{one}: {log_run.rows} rows" for one in targets)]
    for line in lines:
        print(line)
    if args.state_out is not None:
        save(args.state_out, encode(log_run.state))
        print(args.state_out)
    facts = ReplayFacts(
        title=f"Brake temperatures: {path.name}",
        log=path.name,
        vehicle_id=config.vehicle.id,
        configuration=args.config.name,
        heat_mode=config.heat.mode,
        refused=dict(log_run.refused),
        counts=log_run.counts,
        compiled=log_run.compiled,
        warnings=remarks,
        lines=log_run.lines,
        frames=log_run.frames,
    )
    for line in write_pages(args, lambda: replay_page(summary, curves, facts)):
        print(line)


def _vehicle(args: argparse.Namespace) -> tuple[Config, SignalMap]:
    """Load the vehicle; a signal table has no frames to replay one by one."""
    config, signal_map = load_vehicle(args.config)
    if isinstance(signal_map, TableMap) and (args.publish or args.watch):
        msg = (
            "--publish and --watch replay CAN frames, which a signal table "
            "has not: take -o DIR or --report PAGE.html, or a log of frames"
        )
        raise UsageError(msg)
    return config, signal_map


def _check_targets(args: argparse.Namespace, stems: list[str]) -> None:
    """Refuse targets that would overwrite each other or what is read."""
    if args.speed is not None and not args.watch:
        msg = "--speed is the pace of --watch, which is not given"
        raise UsageError(msg)
    written = args.publish, args.report, args.state_out
    of_one = *written, args.figures, args.watch, args.state
    if len(args.logs) > 1 and any(of_one):
        msg = (
            "--publish, --report, --figures, --watch, --state and --state-out "
            "take one LOG at a time"
        )
        raise UsageError(msg)
    if args.out is not None and len(set(stems)) < len(stems):
        names = ", ".join(map(str, args.logs))
        msg = f"two logs would write the same files in {args.out}: {names}"
        raise UsageError(msg)
    tables = [
        args.out / f"{stem}.estimates.{form}"
        for stem in stems
        for form in WRITERS
        if args.out is not None
    ]
    sources = (args.config, args.state, *args.logs)
    refuse_overwriting((*written, *tables), sources)


def _start_remarks(start: str, known_s: float) -> list[str]:
    """Return what the reader must know of the temperatures at the begin."""
    if start == "cold":
        return ["start cold: as cold as the air, because --start says so"]
    if not known_s > 0.0:
        return []
    known, until = "start not known by the end of the log", "throughout"
    if not isinf(known_s):
        known = f"start known after {known_s / 60.0:.0f} min"
        until = "until then"
    return [
        (
            f"the brakes' temperatures before the log are unknown: {known}; "
            f"degraded and the risk an upper bound {until} (--start cold if "
            "the brakes were cold)"
        )
    ]


def _remarks(
    log_run: Run, statistics: DriveStatistics, heat_mode: str
) -> list[str]:
    """Return the remarks on the input that the reader of a result needs."""
    remarks = [
        f"{name} missing for {gap.total_s:.0f} s, longest "
        f"{gap.longest_s:.0f} s from {gap.longest_from_s:.0f} s on: marked "
        f"degraded"
        for name, gap in statistics.gaps(heat_mode).items()
    ]
    if log_run.truncated:
        remarks.append("the log is cut short: its end is missing")
    listed = ", ".join(
        f"{count} {reason.replace('_', ' ')}"
        for reason, count in log_run.refused.most_common()
        if reason not in UNWANTED
    )
    if listed:
        remarks.append(f"refused: {listed}")
    for key, text in (
        ("late", "samples out of order, used from their arrival"),
        (
            "dropped",
            "samples dropped, their stamps far from their neighbours'",
        ),
        ("jumps", "jumps of the clock"),
    ):
        if log_run.counts[key]:
            remarks.append(f"{text}: {log_run.counts[key]}")
    return remarks


def _is_published(name: str) -> bool:
    """Whether the column *name* is the time or a published temperature."""
    nodes = {f"{node}_c" for node in PUBLISHED_NODES}
    return name.rpartition(".")[2] in {"time_s", *nodes}


def _wear_remarks(
    config: Config, worn: Collector, replayed: Callable[..., Run]
) -> list[str]:
    """Return what wear did to the temperatures, where the model follows it.

    Then the log is replayed once more, with linings and discs as configured.
    """
    if not config.wear.model_follows:
        return []
    still = Collector(Part.NONE)
    wear = config.wear.model_copy(update={"model_follows": False})
    replayed(
        config.model_copy(update={"wear": wear}),
        sinks=(),
        summaries=[Chosen(still, _is_published)],
    )
    one, other = worn.results().columns, still.results().columns
    time_s = one.pop("time_s")
    moved_k = np.array([one[name] - other[name] for name in one])
    sizes_k = np.nan_to_num(np.abs(moved_k))
    if not sizes_k.max() > WEAR_MOVED_K:
        return []
    place, row = np.unravel_index(sizes_k.argmax(), sizes_k.shape)
    corner, node = [*one][place].removesuffix("_c").split(".")
    at = clock(time_s[row] - time_s[0])
    return [
        (
            f"wear moved the estimate by up to {moved_k[place, row]:+.0f} K "
            f"({node} {corner}, {at}): [wear] model_follows = true"
        )
    ]


def _formats(asked: str | None) -> tuple[str, ...]:
    """Return the endings of the files that were *asked* for.

    Raises:
        MissingExtraError: the package of one is not installed.
    """
    forms = ("csv", "parquet") if asked in {None, "both"} else (str(asked),)
    try:
        for form in forms:
            require_format(form)
    except MissingExtraError:
        if asked is not None:
            raise
        print("CSV only: Parquet needs pip install 'bstm-daemon[parquet]'")
        return ("csv",)
    return forms


def _stem(path: Path) -> str:
    return Path(path.name.removesuffix(".gz")).stem

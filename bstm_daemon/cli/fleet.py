"""``bstm fleet``: the drives of many cars, replayed in chains."""

import argparse
import csv
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import (
    AbstractContextManager,
    closing,
    contextmanager,
    redirect_stdout,
)
from io import StringIO
from itertools import chain, count
from pathlib import Path
from typing import Any, Final

from bstm_daemon.cli.arguments import (
    add_force,
    add_out,
    check_new,
    check_targets,
    number,
    option,
    shared,
)
from bstm_daemon.cli.main import main
from bstm_daemon.cli.progress import Progress
from bstm_daemon.errors import StateLockedError, require_packages
from bstm_daemon.files import make_folder, replacing
from bstm_daemon.fleet.gap import (
    cars_of,
    failures_of,
    gap_lines,
    groups_of,
    search,
)
from bstm_daemon.fleet.lake import Lake, Options, ask, shipped
from bstm_daemon.fleet.learning import write_prior
from bstm_daemon.fleet.plan import Fleet, Plan, add_logs
from bstm_daemon.fleet.run import Outcome, Run, connect, require_fleet
from bstm_daemon.report.fleet import FleetFacts, fleet_page
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.shell import require_page_packages, write_page
from bstm_daemon.report.text import table, wrapped
from bstm_daemon.report.timescale import duration
from bstm_daemon.service.state_file import lock, safe_name

FAILURES_SHOWN: Final = 40
EXIT_FAILED: Final = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the steps and their arguments."""
    steps = parser.add_subparsers(title="steps", metavar="STEP", required=True)

    def step(
        does: Callable[[argparse.Namespace], int], what: str
    ) -> argparse.ArgumentParser:
        one = steps.add_parser(does.__name__[1:], help=what)
        one.set_defaults(step=does)
        if does is not _plan:
            option(one, "lake LAKE", "", Path)
        return one

    plan = step(_plan, "find the logs of each car")
    option(plan, "logs LOG...", "", Path)
    what = "which log is of which car, and their configurations"
    option(plan, "--vehicles FLEET.toml", what, Path, required=True)
    what = "folder of the plan and of all results"
    option(plan, "-o --out LAKE", what, Path, dest="lake", required=True)
    replay = step(_replay, "replay what is new or changed")
    _add_workers(replay)
    option(
        replay,
        "--on-error",
        "behind a log that cannot be replayed: go on from the last good state "
        "as after a drive that nobody saw, or wait (default: %(default)s)",
        choices=("continue", "hold"),
        default="continue",
    )
    shared(replay, "every", "no-forecast")
    step(_status, "what is done, waits or failed")
    gap = step(
        _gap, "what cars of a type lack or have changed, and the odd one"
    )
    _add_workers(gap)
    what = "search the last N drives of each car (default: %(default)s)"
    option(gap, "--drives N", what, number(1, kind=int), default=8)
    option(
        gap,
        "--anyway",
        "name effects though no bstm match is in a configuration",
    )
    shared(gap, "json")
    add_out(
        gap,
        "write a configuration for a further car of each type, with "
        "[[priors]] from the matches of its cars",
        "DIR",
    )
    add_force(gap, "a configuration in DIR")
    report = step(_report, "write the page of the fleet")
    add_out(report, "page (default: LAKE/report.html)", "FILE.html")
    what = (
        "replay the N worst drives for pages of their own, which the page "
        "leads to (default: %(default)s)"
    )
    option(report, "--pages N", what, number(0, kind=int), default=0)
    query = step(_query, "ask the results in SQL")
    what = (
        "a question in SQL, or the name of a shipped one; without it those "
        "are listed"
    )
    option(query, "sql SQL", what, nargs="?")
    add_out(query, "write the answer as CSV", "FILE.csv")


def run(args: argparse.Namespace) -> int:
    """Run the step."""
    code: int = args.step(args)
    return code


def _add_workers(parser: argparse.ArgumentParser) -> None:
    where = parser.add_mutually_exclusive_group()
    what = "processes on this machine (default: one a core)"
    option(where, "--jobs N", what, number(1, kind=int))
    what = "Dask scheduler whose workers do the work"
    option(where, "--scheduler tls://HOST:PORT", what)
    for name in ("ca", "cert", "key"):
        what = "for tls:// (default: Dask's configuration)"
        option(parser, f"--tls-{name} FILE.pem", what, Path)


def _plan(args: argparse.Namespace) -> int:
    lake, fleet = Lake(args.lake), Fleet(args.vehicles)
    make_folder(lake.root)
    with _owning(lake), Progress("plan") as progress:
        unread = add_logs(
            lake,
            fleet,
            args.logs,
            lambda number, path: progress.show(0.0, f"{number} {path.name}"),
        )
    with closing(Plan(lake)) as plan:
        print(f"{lake.plan}: {len(plan)} drives of {plan.cars()} cars")
    _list("begin not readable, placed by its name", [d.log for d in unread])
    return 0


def _replay(args: argparse.Namespace) -> int:
    require_fleet()
    lake = Lake(args.lake)
    options = Options(round(args.every * 1e6), args.forecast)
    with (
        closing(Plan(lake)) as plan,
        _owning(lake),
        Progress("fleet replay") as progress,
    ):
        hold = args.on_error == "hold"
        replayed = Run(lake, plan, options, hold=hold)
        total, begun_s = len(plan), time.monotonic()

        def show() -> None:
            outcome = replayed.outcome
            spent_s = time.monotonic() - begun_s
            rate = outcome.made / spent_s
            left_s = (total - outcome.seen) / rate if rate else 0.0
            text = f"{3600.0 * rate:.0f} drives/h, {duration(left_s)} left"
            progress.show(outcome.seen / total, text)

        chains = replayed.chains()
        first = next(chains, None)
        if first is not None:
            with _client(args) as client:
                replayed.execute(client, chain([first], chains), show)
    spent_s = time.monotonic() - begun_s
    outcome = replayed.outcome
    print(f"{args.lake}: {_counts(outcome)}, in {duration(spent_s)}")
    _list("not replayed", outcome.failures)
    return EXIT_FAILED if outcome.failures else 0


def _gap(args: argparse.Namespace) -> int:
    require_packages("distributed", extra="fleet", purpose="bstm fleet gap")
    lake = Lake(args.lake)
    check_targets([args.json], ())
    with (
        closing(Plan(lake)) as plan,
        _owning(lake),
        Progress("fleet gap") as progress,
    ):
        cars, failures = cars_of(lake, plan, args.drives, anyway=args.anyway)
        types: dict[str, set[Path]] = {}
        for one in cars:
            types.setdefault(one.last.type, set()).add(Path(one.last.config))
        outs = {
            kind: args.out / f"{safe_name(kind)}.toml"
            for kind in (sorted(types) if args.out else ())
        }
        for out in outs.values():
            check_new(out, force=args.force)
        new = [one for one in cars if one.result()["key"] != one.key]
        done = count(len(cars) - len(new) + 1)
        if new:
            with _client(args) as client:
                search(
                    *(client, new),
                    lambda name: progress.show(next(done) / len(cars), name),
                )
    failures += failures_of(cars)
    groups = groups_of(cars)
    print("\n".join(gap_lines(groups)))
    if args.json is not None:
        write_json(args.json, {"groups": groups, "failures": failures})
    good = {Path(o.last.config) for o in cars if not o.result()["message"]}
    for kind, out in outs.items():
        make_folder(args.out)
        matched = write_prior(kind, sorted(types[kind] & good), out)
        why = "not written: it needs two matched cars"
        print(
            f"{out}: priors of {matched} cars" if matched else f"{out} {why}"
        )
    _list("not searched", failures)
    return EXIT_FAILED if failures else 0


def _client(args: argparse.Namespace) -> AbstractContextManager[Any]:
    tls = args.tls_ca, args.tls_cert, args.tls_key
    return connect(args.scheduler, args.jobs, tls)


def _status(args: argparse.Namespace) -> int:
    lake = Lake(args.lake)
    with closing(Plan(lake)) as plan:
        outcome = Run(lake, plan, None).look()
        print(f"{args.lake}: {plan.cars()} cars, {_counts(outcome)}")
    _list("not replayed", outcome.failures)
    return EXIT_FAILED if outcome.failures else 0


def _report(args: argparse.Namespace) -> int:
    require_page_packages()
    lake = Lake(args.lake)
    out = args.out or lake.root / "report.html"
    with closing(Plan(lake)) as plan:
        check_targets([out], ())
        outcome = Run(lake, plan, None).look()
        cars, dates, worst = (
            ask(lake, name).as_rows() for name in ("cars", "dates", "worst")
        )
        found = {}
        for row in worst[: args.pages]:
            drive = (row["vehicle"], row["name"])
            page = _drive_page(lake, plan, *drive)
            if page is not None:
                found[drive] = os.path.relpath(page, out.parent)
    title = f"Brakes of the fleet: {lake.root.resolve().name}"
    failures, waiting = outcome.failures, outcome.waiting
    facts = FleetFacts(title, cars, dates, worst, found, failures, waiting)
    write_page(out, fleet_page(facts))
    print(out)
    return 0


def _drive_page(
    lake: Lake, plan: Plan, vehicle: str, name: str
) -> Path | None:
    """Replay a drive as it was for a page; None where that is impossible."""
    before = None
    for drive in plan.chain(vehicle):
        receipt = lake.receipt(drive)
        if drive.name == name and receipt is not None:
            page = lake.path(drive, "page")
            make_folder(page.parent)
            pairs = json.loads(drive.map).items()
            arguments = [
                *("replay", drive.log, "-c", drive.config),
                *("--report", str(page)),
                *(() if receipt.options.forecast else ("--no-forecast",)),
                *(f"--map={one}={bus}" for one, bus in pairs),
            ]
            if before is not None and lake.path(before, "state").exists():
                arguments += ["--state", str(lake.path(before, "state"))]
            with redirect_stdout(StringIO()):
                code = main(arguments)
            return page if code == 0 else None
        before = drive
    return None


def _query(args: argparse.Namespace) -> int:
    if args.sql is None:
        rows = [[name, one["what"]] for name, one in shipped().items()]
        print("\n".join(table(["name", "question"], rows)))
        return 0
    check_targets([args.out], ())
    answer = ask(Lake(args.lake), args.sql)
    if args.out is not None:
        with (
            replacing(args.out) as temporary,
            temporary.open("w", encoding="utf-8", newline="") as file,
        ):
            csv.writer(file).writerows([answer.names, *answer.rows])
        print(f"{args.out}: {len(answer.rows)} rows")
        return 0
    print(
        "\n".join(table(answer.names, [[*map(_cell, r)] for r in answer.rows]))
    )
    return 0


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value)


@contextmanager
def _owning(lake: Lake) -> Iterator[None]:
    """Let no other command write *lake* meanwhile.

    Raises:
        StateLockedError: one does.
    """
    try:
        own = lock(lake.root / "lake")
    except StateLockedError as error:
        msg = f"{lake.root}: another 'bstm fleet' writes it (lake.lock)"
        raise StateLockedError(msg) from error
    with closing(own):
        yield


def _counts(outcome: Outcome) -> str:
    parts = (
        (outcome.made, "replayed"),
        (outcome.current, "up to date"),
        (len(outcome.failures), "failed"),
        (outcome.waiting, "waiting"),
    )
    return ", ".join(f"{n} {what}" for n, what in parts if n) or "no drive"


def _list(what: str, found: list[str]) -> None:
    if found:
        more = len(found) - FAILURES_SHOWN
        lines = found[:FAILURES_SHOWN] + [f"and {more} more"] * (more > 0)
        print("\n".join([f"{what}:", *wrapped(lines)]))

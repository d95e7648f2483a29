"""Hidden effects: does ``bstm gap`` name what the reality has and hides.

A car drawn around the nominal one; a configuration matched on two drives of
it without the effect, its tunables then off by a little; two drives with the
effect switched on in the reality (other code and other forms than the
catalogue's); and two held-out drives of another kind. Groups:

S0  nothing hidden                        SO  S1, the true kind unknown
S1  one effect, strength 0.3 to 2         SX  S1, one drive only
S2  two effects                           RT  road, all its effects at once
SU  an effect that no catalogue has       ST  one of a pair of structural twins
zero  S1 with the effect at strength 0
AD  the drive that is advised after one drive, beside every other

    python tests/benchmarks/gap.py --groups S1 S0 --cases 2 --cache FOLDER
    python tests/benchmarks/gap.py --groups stratified --sensors n3 \
        --cache FOLDER
    python tests/benchmarks/gap.py --groups stratified --nodes disc fluid \
        --cache FOLDER
    python tests/benchmarks/gap.py --protocol --cache FOLDER \
        --write docs/evidence-gap.md

What the drives of a case show is kept in the folder, so a run goes on where
it was stopped; answers are found anew when the search has changed. Cars and
seeds of the split ``reported`` are for reporting: develop on
``--split development``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gap_advice import next_drive
from gap_cars import OF_TEMPERATURES, SPLITS, Garage, World, keep
from gap_cases import DRAWS, Case, cost_file, evidence
from gap_figures import figures
from gap_judge import Result, judged, results_of
from gap_page import write
from gap_selection import (
    ADVISED_CASES,
    STRATIFIED,
    cases_of,
    open_cases,
    protocol,
    sample,
    stratified,
)
from gap_shown import fits_fingerprint, shown
from gap_tables import tables
from side_by_side import Goal, Outcome

import bstm_daemon
from bstm_daemon.roles import MEASURED_NODES
from bstm_daemon.simulation.parameters import (
    EFFECT_NAMES,
    PRESETS,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

STRUCTURES: Final = ("thesis", "extended")
CONTROLS: Final = 1
"""Cases of each effect that also serve the controls."""


@cache
def fingerprint() -> str:
    """Return what tells one state of the search from another."""
    package = Path(bstm_daemon.__file__).parent
    digest = hashlib.sha256()
    for file in sorted((package / "analysis" / "gap").glob("*.py")):
        digest.update(file.read_bytes())
    for name in (
        "gap_cases.py", "gap_judge.py", "gap_limits.py", "gap_rivals.py",
    ):  # fmt: skip
        digest.update((Path(__file__).parent / name).read_bytes())
    return digest.hexdigest()[:12]


def judge(
    garage: Garage, case: Case, folder: Path, *, fitted: bool
) -> list[Result]:
    """Return the results of *case*, kept ones where the search is the same."""
    kept = folder / f"{case.key}.json"
    found: list[Result] = []
    search_s = None
    if kept.exists():
        data = json.loads(kept.read_text("utf-8"))
        if data["search"] == fingerprint():
            found = [Result(**one) for one in data["results"]]
            search_s = data["seconds"][1]
    lacking = [o for o in found if fitted and lacks_fits(o)]
    if found and not lacking:
        return found
    if not found:
        evidence(case, garage, folder)
        begin_s = time.process_time()
        found = results_of(
            case, garage, folder, controls=case.number < CONTROLS
        )
        search_s = time.process_time() - begin_s
        lacking = [o for o in found if fitted and lacks_fits(o)]
    if lacking:
        whole = judged(case, garage, evidence(case, garage, folder))
        for one in lacking:
            one.shown.update(shown(case, garage, whole, one, folder))
    data = {
        "search": fingerprint(),
        "world": asdict(case.world),
        "seconds": [drives_s(case, folder), search_s],
        "results": [asdict(one) for one in found],
    }
    keep(kept, (json.dumps(data) + "\n").encode())
    return found


def drives_s(case: Case, folder: Path) -> float | None:
    """Return the CPU time [s] of the drives of *case*; None if unknown."""
    file = cost_file(case, folder)
    if not file.exists():
        return None
    seconds: float = json.loads(file.read_text("utf-8"))
    return seconds


def lacks_fits(one: Result) -> bool:
    """Whether *one* could be seen, or is named right, and is not fitted."""
    wanted = one.group == "S1" and (
        one.detectable or (one.answer == "name" and one.score == 1.0)
    )
    return wanted and one.shown.get("fits") != fits_fingerprint()


def of_car(
    cases: Sequence[Case],
    folder: Path,
    until_s: float,
    *,
    fitted: bool,
    advised: bool = False,
) -> list[Result]:
    """Run *cases*, all of one car, as long as there is time."""
    garage = Garage(cases[0].world, cases[0].car, folder)
    found = []
    for case in cases:
        if time.time() > until_s:
            break
        if advised:
            found += next_drive(garage, case, folder, fingerprint())
        else:
            found += judge(garage, case, folder, fitted=fitted)
    return found


def all_results(
    cases: Sequence[Case],
    folder: Path,
    jobs: int,
    *,
    until_s: float = float("inf"),
    fitted: bool = True,
    advised: bool = False,
) -> list[Result]:
    """Run *cases*, as many cars at once as *jobs*.

    *fitted*: what can be seen on held-out drives too; *advised*: only the
    next drive, of effects that change temperatures alone.
    """
    folder.mkdir(parents=True, exist_ok=True)
    by_car: dict[tuple[World, int], list[Case]] = defaultdict(list)
    # a change of the bus' samples takes ten times as long: last
    for case in sorted(
        cases, key=lambda one: not set(one.effects) <= OF_TEMPERATURES
    ):
        by_car[case.world, case.car].append(case)
    lots = list(by_car.values())
    one = partial(of_car, fitted=fitted, advised=advised)
    if jobs == 1:
        pool, done = None, (one(lot, folder, until_s) for lot in lots)
    else:
        pool = ProcessPoolExecutor(jobs)
        futures = [pool.submit(one, lot, folder, until_s) for lot in lots]
        done = (future.result() for future in futures)
    found: list[Result] = []
    try:
        for number, (lot, results) in enumerate(zip(lots, done, strict=True)):
            found += results
            sys.stderr.write(
                f"{number + 1} of {len(lots)} cars: {len(lot)} cases of "
                f"{lot[0].world}\n"
            )
    finally:
        if pool:
            pool.shutdown(cancel_futures=True)
    return found


def run(*, full: bool) -> Outcome:
    """Return the sample; *full*: two of each effect, and the pairs."""
    cases = sample()
    if full:
        cases = cases_of(World(), ("S1", "S2", "S0"), 2, EFFECT_NAMES)
    kept = os.environ.get("BSTM_GAP_CACHE")
    with tempfile.TemporaryDirectory() as temporary:
        results = all_results(
            cases, Path(kept or temporary), os.cpu_count() or 1, fitted=full
        )
    outcome = Outcome(
        "Hidden effects",
        f"{len(cases)} cases on plain with structure thesis, sensors n2; "
        "95 % intervals of Wilson.",
    )
    outcome.tables = tables(results)
    outcome.goals = goals(results)
    return outcome


def goals(results: Sequence[Result]) -> list[Goal]:
    """Return the levels below which something has broken."""
    by_name = {one.name: one.share for one in figures(results)}
    quiet = 1.0 - by_name["S0, anything reported"].value
    named = by_name["S1, right name or class of two"].value
    honest = 1.0 - by_name["S1, wrong single name, all cases"].value
    return [
        Goal("nothing said where nothing is hidden", quiet, 1.0, 0.01),
        Goal("named right, detectable cases", named, 0.95, 0.25),
        Goal("no wrong single name", honest, 0.98, 0.06),
    ]


def main() -> None:
    """Run the cases that the arguments ask for and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--groups",
        nargs="+",
        choices=(
            *("S1", "S0", "S2", "SU", "ST", "RT", "AD", "zero"),
            *("sample", "stratified"),
        ),
        default=[],
        help=(
            "S1 also serves SO, SX and the controls; stratified: "
            f"{STRATIFIED} cases of S1, S2, S0 and SU"
        ),
    )
    parser.add_argument(
        "--protocol", action="store_true", help="all that is reported"
    )
    parser.add_argument(
        "--cases",
        type=int,
        default=1,
        metavar="N",
        help=f"of each effect or pair; S0: cars of {DRAWS} cases each; AD: "
        "in all",
    )
    parser.add_argument("--preset", choices=tuple(PRESETS), default="plain")
    parser.add_argument("--structure", choices=STRUCTURES, default="thesis")
    parser.add_argument("--sensors", default="n2", help="n1 to n4")
    parser.add_argument(
        "--nodes",
        nargs="+",
        choices=MEASURED_NODES,
        default=(),
        help="where thermocouples are, by default everywhere",
    )
    parser.add_argument("--split", choices=tuple(SPLITS), default="reported")
    parser.add_argument("--cache", type=Path, required=True)
    parser.add_argument("--effects", nargs="*", default=EFFECT_NAMES)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--seconds", type=float, default=float("inf"), help="stop after them"
    )
    parser.add_argument(
        "--no-fit", action="store_true", help="names only, no held-out drives"
    )
    parser.add_argument(
        "--write", type=Path, metavar="FILE", help="all that is kept, into it"
    )
    args = parser.parse_args()
    world = World(
        args.preset,
        args.structure,
        args.sensors,
        args.split,
        tuple(args.nodes),
    )
    cases = cases_of(world, args.groups, args.cases, args.effects)
    if "sample" in args.groups:
        cases += sample()
    if "stratified" in args.groups:
        cases += stratified(world)
    if args.protocol:
        cases += protocol(args.split)
    until_s = time.time() + args.seconds
    results = all_results(
        cases,
        args.cache,
        args.jobs,
        until_s=until_s,
        fitted=not args.no_fit,
    )
    if "AD" in args.groups or args.protocol:
        count = ADVISED_CASES if args.protocol else args.cases
        results += all_results(
            open_cases(world, count, args.effects),
            args.cache,
            args.jobs,
            until_s=until_s,
            advised=True,
        )
    # of several worlds only the page tells them apart
    for table in tables(results) if results and not args.protocol else []:
        for row in ((table.title,), table.header, *table.rows):
            sys.stdout.write("  ".join(row) + "\n")
    if args.write:
        write(args.cache, args.write, args.split, fingerprint())


if __name__ == "__main__":
    main()

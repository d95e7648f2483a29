"""A whole replay, from the log file to results on disk, stage by stage."""

from __future__ import annotations

import tempfile
from functools import partial
from itertools import product
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Any, Final, TypeVar

from log_decode import with_cantools
from recordings import SENSORS, encoder
from side_by_side import Goal, Outcome, Table, three_digits
from traffic import FRAMES_PER_S, RATES_HZ, write_traffic

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.files import shipped_file
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.replay.columns import present_roles, stream_log
from bstm_daemon.replay.results import (
    WRITERS,
    Collector,
    ResultsBuilder,
)
from bstm_daemon.report.drive_statistics import DriveStatistics
from bstm_daemon.simulation import load_drive, parse_drive, simulate
from bstm_daemon.simulation.recorder import write_candump

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from contextlib import AbstractContextManager

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.native.loader import Kernel
    from bstm_daemon.replay.results import Results, Sink

STAGES = (
    *("read and decode", "pass over samples", "march", "publications"),
    *("columns", "summary", "write CSV", "write Parquet"),
)
"""``publications`` is what the estimator does around pass and march."""

WITH_RISK: Final = {
    "city": 1000.0,
    "rich": 1000.0,
    "long-run": 1000.0,
    "parked": 1000.0,
    "simalp": 400.0,
    "grossglockner": 400.0,
}
"""Real-time factor of a replay with risk that the whole benchmark asks of each
drive."""

LIGHTER: Final = 0.96
"""Mass of a right disc as a share of the left one's, where sides are apart."""

PARKED: Final = """
[drive]
name = "parked"
description = "three hours at rest after a short drive"
[[segment]]
speed_kmh = 50
rate_ms2 = 1.5
duration_s = 60
[[segment]]
speed_kmh = 0
rate_ms2 = 3.0
[[segment]]
parked = true
duration_s = 10800
"""

T = TypeVar("T")


class TimedKernel:
    """The compiled kernel with the CPU seconds spent in it."""

    def __init__(self, kernel: Kernel) -> None:
        """Start at zero."""
        self.kernel = kernel
        self.seconds = dict.fromkeys(("pass over samples", "march"), 0.0)

    def sample_pass(self, *args: Any) -> tuple[int, int, int]:
        """Pass over samples."""
        before = process_time()
        found = self.kernel.sample_pass(*args)
        self.seconds["pass over samples"] += process_time() - before
        return found

    def march(self, *args: Any) -> None:
        """March a batch."""
        before = process_time()
        self.kernel.march(*args)
        self.seconds["march"] += process_time() - before


def run(*, full: bool) -> Outcome:
    """Measure an hour of traffic (quick: five minutes), four corners."""
    vehicle = load_vehicle(shipped_file("config/example_vehicle.toml"))
    config, signal_map = vehicle
    seconds = 3600 if full else 300
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mixed.log"
        write_traffic(path, seconds, config)
        rounds = [
            replay_stages(config, signal_map, path)
            for _ in range(3 if full else 2)
        ]
        stages = min(rounds, key=lambda stage: sum(stage.values()))
        heat = config.heat.model_copy(update={"mode": "fused"})
        fused = config.model_copy(update={"heat": heat})
        fused_s = min(
            _to_parquet(replay_stages(fused, signal_map, path))
            for _ in range(3 if full else 2)
        )
        before = process_time()
        with_cantools(path, signal_map)
        others_s = process_time() - before
    to_parquet = _to_parquet(stages)
    to_csv = sum(stages.values()) - stages["write Parquet"]
    outcome = Outcome(
        "Replay",
        f"{seconds / 60:.0f} min of candump, {FRAMES_PER_S} frames a second, "
        f"{sum(RATES_HZ.values())} wanted; four corners, step 0.05 s, ten "
        "rows a second; the compiled kernel. Compared with python-can and "
        "cantools decoding the same log once and doing nothing else. The "
        f"quickest of {len(rounds)} rounds, not the median.",
    )
    outcome.goals = [
        Goal(
            "replay to Parquet against python-can with cantools decoding",
            others_s / to_parquet,
            at_least=10.0,
            tolerance=0.5,
        ),
        Goal(
            "replay to Parquet with observer and fusion against real time",
            seconds / fused_s,
            at_least=1000.0,
            tolerance=0.5,
        ),
    ]
    cars = {"alike": config, "apart": sides_apart(config)}
    drives = {
        (name, *of): factors
        for name in (WITH_RISK if full else ())
        for of, factors in with_risk(cars, signal_map, name).items()
    }
    outcome.goals += [
        Goal(
            f"{name} with risk, sides {sides}, start {start}, "
            f"against {WITH_RISK[name]:.0f}",
            risk / WITH_RISK[name],
            at_least=1.0,
            tolerance=0.5,
        )
        for (name, sides, start), (risk, _) in drives.items()
    ]
    with_forecast = (
        Table(
            "Real-time factor with risk, forecast and advice, to Parquet",
            ("drive", "sides", "start", "factor", "with --no-forecast"),
            tuple(
                (*of, f"{risk:.0f}x", f"{plain:.0f}x")
                for of, (risk, plain) in drives.items()
            ),
        ),
    )
    outcome.tables = [
        *(with_forecast if full else ()),
        Table(
            "CPU time of the stages",
            ("stage", "ms per hour of log", "share to Parquet"),
            tuple(
                (
                    stage,
                    three_digits(stages[stage] * 3.6e6 / seconds),
                    ""
                    if stage == "write CSV"
                    else f"{stages[stage] / to_parquet:.0%}",
                )
                for stage in STAGES
            ),
        ),
        Table(
            "Real-time factor on one core",
            ("to", "factor"),
            (
                ("Parquet", f"{seconds / to_parquet:.0f}x"),
                ("CSV", f"{seconds / to_csv:.0f}x"),
                (
                    "Parquet, mode fused (observer and fusion)",
                    f"{seconds / fused_s:.0f}x",
                ),
                (
                    "samples, with python-can and cantools",
                    f"{seconds / others_s:.0f}x",
                ),
            ),
        ),
    ]
    return outcome


def sides_apart(config: Config) -> Config:
    """Return a car whose right discs are lighter than its left ones.

    Corners alike are marched once: those of a car that was matched are not.
    """
    corners = [
        corner.model_copy(
            update={
                "disc": corner.disc.model_copy(
                    update={"mass_kg": LIGHTER * corner.disc.mass_kg}
                )
            }
        )
        if corner.name in {"FR", "RR"}
        else corner
        for corner in config.corner
    ]
    return config.model_copy(update={"corner": corners})


def with_risk(
    cars: Mapping[str, Config], signal_map: SignalMap, name: str
) -> dict[tuple[str, str], tuple[float, float]]:
    """Return the real-time factors of a drive with and without a forecast.

    By name of the car and by what is known of the start.
    """
    known = parse_drive(PARKED, name) if name == "parked" else load_drive(name)
    drive = simulate(known, sensors=SENSORS)
    seconds = float(drive.time_s[-1])
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.log"
        write_candump(path, drive, encoder())
        written = path.with_suffix(".parquet")
        for of in product(cars, ("unknown", "cold")):
            spent_s = []
            for forecast in (True, False):
                before = process_time()
                with WRITERS["parquet"](written) as table:
                    stream_log(
                        *(cars[of[0]], signal_map, path, [table]),
                        state="cold" if of[1] == "cold" else None,
                        forecast=forecast,
                    )
                spent_s.append(process_time() - before)
            found[of] = seconds / spent_s[0], seconds / spent_s[1]
    return found


def replay_stages(
    config: Config, signal_map: SignalMap, path: Path
) -> dict[str, float]:
    """Return the CPU seconds of each stage, in the order of a replay."""
    kernel = load_kernel("compiled")
    assert kernel is not None
    timed = TimedKernel(kernel)
    estimator = Estimator(config, present_roles(signal_map))
    estimator._coupling._kernel = timed  # type: ignore[assignment]
    for batch, _ in estimator.batches:
        batch.kernel = timed  # type: ignore[assignment]
    kept = Collector()
    builder = ResultsBuilder(estimator, [kept])
    log = iter(EventLog(path, signal_map).events())
    seconds = dict.fromkeys(STAGES, 0.0)

    def spend(stage: str, work: Callable[[], T]) -> T:
        before = process_time()
        found = work()
        seconds[stage] += process_time() - before
        return found

    while True:
        events = spend("read and decode", lambda: next(log, None))
        if events is None:
            break
        advance = partial(
            estimator.advance, events.time_us, events.role, events.value
        )
        blocks = spend("publications", advance)
        spend("columns", partial(builder.add, blocks))
    spend("columns", builder.finish)
    for stage, spent in timed.seconds.items():
        seconds[stage] += spent
        seconds["publications"] -= spent
    results = kept.results()
    statistics = DriveStatistics()
    spend("summary", partial(statistics.write, results))
    summary = statistics.summary()
    out = path.with_suffix(".out")
    for stage, opened in (
        ("write CSV", WRITERS["csv"]),
        ("write Parquet", WRITERS["parquet"]),
    ):
        spend(stage, partial(_write, opened, out, results))
    hottest = summary.corners[0].peaks["disc"].temperature_c
    if not 100.0 < hottest < 900.0:
        msg = f"not a replay: disc at {hottest:.0f} degC"
        raise AssertionError(msg)
    return seconds


def _to_parquet(stages: dict[str, float]) -> float:
    return sum(stages.values()) - stages["write CSV"]


def _write(
    opened: Callable[[Path], AbstractContextManager[Sink]],
    path: Path,
    results: Results,
) -> None:
    with opened(path) as table:
        for stretch in results.stretches():
            table.write(stretch)

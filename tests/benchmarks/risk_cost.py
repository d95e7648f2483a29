"""What risk and forecast cost: CPU time of this process, no other clock."""

from __future__ import annotations

import gc
import tempfile
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from time import process_time, process_time_ns
from typing import TYPE_CHECKING, Final

import numpy as np
from recordings import SENSORS, encoder
from side_by_side import Goal, Outcome, Table

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast.monitor import RiskMonitor
from bstm_daemon.replay.columns import present_roles, stream_log
from bstm_daemon.replay.results import Collector
from bstm_daemon.simulation import load_drive, simulate
from bstm_daemon.simulation.recorder import write_candump

if TYPE_CHECKING:
    import numpy.typing as npt

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

DRIVE: Final = "simalp"
FORECAST_MS: Final = 50.0
PUBLICATION_MS: Final = 5.0
CORE: Final = 0.01
REAL_TIME: Final = 120.0
HEAT: Final = 5.0


def run(*, full: bool) -> Outcome:
    """Measure a drive of 85 min (quick: its begin), four corners."""
    car = shipped_file("config/example_vehicle.toml")
    config, signal_map = load_vehicle(car)
    drive = simulate(load_drive(DRIVE), sensors=SENSORS)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{DRIVE}.log"
        write_candump(path, drive, encoder())
        each_ms, forecasts = _publications(
            config, signal_map, path, np.inf if full else 500.0
        )
        before = process_time()
        stream_log(config, signal_map, path, [Collector()])
        between = process_time()
        stream_log(config, signal_map, path, [Collector()], forecast=False)
        after = process_time()
        with redirect_stdout(StringIO()):
            main(["heat", str(path), "-c", str(car)])
        heat_s = process_time() - after
    seconds = float(drive.time_s[-1])
    quick = np.median(each_ms)
    forecast_ms = (each_ms - quick).clip(0.0).sum() / forecasts
    all_ms = each_ms.sum() / forecasts
    core = each_ms.sum() / len(each_ms) / 100.0
    with_risk, without = (
        seconds / (between - before),
        seconds / (after - between),
    )
    outcome = Outcome(
        "Risk and forecast",
        f"{DRIVE}, four corners, {config.forecast.members} members each, "
        "compiled; a publication every 0.1 s, one at a time",
    )
    outcome.tables = [
        Table(
            "CPU time",
            ("what", "found", "goal"),
            (
                (
                    "a forecast of four corners, both cases, ms",
                    f"{forecast_ms:.1f}",
                    f"{FORECAST_MS:.0f}",
                ),
                (
                    "the same with all that is told in 10 s, ms",
                    f"{all_ms:.1f}",
                    "",
                ),
                (
                    "largest share of a publication, ms",
                    f"{each_ms.max():.1f}",
                    f"{PUBLICATION_MS:.0f}",
                ),
                (
                    "99.9 % of the publications below, ms",
                    f"{np.quantile(each_ms, 0.999):.1f}",
                    "",
                ),
                ("share of a core", f"{core:.2%}", f"{CORE:.0%}"),
                (
                    "replay with risk and advice over real time",
                    f"{with_risk:.0f}",
                    f"{REAL_TIME:.0f}",
                ),
                ("the same with --no-forecast", f"{without:.0f}", ""),
                (
                    "replay with risk and advice over bstm heat",
                    f"{(between - before) / heat_s:.1f}",
                    f"{HEAT:.0f}",
                ),
            ),
        )
    ]
    outcome.goals = [
        Goal("50 ms over a forecast", FORECAST_MS / forecast_ms, 1.0, 0.5),
        Goal(
            "5 ms over a publication's share, 99.9 % of them",
            PUBLICATION_MS / np.quantile(each_ms, 0.999),
            1.0,
            0.5,
        ),
        Goal("1 % over the share of a core", CORE / core, 1.0, 0.5),
        Goal("replay with risk over 120", with_risk / REAL_TIME, 1.0, 0.5),
        Goal("heat over replay", (between - before) / heat_s, HEAT, 0.25),
    ]
    return outcome


def _publications(
    config: Config, signal_map: SignalMap, path: Path, until_s: float
) -> tuple[npt.NDArray[np.float64], int]:
    """Return the CPU time of each publication's risk [ms], and forecasts."""
    estimator = Estimator(config, present_roles(signal_map))
    monitor = RiskMonitor(config, estimator)
    each: list[int] = []
    begun = set()
    first_us: int | None = None
    # as the service does once it is ready
    gc.freeze()
    for events in EventLog(path, signal_map, None).events():
        start_us, end_us = int(events.time_us[0]), int(events.time_us[-1])
        first_us = start_us if first_us is None else first_us
        if start_us - first_us > until_s * 1e6:
            break
        cuts = np.arange(start_us, end_us + 200_000, 100_000)
        places = np.searchsorted(events.time_us, cuts).tolist()
        for part in map(slice, places[:-1], places[1:]):
            for block in estimator.advance(
                events.time_us[part], events.role[part], events.value[part]
            ):
                before = process_time_ns()
                risks = monitor.add(block)
                spent = process_time_ns() - before
                each += [spent // len(risks)] * len(risks)
                begun.add(risks[-1].forecast_us)
    gc.unfreeze()
    return np.array(each) * 1e-6, len(begun - {None})

"""Simulated drives as they were recorded: the log, and the truth beside it.

A drive does not depend on what is made of its log, so that one recording
serves every structure and every source of heat.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import tempfile
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from bstm_daemon.analysis.matching.verification import NODES
from bstm_daemon.files import shipped_file
from bstm_daemon.simulation import load_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from bstm_daemon.simulation.vehicle import CarParameters

T = TypeVar("T")

ROOT: Final = Path(__file__).parents[2]
SENSORS: Final = "n2"
CORNERS: Final = ("FL", "FR")
POWER_S: Final = 0.1
"""Step of the kept brake energy; half a step is the least that is asked."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A drive's log and its truth.

    ``truth_c`` [degC] at ``slow_time_s`` (1 Hz) by ``<corner>.<node>``;
    ``energy_j`` the true friction energy by corner at ``time_s``, since the
    start.
    """

    path: Path
    slow_time_s: np.ndarray
    truth_c: dict[str, np.ndarray]
    time_s: np.ndarray
    energy_j: dict[str, np.ndarray]


def cache_folder() -> Path | None:
    """Return where results are kept: BSTM_POPULATION_CACHE, if it is set."""
    folder = os.environ.get("BSTM_POPULATION_CACHE")
    if not folder:
        return None
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    return path


@cache
def source_key(*patterns: str) -> str:
    """Return a hash over the text of the package's files of *patterns*."""
    digest = hashlib.sha256()
    for pattern in patterns:
        paths = sorted((ROOT / "bstm_daemon").glob(pattern))
        if not paths:
            raise FileNotFoundError(pattern)
        for path in paths:
            digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def kept(text: str, make: Callable[[], T], *patterns: str) -> T:
    """Return what *make* makes, of an earlier run where it is kept.

    It is known by *text* and the package's sources of *patterns*.
    """
    folder = cache_folder()
    if folder is None:
        return make()
    whole = f"{text} {source_key(*patterns)}"
    path = folder / f"{hashlib.sha256(whole.encode()).hexdigest()[:16]}.pickle"
    if path.exists():
        found: T = pickle.loads(path.read_bytes())  # noqa: S301  (our own)
        return found
    made = make()
    part = path.with_suffix(f".{os.getpid()}")
    part.write_bytes(pickle.dumps(made))
    part.replace(path)
    return made


@contextmanager
def recorded(
    name: str, car: CarParameters | None, preset: str, seed: int
) -> Iterator[Recording]:
    """Give drive *name* of *car* (None: the drive's own); kept where asked."""
    folder = cache_folder()
    if folder is None:
        with tempfile.TemporaryDirectory() as made:
            yield _record(Path(made), name, car, preset, seed)
        return
    sources = source_key("simulation/**/*.py", "simulation/**/*.toml")
    text = f"{name} {car} {preset} {seed} {SENSORS} {sources}"
    own = folder / hashlib.sha256(text.encode()).hexdigest()[:16]
    done = own / "truth.pickle"
    if not done.exists():
        own.mkdir(exist_ok=True)
        made_now = _record(own, name, car, preset, seed)
        part = own / "truth.part"
        part.write_bytes(pickle.dumps(made_now))
        part.replace(done)
    yield pickle.loads(done.read_bytes())  # noqa: S301  (our own)


def _record(
    folder: Path, name: str, car: CarParameters | None, preset: str, seed: int
) -> Recording:
    whole = simulate(
        load_drive(name), car, preset=preset, sensors=SENSORS, seed=seed
    )
    path = folder / f"{name}.log"
    write_candump(path, whole, encoder())
    time_s = np.concatenate(([0.0], whole.time_s))
    step_s = np.diff(time_s)
    grid_s = np.arange(0.0, time_s[-1] + POWER_S, POWER_S)
    energy_j = {}
    for lane, corner in enumerate(("FL", "FR", "RL", "RR")):
        sums = np.cumsum(whole.brake_power_w[:, lane] * step_s)
        summed = np.concatenate(([0.0], sums))
        energy_j[corner] = np.interp(grid_s, time_s, summed)
    return Recording(
        path,
        whole.slow_time_s,
        {
            f"{corner}.{node}": whole.truth[f"{corner}.{node}"] - KELVIN_OFFSET
            for corner in CORNERS
            for node in NODES
        },
        grid_s,
        energy_j,
    )


@cache
def encoder() -> Encoder:
    """Return the encoder of the example car's frames."""
    return Encoder(shipped_file("dbc/example_vehicle.dbc"))

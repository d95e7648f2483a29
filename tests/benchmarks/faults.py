"""The campaign of single faults: seen, safe, or silent.

``faults.py [--full] [--share X] [--drives NAME...] [--modes NAME...]
[--cars NAME...] [--jobs N] [--out FILE]``.
A car drives in the independent reality; one fault begins at an onset and
stays. A run is *silent* where the fluid is more than 10 K or the disc more
than 60 K too low at an instant at which the corner is valid; *seen* where the
corner was degraded or invalid by then; *safe* where it never comes to that.
Healthy time counts as degraded where a corner has another reason than
*unverified*: that says of a drive on which no mapped role can check an input,
as one at a constant speed without a bend, nothing that is wrong.
Findings are kept in ``.ci/cache`` until a source changes, so a run goes on
where the last one ended; ``--share`` takes that part of the cases of each
kind, drawn with a seed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import zlib
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from fault_kinds import FAULTS, RATE_HZ, WHEELS, Fault, Recording
from heat_case import configured, hypercube
from measurements import markdown
from side_by_side import Goal, Outcome, Table

from bstm_daemon.config.heat import automatic_mode
from bstm_daemon.estimate import Reason, Validity
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.model.heat.memory import SampleState
from bstm_daemon.roles import ROLE_INDEX, ROLES
from bstm_daemon.simulation import load_drive, simulate
from bstm_daemon.simulation.profile import SAMPLE_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation import SimulatedDrive
    from bstm_daemon.simulation.materials import Array

FLUID_K: Final = 10.0
DISC_K: Final = 60.0
OVER_K: Final = 30.0
WHOLE: Final = 0.9
"""Too low by more than the first two, the fluid too high by the third; a drive
that is degraded for more than the last is so throughout."""

ROOT: Final = Path(__file__).resolve().parents[2]
STORE: Final = ROOT / ".ci" / "cache" / "faults.jsonl"
SOURCES: Final = (
    *("bstm_daemon", "config", "dbc"),
    *(f"tests/benchmarks/{name}.py" for name in ("faults", "fault_kinds")),
    "tests/benchmarks/heat_case.py",
)

HEALTHY_CARS: Final = 20
HEALTHY_SENSORS: Final = ("n1", "n2", "n3", "n4")
"""Drives without a fault: cars that the configuration is wrong for."""

START_US: Final = 1_700_000_000_000_000
EVERY: Final = round(1.0 / SAMPLE_S / RATE_HZ)

INPUTS: Final[dict[str, tuple[str, ...]]] = {
    "all": (
        *WHEELS,
        *("vehicle_speed", "gnss_speed"),
        *("primary_pressure", "secondary_pressure"),
        *("acceleration_longitudinal", "acceleration_lateral", "yaw_rate"),
        *("powertrain_torque", "motor_torque", "engine_speed", "gear"),
        *("clutch_open", "brake_torque", "external_force"),
        *("ambient_temperature", "rain", "brake_switch"),
        *("brake_pedal_travel", "park_brake", "abs_active", "esc_active"),
        *("tc_active", "ignition"),
    ),
    "thesis": (
        *WHEELS,
        *("primary_pressure", "acceleration_longitudinal"),
        "powertrain_torque",
    ),
}
"""What the example car maps, and the four roles of the thesis."""

DRIVES: Final = ("alpine-descent", "simalp", "grossglockner")
FORMED: Final = ("ff", "fb", "fused")
MODES: Final = ("auto", *FORMED)
"""Heat modes; measured discs are another matter, and "auto" is one of them."""

CARS: Final[dict[str, tuple[int | None, int]]] = {
    "example": (None, 1),
    "foreign": (3, 3),
}
"""Number and seed of the configured car, and of the first healthy one whose
discs stay below 700 degC on all drives. With a fault the second has learned on
LEARNING before, as a car in use has. Its circuits, if both are mapped, cross
the car."""

SECONDARY: Final = ("FR", "RL")

LEARNING: Final = "city"

ONSETS: Final = (0.0, 0.35)
"""From the begin, or after this share of the driving, which no parking is."""


MOVING_MS: Final = 0.5
EARLIEST: Final = 0.1
"""Onset of holes and steps of the clock, at the earliest."""

_INTERRUPTIONS: Final = {
    fault.name
    for fault in FAULTS
    if fault.name.startswith(("a hole", "the clock"))
}


@dataclass(frozen=True)
class Case:
    """One run; ``fault`` is a name, or None for a drive without.

    ``car`` is the number of a car that differs from the configuration in
    mass, friction, drag and rolling; without it the configured one drives.
    """

    fault: str | None
    inputs: str
    mode: str
    drive: str
    onset: float
    sensors: str = "n1"
    seed: int = 1
    car: int | None = None


@dataclass
class Finding:
    """What became of a case.

    ``fluid_k`` and ``disc_k`` are the largest under-estimates at which the
    corner was valid, ``over_k`` the largest over-estimate of the fluid at
    which it was; ``unseen_s`` for how long it was silent, ``flagged`` the
    share of the time after the onset that no corner was valid, ``doubted``
    that of the corners' time, of ``driven_s``, at which they were not for
    another reason than ``unverified``, and that where this was the only one.
    """

    case: dict[str, Any]
    fluid_k: float
    disc_k: float
    over_k: float
    unseen_s: float
    flagged: float
    doubted: float
    unverified: float
    driven_s: float
    hottest_k: float

    @property
    def silent(self) -> bool:
        """Whether the brakes were hotter than a valid estimate said."""
        return self.fluid_k > FLUID_K or self.disc_k > DISC_K


@lru_cache(len(DRIVES) + 1)
def _driven(
    drive: str, sensors: str, seed: int, car: int | None
) -> SimulatedDrive:
    drawn = None if car is None else hypercube(HEALTHY_CARS, seed)[car].car()
    return simulate(load_drive(drive), drawn, sensors=sensors, seed=seed)


@lru_cache(len(INPUTS))
def _learned(
    inputs: str, mode: str, sensors: str, seed: int, car: int
) -> list[float] | None:
    """Return what is learned of *car* on a drive without a fault."""
    driven = _driven(LEARNING, sensors, seed, car)
    *columns, present = samples(recorded(driven, inputs))
    config = _configured(mode, inputs, car)
    estimator = Estimator(config, present, judged=False)
    estimator.advance(*columns)
    return estimator.samples.learned()


def recorded(driven: SimulatedDrive, inputs: str) -> Recording:
    """Return what the bus carries of *driven*."""
    stamps = START_US + np.rint(driven.time_s[::EVERY] * 1e6).astype(np.int64)
    on = driven.bus_on[::EVERY]
    return Recording(
        stamps,
        {
            role: np.where(on, driven.roles[role][::EVERY], np.nan)
            for role in INPUTS[inputs]
            if role in driven.roles
        },
    )


def samples(record: Recording) -> tuple[Array, Array, Array, dict[int, int]]:
    """Return stamps, roles and values in the order of the bus; time-outs."""
    streams = [(role, values) for role, values in record.signals.items()]
    streams += list(record.second.items())
    numbers = np.array([ROLE_INDEX[role] for role, _ in streams], np.int32)
    values = np.column_stack([values for _, values in streams]).ravel()
    times = np.repeat(record.stamp_us, len(streams))
    roles = np.tile(numbers, len(record.stamp_us))
    sent = ~np.isnan(values)
    present = {
        ROLE_INDEX[role]: round(ROLES[ROLE_INDEX[role]].timeout_s * 1e6)
        for role in record.signals
    }
    return times[sent], roles[sent], values[sent], present


def true_times(record: Recording, before: Recording, times: Array) -> Array:
    """Return when each publication really was [us]; nan within a jump."""
    step = record.stamp_us - before.stamp_us
    if not step.any():
        return times.astype(np.float64)
    first = int(np.argmax(step != 0))
    ahead = int(step[first])
    after = np.zeros(len(times), bool)
    if ahead > 0:
        after = times >= record.stamp_us[first]
        gap = (times > before.stamp_us[first]) & ~after
    else:
        back = np.flatnonzero(np.diff(times) < 0)
        if len(back):
            after[back[0] + 1 :] = True
        gap = np.zeros(len(times), bool)
    real = np.where(after, times - ahead, times).astype(np.float64)
    real[gap] = np.nan
    return real


def judge(case: Case) -> Finding:
    """Run one case."""
    driven = _driven(case.drive, case.sensors, case.seed, case.car)
    before = recorded(driven, case.inputs)
    record = before.copy()
    # what has not begun to come cannot stop
    least = EARLIEST if case.fault in _INTERRUPTIONS else 0.0
    moving = np.flatnonzero(record.signals[WHEELS[0]] > MOVING_MS)
    first = round(max(case.onset, least) * moving[-1])
    if case.fault is not None:
        stream = np.random.default_rng(
            [case.seed, zlib.crc32(case.fault.encode())]
        )
        _fault(case.fault).make(record, first, stream)
    *columns, present = samples(record)
    start_k = float(driven.truth["FL.fluid"][0])
    blocks = _estimator(case, present, start_k).advance(*columns)
    published = np.concatenate(
        [np.frombuffer(block.times_us, "q") for block in blocks]
    )
    real_us = true_times(record, before, published)
    known = ~np.isnan(real_us)
    at_s = (real_us[known] - START_US) * 1e-6
    found = Finding(asdict(case), *(0.0,) * 9)
    after = at_s >= first / RATE_HZ
    flagged = np.ones(len(at_s), bool)
    silent = np.zeros(len(at_s), bool)
    doubted, unverified = [], []
    for corner in blocks[0].layout.modelled:
        validity = np.concatenate([b.validity[corner] for b in blocks])[known]
        why = np.concatenate([b.reasons[corner] for b in blocks])[known]
        valid = validity == Validity.VALID
        alone = ~valid & (why == Reason.UNVERIFIED.value)
        fluid, disc = (_node(blocks, corner, n)[known] for n in NODES)
        truth = driven.truth
        low_k = np.interp(at_s, driven.slow_time_s, truth[f"{corner}.fluid"])
        disc_k = np.interp(at_s, driven.slow_time_s, truth[f"{corner}.disc"])
        under_fluid = np.where(valid, low_k - fluid, 0.0)
        under_disc = np.where(valid, disc_k - disc, 0.0)
        over = np.where(valid, fluid - low_k, 0.0)
        found.fluid_k = max(found.fluid_k, float(under_fluid.max()))
        found.disc_k = max(found.disc_k, float(under_disc.max()))
        found.over_k = max(found.over_k, float(over.max()))
        found.hottest_k = max(found.hottest_k, float(low_k.max()))
        silent |= (under_fluid > FLUID_K) | (under_disc > DISC_K)
        flagged &= ~valid
        doubted.append((~valid & ~alone)[after])
        unverified.append(alone[after])
    found.unseen_s = float(silent.sum()) * 0.1
    if after.any():
        found.flagged = float(flagged[after].mean())
        found.doubted = float(np.mean(doubted))
        found.unverified = float(np.mean(unverified))
    found.driven_s = float(after.sum()) * 0.1
    return found


def _estimator(
    case: Case, present: dict[int, int], start_k: float
) -> Estimator:
    config = _configured(case.mode, case.inputs, case.car)
    found = Estimator(config, present, history_known=True, initial_k=start_k)
    if case.fault is not None and case.car is not None:
        learned = _learned(
            *(case.inputs, case.mode, case.sensors, case.seed, case.car)
        )
        found.samples = SampleState.new(learned)
        found.samples.know_air(start_k)
    return found


def _configured(mode: str, inputs: str, car: int | None) -> Config:
    config = configured(mode)
    if car is None or "secondary_pressure" not in INPUTS[inputs]:
        return config
    corners = [
        one.model_copy(update={"circuit": "secondary"})
        if one.name in SECONDARY
        else one
        for one in config.corner
    ]
    return config.model_copy(update={"corner": corners})


NODES: Final = ("fluid", "disc")


def _node(blocks: Sequence[Any], corner: str, node: str) -> Array:
    parts = []
    for block in blocks:
        number, place, stride, group = block.layout.modelled[corner]
        output = np.frombuffer(block.outputs[number])
        column = place + group.state_names.index(node)
        parts.append(output[column::stride][: len(block.times_us)])
    return np.concatenate(parts)


def _fault(name: str) -> Fault:
    return next(fault for fault in FAULTS if fault.name == name)


def cases(
    *,
    full: bool,
    drives: Sequence[str] = DRIVES,
    modes: Sequence[str] = MODES,
    cars: Sequence[str] = tuple(CARS),
    share: float = 1.0,
) -> list[Case]:
    """Return the campaign or a sample, each drive without a fault too.

    The sample has every fourth kind, on the first drive from its begin. Of the
    campaign *share* takes a part of the cases of each kind, inputs and mode.
    """
    drives = drives if full else drives[:1]
    cars = cars if full else cars[:1]
    chosen = {
        inputs: dict.fromkeys(_is(mode, inputs) for mode in modes)
        for inputs in INPUTS
    }
    found = [
        Case(None, inputs, mode, drive, 0.0)
        for inputs in INPUTS
        for mode in chosen[inputs]
        for drive in drives
    ]
    if full and "fused" in chosen["all"]:
        found += _healthy(drives)
    for fault in FAULTS if full else FAULTS[::4]:
        for inputs, roles in INPUTS.items():
            if not set(fault.roles) <= set(roles):
                continue
            for mode in chosen[inputs]:
                ours = [
                    Case(fault.name, inputs, mode, drive, onset, "n1", seed, n)
                    for n, seed in (CARS[car] for car in cars)
                    for drive in drives
                    for onset in (ONSETS if full else ONSETS[:1])
                ]
                ours.sort(key=lambda case: _key(case, "the draw"))
                found += ours[: max(round(share * len(ours)), 1)]
    return found


def _is(mode: str, inputs: str) -> str:
    """Return which mode *mode* is where *inputs* are mapped."""
    config = configured(mode)
    if mode != "auto":
        return mode
    return automatic_mode(config.heat, config.corner, {*INPUTS[inputs]})


def _healthy(drives: Sequence[str]) -> Iterator[Case]:
    for inputs in INPUTS:
        for sensors in HEALTHY_SENSORS:
            for drive in drives:
                yield Case(None, inputs, "fused", drive, 0.0, sensors, 2)
        for car in range(HEALTHY_CARS):
            sensors = HEALTHY_SENSORS[car % len(HEALTHY_SENSORS)]
            drive = drives[car % len(drives)]
            yield Case(None, inputs, "fused", drive, 0.0, sensors, 3, car)


def _key(case: Case, sources: str) -> str:
    text = json.dumps([sources, asdict(case)])
    return sha256(text.encode()).hexdigest()


def _sources() -> str:
    found = sha256()
    for name in SOURCES:
        path = ROOT / name
        for file in [path] if path.is_file() else sorted(path.rglob("*")):
            if file.suffix in {".py", ".c", ".h", ".toml", ".dbc"}:
                found.update(file.read_bytes())
    return found.hexdigest()


def examined(chosen: Sequence[Case], jobs: int | None = None) -> list[Finding]:
    """Judge all of them that were not judged yet, on *jobs* cores."""
    sources = _sources()
    keys = {_key(case, sources): case for case in chosen}
    STORE.parent.mkdir(parents=True, exist_ok=True)
    known: dict[str, Finding] = {}
    if STORE.exists():
        for line in STORE.read_text("utf-8").splitlines():
            key, finding = json.loads(line)
            if key in keys:
                known[key] = Finding(**finding)
    # a drive is simulated once for all that is done to it
    left = sorted(
        keys.keys() - known.keys(),
        key=lambda key: (
            *(keys[key].drive, keys[key].sensors),
            *(keys[key].seed, keys[key].car or 0, key),
        ),
    )
    with (
        STORE.open("a", encoding="utf-8") as store,
        ProcessPoolExecutor(jobs or os.cpu_count()) as workers,
    ):
        every = workers.map(judge, (keys[key] for key in left))
        for key, finding in zip(left, every, strict=True):
            known[key] = finding
            store.write(json.dumps([key, asdict(finding)]) + "\n")
            store.flush()
    return [known[key] for key in keys]


def run(*, full: bool) -> Outcome:
    """Run the campaign, or a sample of it."""
    return outcome_of(examined(cases(full=full)))


def outcome_of(found: Sequence[Finding]) -> Outcome:
    """Return tables and goals of what was *found*."""
    faulty = [one for one in found if one.case["fault"] is not None]
    healthy = [one for one in found if one.case["fault"] is None]
    outcome = Outcome(
        "Single faults",
        f"{len({one.case['fault'] for one in faulty})} kinds in "
        f"{len(faulty)} runs, {len(healthy)} without a fault; silent: the "
        f"fluid more than {FLUID_K:.0f} K or the disc more than "
        f"{DISC_K:.0f} K too low while valid.",
    )
    outcome.tables = [_by_mode(found), _worst(faulty)]
    share = {inputs: _share(faulty, inputs, "fused") for inputs in INPUTS}
    over = np.mean([one.over_k > OVER_K for one in faulty])
    fused = [one for one in healthy if one.case["mode"] == "fused"]
    doubted = _of_time(fused, "doubted")
    throughout = sum(one.doubted > WHOLE for one in fused) / max(len(fused), 1)
    outcome.goals = [
        Goal("silent, all inputs, fused", 1.0 - share["all"], 1.0, 0.0),
        Goal("silent, thesis inputs, fused", 1.0 - share["thesis"], 0.99, 0.0),
        Goal("not 30 K too high while valid", 1.0 - float(over), 0.98, 0.0),
        Goal("healthy and not degraded, fused", 1.0 - doubted, 0.995, 0.0),
        Goal("no healthy drive throughout", 1.0 - throughout, 1.0, 0.0),
    ]
    return outcome


def _share(found: Sequence[Finding], inputs: str, mode: str) -> float:
    ours = [one.silent for one in found if _setting(one) == (inputs, mode)]
    return sum(ours) / max(len(ours), 1)


def _by_mode(found: Sequence[Finding]) -> Table:
    rows = []
    for setting in Counter((*_setting(one), _car(one)) for one in found):
        ours = [one for one in found if (*_setting(one), _car(one)) == setting]
        faulty = [one for one in ours if one.case["fault"] is not None]
        healthy = [one for one in ours if one.case["fault"] is None]
        rows.append(
            (
                *setting,
                f"{len(faulty)}",
                f"{sum(one.silent for one in faulty)}",
                f"{sum(one.over_k > OVER_K for one in faulty)}",
                f"{sum(one.driven_s > 0.0 for one in healthy)}",
                f"{_of_time(healthy, 'doubted'):.1%}",
                f"{_of_time(healthy, 'unverified'):.1%}",
            )
        )
    return Table(
        "Runs by inputs and mode",
        (
            *("inputs", "mode", "car", "runs", "silent", "over unseen"),
            *("healthy", "of it degraded", "unverified"),
        ),
        tuple(rows),
    )


def _car(one: Finding) -> str:
    return "example" if one.case["car"] is None else "foreign"


def _of_time(found: Sequence[Finding], name: str) -> float:
    """Return the share of the driven time that *name* of each is."""
    total_s = sum(one.driven_s for one in found)
    counted_s = sum(getattr(one, name) * one.driven_s for one in found)
    return float(counted_s / total_s) if total_s > 0.0 else 0.0


def _setting(one: Finding) -> tuple[str, str]:
    return one.case["inputs"], one.case["mode"]


def _worst(found: Sequence[Finding]) -> Table:
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for one in found:
        key = (one.case["fault"], *_setting(one), _car(one))
        groups.setdefault(key, []).append(one)
    rows = []
    for key, ours in groups.items():
        silent = [one for one in ours if one.silent]
        if silent:
            rows.append(
                (
                    *key,
                    f"{len(silent)} of {len(ours)}",
                    f"{max(one.fluid_k for one in silent):.0f}",
                    f"{max(one.disc_k for one in silent):.0f}",
                )
            )
    return Table(
        "Silent faults: largest under-estimates while valid [K]",
        ("fault", "inputs", "mode", "car", "silent", "fluid", "disc"),
        tuple(rows),
    )


def main(arguments: list[str] | None = None) -> int:
    """Print the campaign's tables as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--drives", nargs="+", default=DRIVES)
    parser.add_argument("--modes", nargs="+", choices=MODES, default=MODES)
    parser.add_argument("--cars", nargs="+", choices=CARS, default=[*CARS])
    parser.add_argument("--share", type=float, default=1.0, metavar="X")
    parser.add_argument("--jobs", type=int, metavar="N")
    parser.add_argument("--out", type=Path, metavar="FILE.md")
    args = parser.parse_args(arguments)
    chosen = cases(
        full=args.full,
        drives=args.drives,
        modes=args.modes,
        cars=args.cars,
        share=args.share,
    )
    outcome = outcome_of(examined(chosen, args.jobs))
    lines = [outcome.about, ""]
    for table in outcome.tables:
        lines += [f"{table.title}:", "", *markdown(asdict(table)), ""]
    text = "\n".join(lines)
    if args.out:
        args.out.write_text(text, "utf-8")
    else:
        sys.stdout.write(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())

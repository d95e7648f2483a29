"""``bstm fleet gap``: the gap of each car, and what cars of a type share."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from bstm_daemon.analysis.gap.changes import is_change, name_of, said_percent
from bstm_daemon.analysis.gap.heat_only import find_force_gap
from bstm_daemon.analysis.gap.joint_effects import NormalEquations
from bstm_daemon.analysis.gap.naming import Naming
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.gap.residual_heat import WINDOW_STEPS
from bstm_daemon.analysis.gap.workflow import find_gap, is_unmatched
from bstm_daemon.analysis.matching.coarse import check_mass
from bstm_daemon.analysis.matching.drives import GRID_S
from bstm_daemon.analysis.matching.learned import DAY_TO_DAY
from bstm_daemon.errors import BstmError, LogError
from bstm_daemon.files import make_folder
from bstm_daemon.fleet.drive import FAILED, FOREIGN, MADE
from bstm_daemon.fleet.lake import (
    Drive,
    Lake,
    hash_of,
    hash_of_config,
    program,
)
from bstm_daemon.fleet.learning import Finding, Searched, learn, odd_ones
from bstm_daemon.fleet.plan import Plan
from bstm_daemon.model.heat.needs import (
    INPUTS,
    check_heat_inputs,
    check_inputs,
)
from bstm_daemon.replay.vehicle import load_vehicle
from bstm_daemon.report.gap_forces import force_json
from bstm_daemon.report.gap_page import gap_json
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.text import percent, table, wrapped
from bstm_daemon.service.state_file import safe_name

FEW: Final = 4
"""Cars that a line names."""


@dataclass(frozen=True)
class CarJob:
    """The search of one car: its drives, the latest ones of the plan.

    ``program`` is that of the client; with ``anyway`` an unmatched car gets
    names too, and one that nobody weighed a search by forces.
    """

    root: str
    drives: tuple[Drive, ...]
    config_hash: str
    anyway: bool
    program: dict[str, str]

    @property
    def last(self) -> Drive:
        """The latest drive; its configuration is the car's."""
        return self.drives[-1]

    @property
    def path(self) -> Path:
        """Where the result is, which is its own receipt."""
        return Path(self.root) / "gap" / f"{safe_name(self.last.vehicle)}.json"

    @cached_property
    def key(self) -> str:
        """Hash of what the result follows from."""
        logs = [(d.log, d.size, d.mtime_ns, d.map) for d in self.drives]
        made = [self.program[name] for name in ("bstm", "code", "kernel")]
        return hash_of([logs, self.config_hash, self.anyway, made])

    def result(self) -> dict[str, Any]:
        """Return the result, with a message where there is none."""
        try:
            found: dict[str, Any] = json.loads(self.path.read_text("utf-8"))
        except (OSError, ValueError):
            return {"key": None, "message": "no result"}
        return found

    def fail(self, message: str) -> None:
        """Note *message*; the next run tries again."""
        make_folder(self.path.parent)
        write_json(self.path, {"key": "", "message": message})


@dataclass(frozen=True)
class Group:
    """Corners of cars of one type, searched alike; none for all by forces.

    ``odd`` has place, value, unit and standard deviations by car.
    """

    type: str
    corners: str
    cars: tuple[str, ...]
    unmatched: tuple[str, ...]
    findings: list[Finding]
    odd: dict[str, list[tuple[str, float, str, float]]]


def cars_of(
    lake: Lake, plan: Plan, most: int, *, anyway: bool
) -> tuple[list[CarJob], list[str]]:
    """Return the search of each car of *plan* in its latest *most* drives.

    And a line for each whose configuration or logs can not be read.
    """
    hashed = cache(hash_of_config)
    root = str(lake.root.resolve())
    cars, failures = [], []
    for vehicle in plan.vehicles():
        good = [one for one in plan.chain(vehicle) if one.problem is None]
        drives = tuple(good[-most:])
        try:
            config = hashed(Path(drives[-1].config))
            cars.append(CarJob(root, drives, config, anyway, program()))
        except IndexError:
            failures.append(f"{vehicle}: no drive that can be read")
        except BstmError as error:
            failures.append(f"{vehicle}: {error}")
    return cars, failures


def search(
    client: Any, cars: Sequence[CarJob], progress: Callable[[str], None]
) -> None:
    """Search *cars* on the workers of *client*, a ``distributed.Client``.

    A car whose workers are lost fails alone. *progress* is called with the
    name of each.

    Raises:
        BstmError: the scheduler is gone.
    """
    from distributed import as_completed  # noqa: PLC0415  (an extra)

    futures = client.map(search_car, cars, pure=False)
    under_way = dict(zip(futures, cars, strict=True))
    for future in as_completed(futures, loop=client.loop):
        car = under_way[future]
        if future.cancelled():
            msg = "the scheduler is gone; what is finished stays"
            raise BstmError(msg)
        error = future.exception()
        if error is not None:
            car.fail(f"{type(error).__name__}: {error}")
        elif future.result() == FOREIGN:
            car.fail("its worker runs another program than this one")
        progress(car.last.vehicle)


def search_car(job: CarJob) -> int:
    """Search the drives of *job* for a gap and write what is found.

    Returns:
        MADE, FAILED or FOREIGN.
    """
    if job.program != program():
        return FOREIGN
    try:
        found = _searched(job)
    except Exception as error:  # noqa: BLE001  (a log may hold anything)
        known = isinstance(error, BstmError)
        job.fail(str(error) if known else f"{type(error).__name__}: {error}")
        return FAILED
    make_folder(job.path.parent)
    write_json(job.path, {"key": job.key, **found}, indent=None)
    return MADE


def _searched(job: CarJob) -> dict[str, Any]:
    config, signal_map = load_vehicle(Path(job.last.config), quiet=True)
    recordings, left_out = [], []
    for drive in job.drives:
        try:
            recordings.append(
                read_recording(
                    *(Path(drive.log), config, signal_map),
                    json.loads(drive.map),
                )
            )
        except LogError as error:
            left_out.append(str(error))
    if not recordings:
        raise LogError("; ".join(left_out))
    measured = [one for one in recordings if one.drive.measured]
    for one in measured or recordings:
        needs = one.name, one.drive.roles, one.present
        if measured:
            check_heat_inputs(*needs, config.heat.mode)
        else:
            check_inputs(*needs, INPUTS["ff"], "pressure against motion")
    if not measured:
        if not job.anyway:
            check_mass(Path(job.last.config))
        force = find_force_gap(config, recordings)
        groups = [force_json(force) | _equations(force.naming)]
    else:
        named = job.anyway or not is_unmatched(config, measured)
        gaps = find_gap(config, measured, until="name" if named else "locate")
        groups = [gap_json(gap) | _equations(gap.naming) for gap in gaps]
    return {"message": None, "left_out": left_out, "groups": groups}


def _equations(naming: Naming | None) -> dict[str, Any]:
    found = naming.equations if naming else None
    return {"equations": asdict(found) if found else None}


def failures_of(cars: Sequence[CarJob]) -> list[str]:
    """Return a line for each of *cars* that could not be searched."""
    return [
        f"{job.last.vehicle}: {message}"
        for job in cars
        if (message := job.result()["message"])
    ]


def groups_of(cars: Sequence[CarJob]) -> list[Group]:
    """Return what the results of *cars* show, by type and corners."""
    by_group: dict[tuple[str, str], dict[str, dict[str, Any]]] = {}
    for job in cars:
        for one in job.result().get("groups", ()):
            place = job.last.type, ", ".join(one["corners"])
            by_group.setdefault(place, {})[job.last.vehicle] = one
    return [
        _group(*place, results) for place, results in sorted(by_group.items())
    ]


def _group(
    kind: str, corners: str, results: dict[str, dict[str, Any]]
) -> Group:
    searched = []
    for car, one in results.items():
        if one["equations"] is None:
            continue
        names, *rest = one["equations"].values()
        equations = NormalEquations(tuple(names), *map(np.array, rest))
        searched.append(Searched(car, one["naming"]["answer"], equations))
    return Group(
        kind,
        corners,
        tuple(results),
        tuple(car for car, one in results.items() if "naming" not in one),
        learn(searched),
        _odd(results),
    )


def _odd(
    results: dict[str, dict[str, Any]],
) -> dict[str, list[tuple[str, float, str, float]]]:
    """Return the cars whose residual heat differs from the others'."""
    by_place: dict[tuple[str, str], dict[str, tuple[float, float]]] = {}
    for car, one in results.items():
        if work := one.get("braking_work_j"):
            ratio = work["pressure"] / max(work["motion"], 1.0) - 1.0
            place = "work of pressure over that of motion", "%"
            own = by_place.setdefault(place, {})
            own[car] = 100.0 * ratio, 100.0 * DAY_TO_DAY
        sums: dict[str, list[float]] = {}
        for cell in one.get("cells", ()):
            total = sums.setdefault(
                f"{cell['node']}, {cell['regime']}", [0.0, 0.0, 0.0]
            )
            total[0] += cell["energy_j"]
            total[1] += cell["deviation_j"] ** 2
            total[2] += cell["windows"] * WINDOW_STEPS * GRID_S
        for where, (energy_j, variance, duration_s) in sums.items():
            by_place.setdefault((where, "W"), {})[car] = (
                energy_j / duration_s,
                variance**0.5 / duration_s,
            )
    found: dict[str, list[tuple[str, float, str, float]]] = {}
    for (where, unit), values in by_place.items():
        for car, z in odd_ones(values).items():
            found.setdefault(car, []).append((where, values[car][0], unit, z))
    return found


def gap_lines(groups: Sequence[Group]) -> list[str]:
    """Return *groups* for people."""
    lines = []
    for one in groups:
        count = len(one.cars)
        where = one.corners or "by forces"
        lines.append(f"{one.type}, {where}: {count} cars searched")
        if bare := one.unmatched:
            lines.append(f"  not matched, no names (--anyway): {_few(bare)}")
        rows = [_row(finding, count) for finding in one.findings]
        if rows:
            head = "what", "who has it", "evidence", "strength", "probability"
            lines += [f"  {line}" for line in table(head, rows)]
            lines += wrapped(
                [
                    "not separated: " + ", ".join(map(name_of, each.names))
                    for each in one.findings
                    if len(each.names) > 1
                ],
                *("  ", "    "),
            )
        elif count == 1:
            lines.append("  one car says nothing of its type")
        elif len(one.unmatched) < count:
            lines.append("  nothing that several cars or one of them show")
        lines += [
            f"  odd one out: {car}: {place} {value:+.3g} {unit} ({z:+.1f} sd "
            "from the other cars)"
            for car, places in one.odd.items()
            for place, value, unit, z in places
        ]
    return lines


def _row(one: Finding, count: int) -> list[str]:
    name = one.names[0] if one.names else ""
    cars = _few([*one.strengths])
    who = {"type": "the type", "car": cars, "sensor": f"a sensor of {cars}"}

    def said(strength: float, deviation: float) -> str:
        if is_change(name):
            return said_percent(name, strength)
        return f"{strength:.2g} ± {deviation:.1g}"

    strengths = [said(*each) for each in one.strengths.values()]
    if one.scope == "type":
        type_has = said(one.strength, one.deviation)
        strengths = [f"{type_has}, cars differ by {100 * one.spread:.0f} %"]
    return [
        name_of(name) + " or others" * (len(one.names) > 1)
        if name
        else "none of the known effects",
        who[one.scope],
        f"{len(one.carriers)} of {count} cars",
        _few(strengths) if name else "",
        percent(min(one.probability, 0.9999)),
    ]


def _few(names: Sequence[str]) -> str:
    more = len(names) - FEW
    return ", ".join(names[:FEW]) + f" and {more} more" * (more > 0)

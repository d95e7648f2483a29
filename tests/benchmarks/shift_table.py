"""How far each effect of the reality shifts the front left brake.

Marches the plain car and every effect at strength 1 side by side and writes a
Markdown table: signed shifts of disc / pad back / fluid [K] at the last stop
and at the plain car's fluid peak after it, and where over all drives disc and
fluid shift most. Effects that only change signals are shown by what a nominal
brake would reach with the power that pressure (Feed-Forward) or forces
(Feed-Back) then claim.

    python tests/benchmarks/shift_table.py simalp rich long-run -o table.md
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.simulation import (
    EFFECT_NAMES,
    NOMINAL,
    CornerParameters,
    Drive,
    Effects,
    LaneInputs,
    SimulatedDrive,
    drive_names,
    load_drive,
    march_lanes,
    simulate,
)
from bstm_daemon.simulation.profile import SAMPLE_S
from bstm_daemon.simulation.sensors import SensorSuite
from bstm_daemon.simulation.simulate import Prepared, prepare
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    Array = npt.NDArray[np.float64]
    Traces = dict[str, Array]

NODES = ("disc", "pad_back", "fluid")
FRICTION = EFFECT_NAMES[:4]
IN_CAR = ("hydraulic_lag", "mass_error", "brake_share")
THERMOCOUPLE = ("thermocouple_offset", "thermocouple_lag")
FORWARD = (*FRICTION, "pushout_pressure", "hydraulic_lag", "brake_share")
BACK = (
    "accelerometer_bias",
    "mass_error",
    "brake_share",
    "powertrain_torque_error",
)
SIGNAL_ONLY = {
    "pushout_pressure",
    "accelerometer_bias",
    "powertrain_torque_error",
    "ambient_heat_soak",
}


def alone(name: str) -> Effects:
    """Return the effect *name* at strength 1, all others off."""
    return Effects().with_strength(name, 1.0)


def march(
    ready: Prepared,
    corners: Sequence[CornerParameters],
    effects: Sequence[Effects],
    inputs: LaneInputs,
) -> list[Traces]:
    """March lanes of *ready* and return each lane's traces at 1 Hz."""
    result = march_lanes(
        corners,
        effects,
        inputs,
        start_k=np.full(len(corners), ready.start_k),
    )
    seconds = np.arange(1.0, ready.course.time_s[-1])
    return [
        {
            node: np.interp(
                seconds, result.time_s, result.nodes[node][:, lane]
            )
            for node in NODES
        }
        for lane in range(len(corners))
    ]


def front_left(inputs: LaneInputs, power_w: Array | None = None) -> LaneInputs:
    """Return the front left corner's *inputs*, with *power_w* (n,) instead."""
    power = inputs.power_w[:, :1] if power_w is None else power_w[:, None]
    return replace(
        inputs,
        power_w=power,
        pressure_pa=inputs.pressure_pa[:, :1],
        contact=inputs.contact[:, :1],
        pumping_pa_s=inputs.pumping_pa_s[:, :1],
        corners_per_car=0,
    )


def corner_shifts(drive: Drive) -> tuple[Prepared, dict[str, Traces]]:
    """Return the traces of plain (name "") and of every effect on *drive*."""
    ready = prepare(drive, None, Effects())
    corner = ready.car.corners[0]
    lanes = [
        name
        for name in EFFECT_NAMES
        if name not in {*FRICTION, *IN_CAR, *THERMOCOUPLE, *SIGNAL_ONLY}
    ]
    sets = [Effects(), *map(alone, lanes)]
    inputs = front_left(ready.inputs)
    # lanes of equal power: the one column serves them all
    wide = replace(inputs, power_w=np.repeat(inputs.power_w, len(sets), 1))
    marched = march(ready, [corner] * len(sets), sets, wide)
    traces = dict(zip(["", *lanes], marched, strict=True))
    for name in (*FRICTION, *IN_CAR):
        other = prepare(drive, None, alone(name))
        traces[name] = march(
            other, other.car.corners, [alone(name)] * 4, other.inputs
        )[0]
    for name in THERMOCOUPLE:
        suite = SensorSuite(alone(name), 0)
        traces[name] = {
            node: suite.read(f"temp_fl_{node}", traces[""][node], 1.0)
            for node in NODES
        }
    return ready, traces


def claimed_power(driven: SimulatedDrive, *, back: bool) -> Array:
    """Return the front left brake's power [W] as the signals claim it."""
    roles, share = driven.roles, NOMINAL.gains / NOMINAL.gains.sum()
    v = roles["vehicle_speed"]
    if not back:
        forward: Array = roles["primary_pressure"] * NOMINAL.gains[0] * v
        return forward
    dv_dt = np.gradient(v, SAMPLE_S)
    sine = (roles["acceleration_longitudinal"] - dv_dt) / GRAVITY_MS2
    torque = roles["powertrain_torque"] + roles["motor_torque"]
    mass = driven.drive.drive.mass_kg
    car = NOMINAL if mass is None else replace(NOMINAL, mass_kg=mass)
    force = (
        torque / car.wheel_radius_m
        + roles["external_force"]
        - car.resistance(v, np.arcsin(sine))
        - car.effective_mass_kg * dv_dt
    )
    on = roles["brake_switch"] > 0
    claim: Array = np.maximum(force, 0.0) * on * share[0] * v
    return claim


def signal_shifts(drive: Drive) -> dict[str, tuple[Traces, Traces]]:
    """Return (truth, what a nominal brake reaches with the claim)."""
    found = {}
    nominal = NOMINAL.corners[0]
    for names, back in ((FORWARD, False), (BACK, True)):
        for name in names:
            driven = simulate(drive, preset=alone(name))
            ready = prepare(drive, None, alone(name))
            steps = ready.inputs.step_s
            starts = np.rint((np.cumsum(steps) - steps) / SAMPLE_S)
            claim = claimed_power(driven, back=back)
            mean = np.add.reduceat(claim, starts.astype(int))
            mean /= steps / SAMPLE_S
            claimed = march(
                ready, [nominal], [Effects()], front_left(ready.inputs, mean)
            )[0]
            rows = len(claimed["disc"])
            truth = {n: driven.truth[f"FL.{n}"][:rows] for n in NODES}
            side = "FB" if back else "FF"
            found[f"{name} ({side})"] = (truth, claimed)
    return found | ambient_shift(drive)


def ambient_shift(drive: Drive) -> dict[str, tuple[Traces, Traces]]:
    """Return the same for the ambient sensor above a hot engine."""
    name = "ambient_heat_soak"
    ready = prepare(drive, None, Effects())
    reading = simulate(drive, preset=alone(name)).roles["ambient_temperature"]
    ends = np.cumsum(ready.inputs.step_s) / SAMPLE_S - 1
    inputs = front_left(ready.inputs)
    believed = replace(
        inputs, ambient_k=reading[np.rint(ends).astype(int), None]
    )
    corner = [ready.car.corners[0]]
    truth, claimed = (
        march(ready, corner, [Effects()], each)[0]
        for each in (inputs, believed)
    )
    return {f"{name} (ambient)": (truth, claimed)}


def rows_of(ready: Prepared, plain: Traces) -> tuple[int, int]:
    """Return the rows of the last stop and of the fluid peak after it."""
    moving = np.flatnonzero(ready.course.speed_ms > 0)[-1]
    stop = min(int(moving * SAMPLE_S), len(plain["fluid"]) - 1)
    return stop, stop + int(plain["fluid"][stop:].argmax())


def cells(base: Traces, other: Traces, rows: tuple[int, int]) -> list[str]:
    """Return the signed shifts at *rows*, as text."""
    # a heavier car's drive may end a second later
    last = min(len(trace) for trace in other.values()) - 1
    return [
        " / ".join(
            f"{other[node][min(row, last)] - base[node][row]:+.1f}"
            for node in NODES
        )
        for row in rows
    ]


def largest(
    shifts: dict[str, tuple[Traces, Traces]], node: str
) -> tuple[str, float]:
    """Return the drive and the value of the largest shift of *node*."""
    best = ("", 0.0)
    for drive, (base, other) in shifts.items():
        rows = min(len(base[node]), len(other[node]))
        series = other[node][:rows] - base[node][:rows]
        value = float(series[np.abs(series).argmax()])
        if abs(value) > abs(best[1]):
            best = (drive, value)
    return best


def write_table(shown: Sequence[str], others: Sequence[str]) -> str:
    """Return the Markdown tables of the drives *shown*, searching *others*."""
    shifts: dict[str, dict[str, tuple[Traces, Traces]]] = {}
    text: dict[str, list[str]] = {}
    for name in dict.fromkeys([*shown, *others]):
        drive = load_drive(name)
        ready, traces = corner_shifts(drive)
        plain = traces[""]
        rows = rows_of(ready, plain)
        for effect in EFFECT_NAMES:
            if effect in SIGNAL_ONLY:
                continue
            shifts.setdefault(effect, {})[name] = (plain, traces[effect])
            if name in shown:
                got = cells(plain, traces[effect], rows)
                text.setdefault(effect, []).extend(got)
        if name in shown:
            for effect, pair in signal_shifts(drive).items():
                shifts.setdefault(effect, {})[name] = pair
                text.setdefault(effect, []).extend(cells(*pair, rows))
    heads = [f"{name}, {when}" for name in shown for when in ("stop", "peak")]
    lines = [
        f"| {' | '.join(['effect', *heads, 'most: disc', 'fluid'])} |",
        "|---" * (len(heads) + 3) + "|",
    ]
    for effect, values in text.items():
        number = EFFECT_NAMES.index(effect.split(" ")[0]) + 1
        most = [
            f"{value:+.1f} {name}"
            for name, value in (
                largest(shifts[effect], "disc"),
                largest(shifts[effect], "fluid"),
            )
        ]
        row = " | ".join([f"{number} {effect}", *values, *most])
        lines.append(f"| {row} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the table that the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drives", nargs="*", default=["simalp", "rich"])
    parser.add_argument(
        "--search",
        nargs="*",
        default=[],
        help="further drives for the largest shifts, or 'all'",
    )
    parser.add_argument("-o", "--out", type=Path)
    args = parser.parse_args()
    others = drive_names() if args.search == ["all"] else args.search
    table = write_table(args.drives, others)
    if args.out is None:
        sys.stdout.write(table)
    else:
        args.out.write_text(table, encoding="utf-8")


if __name__ == "__main__":
    main()

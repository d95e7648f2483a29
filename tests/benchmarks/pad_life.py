"""Lining thickness over whole pad lives of three kinds of driver.

The simulated car wears its linings by a model of its own, with which the
estimator shares no code: more steeply above 320 degC, and at a rate per joule
that differs from driver to driver. A driver repeats a drive until the linings
are down to a millimetre. The estimator hears speed, pressure and air only,
and the switches when the piston-side lining comes to them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from side_by_side import Outcome, Table

from bstm_daemon.config.reading import load_config
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.files import shipped_file
from bstm_daemon.model.wear.dose import DOSE
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.simulation.drives import parse_drive
from bstm_daemon.simulation.lanes import Lanes, start_state
from bstm_daemon.simulation.parameters import DEFAULT_MESH, preset_effects
from bstm_daemon.simulation.reality import LaneInputs, march
from bstm_daemon.simulation.simulate import prepare, simulate
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    from bstm_daemon.config.sections import Config

    Column = npt.NDArray[np.float64]

FRONT_M: Final = 0.011
"""New lining of the front brakes."""

LEFT_M: Final = 0.0012
"""A life ends here; the simulated lining stops wearing at 1 mm."""

BUILT_IN_WEAR_M: Final = 0.0045
"""What the simulated effect has worn off beforehand, a unit of strength."""

SAMPLE_HZ: Final = 20

PIECES: Final = 60
"""Parts of a drive at which the simulated thickness is noted."""

CALM: Final = """
[drive]
name = "calm"
description = "town and country with an even foot"
ambient_c = 15.0
propulsion = "engine"

[[segment]]
repeat = 30

[[segment.segment]]
speed_kmh = 50.0
rate_ms2 = 1.2
gear = 3
duration_s = 40.0

[[segment.segment]]
speed_kmh = 0.0
rate_ms2 = 1.1
gear = 3

[[segment.segment]]
speed_kmh = 80.0
rate_ms2 = 1.0
gear = 4
duration_s = 50.0

[[segment.segment]]
speed_kmh = 30.0
rate_ms2 = 1.3
gear = 3

[[segment]]
speed_kmh = 0.0
rate_ms2 = 1.0
gear = 2

[[segment]]
parked = true
duration_s = 600.0
"""

BRISK: Final = """
[drive]
name = "brisk"
description = "motorway, country road, a pass"
ambient_c = 20.0
propulsion = "engine"

[[segment]]
repeat = 12

[[segment.segment]]
speed_kmh = 120.0
rate_ms2 = 2.0
gear = 5
duration_s = 50.0

[[segment.segment]]
speed_kmh = 50.0
rate_ms2 = 3.5
gear = 4
duration_s = 30.0

[[segment.segment]]
speed_kmh = 90.0
rate_ms2 = 2.0
gear = 4
duration_s = 40.0

[[segment.segment]]
speed_kmh = 0.0
rate_ms2 = 2.8
gear = 3

[[segment]]
repeat = 12

[[segment.segment]]
speed_kmh = 70.0
rate_ms2 = 1.5
gear = 3
grade_percent = -8.0
duration_s = 20.0

[[segment.segment]]
speed_kmh = 30.0
rate_ms2 = 3.0
gear = 3
grade_percent = -8.0
duration_s = 12.0

[[segment]]
speed_kmh = 0.0
rate_ms2 = 2.0
gear = 2

[[segment]]
parked = true
duration_s = 900.0
"""

HARD: Final = """
[drive]
name = "hard"
description = "a way to the track, laps, the way home"
ambient_c = 20.0
propulsion = "engine"

[[segment]]
repeat = 25

[[segment.segment]]
speed_kmh = 110.0
rate_ms2 = 3.0
gear = 4
duration_s = 40.0

[[segment.segment]]
speed_kmh = 40.0
rate_ms2 = 5.0
gear = 3
duration_s = 15.0

[[segment]]
repeat = 3

[[segment.segment]]
speed_kmh = 150.0
rate_ms2 = 3.5
gear = 4

[[segment.segment]]
speed_kmh = 70.0
rate_ms2 = 7.0
gear = 3
duration_s = 20.0

[[segment.segment]]
speed_kmh = 120.0
rate_ms2 = 3.5
gear = 3

[[segment.segment]]
speed_kmh = 60.0
rate_ms2 = 7.0
gear = 3
duration_s = 20.0

[[segment]]
speed_kmh = 60.0
rate_ms2 = 2.0
gear = 4
duration_s = 300.0

[[segment]]
speed_kmh = 0.0
rate_ms2 = 3.0
gear = 2

[[segment]]
parked = true
duration_s = 900.0
"""


@dataclass(frozen=True)
class Driver:
    """A drive that is repeated, and how much this driver wears a joule."""

    name: str
    drive: str
    strength: float


DRIVERS: Final = (
    Driver("calm", CALM, 0.8),
    Driver("brisk", BRISK, 1.0),
    Driver("hard", HARD, 1.4),
)


@dataclass(frozen=True)
class Life:
    """One pad life at the ends of its drives, front left; metres.

    ``truth_m`` [n, 2] are piston side and finger side; ``estimate_m`` and
    ``std_m`` [n].
    """

    hours: Column
    truth_m: Column
    estimate_m: Column
    std_m: Column
    hottest_k: float
    refits_j: float

    @property
    def error_m(self) -> Column:
        """Estimate less the mean of the two linings."""
        return self.estimate_m - self.truth_m.mean(axis=1)


@dataclass(frozen=True)
class _Truth:
    time_s: Column
    thickness_m: Column
    hottest_k: float
    samples: dict[str, Column]


def wear_out(driver: Driver, pace: float = 1.0) -> _Truth:
    """Drive until the front linings are worn; *pace* times as fast."""
    drive = parse_drive(driver.drive, driver.name)
    strength = driver.strength * pace
    effects = replace(preset_effects("road"), pad_wear=strength)
    plain = prepare(drive, None, effects)
    corners = [
        replace(
            corner,
            pad_thickness_m=corner.pad_thickness_m
            + BUILT_IN_WEAR_M * strength,
        )
        for corner in plain.car.corners
    ]
    lanes = Lanes(corners, [effects] * len(corners), DEFAULT_MESH)
    state = start_state(lanes, np.full(len(corners), plain.start_k))
    pieces = list(_pieces(plain.inputs))
    at_s = [0.0]
    thickness = [state.pad_m[:, 0].copy()]
    hottest_k = 0.0
    while thickness[-1].min() > LEFT_M:
        for piece in pieces:
            done = march(lanes, state, piece)
            state = done.state
            surface_k = done.chain_k[:, lanes.surface - 1, :, 0]
            hottest_k = max(hottest_k, float(surface_k.max(initial=0.0)))
            at_s.append(at_s[-1] + float(piece.step_s.sum()))
            thickness.append(state.pad_m[:, 0].copy())
    every = 100 // SAMPLE_HZ
    driven = simulate(drive, preset="road", sensors="n2", seed=1)
    samples = {
        role: driven.roles[role][::every]
        for role in (
            "vehicle_speed",
            "primary_pressure",
            "secondary_pressure",
            "ambient_temperature",
        )
    }
    return _Truth(np.array(at_s), np.array(thickness), hottest_k, samples)


def _pieces(inputs: LaneInputs) -> Iterator[LaneInputs]:
    """Cut a drive, so that the moment of a switch is known."""
    edges = np.linspace(0, len(inputs.step_s), PIECES + 1).astype(int)
    for begin, end in pairwise(edges.tolist()):
        part = {
            name: getattr(inputs, name)[begin:end]
            for name in (
                *("step_s", "keep", "speed_ms", "power_w", "pressure_pa"),
                *("contact", "ambient_k", "wetness", "pumping_pa_s"),
            )
        }
        yield replace(inputs, **part)


def car(pace: float, **wear: Any) -> Config:
    """Return the example car's front left brake; expects *pace*.

    The model follows the wear, unless *wear* says otherwise.
    """
    config = load_config(shipped_file("config/example_vehicle.toml"))
    expected = config.wear.pad_wear_m3_j * pace
    changed = config.wear.model_copy(
        update={"pad_wear_m3_j": expected, "model_follows": True, **wear}
    )
    return config.model_copy(
        update={"wear": changed, "corner": config.corner[:1]}
    )


def estimate(truth: _Truth, config: Config, switches: tuple[str, ...]) -> Life:
    """Run the estimator through the life of *truth*, hearing *switches*."""
    heard = (*truth.samples, *switches)
    timeouts = {ROLE_INDEX[role]: 3_600_000_000 for role in heard}
    estimator = Estimator(config, timeouts, history_known=True)
    drive_us = round(truth.time_s[PIECES] * 1e6)
    times = {
        "pads_new": 60_000_000,
        "pad_worn_1mm": _crossing_us(truth, FRONT_M - 1e-3),
        "pad_2mm_left": _crossing_us(truth, 2e-3),
    }
    drives = (len(truth.time_s) - 1) // PIECES
    count = len(truth.samples["vehicle_speed"])
    step_us = 1_000_000 // SAMPLE_HZ
    base_us = np.repeat(np.arange(count, dtype=np.int64), len(truth.samples))
    base_us *= step_us
    roles = np.tile(
        np.array([ROLE_INDEX[r] for r in truth.samples], np.int32), count
    )
    values = np.column_stack(list(truth.samples.values())).ravel()
    estimates, stds = [FRONT_M], [0.0]
    for turn in range(drives):
        begin_us = turn * drive_us
        keep = base_us < drive_us
        part = [base_us[keep] + begin_us, roles[keep], values[keep]]
        for role in switches:
            part = _with_switch(part, ROLE_INDEX[role], times[role])
        estimator.advance(*part)
        law = estimator.wear.pads["FL"].law
        dose_j = estimator.state("FL")[DOSE]
        estimates.append(law.thickness_at_m(dose_j))
        stds.append(law.std_at_m(dose_j))
    return Life(
        truth.time_s[::PIECES] / 3600.0,
        truth.thickness_m[::PIECES],
        np.array(estimates),
        np.array(stds),
        truth.hottest_k,
        estimator.wear.worn_heat_j["FL"],
    )


def _crossing_us(truth: _Truth, at_m: float) -> int:
    """When the piston-side lining comes to *at_m*."""
    piston_m = truth.thickness_m[:, 0]
    return round(np.interp(-at_m, -piston_m, truth.time_s) * 1e6)


def _with_switch(part: list[Any], role: int, on_us: int) -> list[Any]:
    """Add the samples of a switch, one a second, on from *on_us*."""
    times, roles, values = part
    stamps = np.arange(times[0], times[-1], 1_000_000, dtype=np.int64)
    at = np.searchsorted(times, stamps)
    return [
        np.insert(times, at, stamps),
        np.insert(roles, at, np.int32(role)),
        np.insert(values, at, (stamps >= on_us).astype(np.float64)),
    ]


SWITCHES: Final = ("pads_new", "pad_worn_1mm", "pad_2mm_left")


PACES: Final = {"calm": 4.0, "brisk": 1.0, "hard": 1.0}
"""Quick lives: where no face is hot, faster wear changes nothing else."""

HEARD: Final = {
    "no switch": ((), True),
    "pads_new, pad_worn_1mm": (SWITCHES[:2], True),
    "all three": (SWITCHES, True),
    "all three, not followed": (SWITCHES, False),
}
"""The switches, and whether the thermal model follows the wear."""


def run(*, full: bool) -> Outcome:
    """Run the pad lives, with and without switches."""
    rows = []
    for driver in DRIVERS:
        pace = 1.0 if full else PACES[driver.name]
        truth = wear_out(driver, pace)
        rows += [
            (
                f"{driver.name}, {name}",
                *cells(
                    estimate(truth, car(pace, model_follows=follows), roles)
                ),
            )
            for name, (roles, follows) in HEARD.items()
        ]
    return Outcome(
        "Pad lives",
        "Front left of the example car, Feed-Forward, sensors n2; the "
        "simulated car has the preset road and wears by its own model.",
        tables=[
            Table(
                "Thickness against the mean of both linings",
                (
                    *("driver, switches", "hours", "hottest face, degC"),
                    *("largest error, mm", "RMS, mm", "either lining, mm"),
                    *("after the first mm, mm", "within 2 std"),
                ),
                tuple(rows),
            )
        ],
    )


def cells(life: Life) -> tuple[str, ...]:
    """Return a row of the table."""
    error_mm = 1e3 * life.error_m
    either_mm = 1e3 * np.abs(life.estimate_m[:, None] - life.truth_m).max()
    later = life.truth_m.max(axis=1) < FRONT_M - 1e-3
    inside = np.abs(life.error_m) <= 2.0 * life.std_m
    return (
        f"{life.hours[-1]:.0f}",
        f"{life.hottest_k - KELVIN_OFFSET:.0f}",
        f"{np.abs(error_mm).max():.2f}",
        f"{np.sqrt((error_mm**2).mean()):.2f}",
        f"{either_mm:.2f}",
        f"{np.abs(error_mm[later]).max():.2f}",
        f"{inside.mean():.0%}",
    )

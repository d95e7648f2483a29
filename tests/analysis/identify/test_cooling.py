"""``identify cooling`` against the reality's own convection, Eq 4.12."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.analysis.identify.cool_downs import (
    CoolDown,
    cool_downs,
    slow_of,
)
from bstm_daemon.analysis.identify.cooling import (
    AxleCooling,
    CoolingPoint,
    Series,
    fit_cooling,
    identify_cooling,
    speed_groups,
    ten_pairs,
)
from bstm_daemon.analysis.identify.disc_loss import DiscLoss, disc_loss
from bstm_daemon.analysis.identify.driving import Driving, driving_of
from bstm_daemon.analysis.quality.recording import Recording
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.simulation import SimulatedDrive
from bstm_daemon.simulation.parameters import FRONT

Logged = Callable[..., Path]
Reader = Callable[[Path], Driving]
Example = tuple[Config, SignalMap]
Sampled = Callable[..., Recording]
AxleOf = Callable[..., AxleCooling]

SPEEDS_KMH = [0, 18, 36, 50, 70, 90, 150]
DISCS = [
    *("vehicle_speed", "primary_pressure", "ambient_temperature"),
    *("temp_fl_disc", "temp_fl_disc_2", "temp_fr_disc", "temp_fr_disc_2"),
    *("temp_fl_pad_front", "temp_fr_pad_front"),
]

CRUISE = """
[drive]
name = "cruise"
description = "one stop, then 3 min at 60 km/h"
thermocouple_logger = true
[[segment]]
speed_kmh = 110.0
rate_ms2 = 2.0
gear = 4
[[segment]]
speed_kmh = 60.0
rate_ms2 = 6.0
gear = 4
duration_s = 180.0
"""


FAST = CRUISE.replace("110.0", "240.0").replace("60.0", "200.0")
"""The configured table ends at 150 km/h."""


def with_form(config: Config, form: str) -> Config:
    cooling = config.cooling.model_copy(update={"form": form})
    return config.model_copy(update={"cooling": cooling})


def true_s_per_s(speed_ms: float) -> float:
    """H A of the reality's front disc over its mass times cp at 20 degC.

    Forced convection on faces and vanes, mixed with the natural one at 250 K.
    """
    natural = FRONT.natural_convection_w_m2k * (250.0 / 200.0) ** 0.25
    wind = speed_ms**FRONT.forced_exponent

    def mixed(still: float, forced: float) -> float:
        return float(np.cbrt(still**3 + forced**3))

    conductance = 2.0 * FRONT.face_air_area_m2 * mixed(
        natural, FRONT.forced_face_w_m2k * wind
    ) + FRONT.vent_area_m2 * mixed(
        FRONT.parked_vent_fraction * natural, FRONT.forced_vent_w_m2k * wind
    )
    return conductance / (FRONT.ring_mass_kg * 460.0)


@pytest.fixture(scope="module")
def sample_of(
    simulated: Callable[..., SimulatedDrive], sampled: Sampled
) -> Sampled:
    """Return a function that records the discs of a drive, past its DBC."""

    def sample(
        drive: str, sensors: str, roles: Sequence[str] = DISCS, seed: int = 3
    ) -> Recording:
        return sampled(simulated(drive, sensors, seed=seed), *roles)

    return sample


@pytest.fixture(scope="module")
def axle_of(example: Example, sample_of: Sampled) -> AxleOf:
    """Return a function that identifies the front discs on a drive."""

    def axle(
        drive: str, sensors: str, form: str, seed: int = 3
    ) -> AxleCooling:
        config = with_form(example[0], form)
        sample = sample_of(drive, sensors, seed=seed)
        reading = driving_of("log", sample, config, example[1])
        (found,) = identify_cooling([reading], config).axles
        return found

    return axle


@pytest.mark.slow
def test_cooldown_through_its_can_frames(
    logged: Logged, driving: Reader, example: Example
) -> None:
    """Drive `cooldown`: 100 km/h from 685 °C; at 50 km/h the disc is cold."""
    config = with_form(example[0], "conductance")

    found = identify_cooling([driving(logged("cooldown", "n2"))], config)

    (axle,) = found.axles
    (point,) = axle.points
    true = true_s_per_s(100.0 / 3.6)
    assert point.identified
    assert point.speed_ms == pytest.approx(100.0 / 3.6, abs=0.02)
    assert abs(point.value - true) < 2.0 * point.standard_error
    assert point.standard_error < 0.015 * true
    assert axle.fit.residual_k < 1.5
    assert set(point.by_corner) == {"FL", "FR"}
    assert "4 times a disc" in found.searched[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "sensors",
    [
        pytest.param(n, marks=[] if n == "n1" else pytest.mark.slow)
        for n in ("n1", "n2", "n3", "n4")
    ],
)
def test_the_reality_s_own_convection(axle_of: AxleOf, sensors: str) -> None:
    """Drive `cooling`, 18 to 150 km/h: 2 % of the lump's, or two errors.

    The lump is isothermal; the reality's vanes are cooler than its faces,
    where the thermocouples are, by what is 1.7 % of S at 150 km/h.
    """
    axle = axle_of("cooling", sensors, "conductance")

    assert [round(3.6 * p.speed_ms) for p in axle.points] == SPEEDS_KMH
    for point in axle.points[1:]:
        true = true_s_per_s(point.speed_ms)
        error = abs(point.value - true)
        assert error < 0.02 * true + 2.0 * point.standard_error
        assert point.identified
    assert (
        axle.fit.residual_k < {"n1": 1, "n2": 1.5, "n3": 4, "n4": 10}[sensors]
    )


@pytest.mark.slow  # five identifications
@pytest.mark.full
def test_intervals_hold_under_drift(axle_of: AxleOf) -> None:
    """Four drives of six speeds, n3 and n4: 90 % intervals hold in 85 %.

    They hold the S that clean sensors give.
    """
    clean = axle_of("cooling", "none", "conductance").points[1:]
    within, widths = [], []
    for sensors in ("n3", "n4"):
        for seed in range(2):
            axle = axle_of("cooling", sensors, "conductance", seed)
            for point, true in zip(axle.points[1:], clean, strict=True):
                error = abs(point.value - true.value)
                within.append(error < 1.645 * point.standard_error)
                widths.append(point.standard_error / point.value)

    assert np.mean(within) >= 0.85
    assert max(widths) < 0.06


@pytest.mark.slow
def test_form_that_does_not_fit_is_named(
    example: Example, sample_of: Sampled
) -> None:
    """The reality's h A is constant: a rate is not, by 10 K from 685 °C."""
    config = example[0]
    sample = sample_of("cooldown", "n2")
    reading = driving_of("log", sample, config, example[1])

    found = identify_cooling([reading], config)

    assert config.cooling.form == "rate"
    assert found.axles[0].fit.residual_k == pytest.approx(10.0, abs=2.0)
    assert any(
        '"rate" the fit misses by' in text and "conductance" in text
        for text in found.remarks
    )


def test_ten_pairs_are_the_thesis_s() -> None:
    """Five points of a pure exponential: ten times the same S."""
    time_s = np.arange(600.0)
    down = cooling_disc(300.0 * np.exp(-3e-3 * time_s) + 290.0)
    bins = down.bins(down.disc_k)
    series = Series(down, 0, down.bins(time_s), bins, bins)

    pairs = ten_pairs(series)

    assert len(pairs) == 10
    assert pairs == pytest.approx([3e-3] * 10, rel=1e-4)


def cooling_disc(disc_k: np.ndarray, speed_ms: float = 20.0) -> CoolDown:
    count = len(disc_k)
    return CoolDown(
        *("log", "temp_fl_disc", "FL", 0.0),
        np.arange(float(count)),
        disc_k,
        np.full(count, 290.0),
        np.full(count, speed_ms),
        np.full(count, np.nan),
    )


@pytest.mark.slow
def test_exponential_gives_its_rate_back(example: Example) -> None:
    """Noise of 1 K and a drift of 3 K: within two errors, 20 times of 20."""
    loss = disc_loss(example[0], "FL")
    assert loss is not None
    rng = np.random.default_rng(5)
    misses = []
    for _ in range(20):
        time_s = np.arange(600.0)
        drift = np.zeros(600)
        for i in range(1, 600):
            drift[i] = drift[i - 1] * np.exp(-1 / 300.0) + rng.normal(
                0, 3.0 * np.sqrt(1 - np.exp(-2 / 300.0))
            )
        disc = 290.0 + 300.0 * np.exp(-3e-3 * time_s) + drift
        disc += rng.normal(0, 1.0, 600)
        found = fit_cooling(
            [cooling_disc(disc)], [loss], [0], [20.0], rate_form=True
        )
        misses.append(
            (float(found.s_per_s[0]) - 3e-3) / found.standard_error(0)
        )
    assert np.max(np.abs(misses)) < 3.0
    assert np.mean(np.abs(misses) < 1.645) >= 0.8


@pytest.mark.slow
def test_radiation_is_taken_off_at_standstill(example: Example) -> None:
    """Marched with the estimator's own terms, the convection comes back."""
    loss = disc_loss(example[0], "FL")
    assert loss is not None
    thermal = example[0].thermal.model_copy(update={"disc_view_factor": 0.5})
    half = disc_loss(example[0].model_copy(update={"thermal": thermal}), "FL")
    assert half is not None
    assert half.radiation_w_k4 == pytest.approx(0.5 * loss.radiation_w_k4)
    assert half.pads_w_k4 == loss.pads_w_k4
    now, disc = 850.0, []
    convection = 1.5e-4
    for _ in range(3000):
        disc.append(now)
        radiated = loss.radiation_w_k4 * (now**4 - 290.0**4)
        capacity = float(loss.heat_capacity_j_k(np.array([now]))[0])
        now -= convection * (now - 290.0) + radiated / capacity
    down = cooling_disc(np.array(disc), 0.0)

    found, whole = (
        fit_cooling([down], [loss], [0], [0.0], rate_form=True, beside=beside)
        for beside in (True, False)
    )

    assert found.s_per_s[0] == pytest.approx(convection, rel=0.01)
    assert found.residual_k < 0.2
    assert whole.s_per_s[0] > 3.0 * convection
    assert whole.residual_k > 20 * found.residual_k


@pytest.mark.slow
def test_parked_fraction_and_table(axle_of: AxleOf) -> None:
    """At rest S is the whole loss, of which the fraction is convection."""
    axle = axle_of("cooling", "n1", "rate")

    parked = axle.points[0]
    assert parked.speed_ms == 0.0
    assert axle.still == pytest.approx(parked.value / parked.whole)
    assert axle.table[0] == (0.0, parked.whole, True)
    assert all(measured for *_, measured in axle.table)
    assert len(axle.table) == len(SPEEDS_KMH)


@pytest.mark.slow
def test_points_that_were_not_driven_keep_the_shape(
    example: Example, axle_of: AxleOf
) -> None:
    """One speed moves the whole table by its factor, standstill excepted."""
    axle = axle_of("cooldown", "n1", "rate")

    config = example[0].cooling
    factor = axle.points[0].value / np.interp(
        axle.points[0].speed_ms, config.speed_ms, config.s_per_s
    )
    table = {round(speed, 2): s for speed, s, _ in axle.table}
    assert table[0.0] == config.s_per_s[0]
    assert table[41.67] == pytest.approx(factor * config.s_per_s[-1])
    assert axle.still is None
    assert sum(measured for *_, measured in axle.table) == 1


def test_sides_that_part_widen_the_error() -> None:
    """A value for both is uncertain by their half difference."""
    loss = flat_disc()
    time_s = np.arange(900.0)
    downs = [
        replace(
            cooling_disc(290.0 + 300.0 * np.exp(-s * time_s)),
            role=f"temp_{corner.lower()}_disc",
            corner=corner,
        )
        for corner, s in (("FL", 3.0e-3), ("FR", 3.3e-3))
    ]

    found = fit_cooling(downs, [loss, loss], [0, 0], [20.0], rate_form=True)

    assert found.by_corner[0]["FL"][0] == pytest.approx(3.0e-3, rel=0.02)
    assert found.by_corner[0]["FR"][0] == pytest.approx(3.3e-3, rel=0.02)
    assert found.standard_error(0) == pytest.approx(1.5e-4, rel=0.3)


def flat_disc() -> DiscLoss:
    return DiscLoss(
        *(Table(200.0, 1000.0, (500.0, 500.0)), 8.0, True, 0.0, 0.0, 5.0),
        *(0.4, (0.0, 40.0), (1e-3, 5e-3)),
    )


def test_speeds_are_grouped() -> None:
    """No further apart than one stretch may be, standstill by itself."""
    downs = [
        cooling_disc(np.full(100, 400.0), speed)
        for speed in (27.9, 0.0, 5.0, 27.0, 5.4, 0.1)
    ]

    groups, speeds = speed_groups(downs)

    assert groups == [2, 0, 1, 2, 1, 0]
    assert speeds == pytest.approx([0.0, 5.2, 27.45])


@pytest.mark.slow
def test_only_released_even_and_hot(logged: Logged, driving: Reader) -> None:
    """Every stretch begins after the brake and stays at its speed."""
    reading = driving(logged("cooldown", "n2"))

    found, _ = cool_downs(slow_of(reading))

    for down in found:
        part = (reading.time_s > down.start_s) & (
            reading.time_s < down.start_s + down.time_s[-1]
        )
        assert np.nanmax(reading.value("primary_pressure")[part]) < 0.5e5
        assert np.ptp(down.speed_ms) < 1.2
        assert down.disc_k[0] > down.ambient_k[0] + 40.0


@pytest.mark.slow
def test_parked_with_ignition_off_is_standstill(
    example: Example,
    simulated: Callable[..., SimulatedDrive],
    sampled: Sampled,
) -> None:
    """The bus is silent, the logger goes on: the car has not moved."""
    drive = simulated("cooling", "n1")
    sample = sampled(drive, *DISCS)
    on_until = float(drive.time_s[np.flatnonzero(drive.bus_on)[-1]])
    cut = {}
    for role, one in sample.series.items():
        keep = one.time_s < on_until
        cut[role] = (
            one
            if role.startswith("temp_")
            else replace(one, time_s=one.time_s[keep], value=one.value[keep])
        )
    silent = Recording(cut, sample.duration_s, {}, {})

    found, _ = cool_downs(slow_of(driving_of("log", silent, *example)))

    parked = [down for down in found if down.standing]
    assert len(parked) == 4
    assert min(down.time_s[-1] for down in parked) > 1800.0


def test_the_table_reaches_as_far_as_the_car_cools(
    example: Example, sample_of: Sampled
) -> None:
    """What is faster is told; without a cool-down there, a power law."""
    sample = sample_of(FAST, "n1", [*DISCS, "gear", "powertrain_torque"])
    reading = driving_of("fast.log", sample, *example)

    found = identify_cooling([reading], example[0])

    (axle,) = found.axles
    *_, (before_ms, _, scaled), (end_ms, s_per_s, measured) = axle.table
    assert (before_ms, scaled) == (41.67, False)
    assert end_ms == pytest.approx(200.0 / 3.6, abs=0.3)
    assert measured
    assert s_per_s == axle.points[-1].value
    share = np.mean(reading.speed_ms > end_ms + 1.0)
    assert share > 0.02
    assert (
        f"front: {100 * share:.0f} % of the time is faster than the table, "
        "which ends at 200 km/h: beyond it a power law"
    ) in found.remarks
    disc = replace(
        axle.disc,
        speeds_ms=tuple(speed for speed, *_ in axle.table),
        s_per_s=tuple(s for _, s, _ in axle.table),
    )
    beyond = float(disc.configured(1.2 * end_ms))
    assert beyond > 1.05 * s_per_s


@pytest.mark.parametrize(
    ("roles", "words"),
    [
        (DISCS[:3], "no measured disc temperature in this log"),
        ([DISCS[0], *DISCS[2:]], "no signal shows that the brake is released"),
    ],
)
def test_what_is_missing_is_said(
    example: Example, roles: list[str], words: str, sample_of: Sampled
) -> None:
    sample = sample_of(CRUISE, "n1", roles)
    reading = driving_of("short.log", sample, *example)

    with pytest.raises(LogError, match=r"no cool-down found\. short\.log: "):
        identify_cooling([reading], example[0])
    with pytest.raises(LogError, match=words):
        identify_cooling([reading], example[0])


@pytest.mark.slow
def test_dead_thermocouple_is_no_cool_down(
    example: Example, sample_of: Sampled
) -> None:
    sample = sample_of("cooldown", "n1")
    series = dict(sample.series)
    for role in DISCS[3:7]:
        one = series[role]
        series[role] = replace(one, value=np.full(len(one), 600.0))
    reading = driving_of(
        "log", Recording(series, sample.duration_s, {}, {}), *example
    )

    with pytest.raises(LogError, match="0 times a disc 40 K above"):
        identify_cooling([reading], example[0])


@pytest.mark.slow
def test_emissivity_that_cools_faster_than_the_disc(
    example: Example, sample_of: Sampled
) -> None:
    """Radiation alone is more than the loss: no convection is given."""
    thermal = example[0].thermal.model_copy(update={"disc_emissivity": 1.0})
    config = example[0].model_copy(update={"thermal": thermal})
    sample = sample_of("cooling", "n1")
    reading = driving_of("log", sample, config, example[1])

    (axle,) = identify_cooling([reading], config).axles

    parked: CoolingPoint = axle.points[0]
    assert not parked.identified
    assert "emissivity" in parked.caveat
    assert axle.still is None
    assert axle.table[0][1] == config.cooling.s_per_s[0]

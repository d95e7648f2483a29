"""Heat by source against the energy that the simulated brakes took."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.identify.brake_samples import applications
from bstm_daemon.analysis.identify.heat_comparison import (
    HeatComparison,
    StopFriction,
    compare_heat,
    stop_friction,
)
from bstm_daemon.config.heat import HeatConfig
from tests.replayed import replay_log

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.identify.driving import Driving
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation import SimulatedDrive

    from .conftest import Logged

    Reader = Callable[..., Driving]
    Example = tuple[Config, SignalMap]
    Compared = Callable[..., tuple[HeatComparison, StopFriction]]


@pytest.fixture
def compared(logged: Logged, driving: Reader, example: Example) -> Compared:
    """Return a function that compares the sources over a drive."""

    def of_drive(
        drive: str, sensors: str = "n1", **options: object
    ) -> tuple[HeatComparison, StopFriction]:
        path = logged(drive, sensors, **options)
        config, plan = example
        config = config.model_copy(
            update={"heat": HeatConfig(mode="ff", derivative_filter_s=0.3)}
        )
        read = driving(path)
        results = replay_log(config, plan, path, forecast=False).results
        heat = compare_heat(results, read, config)
        return heat, stop_friction(read, config, heat)

    return of_drive


@pytest.mark.slow
def test_totals_are_the_truth(
    compared: Compared, simulated: Callable[..., SimulatedDrive]
) -> None:
    """Fig 4.5, 6.1: FF, FB and Eq 4.5 within 1 %, the bus's torque 60 %."""
    heat, _ = compared("idiada-step", "none")
    drive = simulated("idiada-step", "none")
    true_j = float(drive.brake_energy_j[-1].sum())

    assert heat.total_j("ff") == pytest.approx(true_j, rel=0.01)
    assert heat.total_j("fb") == pytest.approx(true_j, rel=0.01)
    assert heat.total_j("can") == pytest.approx(0.6 * true_j, rel=0.02)
    assert len(heat.stops) == 4
    for stop in heat.stops:
        balance = stop.balance
        assert balance.brake_j == pytest.approx(stop.energy_j["fb"], rel=0.01)
        assert balance.kinetic_j == pytest.approx(868e3, rel=0.01)
        left = balance.kinetic_j - balance.drag_j - balance.climb_j
        assert left + balance.drive_j == pytest.approx(balance.brake_j)


@pytest.mark.slow
def test_accelerometer_bias_is_in_feed_back(compared: Compared) -> None:
    """What the thesis could not use: FB alone follows the sensor's offset."""
    clean, _ = compared("idiada-step", "none")
    biased, _ = compared("idiada-step", "n1")

    moved_j = biased.total_j("fb") - clean.total_j("fb")
    assert abs(moved_j) > 0.03 * clean.total_j("fb")
    assert biased.total_j("ff") == pytest.approx(clean.total_j("ff"), rel=0.01)
    # it stands in the climb of the balance
    climb_j = sum(s.balance.climb_j for s in biased.stops)
    assert climb_j == pytest.approx(-moved_j, rel=0.1)


@pytest.mark.slow
def test_transient_braking_is_one_stop(compared: Compared) -> None:
    """Fig 4.6: pulses within a stop, the sum as at constant pressure."""
    heat, _ = compared("idiada-pulse", "none")

    assert len(heat.stops) == 3
    for stop in heat.stops:
        forward = stop.energy_j["ff"]
        assert forward == pytest.approx(stop.energy_j["fb"], rel=0.02)


@pytest.mark.slow
def test_ratio_of_friction_configured_too_high(
    logged: Logged, driving: Reader, example: Example
) -> None:
    """Fig 6.2, 6.3: mu 25 % too high, so FF is 1.25 times FB."""
    config, plan = example
    corners = [
        corner.model_copy(update={"friction_coefficient": 1.25 * 0.38})
        for corner in config.corner
    ]
    config = config.model_copy(update={"corner": corners})
    path = logged("idiada-step", "none")
    heat = compare_heat(
        replay_log(config, plan, path, forecast=False).results,
        driving(path),
        config,
    )

    momentary = heat.momentary_ratio()
    assert np.nanmedian(momentary) == pytest.approx(1.25, rel=0.02)
    assert heat.integrated_ratio()[-1] == pytest.approx(1.25, rel=0.02)
    assert not np.isfinite(momentary[~heat.braking]).any()


@pytest.mark.slow
def test_pressure_over_force_rises_as_friction_fades(
    compared: Compared,
) -> None:
    """Fig 4.9: pushed for 25 min, 410 Pa/N by geometry, more when hot."""
    even, _ = compared("simalp", "none")
    fading, _ = compared("simalp", "none", preset="road", friction_history=1.0)

    def ends(heat: HeatComparison) -> tuple[float, float]:
        ratio = heat.pressure_per_force()
        known = ratio[np.isfinite(ratio)]
        return float(np.median(known[:300])), float(np.median(known[-300:]))

    first, last = ends(even)
    assert first == pytest.approx(415.0, rel=0.03)
    assert last == pytest.approx(first, rel=0.02)
    first, last = ends(fading)
    assert last > 1.15 * first


@pytest.mark.slow
def test_friction_of_the_stops(compared: Compared) -> None:
    """Fig 4.7: within stops by motion, front and rear by their heat."""
    _, friction = compared("idiada-step")

    assert len(friction.within) == 4
    for one in friction.within:
        assert float(np.mean(one.friction)) == pytest.approx(0.38, rel=0.01)
    front = [o.friction for o in friction.axles if o.axle == "front"]
    rear = [o.friction for o in friction.axles if o.axle == "rear"]
    assert front == pytest.approx([0.38] * len(front), rel=0.07)
    # what the front's discs are off by is 2.3 times as much behind
    assert rear == pytest.approx([0.38] * len(rear), rel=0.15)
    by_discs = {one.axle: one.by_discs for one in friction.axles}
    assert by_discs == {"front": True, "rear": False}


@pytest.mark.slow
def test_friction_falls_with_temperature(compared: Compared) -> None:
    """The fade test: the front's friction falls as its discs heat up."""
    _, friction = compared("ams", preset="road")

    front = [one for one in friction.axles if one.axle == "front"]
    assert len(front) >= 8
    assert front[-1].initial_c > front[0].initial_c + 300.0
    assert front[-1].friction < 0.8 * front[0].friction
    assert len(friction.within) == 10
    means = [float(np.mean(one.friction)) for one in friction.within]
    assert means[-1] < 0.9 * means[0]


@pytest.mark.slow
def test_sources_that_are_not_there_are_named(
    logged: Logged, driving: Reader, example: Example
) -> None:
    config, plan = example
    path = logged("idiada-step")
    read = driving(path)
    read.channels.dead.update({"powertrain_torque", "brake_torque"})
    heat = compare_heat(
        replay_log(config, plan, path, forecast=False).results, read, config
    )

    assert set(heat.power_w) == {"ff"}
    assert heat.absent["fb"] == "no torque at the wheels in this log"
    assert "brake_torque" in heat.absent["can"]
    assert "fused" in heat.absent
    assert not np.isfinite(heat.momentary_ratio()).any()


@pytest.mark.slow
def test_fused_power_is_shown_where_it_is_given(
    logged: Logged, driving: Reader, example: Example
) -> None:
    """A replay handed over as fused stands beside the others."""
    config, plan = example
    heat_config = config.heat.model_copy(update={"mode": "ff"})
    config = config.model_copy(update={"heat": heat_config})
    path = logged("idiada-step")
    results = replay_log(config, plan, path, forecast=False).results
    heat = compare_heat(results, driving(path), config, results)

    assert heat.total_j("fused") == pytest.approx(heat.total_j("ff"))
    assert "fused" not in heat.absent


def test_applications_join_presses_and_drop_touches() -> None:
    time_s = np.arange(0.0, 20.0, 0.1)
    speed = np.where(time_s < 18.0, 10.0, 0.0)
    pressed = (time_s >= 2.0) & (time_s < 4.0)
    pressed |= (time_s >= 5.0) & (time_s < 6.0)
    pressed |= (time_s >= 10.0) & (time_s < 10.2)
    pressed |= time_s >= 15.0

    spans = applications(time_s, speed, pressed)

    assert [
        (round(time_s[s.first], 1), round(time_s[s.last], 1)) for s in spans
    ] == [(2.0, 5.9), (15.0, 17.9)]

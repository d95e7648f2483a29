"""The brake corner: conservation, convergence, cooling, every effect."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bstm_daemon.simulation import (
    EFFECT_NAMES,
    CornerParameters,
    Effects,
    LaneInputs,
    Mesh,
    march_lanes,
)
from bstm_daemon.simulation.lanes import Lanes, start_state
from bstm_daemon.simulation.parameters import (
    FRONT,
    LUMPS,
    UNHEARD_NAMES,
    DrawnPath,
)
from bstm_daemon.simulation.reality import (
    extension,
    march_compiled,
    march_numpy,
)
from bstm_daemon.simulation.sizes import BOILING_K
from bstm_daemon.simulation.vehicle import NOMINAL

Inputs = Callable[..., LaneInputs]

IN_THE_CAR = {
    "pushout_pressure",
    "hydraulic_lag",
    "thermocouple_offset",
    "thermocouple_lag",
    "accelerometer_bias",
    "mass_error",
    "brake_share",
    "powertrain_torque_error",
    "ambient_heat_soak",
}
"""Effects that act outside the brake corner."""

ALL_NAMES = (*EFFECT_NAMES, *UNHEARD_NAMES)
ALL_ON = Effects(**dict.fromkeys(ALL_NAMES, 1.0))


WILD: dict[str, Any] = {
    "iron_slope_j_kgk2": 0.3,
    "pad_capacity_slope_j_kgk2": 0.9,
    "pad_conductivity_slope_1_k": -4e-4,
    "drawn_paths": (
        DrawnPath(
            start=1,
            end=len(LUMPS) - 1,
            conductance_w_k=-2.0,
            speed_exponent=0.6,
            heat_exponent=1.4,
            band_ms=15.0,
            contact=-1.0,
        ),
        DrawnPath(start=8, end=len(LUMPS), conductance_w_k=3.0, onset_k=340.0),
    ),
}
"""All that sets a car of the preset wild apart."""


def rich_inputs(make: Inputs, lanes: int) -> LaneInputs:
    """Return drags with pauses at two speeds and pressures, wet, a soak."""
    n = 560
    at = np.arange(n)
    driving = at < 400
    braking = driving & (at % 100 < 70)
    speed = np.where(driving, np.where(at < 200, 10.0, 22.0), 0.0)
    power = np.where(braking, np.where(at < 200, 12e3, 30e3), 0.0)
    return make(
        n,
        1.0,
        speed_ms=speed,
        power_w=power[:, None] * np.ones(lanes),
        pressure_pa=np.where(braking, np.where(at < 200, 1e6, 3e6), 0.0),
        contact=braking.astype(float),
        wetness=np.where(at % 200 < 60, 0.8, 0.0),
        pumping_pa_s=np.where(driving, 1e5, 0.0),
    )


def each_effect() -> list[Effects]:
    """Return plain, every effect alone, and all together."""
    alone = [Effects().with_strength(name, 1.0) for name in ALL_NAMES]
    return [Effects(), *alone, ALL_ON]


@pytest.mark.slow
def test_energy_balance_closes_for_every_effect(lane_inputs: Inputs) -> None:
    effects = each_effect()
    inputs = rich_inputs(lane_inputs, len(effects))
    corners = [FRONT] * (len(effects) - 1) + [replace(FRONT, **WILD)]
    lanes = Lanes(corners, effects, Mesh())
    state = start_state(lanes, np.full(len(effects), 320.0))

    result = march_numpy(lanes, state, inputs)

    assert result.heat_in_j.min() > 1e6
    assert np.abs(result.balance_residual).max() < 1e-11


@pytest.mark.slow
@pytest.mark.full
def test_compiled_march_is_the_same(lane_inputs: Inputs) -> None:
    reality = extension()
    if reality is None:
        pytest.skip("the compiled reality is not installed")
    effects = each_effect()
    inputs = rich_inputs(lane_inputs, len(effects))
    uneven = replace(FRONT, piston_side_share=0.55, **WILD)
    corners = [FRONT] * (len(effects) - 1) + [uneven]
    lanes = Lanes(corners, effects, Mesh())
    start = np.full(len(effects), 320.0)

    slow = march_numpy(lanes, start_state(lanes, start), inputs)
    fast = march_compiled(reality, lanes, start_state(lanes, start), inputs)

    np.testing.assert_allclose(fast.chain_k, slow.chain_k, atol=1e-7)
    np.testing.assert_allclose(fast.lump_k, slow.lump_k, atol=1e-7)
    np.testing.assert_allclose(fast.power_w, slow.power_w, rtol=1e-10)
    np.testing.assert_allclose(fast.heat_out_j, slow.heat_out_j, rtol=1e-10)
    for name in ("chain_j", "lump_j", "pad_m", "char", "friction_j"):
        np.testing.assert_allclose(
            getattr(fast.state, name),
            getattr(slow.state, name),
            rtol=1e-9,
            atol=1e-9,
        )


def test_compiled_march_refuses_a_mesh_beyond_its_limit(
    lane_inputs: Inputs,
) -> None:
    reality = extension()
    if reality is None:
        pytest.skip("the compiled reality is not installed")
    lanes = Lanes([FRONT], [Effects()], Mesh(pad_nodes=200))
    state = start_state(lanes, np.array([300.0]))

    with pytest.raises(ValueError, match="128 nodes"):
        march_compiled(reality, lanes, state, lane_inputs(2, 1.0))


@pytest.mark.parametrize("name", sorted(set(ALL_NAMES) - IN_THE_CAR))
def test_effect_of_the_corner_changes_it(
    lane_inputs: Inputs, name: str
) -> None:
    inputs = rich_inputs(lane_inputs, 2)
    effects = [Effects(), Effects().with_strength(name, 1.0)]
    # hot enough for the transition of iron, pyrolysis and boiling fluid
    start = np.full(2, 425.0)

    result = march_lanes([FRONT] * 2, effects, inputs, start_k=start)

    largest = max(
        float(np.abs(series[:, 1] - series[:, 0]).max())
        for series in result.nodes.values()
    )
    assert largest > 0.2


def test_effects_outside_the_corner_leave_it(lane_inputs: Inputs) -> None:
    effects = [Effects(), Effects(**dict.fromkeys(IN_THE_CAR, 1.0))]
    inputs = rich_inputs(lane_inputs, 2)

    result = march_lanes(
        [FRONT] * 2, effects, inputs, start_k=np.full(2, 300.0)
    )

    for series in result.nodes.values():
        np.testing.assert_array_equal(series[:, 0], series[:, 1])


def test_lanes_do_not_touch_each_other(lane_inputs: Inputs) -> None:
    effects = each_effect()
    inputs = rich_inputs(lane_inputs, len(effects))
    start = np.full(len(effects), 320.0)
    together = march_lanes(
        [FRONT] * len(effects), effects, inputs, start_k=start
    )

    alone = march_lanes(
        [FRONT],
        [ALL_ON],
        rich_inputs(lane_inputs, 1),
        start_k=np.array([320.0]),
    )

    for name, series in alone.nodes.items():
        np.testing.assert_allclose(
            together.nodes[name][:, -1], series[:, 0], atol=1e-8
        )


@pytest.mark.parametrize(
    "effects",
    [
        Effects(),
        replace(ALL_ON, residual_drag=0.0, damper_heat=0.0),
    ],
)
def test_corner_at_ambient_stays_there(
    lane_inputs: Inputs, effects: Effects
) -> None:
    result = march_lanes(
        [FRONT],
        [effects],
        lane_inputs(200, 2.0, speed_ms=20.0, wetness=1.0),
        start_k=np.array([283.15]),
    )

    for series in result.nodes.values():
        np.testing.assert_allclose(series, 283.15, atol=1e-6)


def test_a_dragging_pad_heats_by_torque_over_the_car_s_own_wheel(
    lane_inputs: Inputs,
) -> None:
    """1.5 Nm of a cold caliper at 20 m/s, whatever the wheel's size."""
    radii_m = (0.3418, 0.25)
    cars = [replace(NOMINAL, wheel_radius_m=radius_m) for radius_m in radii_m]
    result = march_lanes(
        [car.corners[0] for car in cars],
        [Effects(residual_drag=1.0)] * 2,
        lane_inputs(1, 0.05, speed_ms=20.0),
        start_k=np.array([283.15] * 2),
    )

    expected_j = [1.5 * 20.0 / radius_m * 0.05 for radius_m in radii_m]
    np.testing.assert_allclose(result.heat_in_j, expected_j, rtol=1e-9)


def cooling_rate(
    make: Inputs, speed_ms: float, start_c: float, corner: CornerParameters
) -> float:
    """Return S [1/s] of the ring between 60 s and 120 s of cooling."""
    inputs = make(120, 1.0, speed_ms=speed_ms)
    result = march_lanes(
        [corner], [Effects()], inputs, start_k=np.array([start_c + 273.15])
    )
    excess = result.nodes["disc_mean"][:, 0] - 283.15
    return float(np.log(excess[59] / excess[119]) / 60.0)


@pytest.mark.parametrize(
    ("speed_kmh", "least", "most"),
    [(0.0, 3e-4, 5e-4), (36.0, 1.2e-3, 2.4e-3), (100.0, 3e-3, 5e-3)],
)
def test_disc_cools_at_the_rates_of_vehicles(
    lane_inputs: Inputs, speed_kmh: float, least: float, most: float
) -> None:
    rate = cooling_rate(lane_inputs, speed_kmh / 3.6, 250.0, FRONT)

    assert least < rate < most


def test_half_the_step_changes_nothing_that_matters(
    lane_inputs: Inputs,
) -> None:
    # a stop from 100 km/h: 60 kW falling to 0 within 5 s, then rest
    def stop(step_s: float) -> LaneInputs:
        n = round(20.0 / step_s)
        middle = (np.arange(n) + 0.5) * step_s
        left = np.maximum(1.0 - middle / 5.0, 0.0)
        return lane_inputs(
            n,
            step_s,
            speed_ms=27.8 * left,
            power_w=60e3 * left,
            pressure_pa=np.where(left > 0, 4e6, 0.0),
            contact=(left > 0).astype(float),
        )

    def marched(step_s: float) -> tuple[float, float]:
        result = march_lanes(
            [FRONT], [Effects()], stop(step_s), start_k=np.array([350.0])
        )
        surface = result.nodes["disc_surface"]
        return float(surface.max()), float(surface[-1, 0])

    peak, end = marched(0.5)
    peak_half, end_half = marched(0.25)
    peak_fine, end_fine = marched(0.05)

    assert abs(peak - peak_fine) < 1.5
    assert abs(end - end_fine) < 0.05
    # second order: half the step, a quarter of the error (or rounding)
    assert abs(end_half - end_fine) < 0.5 * abs(end - end_fine) + 1e-3
    assert abs(peak_half - peak_fine) < abs(peak - peak_fine) + 1e-3


def test_driver_presses_harder_when_friction_fades(
    lane_inputs: Inputs,
) -> None:
    faded = Effects(friction_fade=1.0)
    inputs = lane_inputs(
        60,
        1.0,
        speed_ms=20.0,
        power_w=np.full((60, 4), 10e3),
        pressure_pa=2e6,
        contact=1.0,
        corners_per_car=4,
    )

    result = march_lanes(
        [FRONT] * 4,
        [faded, Effects(), Effects(), Effects()],
        inputs,
        start_k=np.full(4, 750.0),
    )

    assert result.friction[-1, 0] < 0.9
    np.testing.assert_allclose(result.power_w.sum(axis=1), 40e3)
    assert result.power_w[-1, 0] < 10e3 < result.power_w[-1, 1]


def test_given_pressure_brakes_less_when_friction_fades(
    lane_inputs: Inputs,
) -> None:
    inputs = lane_inputs(
        60, 1.0, speed_ms=20.0, power_w=10e3, pressure_pa=2e6, contact=1.0
    )

    result = march_lanes(
        [FRONT],
        [Effects(friction_fade=1.0)],
        inputs,
        start_k=np.array([750.0]),
    )

    assert result.power_w[-1, 0] == pytest.approx(
        10e3 * result.friction[-1, 0]
    )
    assert result.friction[-1, 0] < 0.9


def test_boiling_fluid_lags_while_it_takes_up_latent_heat(
    lane_inputs: Inputs,
) -> None:
    inputs = lane_inputs(
        900,
        1.0,
        speed_ms=10.0,
        power_w=25e3,
        contact=1.0,
        pressure_pa=2e6,
    )

    result = march_lanes(
        [FRONT] * 2,
        [Effects(), Effects(fluid_latent_heat=1.0)],
        inputs,
        start_k=np.full(2, 400.0),
    )

    plain, boiling = result.nodes["fluid"].T
    assert plain[-1] > BOILING_K + 20
    behind = plain - boiling
    assert behind.max() > 0.3
    assert abs(plain[behind.argmax()] - BOILING_K) < 30


def test_a_disc_without_vanes_is_refused() -> None:
    heavy = replace(FRONT, cheek_thickness_m=0.02)
    with pytest.raises(ValueError, match="no vanes"):
        Lanes([FRONT, heavy], [Effects()] * 2, Mesh())

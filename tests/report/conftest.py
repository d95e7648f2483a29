"""A drive for the report: 25 min of descent, then an hour standing."""

import numpy as np
import numpy.typing as npt
import pytest

from bstm_daemon.replay.results import Results

DESCENT_S = 1500.0
SOAK_S = 3600.0
WET_BOILING_POINT_C = 155.0
POWER_W = 6100.0
SPEED_MS = 10.0

NODES = ("disc", "pad_front", "pad_back", "fluid")


def corner_columns(
    name: str,
    elapsed_s: npt.NDArray[np.float64],
    strength: float,
    rng: np.random.Generator,
) -> dict[str, npt.NDArray[np.float64]]:
    """Return the columns of a corner that brakes with *strength*."""
    braking = elapsed_s < DESCENT_S
    rise = 1 - np.exp(-np.minimum(elapsed_s, DESCENT_S) / 600)
    since_stop_s = np.maximum(elapsed_s - DESCENT_S, 0.0)
    disc_c = 10 + 650 * strength * rise * np.exp(-since_stop_s / 1100)
    pad_front_c = 10 + 560 * strength * rise * np.exp(-since_stop_s / 1000)
    pad_back_c = 10 + 230 * strength * rise * np.exp(-since_stop_s / 2600)
    # a fluid that peaks 12 min after the stop
    soaked = since_stop_s / 720 * np.exp(1 - since_stop_s / 720)
    fluid_c = 10 + 60 * strength * rise * np.exp(-since_stop_s / 3000)
    fluid_c += 75 * strength * soaked
    power_w = np.where(
        braking,
        POWER_W * strength * (1 + 0.3 * np.sin(elapsed_s / 7)),
        0.0,
    )
    columns = {
        "disc_c": disc_c,
        "pad_front_c": pad_front_c,
        "pad_1_c": (pad_front_c + pad_back_c) / 2,
        "pad_back_c": pad_back_c,
        "fluid_c": fluid_c,
        "margin_k": WET_BOILING_POINT_C - fluid_c,
        "brake_power_w": power_w,
        "brake_power_ff_w": power_w,
        "brake_power_fb_w": power_w * 0.85
        + np.where(braking, rng.normal(0, 400, len(elapsed_s)), 0.0),
        "pressure_pa": np.where(braking, 2.1e6 * strength, 0.0)
        * (1 + 0.3 * np.sin(elapsed_s / 7)),
        "validity": np.select(
            [
                (elapsed_s > 300) & (elapsed_s < 380),
                (elapsed_s > 900) & (elapsed_s < 930),
            ],
            [1.0, 2.0],
            0.0,
        ),
    }
    columns["reasons"] = np.select(
        [columns["validity"] == 1.0, columns["validity"] == 2.0], [4.0, 10.0]
    )
    for node, offset in zip(NODES, (12.0, -15.0, 6.0, 3.0), strict=True):
        measured = columns[f"{node}_c"] * 1.02 + offset
        measured += rng.normal(0, 1.0, len(elapsed_s))
        measured[np.arange(len(elapsed_s)) % 10 != 0] = np.nan
        columns[f"{node}_measured_c"] = measured
    return {f"{name}.{key}": column for key, column in columns.items()}


def make_descent(step_s: float = 0.1, start_s: float = 1.7e9) -> Results:
    """Return the descent with a row every *step_s*."""
    count = round((DESCENT_S + SOAK_S) / step_s) + 1
    elapsed_s = np.arange(count) * step_s
    rng = np.random.default_rng(1)
    columns = {
        "time_s": start_s + elapsed_s,
        "speed_ms": np.where(elapsed_s < DESCENT_S, SPEED_MS, 0.0),
        "distance_m": np.minimum(elapsed_s, DESCENT_S) * SPEED_MS,
    }
    for name, strength in (("FL", 1.0), ("FR", 0.95)):
        columns |= corner_columns(name, elapsed_s, strength, rng)
    for name in ("RL", "RR"):
        rear = corner_columns(name, elapsed_s, 0.4, rng)
        # the rear is braked but has no thermal model
        columns |= {
            key: column
            for key, column in rear.items()
            if "power" in key or "pressure" in key
        }
    return Results(columns, ("RL", "FL", "FR", "RR"), ("FL", "FR"))


@pytest.fixture(scope="session")
def descent() -> Results:
    """Return 25 min of descent and an hour standing, at 10 Hz."""
    return make_descent()

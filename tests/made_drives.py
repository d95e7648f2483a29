"""Drives of one corner whose values are known.

Made by the model itself, or by a disc of one or two nodes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.matching.drives import GRID_S, Drive, Thermocouple
from bstm_daemon.analysis.matching.march import march
from bstm_daemon.channels import CHANNELS
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.estimator.corner_model import compile_corner

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from bstm_daemon.config.sections import Config

EXAMPLE: Final = Path(__file__).parents[1] / "config" / "example_vehicle.toml"
NODES: Final = ("disc", "pad_front", "pad_back", "fluid")
AIR_K: Final = 285.0
LUMPED_START_K: Final = 350.0
PA_W: Final = 50.0
"""Pressure of a made drive over its brake power."""

Profile = tuple[tuple[float, float, float], ...]
"""Stretches of speed [m/s], brake power [W], duration [s]."""


def effect_entries(
    strengths: Mapping[str, float], form: Mapping[str, float] | None = None
) -> list[EffectConfig]:
    """Return ``[[effect]]`` entries of *strengths* by name, in *form*."""
    return [
        EffectConfig(
            name=name, parameters={"strength": strength, **(form or {})}
        )
        for name, strength in strengths.items()
    ]


def driven(
    config: Config,
    name: str,
    profile: Profile,
    *,
    every: int,
    nodes: Sequence[str] = NODES,
    noise_k: float = 0.0,
    seed: int = 1,
    scale: float = 1.0,
) -> Drive:
    """Return the front left corner of *config* driven by *profile*.

    Thermocouples at *nodes* are read each *every* steps of the grid, with
    white noise; the brake power of the profile is taken *scale* times.
    """
    steps = [round(duration / GRID_S) for *_, duration in profile]
    rows = np.zeros((sum(steps), 1, len(CHANNELS)))
    rows[:, 0, CHANNELS.index("ambient_k")] = AIR_K
    for i, (channel, factor) in enumerate(
        (("speed_ms", 1.0), ("brake_power_w", scale))
    ):
        column = np.repeat([part[i] for part in profile], steps)
        rows[:, 0, CHANNELS.index(channel)] = column * factor
    power = rows[:, 0, CHANNELS.index("brake_power_w")]
    rows[:, 0, CHANNELS.index("brake_on")] = power > 0.0
    rows[:, 0, CHANNELS.index("pressure_pa")] = PA_W * power
    empty = Drive(name, 0.0, ("FL",), rows, {"FL": {}})
    program = compile_corner(config, config.corner[0])
    start = {node.name: AIR_K for node in program.network.nodes}
    result = march([program], empty, "FL", start)
    rng = np.random.default_rng(seed)
    at = slice(every - 1, None, every)
    couples = {
        node: Thermocouple(
            empty.time_s[at],
            result[node][at, 0]
            + rng.normal(0.0, noise_k, len(empty.time_s[at])),
        )
        for node in nodes
    }
    return Drive(name, 0.0, ("FL",), rows, {"FL": couples})


def stops(seconds: float, seed: int = 1) -> npt.NDArray[np.float64]:
    """Return a speed on the grid, (n,): stops from many speeds, and rests."""
    rng = np.random.default_rng(seed)
    speed = [0.0]
    while len(speed) < seconds / GRID_S:
        top = rng.uniform(15.0, 45.0)
        speed += list(np.arange(0.0, top, 1.0)) + [top] * 40
        speed += list(np.arange(top, 0.0, -rng.uniform(1.5, 4.0)))
        speed += [0.0] * int(rng.integers(5, 60))
    return np.array(speed[: round(seconds / GRID_S)])


def lumped(
    values: Mapping[str, float],
    seconds: float = 1800.0,
    *,
    seed: int = 1,
    name: str = "made",
    within: int = 1,
    corners: tuple[str, ...] = ("FL",),
    air_k: npt.NDArray[np.float64] | float = 290.0,
    gap_s: tuple[float, float] | None = None,
) -> Drive:
    """Return a drive whose FL disc follows the equations exactly.

    They are solved by the midpoint rule in steps of 50 ms. With a c the heat
    is from the motion, seen *within* times in each step of the grid, else
    there is a pressure.
    """
    fine = np.interp(
        np.arange(0.0, seconds, GRID_S / within),
        np.arange(0.0, seconds, GRID_S),
        stops(seconds, seed),
    )
    rate = np.gradient(fine, GRID_S / within)
    on = rate < -2.0
    speed = fine.reshape(-1, within).mean(axis=1)
    air = np.broadcast_to(air_k, speed.shape)
    rows = np.zeros((len(speed), len(corners), len(CHANNELS)))
    rows[:, :, CHANNELS.index("speed_ms")] = speed[:, None]
    rows[:, :, CHANNELS.index("ambient_k")] = air[:, None]
    if "c" in values:
        lost = -(rate + values["c"] * fine**2) * fine
        heat = np.where(on, np.maximum(lost, 0.0), 0.0)
        heat = heat.reshape(-1, within).mean(axis=1)
    else:
        rng = np.random.default_rng(seed)
        pressure = np.where(on, rng.uniform(5e5, 4e6, len(speed)), 0.0)
        rows[:, :, CHANNELS.index("pressure_pa")] = pressure[:, None]
        heat = pressure * speed
    heat *= values["k"]
    cooling = values["a"] + values["b"] * speed
    g, h = values.get("g", 0.0), values.get("h", 0.0)
    disc = hat = LUMPED_START_K
    found, small = np.empty(len(speed)), 10
    step_s = GRID_S / small
    for i in range(len(speed)):
        for _ in range(small if i else 0):
            half = 0.5 * step_s
            loss = cooling[i] * (disc - air[i]) + g * (disc - hat)
            middle = disc + half * (heat[i] - loss)
            middle_hat = hat + half * h * (disc - hat)
            loss = cooling[i] * (middle - air[i]) + g * (middle - middle_hat)
            disc += step_s * (heat[i] - loss)
            hat += step_s * h * (middle - middle_hat)
        found[i] = disc
    time_s = GRID_S * np.arange(1.0, len(speed) + 1.0)
    keep = np.ones(len(speed), bool)
    if gap_s is not None:
        keep = (time_s < gap_s[0]) | (time_s > gap_s[1])
    couple = Thermocouple(time_s[keep], found[keep])
    return Drive(
        name,
        0.0,
        corners,
        rows,
        {"FL": {"disc": couple}},
        speed_ms=fine.reshape(-1, within),
    )

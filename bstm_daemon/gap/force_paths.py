"""Forces of effects that the pass over samples does not form.

Each returns what an effect adds to the force of the pressure, (windows,).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.corner_model import compiled_model, corner_model
from bstm_daemon.matching.march import initial_temperatures, march
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.config import Config
    from bstm_daemon.effects.effect import Effect
    from bstm_daemon.gap.force_balance import Forces
    from bstm_daemon.gap.recording import Recording
    from bstm_daemon.matching.drives import Column

COLD_C: Final = 20.0

PLAIN_MS2: Final = 0.1
SHORTEST: Final = 4.0
"""Braking that no pressure tells of: so much, over so many windows, or harder
and shorter."""


def drag_n(
    effect: Effect, recording: Recording, part: Forces, config: Config
) -> Column:
    """Return the drag of released pads; hot ones rub more."""
    span = effect["hot_c"] - COLD_C
    total = np.zeros(len(part.speed_ms))
    for corner in config.disc_corners():
        model = corner_model(config, corner)
        program = compiled_model(model)
        drive = recording.drive
        start = initial_temperatures(program, drive, corner.name)
        result = march([program], drive, corner.name, start)
        pad_c = result["pad_back"][part.first, 0] - KELVIN_OFFSET
        hot = np.clip((pad_c - COLD_C) / span, 0.0, 1.0)
        cold = effect["cold_share"]
        total += cold + (1.0 - cold) * hot
    newton = effect.strength * effect["torque_nm"]
    newton /= config.vehicle.wheel_radius_m
    return np.asarray(newton * total * (1.0 - part.braked))


def bedded_n(
    effect: Effect,
    recording: Recording,  # noqa: ARG001
    part: Forces,
    config: Config,  # noqa: ARG001
) -> Column:
    """Return what friction loses while linings take up their first heat."""
    seconds = np.gradient(part.time_s)
    taken_j = np.cumsum(part.pressed_n * part.speed_ms * seconds, axis=1)
    drop = min(effect.strength * effect["drop"], 0.95)
    lost = drop * (1.0 - np.exp(-taken_j / effect["bedding_energy_j"]))
    return np.asarray(-(lost * part.pressed_n).sum(axis=0))


def unpressed_n(
    effect: Effect,
    recording: Recording,  # noqa: ARG001
    part: Forces,
    config: Config,
) -> Column:
    """Return the force of brakings that no pressure tells of.

    A braking is a stretch of windows with the brake released and more force
    than :data:`PLAIN_MS2`, too long and too strong for noise, which so does
    not explain itself. The windows that it begins and ends in belong to it.
    """
    least = PLAIN_MS2 * config.vehicle.mass_kg
    motion = np.nan_to_num(part.motion_n)
    own = (part.braked < 0.5) & (motion > least)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], own, [0]))))
    found = np.zeros(len(motion))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if motion[first:last].sum() >= SHORTEST * least:
            whole = slice(max(first - 1, 0), last + 1)
            released = 1.0 - part.braked[whole]
            found[whole] = np.maximum(motion[whole], 0.0) * released
    return np.asarray(effect.strength * found)

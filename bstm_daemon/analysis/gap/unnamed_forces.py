"""Forces that differ by a law without a name: their open set.

Friction as a whole is a tunable. What is left may go with anything that the
brake does or has done: a straight line in each of these stands for whatever
law it is, so that an effect beyond the catalogue is not taken for nothing. So
does a share of what it takes to accelerate and lift the car.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.force_balance import ForceComparison
from bstm_daemon.analysis.gap.forces import Forces
from bstm_daemon.analysis.gap.unnamed import Unnamed
from bstm_daemon.analysis.matching.march import march
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.estimator.corner_model import compile_corner

FRICTION: Final = "friction"
MOTION: Final = "force of the motion"
"""The places of what forces show."""

SHARE: Final = 0.05
"""Of friction that counts as strength 1: what it differs by over one standard
deviation of what it goes with; and of the car's inertia and weight."""

SETTLED_S: Final = 10.0
"""From then on the friction of a held brake no longer changes."""


def unnamed_forces(comparison: ForceComparison) -> tuple[Unnamed, ...]:
    """Return by what each changes the whitened residual of *comparison*."""
    found = [
        (FRICTION, what, change_n) for what, change_n in _friction(comparison)
    ]
    # a mass scales the noise of the motion too: that explains nothing
    inertia_n = comparison.column("inertia_n") - comparison.noise_n
    found.append((MOTION, "acceleration and slope", SHARE * inertia_n))
    return tuple(
        Unnamed(place, f"with {what}", change, is_heat=False)
        for place, what, change_n in found
        for change in [comparison.layout.whiten(change_n)]
    )


def _friction(comparison: ForceComparison) -> Iterator[tuple[str, Column]]:
    """Yield what friction may go with, and the force that it then changes."""
    whole_n = comparison.column("whole_n")
    for what, parts in _drivers(comparison):
        pairs = zip(parts, comparison.kept, strict=True)
        driver = np.concatenate([one[own] for one, own in pairs])
        weight = whole_n**2 / max(float(whole_n @ whole_n), 1e-9)
        apart = driver - weight @ driver
        size = float(np.sqrt(weight @ apart**2))
        if size > 0.0:
            yield what, SHARE * whole_n * apart / size


def _drivers(
    comparison: ForceComparison,
) -> Iterator[tuple[str, list[Column]]]:
    """Yield what friction may go with, (windows,) by drive."""
    parts = comparison.parts
    yield "speed", [one.speed_ms for one in parts]
    yield "pressure", [one.whole_n for one in parts]
    yield (
        "the length of the braking",
        [np.log1p(np.minimum(_braked_s(one), SETTLED_S)) for one in parts],
    )
    yield (
        "the work so far",
        [np.cumsum(one.whole_n * one.metres) for one in parts],
    )
    yield "the discs' temperature", _discs_k(comparison)


def _braked_s(part: Forces) -> Column:
    """Return since when the brake is held, by window [s]."""
    seconds = np.gradient(part.time_s)
    held_s = np.zeros(len(seconds))
    now = 0.0
    for i, braked in enumerate(part.braked):
        now = (now + seconds[i]) * (braked > 0.0)
        held_s[i] = now
    return held_s


def _discs_k(comparison: ForceComparison) -> list[Column]:
    """Return the temperatures of the discs together, by window [K]."""
    found = [np.zeros(len(part.first)) for part in comparison.parts]
    for corner in comparison.config.disc_corners():
        program = compile_corner(comparison.config, corner)
        for i, one in enumerate(comparison.recordings):
            result = march([program], one.drive, corner.name)
            found[i] += result["disc"][comparison.parts[i].first, 0]
    return found

"""What no search could do better: limits of the information in a case.

Each knows more than a search does: the exact form of what is hidden, and
the noise that residuals have, which is that of the search itself.
"""

from __future__ import annotations

from statistics import NormalDist
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy import stats

from bstm_daemon.analysis.gap.naming import SURE
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.statistics.evidence import Projector
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.simulation.sensors import SENSOR_PRESETS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gap_cases import Evidence

    from bstm_daemon.analysis.gap.signatures import Linearised, Signature
    from bstm_daemon.analysis.statistics.series import Column

FALSE_ALARMS: Final = 0.01
"""Of the test for something that has no name: the goal of S0."""

SHARE: Final = 1e-6
"""Directions that explain less than this of the largest are none."""


def named(
    project: Projector,
    change: Column,
    others: Sequence[Signature],
    twins: Sequence[str],
) -> float:
    """Return the probability that the true kind can be named at all.

    Its exact form in whitened temperatures, *change* (n,), is told; each of
    *others* takes the strength that comes closest. The nearest one may be a
    twin: then a class of two is right. With a squared distance d2 between
    both, the logarithm of their odds is normal, d2/2 in the mean with
    variance d2.
    """
    normal = NormalDist()
    least = np.log(SURE / (1.0 - SURE))
    own = project(change)
    whole = float(change @ own)
    powers = []
    for one in others:
        shape = one.at(1.0)
        size = float(shape @ project(shape))
        # a residual is the model less what is measured
        along = -float(shape @ own)
        if size <= 0.0 or (along < 0.0 and not one.either_sign):
            along, size = 0.0, 1.0
        apart = max(whole - along**2 / size, 1e-9) ** 0.5
        powers.append((normal.cdf(apart / 2.0 - least / apart), one.name))
    powers.sort()
    if powers and powers[0][1] in twins:
        del powers[0]
    return powers[0][0] if powers else 1.0


def without_name(
    project: Projector, change: Column, known: Linearised
) -> float:
    """Return the probability that anything is seen, the kind unknown.

    A chi-square test, at :data:`FALSE_ALARMS`, of all effects that *known*
    still has and all heats without a name together.
    """
    columns = np.column_stack(
        [
            *(one.at(1.0) for one in known.signatures),
            *(one.change for one in known.unknown),
        ]
    )
    projected = project(columns)
    size, turn = np.linalg.eigh(columns.T @ projected)
    kept = size > SHARE * size.max()
    seen = (turn[:, kept].T @ (projected.T @ change)) / np.sqrt(size[kept])
    count = int(kept.sum())
    least = stats.chi2.ppf(1.0 - FALSE_ALARMS, count)
    return float(stats.ncx2.sf(least, count, float(seen @ seen)))


def of_sensors(sensors: str, kept: Evidence, layout: Layout) -> float:
    """Return the squared distance by the noise of the sensors alone.

    What the form of the model is off by is taken as known, offset and lag of
    the thermocouples too, so it is a limit that no search reaches.
    """
    preset = SENSOR_PRESETS[sensors]
    if preset is None:
        return 0.0
    own = preset.thermocouple
    found = []
    for one in layout.series:
        # each thermocouple of a node that is one series errs by itself
        apart = len(one.couples) ** -0.5
        noise = SensorNoise(
            apart * own.noise, apart * own.drift, 0.0, apart * own.bias_sd,
            0.0, 0.0,
        )  # fmt: skip
        found.append((one, noise))
    exact = Layout(
        layout.series,
        {one.node: noise for one, noise in found},
        layout.prior,
        layout.drive_names,
    )
    project = Projector(exact.whiten(kept.sensed.jacobian_k), layout.prior)
    change = exact.whiten(kept.change_k)
    return float(change @ project(change))

"""Wear over the rows of a replay: whole columns at a time."""

from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.model.wear.car import Laws
from bstm_daemon.model.wear.law import WearLaw

Column = npt.NDArray[np.float64]

WEAR_COLUMNS: Final = ("pad_thickness_m", "pad_thickness_std_m", "disc_loss_m")
"""Columns of a corner, in the order of :func:`wear_table`."""


def wear_table(laws: Laws, dose_j: Column) -> Column:
    """Return [n, 3] of :data:`WEAR_COLUMNS` at the doses *dose_j* [n].

    The same operations as those of
    :class:`~bstm_daemon.model.wear.law.WearLaw`, so the same numbers as the
    frames are made from.
    """
    found = np.empty((len(dose_j), len(WEAR_COLUMNS)))
    ends: list[Any] = [*laws, (len(dose_j), None)]
    for (begin, law), (end, _) in pairwise(ends):
        _fill(law, dose_j[begin:end], found[begin:end])
    return found


def _fill(law: WearLaw, dose_j: Column, found: Column) -> None:
    since_j = dose_j - law.dose_j
    line = law.thickness_m - law.rate_m_j * since_j
    found[:, 0] = np.maximum(
        np.maximum(np.minimum(line, law.highest_m), law.lowest_m), 0.0
    )
    known_m = law.thickness_std_m
    spread_m = law.rate_spread * (law.rate_m_j * since_j)
    found[:, 1] = np.sqrt(known_m * known_m + spread_m * spread_m)
    found[:, 2] = law.disc_loss_m + law.disc_rate_m_j * since_j

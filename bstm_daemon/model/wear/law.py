"""Lining thickness over the wear dose: Eq 4.20 and 4.21 as straight lines.

The *dose* W [J] is the friction energy of a corner, its part above 320 degC
counted more (:mod:`bstm_daemon.model.wear.dose`); below that it is the E_abs
of the thesis. Between two events the thickness is a line in it::

    z(W) = z_ref - rate (W - W_ref)         within [lowest, highest]

In their right form (the printed Eq 4.20 lacks the millimetre, and the two
indices of Eq 4.21 mean different things)::

    Eq 4.20   z = z_new - d_1 (W - W_new) / (W_1 - W_new)
    Eq 4.21   z = l_2 - (z_new - d_1 - l_2) / (W_2 - W_1) (W - W_2)

with d_1 = 1 mm *worn* at the first indicator and l_2 = 2 mm *left* at the
second. The first is written from the indicator on, where the line and its
uncertainty are known best; it is the same line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, sqrt

from bstm_daemon.estimate import WearSource


@dataclass(frozen=True, slots=True)
class WearLaw:
    """One line, its standard deviation and its limits; SI.

    ``rate_spread`` is the relative standard deviation of the rate: away from
    the reference the interval grows with what has been worn since. The disc
    loses thickness, both faces together, along a line of its own.
    """

    source: WearSource
    thickness_m: float
    dose_j: float
    rate_m_j: float
    thickness_std_m: float
    rate_spread: float
    lowest_m: float = 0.0
    highest_m: float = inf
    disc_loss_m: float = 0.0
    disc_rate_m_j: float = 0.0

    def thickness_at_m(self, dose_j: float) -> float:
        """Return the lining thickness [m] at *dose_j*."""
        line = self.thickness_m - self.rate_m_j * (dose_j - self.dose_j)
        return max(min(line, self.highest_m), self.lowest_m, 0.0)

    def std_at_m(self, dose_j: float) -> float:
        """Return the standard deviation [m] of the thickness at *dose_j*."""
        known_m = self.thickness_std_m
        spread_m = self.rate_spread * (self.rate_m_j * (dose_j - self.dose_j))
        # hypot is rounded differently from library to library
        return sqrt(known_m * known_m + spread_m * spread_m)

    def disc_loss_at_m(self, dose_j: float) -> float:
        """Return the thickness [m] that the disc has lost at *dose_j*."""
        return self.disc_loss_m + self.disc_rate_m_j * (dose_j - self.dose_j)

    def moved_to(self, dose_j: float) -> WearLaw:
        """Return the same law with its reference at *dose_j*."""
        return replace(
            self,
            thickness_m=self.thickness_at_m(dose_j),
            thickness_std_m=self.std_at_m(dose_j),
            disc_loss_m=self.disc_loss_at_m(dose_j),
            dose_j=dose_j,
        )


def first_millimetre_rate_m_j(
    worn_m: float, dose_new_j: float, dose_first_j: float
) -> float:
    """Return the wear per dose [m/J] of the first millimetre (Eq 4.20).

    Raises:
        ValueError: no dose lies between new pads and the indicator.
    """
    return _slope(worn_m, dose_first_j - dose_new_j)


def between_indicators_rate_m_j(
    new_m: float,
    worn_m: float,
    left_m: float,
    dose_first_j: float,
    dose_second_j: float,
) -> float:
    """Return the wear per dose [m/J] between the indicators (Eq 4.21).

    Raises:
        ValueError: no dose lies between them, or no lining does.
    """
    return _slope(new_m - worn_m - left_m, dose_second_j - dose_first_j)


def _slope(depth_m: float, dose_j: float) -> float:
    if not (depth_m > 0.0 and dose_j > 0.0):
        msg = f"{depth_m} m of lining worn by {dose_j} J is no rate"
        raise ValueError(msg)
    return depth_m / dose_j

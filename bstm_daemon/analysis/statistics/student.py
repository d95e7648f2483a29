"""Student's t distribution as a prior of a least-squares fit."""

from math import inf

import numpy as np

from bstm_daemon.analysis.statistics.series import Column


def as_normal(deviations: Column, freedom: float) -> Column:
    """Return what a normal prior would hold as strongly as Student's t.

    Half its square is the fall of the logarithm of the density, scaled to
    that of the normal one near 0 (Lange, Little and Taylor, Robust
    statistical modeling using the t distribution, 1989).

    Args:
        deviations: how far a value lies off, over the scale, of any shape.
        freedom: degrees of freedom; infinite is the normal prior.
    """
    if freedom == inf:
        return deviations
    square = freedom * np.log1p(deviations**2 / freedom)
    return np.asarray(np.sign(deviations) * np.sqrt(square))

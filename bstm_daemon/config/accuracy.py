"""The accuracy of the estimates of a matched model."""

from __future__ import annotations

from math import sqrt
from typing import Final

from bstm_daemon.config.section import NotNegative, Positive, Section

USUAL_DRIFT_K: Final = 1.0
"""Drift of a thermocouple that the accuracy of models includes already."""


class AccuracyConfig(Section):
    """``[accuracy]``: what a matched model leaves over, by ``bstm match``.

    Standard deviation of a node's estimate: ``_k`` and ``_share`` of its rise
    above the air, in quadrature. The last two describe the thermocouples, by
    their data sheet: a constant offset, and a drift over minutes.
    """

    disc_k: Positive | None = None
    disc_share: NotNegative = 0.0
    pad_front_k: Positive | None = None
    pad_front_share: NotNegative = 0.0
    pad_back_k: Positive | None = None
    pad_back_share: NotNegative = 0.0
    fluid_k: Positive | None = None
    fluid_share: NotNegative = 0.0
    thermocouple_offset_k: NotNegative = 0.0
    thermocouple_drift_k: NotNegative = 0.0

    def drift_beyond_usual_k(self) -> float:
        """Return the drift beyond that of a usual thermocouple, sd [K]."""
        return sqrt(max(self.thermocouple_drift_k**2 - USUAL_DRIFT_K**2, 0.0))

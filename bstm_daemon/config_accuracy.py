"""How sure the estimates of a matched model are."""

from __future__ import annotations

from bstm_daemon.config_section import NotNegative, Positive, Section


class AccuracyConfig(Section):
    """``[accuracy]``: what a matched model leaves over, by ``bstm match``.

    Standard deviation of a node's estimate: ``_k`` and ``_share`` of its rise
    above the air, in quadrature. ``thermocouple_offset_k`` is of what is
    measured: what a junction reads too much, always the same.
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

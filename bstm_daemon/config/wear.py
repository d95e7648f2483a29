"""The section ``[wear]``: wear of linings and discs, and its indicators."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bstm_daemon.config.section import Positive, Section

SpecificWear = Annotated[float, Field(gt=0, le=1e-10)]
"""Volume per friction energy [m3/J]; linings lie near 1e-13."""

Spread = Annotated[float, Field(gt=0, le=2)]
Depth = Annotated[float, Field(gt=0, le=0.02)]


class WearConfig(Section):
    """``[wear]``: lining and disc volume worn per joule of friction.

    ``law``: ``energy`` (Eq 4.20, 4.21) counts the friction heat that the
    model is given, ``archard`` (Eq 2.13) contact pressure times sliding
    speed. Both count more above ``hot_from_c`` (Fig 2.7). The indicators
    report of the axle that ``indicators`` names.
    """

    law: Literal["energy", "archard"] = "energy"
    pad_wear_m3_j: SpecificWear = 3.0e-13
    disc_wear_m3_j: Annotated[float, Field(ge=0, le=1e-10)] = 1.0e-13
    rate_spread: Spread = 0.5
    learned_spread: Spread = 0.15
    hot_from_c: Annotated[float, Field(ge=100, le=700)] = 320.0
    hot_doubling_k: Annotated[float, Field(ge=10, le=1000)] = 90.0
    hot_limit: Annotated[float, Field(ge=1, le=1000)] = 30.0
    indicators: Literal["front", "rear", "all"] = "front"
    first_indicator_worn_m: Depth = 0.001
    second_indicator_left_m: Depth = 0.002
    indicator_std_m: Positive = 1.0e-4
    configured_std_m: Positive = 5.0e-4
    limit_m: Depth = 0.002
    model_follows: bool = True

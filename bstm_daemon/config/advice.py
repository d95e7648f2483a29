"""The section ``[advice]``: requests to the car, and when."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bstm_daemon.config.section import Fraction, Positive, Section

Margin = Annotated[float, Field(ge=0, le=150)]
Speed = Annotated[float, Field(ge=0, le=40)]


class AdviceConfig(Section):
    """``[advice]``: the driver interface (thesis, chapter 7).

    Nothing of it is sent without ``[publish] requests``, and nothing of it
    acts on the car: it is a value in a frame. Margins are those of the fluid
    with one standard deviation to the wet boiling point, the worst case.
    """

    while_driving: bool = False
    sound: bool = True
    parked_after_s: Annotated[float, Field(ge=1, le=3600)] = 60.0
    gearbox: Literal["none", "manual", "automatic"] = "none"
    descent_power_w: Positive = 5000.0
    descent_window_s: Annotated[float, Field(ge=5, le=600)] = 40.0
    shift_below_rpm: Positive = 3500.0
    pedal_feel_from_k: Margin = 60.0
    pedal_feel_least: Fraction = 0.5
    isolation_margin_k: Margin = 10.0
    isolation_hysteresis_k: Margin = 10.0
    isolation_speed_ms: Speed = 14.0
    brake_split: Literal["front-rear", "diagonal"] = "diagonal"
    park_brake_speed_ms: Speed = 6.0
    detector_pressure_pa: Positive = 2.0e6
    detector_pedal_rate_1_s: Positive = 1.0
    detector_score: Annotated[float, Field(ge=0.1, le=1)] = 0.6
    detector_hold_s: Annotated[float, Field(ge=0.1, le=5)] = 0.5

"""The brake fluid and its forecast."""

from __future__ import annotations

import itertools
from datetime import date  # noqa: TC003  (pydantic resolves it at run time)
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bstm_daemon.config.section import Positive, Section, require

BoilingPoint = Annotated[float, Field(ge=100, le=400)]
Limit = Annotated[float, Field(ge=100, le=1200)]


class FluidConfig(Section):
    """``[fluid]``: the brake fluid's grade and age."""

    grade: Literal["DOT3", "DOT4", "DOT5.1", "CLASS6"] = "DOT4"
    changed: date | None = None
    climate: Literal["dry", "temperate", "humid"] = "temperate"
    water_percent: Annotated[float, Field(ge=0, le=10)] | None = None
    water_measured: date | None = None
    water_accuracy: Annotated[float, Field(gt=0, le=1)] = 0.1
    dry_boiling_point_c: BoilingPoint | None = None
    wet_boiling_point_c: BoilingPoint | None = None

    @model_validator(mode="after")
    def _points_fit(self) -> Self:
        dry, wet = self.dry_boiling_point_c, self.wet_boiling_point_c
        if dry is not None and wet is not None:
            require(
                wet < dry,
                "'wet_boiling_point_c' must be below 'dry_boiling_point_c'",
            )
        require(
            self.water_measured is None or self.water_percent is not None,
            "'water_measured' is the date of 'water_percent'",
        )
        return self


class ForecastConfig(Section):
    """``[forecast]``: the ensemble, and the limits of disc and pads.

    ``uncertainty`` widens or narrows what the ensemble takes for unknown of
    the model; the limits are where elevated, high and critical begin.
    """

    members: Annotated[int, Field(ge=8, le=256)] = 64
    uncertainty: Positive = 1.0
    disc_limits_c: list[Limit] = [500.0, 600.0, 700.0]
    pad_limits_c: list[Limit] = [400.0, 500.0, 600.0]

    @model_validator(mode="after")
    def _limits_rise(self) -> Self:
        for name in ("disc_limits_c", "pad_limits_c"):
            limits = getattr(self, name)
            require(
                len(limits) == 3
                and all(a < b for a, b in itertools.pairwise(limits)),
                f"{name!r} needs three limits that rise: elevated, high, "
                "critical",
            )
        return self

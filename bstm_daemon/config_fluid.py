"""The brake fluid."""

from __future__ import annotations

from datetime import date  # noqa: TC003  (pydantic resolves it at run time)
from typing import Annotated, Literal

from pydantic import Field

from bstm_daemon.config_section import Section


class FluidConfig(Section):
    """``[fluid]``: the brake fluid's grade and age."""

    grade: Literal["DOT3", "DOT4", "DOT5.1", "CLASS6"] = "DOT4"
    changed: date | None = None
    water_percent: Annotated[float, Field(ge=0, le=10)] | None = None

"""Base class of the sections of the configuration."""

from __future__ import annotations

import itertools
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Text = Annotated[str, Field(min_length=1)]


class Section(BaseModel):
    """Base of all sections.

    Unknown keys are errors, values are final, a text is never read as a
    number, and neither NaN nor infinity is a number.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False
    )

    @model_validator(mode="after")
    def _checked(self) -> Self:
        self._check()
        return self

    def _check(self) -> None:
        """Raise :class:`ValueError` unless the keys fit each other."""


def require(condition: bool, message: str) -> None:  # noqa: FBT001
    """Raise :class:`ValueError` with *message* unless *condition*."""
    if not condition:
        raise ValueError(message)


def check_curve(
    x: list[float], y: list[float], x_name: str, y_name: str
) -> None:
    """Raise :class:`ValueError` unless *x* and *y* are points, *x* rising."""
    require(
        len(x) == len(y) and len(x) > 1,
        f"{x_name!r} and {y_name!r} need the same length, at least 2: "
        f"{len(x)} and {len(y)} given",
    )
    require(
        all(a < b for a, b in itertools.pairwise(x)),
        f"{x_name!r} must rise from point to point",
    )

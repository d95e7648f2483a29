"""Base class of the sections of the configuration."""

import itertools
from math import pi
from typing import Annotated, Any, Self

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


def with_piston_area(given: Any) -> Any:
    """Return a corner's keys with the area of a piston of given diameter.

    Raises:
        ValueError: the area is there too, and another.
    """
    diameter_mm = isinstance(given, dict) and given.get("piston_diameter_mm")
    # anything else is refused where the key itself is checked
    if not isinstance(diameter_mm, int | float) or not 0 < diameter_mm < 1e4:
        return given
    area_m2 = pi / 4.0 * (diameter_mm * 1e-3) ** 2
    require(
        given.get("piston_area_m2", area_m2) == area_m2,
        "give 'piston_area_m2' or 'piston_diameter_mm', not both",
    )
    return given | {"piston_area_m2": area_m2}


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


class Curve(Section):
    """A material property over temperature, linear between the points.

    Of a file, ``csv`` stands there alone.
    """

    temperature_c: list[float] = []
    value: list[Positive] = []
    csv: Text | None = None

    def _check(self) -> None:
        require(self.csv is None, "'csv' is read with a configuration file")
        check_curve(self.temperature_c, self.value, "temperature_c", "value")

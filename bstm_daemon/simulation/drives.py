"""Drives as data, read from TOML: speeds, braking and surroundings.

A drive is a table ``[drive]`` and a list ``[[segment]]``. A segment is one of

* *driven*: ``speed_kmh`` is reached at ``rate_ms2`` and then held until
  ``duration_s`` or ``distance_m`` is used up; with neither, the segment ends
  when the speed is reached;
* *free*: ``until_speed_kmh``; the forces decide (coasting, or braking with a
  given pressure or force) and the segment ends at that speed;
* *parked*: ``parked = true`` for ``duration_s``.

``repeat`` with inner ``[[segment.segment]]`` repeats a block. A value set in a
segment holds for that segment only. ``docs/reality.md`` lists the keys.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from bstm_daemon.errors import ConfigError, FileAccessError
from bstm_daemon.simulation.vehicle import packaged, packaged_text

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Corners = Annotated[list[Finite], Field(min_length=4, max_length=4)]
Factors = dict[str, Positive]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Segment(_Table):
    """One ``[[segment]]``; see the module for the three kinds.

    ``grade_percent`` is positive uphill, ``external_force_n`` positive
    forward, ``headwind_ms`` against the car, ``bend_radius_m`` positive to
    the left, ``gear`` 0 neutral.
    ``brake_pressure_bar`` or ``brake_force_n`` (all wheels) press the brake
    whatever the speed needs; the drive's propulsion balances it; on a free
    segment ``pressure_rise_bar_s`` lets the pressure rise.
    ``assist`` brakes without primary pressure. ``active`` lists the
    interventions that report themselves, ``regeneration`` is the share of the
    brake force that a motor takes.

    Interventions at FL, FR, RL, RR: ``corner_pressure_bar`` presses single
    brakes beyond the driver's demand, ``slip`` is the share by which a wheel
    turns too slowly (negative: it spins), ``modulation`` the share by which
    the anti-lock system moves pressure between left and right.
    """

    label: str = ""
    speed_kmh: NotNegative | None = None
    until_speed_kmh: NotNegative | None = None
    rate_ms2: Positive = 1.0
    duration_s: Positive | None = None
    distance_m: Positive | None = None
    parked: bool = False
    grade_percent: Annotated[float, Field(ge=-30, le=30)] = 0.0
    external_force_n: Finite = 0.0
    headwind_ms: Finite = 0.0
    brake_pressure_bar: NotNegative | None = None
    pressure_rise_bar_s: Finite = 0.0
    brake_force_n: NotNegative | None = None
    corner_pressure_bar: Corners = [0.0, 0.0, 0.0, 0.0]
    slip: Corners = [0.0, 0.0, 0.0, 0.0]
    modulation: Annotated[float, Field(ge=0, lt=1)] = 0.0
    gear: Annotated[int, Field(ge=0, le=6)] = 0
    bend_radius_m: Finite = 0.0
    rain: Annotated[float, Field(ge=0, le=1)] = 0.0
    ambient_c: Annotated[float, Field(ge=-40, le=60)] | None = None
    ignition: bool = True
    assist: bool = False
    active: list[Literal["abs", "esc", "tc"]] = []
    regeneration: Annotated[float, Field(ge=0, le=1)] = 0.0
    repeat: Annotated[int, Field(ge=1, le=10_000)] = 1
    segment: list[Segment] = []

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        kinds = [
            bool(self.segment),
            self.parked,
            self.speed_kmh is not None,
            self.until_speed_kmh is not None,
        ]
        if sum(kinds) != 1:
            msg = (
                "needs exactly one of 'speed_kmh', 'until_speed_kmh', "
                "'parked' and an inner 'segment'"
            )
            raise ValueError(msg)
        if self.repeat > 1 and not self.segment:
            msg = "'repeat' needs an inner 'segment'"
            raise ValueError(msg)
        if self.parked and self.duration_s is None:
            msg = "'parked' needs 'duration_s'"
            raise ValueError(msg)
        for one, other in (
            ("duration_s", "distance_m"),
            ("until_speed_kmh", "distance_m"),
            ("brake_pressure_bar", "brake_force_n"),
        ):
            if None not in (getattr(self, one), getattr(self, other)):
                msg = f"'{one}' and '{other}' exclude each other"
                raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _interventions(self) -> Self:
        if not all(-1.0 < slip < 1.0 for slip in self.slip):
            msg = "'slip' needs four shares between -1 and 1"
            raise ValueError(msg)
        if min(self.corner_pressure_bar) < 0:
            msg = "'corner_pressure_bar' needs four values of 0 or more"
            raise ValueError(msg)
        if any(self.corner_pressure_bar) and self.speed_kmh is None:
            msg = "'corner_pressure_bar' needs 'speed_kmh'"
            raise ValueError(msg)
        if self.pressure_rise_bar_s != 0 and (
            self.until_speed_kmh is None or self.brake_pressure_bar is None
        ):
            msg = (
                "'pressure_rise_bar_s' needs 'until_speed_kmh' and "
                "'brake_pressure_bar'"
            )
            raise ValueError(msg)
        return self


class DriveHead(_Table):
    """``[drive]``: name, surroundings, and what moves the car.

    ``propulsion`` ``"push"``: a pusher or belt supplies positive force, the
    drive line is idle. ``thermocouple_logger``: the measuring system keeps
    recording temperatures while the ignition is off. ``vehicle`` is the
    packaged car that drives unless another is asked for; ``scale`` multiplies
    parameters of its front and rear corners (other rims, other air).
    """

    name: str
    description: str
    ambient_c: Annotated[float, Field(ge=-40, le=60)] = 20.0
    start_c: Annotated[float, Field(ge=-40, le=600)] | None = None
    mass_kg: Positive | None = None
    propulsion: Literal["engine", "push"] = "engine"
    vehicle: str = "nominal"
    scale: dict[Literal["front", "rear"], Factors] = {}
    thermocouple_logger: bool = False


class Drive(_Table):
    """A whole drive file."""

    drive: DriveHead
    segment: Annotated[list[Segment], Field(min_length=1)]

    @property
    def name(self) -> str:
        """Name of the drive."""
        return self.drive.name

    def flat(self) -> Iterator[tuple[str, Segment]]:
        """Yield (place in the file, segment) with repeats unrolled."""
        yield from _flatten(self.segment, "segment")


def _flatten(
    segments: list[Segment], place: str
) -> Iterator[tuple[str, Segment]]:
    for index, segment in enumerate(segments, start=1):
        here = f"{place}[{index}]"
        if not segment.segment:
            yield here, segment
            continue
        for _ in range(segment.repeat):
            yield from _flatten(segment.segment, f"{here}.segment")


def drive_names() -> list[str]:
    """Return the names of the drives that come with the package, sorted."""
    return list(packaged("drives"))


def load_drive(name: str) -> Drive:
    """Return the packaged drive *name*.

    Raises :class:`~bstm_daemon.errors.UsageError` for an unknown name.
    """
    return parse_drive(packaged_text("drives", name), f"{name}.toml")


def read_drive(path: Path) -> Drive:
    """Return the drive of the TOML file *path*.

    Raises :class:`~bstm_daemon.errors.FileAccessError` if it cannot be read
    and :class:`~bstm_daemon.errors.ConfigError` if it is not a drive.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        msg = f"{path}: cannot read the drive: {error.strerror}"
        raise FileAccessError(msg) from error
    except UnicodeDecodeError as error:
        raise ConfigError([f"{path}: not a UTF-8 text file"]) from error
    return parse_drive(text, str(path))


def parse_drive(text: str, file: str) -> Drive:
    """Return the drive written in *text*; *file* names it in messages.

    Raises :class:`~bstm_daemon.errors.ConfigError`, one line a problem.
    """
    try:
        return Drive.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise ConfigError([f"{file}: not TOML: {error}"]) from error
    except ValidationError as error:
        problems = [
            f"{file}: {_place(problem['loc'])}: {_words(problem['msg'])}"
            for problem in error.errors()
        ]
        raise ConfigError(problems) from error


def _place(location: tuple[int | str, ...]) -> str:
    place = ""
    for part in location:
        if isinstance(part, int):
            place += f"[{part + 1}]"
        else:
            place += f".{part}" if place else part
    return place or "drive"


def _words(message: str) -> str:
    words = message.removeprefix("Value error, ")
    if words == "Extra inputs are not permitted":
        return "unknown key; see the keys of a drive in docs/reality.md"
    return words

"""Types and models that validate the content of a state file.

A file may hold anything, so nothing of it is used before one of the models
below, or the :class:`Machine` whose memory it is, has validated it.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from math import isfinite
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    Field,
    TypeAdapter,
    ValidationError,
)

from bstm_daemon.config.wording import problems_of_section

Document = dict[str, Any]

Int64 = Annotated[int, Field(strict=True, ge=-(2**63), le=2**63 - 1)]
"""A stamp [us], bits or a count."""

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Share = Annotated[Number, Field(ge=0.0, le=1.0)]
Flag = Annotated[bool, Field(strict=True)]

AnyNumber = Annotated[
    float,
    Field(strict=True),
    BeforeValidator(lambda v: float(v) if isinstance(v, str) else v),
]
"""A number, as text if it is not finite: JSON has neither NaN nor infinity."""


class StateError(ValueError):
    """A document that is no state of this car; the message says why."""


class Saved(BaseModel):
    """Base of the models; unknown keys are ignored."""


class SavedState(Saved):
    """What an estimator saves, and when."""

    vehicle_id: str | None = None
    time_us: Int64 | None = None
    wall_us: Int64 | None = None
    start_bound: dict[str, dict[str, Number]] = {}
    history_left_us: Number = 0.0
    """Of a file without ``start_bound``: above 0 where no start is known."""
    drove_unseen: Flag = False
    """Whether the car was driven after it, nobody knows how."""
    ambient_k: Number | None = None
    air_k: Number = 0.0
    """The air by its own history; 0 before any."""
    corners: dict[str, dict[str, Number]]
    samples: Document
    learned: Any = None
    wear: Document | None = None
    trust: Document | None = None
    unproven: Document | None = None
    unseen: Document | None = None
    speed_ms: Number = 0.0


def after_unseen_drive(document: Mapping[str, Any]) -> Document:
    """Return the state *document* of a car that was driven unseen since.

    What was learned of the car and its wear stay; how hot its brakes are is
    unknown, and so is when the drive ended.
    """
    unknown: Document = {"wall_us": None, "start_bound": {}}
    return {
        **document,
        **unknown,
        "history_left_us": 1.0,
        "drove_unseen": True,
    }


class SavedSamples(Saved):
    """The pass over samples, of the layout that it has here."""

    times: list[Int64]
    numbers: list[Number | None]
    flags: tuple[Annotated[Int64, Field(ge=-(2**31), lt=2**31)]]
    open_flags: Int64


class SavedLearned(Saved):
    """What was learned of the car of which configuration."""

    vehicle: list[Number]
    numbers: dict[str, Number]


Model = TypeVar("Model", bound=Saved)


def checked(model: type[Model], document: object, where: str = "") -> Model:
    """Return *document*, the part *where* of a state, as a *model*.

    Raises:
        StateError: it is none; the first problem in one line.
    """
    try:
        return model.model_validate(document)
    except ValidationError as error:
        problem = problems_of_section(error, model, where)[0].strip()
        raise StateError(problem) from error


class Machine:
    """A state machine whose memory is the attributes in ``MEMORY``.

    Each has the type that its plain form must be of, because a state file
    may hold anything: an enumeration, one of the types above or a tuple of
    them.
    """

    MEMORY: ClassVar[Mapping[str, Any]] = {}
    _readers: ClassVar[Mapping[str, TypeAdapter[Any]]] = {}

    def __init_subclass__(cls) -> None:
        """Prepare to read the memory."""
        cls._readers = {n: TypeAdapter(kind) for n, kind in cls.MEMORY.items()}

    def export(self) -> dict[str, Any]:
        """Return the memory as plain values that JSON knows."""
        return {name: _plain(getattr(self, name)) for name in self.MEMORY}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Take over what :meth:`export` gave.

        Raises:
            KeyError, TypeError, ValueError: it is nothing of that kind; the
                machine is as it was.
        """
        read = {
            name: reader.validate_python(saved[name])
            for name, reader in self._readers.items()
        }
        for name, value in read.items():
            setattr(self, name, value)


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not isfinite(value):
        return str(value)
    return value

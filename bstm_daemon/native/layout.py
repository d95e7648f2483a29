"""A dataclass as the layout of two arrays that Python and C share.

Its ``int`` fields lie in an array of int64, its ``float`` fields in one of
float64, each in the order of declaration. A list has a fixed
:class:`Length`; a field that is such a dataclass itself lies in place. C gets
the same as structs (:mod:`bstm_daemon.native.header`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from functools import cache
from itertools import islice
from typing import (
    Annotated,
    Any,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Length:
    """Length of a list: its name in C, and how many entries."""

    name: str
    entries: int


@dataclass(frozen=True, slots=True)
class Field:
    """A field: its name, ``int``, ``float`` or a layout, and its length."""

    name: str
    kind: type
    length: Length | None


@dataclass(frozen=True, slots=True)
class Place:
    """Where a field lies: its dotted name, first entry and length."""

    path: str
    first: int
    length: Length | None

    @property
    def entries(self) -> int:
        """How many it takes."""
        return 1 if self.length is None else self.length.entries


@cache
def fields_of(layout: Any) -> tuple[Field, ...]:
    """Return the fields of *layout* in order."""
    hints = get_type_hints(layout, include_extras=True)
    found = []
    for name in (field.name for field in fields(layout)):
        kind, length = hints[name], None
        if get_origin(kind) is Annotated:
            listed, length = get_args(kind)
            (kind,) = get_args(listed)
        found.append(Field(name, kind, length))
    return tuple(found)


@cache
def places(layout: Any, kind: type) -> tuple[Place, ...]:
    """Return where the fields of *kind* (``int`` or ``float``) lie."""
    found: list[Place] = []
    at = 0
    for field in fields_of(layout):
        if field.kind is kind:
            found.append(Place(field.name, at, field.length))
            at += found[-1].entries
        elif field.kind not in {int, float}:
            inner = places(field.kind, kind)
            for place in inner:
                path = f"{field.name}.{place.path}"
                found.append(Place(path, at + place.first, place.length))
            at += size(field.kind, kind)
    return tuple(found)


@cache
def size(layout: Any, kind: type) -> int:
    """Return how many entries of *kind* *layout* has."""
    return sum(place.entries for place in places(layout, kind))


@cache
def first(layout: Any, path: str) -> int:
    """Return the first entry of the field with the dotted name *path*.

    Raises:
        KeyError: there is none.
    """
    for place in (*places(layout, int), *places(layout, float)):
        if place.path == path:
            return place.first
    raise KeyError(path)


def unpack(
    layout: Callable[..., T], ints: Iterator[int], floats: Iterator[float]
) -> T:
    """Return a *layout* with the next entries of both arrays."""
    values: list[Any] = []
    for field in fields_of(layout):
        kind, length = field.kind, field.length
        if kind is not int and kind is not float:
            values.append(unpack(kind, ints, floats))
            continue
        source: Iterator[Any] = ints if kind is int else floats
        if length is None:
            values.append(next(source))
        else:
            values.append(list(islice(source, length.entries)))
    return layout(*values)


def pack(memory: Any, ints: list[int], floats: list[float]) -> None:
    """Append the fields of *memory*, which is of a layout, to both."""
    for field in fields_of(memory.__class__):
        kind, value = field.kind, getattr(memory, field.name)
        if kind is not int and kind is not float:
            pack(value, ints, floats)
            continue
        target: list[Any] = ints if kind is int else floats
        if field.length is None:
            target.append(value)
        else:
            target.extend(value)


def zeros(layout: Callable[..., T]) -> T:
    """Return a *layout* of zeros."""
    return unpack(
        layout,
        iter([0] * size(layout, int)),
        iter([0.0] * size(layout, float)),
    )

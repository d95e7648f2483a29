"""The C header of the tables that Python and C share.

Constants, names and layouts are written in Python alone; the build
(``building.py``) writes them down for C. Only the standard library is needed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from math import isinf
from types import ModuleType
from typing import Any, Final

from bstm_daemon.native.layout import Field, Length, fields_of, size

SMALL: Final = 1 << 16
"""Integers below are enumerators, so that ``int`` counts up to them; larger
ones are int64."""


@dataclass(slots=True)
class Header:
    """A header that is being written."""

    lines: list[str] = field(default_factory=list)
    values: dict[str, object] = field(default_factory=dict)

    def text(self) -> str:
        """Return the whole header."""
        return "\n".join(
            (
                "/* Written by building.py out of the Python tables. */",
                "#ifndef BSTM_GENERATED_H",
                "#define BSTM_GENERATED_H",
                "#include <math.h>",
                "#include <stdint.h>",
                *self.lines,
                "#endif",
                "",
            )
        )

    def constants(self, *modules: ModuleType) -> None:
        """Add each public constant of *modules* that is made of numbers."""
        for module in modules:
            for name, value in vars(module).items():
                if name.isupper() and not name.startswith("_"):
                    self._constant(name, value)

    def names(self, prefix: str, names: Iterable[str], total: str) -> None:
        """Number *names* from 0 on as enumerators, *total* after the last."""
        for number, name in enumerate((*names, None)):
            text = total if name is None else f"{prefix}{name}".upper()
            self._constant(text, number)

    def values_of(self, prefix: str, table: Mapping[str, int]) -> None:
        """Add each value of *table*: what are bits may need 64."""
        for name, value in table.items():
            text = f"{prefix}{name}".upper()
            if self._new(text, value):
                self.lines.append(f"#define {text} INT64_C({value})")

    def layout(self, layout: Any) -> None:
        """Add the structs of *layout*, those of its parts before."""
        for part in fields_of(layout):
            if part.kind not in {int, float}:
                self.layout(part.kind)
            elif part.length is not None and part.length.name.isidentifier():
                self._constant(part.length.name, part.length.entries)
        if not self._new(layout.__name__, layout):
            return
        for kind in (int, float):
            if size(layout, kind):
                self.lines.append("typedef struct {")
                self.lines += _members(layout, kind)
                self.lines.append(f"}} {_struct_name(layout, kind)};")

    def record(self, kind: type) -> None:
        """Add the dataclass *kind* of numbers and flags as a struct."""
        if self._new(kind.__name__, kind):
            self.lines.append("typedef struct {")
            for part in fields_of(kind):
                of = {bool: "int", int: "int64_t", float: "double"}[part.kind]
                self.lines.append(f"    {of} {part.name}{_brackets(part)};")
            self.lines.append(f"}} {kind.__name__};")

    def _constant(self, name: str, value: object) -> None:
        written = _written(value)
        if written is None or not self._new(name, value):
            return
        kind, text = written
        if kind == "int":
            self.lines.append(f"enum {{ {name} = {text} }};")
        elif kind == "define":
            self.lines.append(f"#define {name} {text}")
        else:
            self._record(value)
            self.lines.append(f"static const {kind.format(name)} = {text};")

    def _record(self, value: object) -> None:
        """Add the struct of a record, or of a table of them."""
        if not _is_record(value):
            if isinstance(value, tuple) and value and _is_record(value[0]):
                self._record(value[0])
            return
        if self._new(type(value).__name__, type(value)):
            members = ", ".join(f.name for f in fields(value))  # type: ignore[arg-type]
            self.lines.append(
                f"typedef struct {{ double {members}; }} "
                f"{type(value).__name__};"
            )

    def _new(self, name: str, value: object) -> bool:
        """Whether *name* is new.

        Raises:
            ValueError: it stands for another value already.
        """
        if name not in self.values:
            self.values[name] = value
            return True
        if self.values[name] != value:
            msg = f"{name} is {self.values[name]!r} and {value!r}"
            raise ValueError(msg)
        return False


def _written(value: object) -> tuple[str, str] | None:
    """How *value* is declared and written; None where it is no number."""
    found = None
    if isinstance(value, int) and not isinstance(value, bool):
        small = abs(value) < SMALL
        found = ("int", str(value)) if small else ("define", _number(value))
    elif isinstance(value, float):
        found = "define", f"({_number(value)})"
    elif _is_record(value):
        found = f"{type(value).__name__} {{}}", _braces(value)
    elif isinstance(value, tuple) and value:
        kind = {float: "double", int: "int"}.get(type(value[0]))
        if _is_record(value[0]):
            kind = type(value[0]).__name__
        if kind is not None:
            found = f"{kind} {{}}[{len(value)}]", _braces(value)
    return found


def _is_record(value: object) -> bool:
    """Whether *value* is an object of a dataclass with numbers alone."""
    return (
        is_dataclass(value)
        and not isinstance(value, type | Length)
        and all(f.type in {"float", float} for f in fields(value))
    )


def _braces(value: Any) -> str:
    if is_dataclass(value):
        value = [getattr(value, f.name) for f in fields(value)]
    inner = (
        _number(v) if isinstance(v, int | float) else _braces(v) for v in value
    )
    return "{" + ", ".join(inner) + "}"


def _number(value: float) -> str:
    if isinstance(value, int) and not isinstance(value, bool):
        return "INT64_MIN" if value == -(2**63) else f"INT64_C({value})"
    if isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    return repr(value)


def _members(layout: Any, kind: type) -> list[str]:
    found = []
    for part in fields_of(layout):
        if part.kind is kind:
            of = "int64_t" if kind is int else "double"
            found.append(f"    {of} {part.name}{_brackets(part)};")
        elif part.kind not in {int, float} and size(part.kind, kind):
            found.append(f"    {_struct_name(part.kind, kind)} {part.name};")
    return found


def _brackets(part: Field) -> str:
    return "" if part.length is None else f"[{part.length.name}]"


def _struct_name(layout: Any, kind: type) -> str:
    """Name of the struct; one of a single kind has the layout's own."""
    if not (size(layout, int) and size(layout, float)):
        return str(layout.__name__)
    return f"{layout.__name__}{'Ints' if kind is int else 'Floats'}"

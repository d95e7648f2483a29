"""Results as JSON files, by pydantic's serialiser."""

from __future__ import annotations

from dataclasses import fields
from operator import attrgetter, methodcaller
from typing import TYPE_CHECKING, Any

from pydantic_core import to_json

from bstm_daemon.files import replacing

if TYPE_CHECKING:
    from pathlib import Path

    from _typeshed import DataclassInstance


def own_fields(result: DataclassInstance, *without: str) -> dict[str, Any]:
    """Return the fields of *result* by name, but those of *without*."""
    return {
        field.name: getattr(result, field.name)
        for field in fields(result)
        if field.name not in without
    }


def picked(result: object, *names: str, **renamed: str) -> dict[str, Any]:
    """Return attributes of *result* by name, those of *renamed* by another.

    A dotted name goes deeper, as in ``log="stretch.driving.name"``.
    """
    wanted = dict(zip(names, names, strict=True)) | renamed
    return {key: attrgetter(name)(result) for key, name in wanted.items()}


def write_json(path: Path, result: object, indent: int | None = 2) -> None:
    """Write *result* to *path* as JSON, whole or not at all.

    It may hold dataclasses and arrays; NaN and infinity become null.

    Raises:
        FileAccessError: *path* can not be written.
    """
    text = to_json(
        result,
        indent=indent,
        inf_nan_mode="null",
        fallback=methodcaller("tolist"),
    )
    with replacing(path) as temporary:
        temporary.write_bytes(text + b"\n")

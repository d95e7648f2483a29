"""Results as JSON files, by pydantic's serialiser."""

from __future__ import annotations

import json
from dataclasses import fields
from operator import attrgetter, methodcaller
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic_core import to_json

from bstm_daemon.files import replacing

if TYPE_CHECKING:
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

    It may hold dataclasses and arrays; NaN and infinity become null, other
    numbers have ten digits: no rounding error of a float is shown.

    Raises:
        FileAccessError: *path* can not be written.
    """
    text = to_json(
        result, inf_nan_mode="null", fallback=methodcaller("tolist")
    )
    short = json.loads(text, parse_float=lambda x: float(f"{float(x):.10g}"))
    with replacing(path) as temporary:
        temporary.write_text(
            json.dumps(short, indent=indent, ensure_ascii=False) + "\n",
            encoding="utf-8",
        )

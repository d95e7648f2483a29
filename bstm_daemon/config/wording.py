"""The wording of configuration problems.

pydantic knows what is wrong and where in its own terms. Here that becomes
``[section] key = value: must be ...`` with the allowed range, read from the
models themselves so that a message and a model cannot differ.
"""

from __future__ import annotations

import json
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.errors import hint, nearest

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError
    from pydantic_core import ErrorDetails

Schema = dict[str, Any]

_RANGE_ERRORS: Final = frozenset(
    {"greater_than", "greater_than_equal", "less_than", "less_than_equal"}
)
_SHOWN_CHARACTERS: Final = 60


def problems_of_section(
    error: ValidationError, model: type[BaseModel], where: str
) -> list[str]:
    """Word each problem of one section, in pydantic's order.

    *where* is the section as written, such as ``[vehicle]``; *model* is what
    the section was validated with.
    """
    schema = model.model_json_schema()
    details = error.errors()
    unknown = [d["loc"] for d in details if d["type"] == "extra_forbidden"]

    def is_misspelt(*table: int | str) -> bool:
        beside = [
            str(key) for *other, key in unknown if other == [*table[:-1]]
        ]
        return nearest(str(table[-1]), beside) is not None

    # a key that is misspelt is one problem, not a missing one as well
    return [
        _word(detail, schema, where)
        for detail in details
        if not (detail["type"] == "missing" and is_misspelt(*detail["loc"]))
    ]


def allowed(model: type[BaseModel], key: str) -> str:
    """Return what *key* of *model* may be, e.g. ``a number from 0 to 1``."""
    schema = model.model_json_schema()
    return _kind(_inside(schema, key, schema), schema)


def toml_text(value: object) -> str:
    """Return *value* as TOML would write it, shortened when long."""
    if isinstance(value, str | bool | list | dict):
        text = json.dumps(value, ensure_ascii=False, default=str)
    elif isinstance(value, float) and not isfinite(value):
        text = str(value)
    else:
        text = f"{value}"
    return shortened(text)


def shortened(text: str) -> str:
    """Return *text*, its end left out when it is long."""
    if len(text) > _SHOWN_CHARACTERS:
        text = text[: _SHOWN_CHARACTERS - 3] + "..."
    return text


def _word(detail: ErrorDetails, schema: Schema, where: str) -> str:
    kind = detail["type"]
    path, node, parent = _follow(detail["loc"], schema)
    subject = f"{where} {path}" if path else where
    shown = f"{subject} = {toml_text(detail['input'])}"
    if kind == "missing":
        return f"{subject}: missing, must be {_kind(node, schema)}"
    if kind == "extra_forbidden":
        name = str(detail["loc"][-1])
        known = hint(name, parent.get("properties", {}))
        return f"{shown}: unknown key, {known}"
    if kind == "value_error":
        return f"{subject}: {detail['ctx']['error']}"
    if kind in _RANGE_ERRORS:
        return f"{shown}: must be {_range(node)}"
    if kind == "finite_number":
        limits = _range(node)
        return f"{shown}: must be finite{limits and ' and ' + limits}"
    return f"{shown}: must be {_kind(node, schema)}"


def _follow(
    loc: tuple[int | str, ...], schema: Schema
) -> tuple[str, Schema, Schema]:
    """Return the written path, the schema there and the schema around it."""
    path, node, parent = "", schema, schema
    for part in loc:
        is_form = "oneOf" in node
        parent, node = node, _inside(node, part, schema)
        if is_form:
            continue
        if isinstance(part, int):
            path += f"[{part}]"
        else:
            path += f".{part}" if path else part
    return path, node, parent


def _inside(node: Schema, part: int | str, schema: Schema) -> Schema:
    if "oneOf" in node:
        number, curve = node["oneOf"]
        found = curve if part == "curve" else number
    elif isinstance(part, int):
        found = node.get("items", {})
    else:
        rest = node.get("additionalProperties")
        fallback = rest if isinstance(rest, dict) else {}
        found = node.get("properties", {}).get(part, fallback)
    return _resolved(found, schema)


def _resolved(node: Schema, schema: Schema) -> Schema:
    for option in node.get("anyOf", ()):
        if option.get("type") != "null":
            return _resolved(option, schema)
    if "$ref" in node:
        name = str(node["$ref"]).rpartition("/")[2]
        return _resolved(schema["$defs"][name], schema)
    return node


def _kind(node: Schema, schema: Schema) -> str:
    choices = node.get("enum", [node["const"]] if "const" in node else [])
    if choices:
        *others, last = (toml_text(choice) for choice in choices)
        return ", ".join(others) + " or " + last if others else last
    match node.get("type"):
        case "number":
            return f"a number {_range(node)}".rstrip()
        case "integer":
            return f"a whole number {_range(node)}".rstrip()
        case "boolean":
            return "true or false"
        case "string":
            return _kind_of_text(node)
    return _compound_kind(node, schema)


def _kind_of_text(node: Schema) -> str:
    if "format" in node:
        return "a date such as 2024-05-31"
    return "a text, not empty" if "minLength" in node else "a text"


def _compound_kind(node: Schema, schema: Schema) -> str:
    if "oneOf" in node:
        options = (_resolved(option, schema) for option in node["oneOf"])
        return " or ".join(_kind(option, schema) for option in options)
    if node.get("type") == "array":
        # of a tuple the entries are listed
        items = node.get("items") or node["prefixItems"][0]
        entry = _kind(_resolved(items, schema), schema)
        return f"a list, each entry {entry}"
    keys = ", ".join(node.get("required") or node.get("properties", ()))
    return f"a table with {keys}" if keys else "a table"


def _range(node: Schema) -> str:
    low, above = node.get("minimum"), node.get("exclusiveMinimum")
    high = node.get("maximum")
    if low is not None and high is not None:
        return f"from {low:g} to {high:g}"
    if above is not None:
        limit = f"greater than {above:g}"
        return limit if high is None else f"{limit} and at most {high:g}"
    return "" if low is None else f"{low:g} or more"

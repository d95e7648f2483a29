"""The JSON schema of the configuration, for editors that complete and check.

A key's description is the string below it in its model, which pydantic would
read at every start of the service; here it is read when the schema is asked
for.
"""

import ast
import inspect
import itertools
import re
import textwrap
from collections.abc import Iterator
from typing import Any

from bstm_daemon.config.section import Section
from bstm_daemon.config.sections import Config
from bstm_daemon.roles import ROLES

_LINK = re.compile(r" ?\(\[[^]]*\]\([^)]*\)\)|\[([^]]*)\]\([^)]*\)")
"""A link of the reference: nothing, or its text within a sentence."""


def config_schema() -> dict[str, Any]:
    """Return the schema of a configuration file (JSON Schema 2020-12)."""
    schema = Config.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "configuration of bstm_daemon"
    schema["properties"]["signals"]["propertyNames"] = {
        "enum": [role.name for role in ROLES]
    }
    # of a corner the one gives the other
    schema["$defs"]["CornerConfig"]["required"].remove("piston_area_m2")
    by_name = {one.__name__: one for one in _sections(Section)}
    for name, part in schema["$defs"].items():
        if name in by_name:
            for key, text in meanings(by_name[name]).items():
                part["properties"][key]["description"] = _LINK.sub(r"\1", text)
    return schema


def meanings(model: type[Section]) -> dict[str, str]:
    """Return what each documented key of *model* means, in one line each."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(model)))
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    found = {}
    for field, below in itertools.pairwise(body):
        match field, below:
            case (
                ast.AnnAssign(target=ast.Name(id=key)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                found[key] = " ".join(text.split())
    return found


def _sections(base: type[Section]) -> Iterator[type[Section]]:
    for one in base.__subclasses__():
        yield one
        yield from _sections(one)

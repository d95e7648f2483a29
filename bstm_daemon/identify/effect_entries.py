"""Values of ``[[effect]]`` entries in a configuration, comments kept."""

from __future__ import annotations

from copy import deepcopy
from typing import Any


def set_effect_parameter(
    document: Any,
    effect: str,
    corner: str,
    key: str,
    value: float | list[float],
    origin: str,
) -> None:
    """Set parameter *key* of *effect* in *document*, a tomlkit document.

    For *corner*, or all; an effect that only the structure gives gets an
    entry. The line of the parameters says *origin* and what the value was.
    """
    from tomlkit.items import InlineTable  # noqa: PLC0415  (as below)

    table = _entry(document, effect, corner)
    parameters = table["parameters"]
    known = parameters.get(key)
    # an inline table has one comment, behind it
    inline = isinstance(parameters, InlineTable)
    old = parameters if inline else known
    said = "" if old is None else old.trivia.comment.lstrip("# ")
    parameters[key] = value
    was = "typical" if known is None else str(known)
    words = f"{origin}; was {was}"
    line = parameters if inline else parameters[key]
    line.comment(f"{words} ({said})" if said else words)


def _entry(document: Any, effect: str, corner: str) -> Any:
    """Return the entry of *effect* for *corner*, made where there is none."""
    import tomlkit  # noqa: PLC0415  (of the extra identify)

    if "effect" not in document:
        document["effect"] = tomlkit.aot()
    entries: Any = document["effect"]
    own = [one for one in entries if one["name"] == effect]
    for one in own:
        if one.get("corner", "all") == corner:
            break
    else:
        if own and own[0].get("corner", "all") == "all":
            _split(document, entries, own[0])
            return _entry(document, effect, corner)
        one = tomlkit.table()
        one["name"] = effect
        if corner != "all":
            one["corner"] = corner
        entries.append(one)
        one = entries[-1]
    if "parameters" not in one:
        one["parameters"] = tomlkit.inline_table()
    return one


def _split(document: Any, entries: Any, whole: Any) -> None:
    """Let *whole*, of all corners, become one entry for each."""
    names = [str(corner["name"]) for corner in document["corner"]]
    for name in names[1:]:
        copy = deepcopy(whole)
        copy["corner"] = name
        entries.append(copy)
    whole["corner"] = names[0]

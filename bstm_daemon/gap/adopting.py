"""Effects that were found into a copy of the configuration, comments kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.errors import FileAccessError, MissingExtraError
from bstm_daemon.files import replacing
from bstm_daemon.identify.writing import move_paths

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bstm_daemon.config import EffectConfig

_DIGITS: Final = 5


def adopt(source: Path, target: Path, effects: Sequence[EffectConfig]) -> None:
    """Write *source* with *effects* as *target*, whole or not at all.

    An entry takes the place of its namesake for the same corner; everything
    else stays as it is. Paths are made relative to the new file's folder.

    Raises:
        MissingExtraError: tomlkit is not installed.
        FileAccessError: *source* is unreadable or *target* unwritable.
    """
    try:
        import tomlkit  # noqa: PLC0415  (of the extra identify)
    except ImportError as error:
        raise MissingExtraError(
            package="tomlkit", extra="identify", purpose="-o NEW.toml"
        ) from error
    try:
        text = source.read_text(encoding="utf-8")
    except OSError as error:
        msg = f"{source}: cannot be read: {error.strerror or error}"
        raise FileAccessError(msg) from error
    document = tomlkit.parse(text)
    if "effect" not in document:
        document["effect"] = tomlkit.aot()
    entries: Any = document["effect"]
    for effect in effects:
        table = tomlkit.table()
        table["name"] = effect.name
        if effect.corner != "all":
            table["corner"] = effect.corner
        table["parameters"] = _inline(
            tomlkit,
            {
                name: float(f"{value:.{_DIGITS}g}")
                for name, value in effect.parameters.items()
            },
        )
        table["provenance"] = _inline(tomlkit, effect.provenance)
        same = [
            i
            for i, one in enumerate(entries)
            if one["name"] == effect.name
            and one.get("corner", "all") == effect.corner
        ]
        if same:
            entries[same[0]] = table
        else:
            entries.append(table)
    move_paths(document, source.resolve().parent, target.resolve().parent)
    with replacing(target) as file:
        file.write_text(tomlkit.dumps(document), encoding="utf-8")


def _inline(tomlkit: Any, values: dict[str, Any]) -> Any:
    table = tomlkit.inline_table()
    for name, value in values.items():
        table[name] = value
    return table

"""A configuration changed into a copy of it, comments kept."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.errors import FileAccessError, MissingExtraError
from bstm_daemon.files import replacing

if TYPE_CHECKING:
    from collections.abc import Iterator

_PATHS: Final = (("state", "file"), ("record", "folder"), ("metrics", "file"))


@contextmanager
def changed_copy(source: Path, target: Path) -> Iterator[Any]:
    """Give *source* as a tomlkit document to change; it becomes *target*.

    Whole or not at all. Paths are made relative to the new file's folder.

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
    yield document
    _move_paths(document, source.resolve().parent, target.resolve().parent)
    with replacing(target) as file:
        file.write_text(tomlkit.dumps(document), encoding="utf-8")


def _move_paths(document: Any, old: Path, new: Path) -> None:
    """Make relative paths of *document*, of folder *old*, right in *new*."""
    if old == new:
        return
    places = [(bus, "dbc") for bus in document.get("bus", [])]
    places += [
        (document[section], key)
        for section, key in _PATHS
        if section in document
    ]
    for table, key in places:
        path = table.get(key)
        if path is not None and not Path(str(path)).is_absolute():
            moved = os.path.relpath(old / str(path), new)
            table[key] = Path(moved).as_posix()

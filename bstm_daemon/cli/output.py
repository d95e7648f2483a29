"""Result files that are whole or absent, never half-written."""

from __future__ import annotations

import json
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from bstm_daemon.errors import FileAccessError


def write_json(path: Path, value: object) -> None:
    """Write *value* as JSON to *path*.

    Raises:
        FileAccessError: *path* cannot be written.
        ValueError: *value* holds NaN or infinity, which JSON has not.

    """
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_text(path: Path, text: str) -> None:
    """Write *text* to *path* through a temporary file beside it.

    Raises:
        FileAccessError: *path* cannot be written.

    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            Path(name).replace(path)
        except BaseException:
            with suppress(FileNotFoundError):
                Path(name).unlink()
            raise
    except OSError as error:
        msg = f"{path}: cannot be written: {error.strerror}"
        raise FileAccessError(msg) from error

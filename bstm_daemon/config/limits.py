"""Limits of sizes, lengths and depths that no vehicle needs to exceed.

A configuration or a DBC beyond them is damaged, or made to exhaust the
computer that reads it.
"""

import stat
from pathlib import Path
from typing import Final

DBC_BYTES: Final = 64 << 20
TOML_BYTES: Final = 4 << 20
CSV_BYTES: Final = 1 << 20
CSV_ROWS: Final = 1000
"""Points of a table, which is interpolated on a grid of as many."""
TOML_DEPTH: Final = 16
"""Deepest nesting of tables and lists."""
TOML_INTEGER_BITS: Final = 63
"""Bits of an integer's magnitude; TOML guarantees no more."""

COMMENT_CHARACTERS: Final = 1 << 16
"""Longest comment of a DBC; a longer one is left out."""
MESSAGE_BYTES: Final = 4095
"""Longest message of the transport protocol ISO 15765-2."""
SIGNAL_BITS: Final = 512
"""Bits of a CAN FD frame."""

EXPRESSION_CHARACTERS: Final = 4096
EXPRESSION_TERMS: Final = 200
EXPRESSION_DEPTH: Final = 50


def read_limited(path: Path, most_bytes: int) -> bytes:
    """Return the content of the regular file *path*.

    Raises:
        OSError: It cannot be read.
        ValueError: It is no regular file, or longer than *most_bytes*.
    """
    kind = path.stat().st_mode
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        msg = "is no regular file"
        raise ValueError(msg)
    with path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        msg = f"is longer than {most_bytes >> 20} MiB, the most that is read"
        raise ValueError(msg)
    return content

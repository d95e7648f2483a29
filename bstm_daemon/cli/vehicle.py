"""The vehicle and its state, from the files that arguments name."""

from pathlib import Path
from typing import Any

from bstm_daemon.errors import FileAccessError
from bstm_daemon.replay.vehicle import load_vehicle
from bstm_daemon.service.state_file import read

__all__ = ["load_vehicle", "read_state"]


def read_state(path: Path, flag: str) -> dict[str, Any]:
    """Return the state file *path*, given by *flag*, and leave it as it is.

    Raises:
        FileAccessError: it is missing or unusable.
    """
    loaded = read(path)
    if loaded.document is None:
        problem = loaded.problem or f"{path}: No such file or directory"
        msg = f"{flag} {problem}"
        raise FileAccessError(msg)
    return loaded.document

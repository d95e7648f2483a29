"""Result files, whole or absent, and the files that come with the program."""

import errno
import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from bstm_daemon.errors import FileAccessError, UsageError


def shipped_file(name: str) -> Path:
    """Return the path of a shipped file such as ``dbc/bstm.dbc``.

    In a checkout they stand beside the package; an installation puts them
    under ``share/bstm-daemon`` of its prefix.

    Raises:
        FileAccessError: it is in neither place.
    """
    places = (
        Path(__file__).resolve().parents[1],
        Path(sys.prefix) / "share" / "bstm-daemon",
    )
    for place in places:
        if (place / name).is_file():
            return place / name
    looked = " nor ".join(str(place) for place in places)
    msg = f"{name}: a file of this program is neither in {looked}; reinstall"
    raise FileAccessError(msg)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary file beside *path*; on success it becomes *path*.

    On any exception, Ctrl-C included, *path* stays as it was and the
    temporary file goes.

    Raises:
        FileAccessError: the folder is missing or not writable.
    """
    temporary = None
    try:
        handle, name = tempfile.mkstemp(
            dir=path.parent, prefix=f".{path.name}."
        )
        os.close(handle)
        temporary = Path(name)
        temporary.chmod(0o666 & ~_umask())
        yield temporary
        temporary.replace(path)
    except BaseException as error:
        if temporary is not None:
            with suppress(OSError):
                temporary.unlink()
        if isinstance(error, OSError):
            msg = f"{path}: cannot be written: {error.strerror or error}"
            raise FileAccessError(msg) from error
        raise


def ensure_writable(path: Path) -> None:
    """Refuse *path* where :func:`replacing` could not write it.

    Asked before long work, so that no result is lost at its end.

    Raises:
        FileAccessError: *path* is a folder, or its own is missing or not
            writable.
    """
    if path.is_dir():
        reason = errno.EISDIR
    elif not path.parent.is_dir():
        reason = errno.ENOTDIR if path.parent.exists() else errno.ENOENT
    elif not os.access(path.parent, os.W_OK | os.X_OK):
        reason = errno.EACCES
    else:
        return
    msg = f"{path}: cannot be written: {os.strerror(reason)}"
    raise FileAccessError(msg)


def make_folder(path: Path) -> None:
    """Create the folder *path* where it is missing.

    Raises:
        FileAccessError: it can not be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f"{path}: cannot be created: {error.strerror or error}"
        raise FileAccessError(msg) from error


def read_secret(path: Path) -> str:
    """Return the text of *path*, which other users can not read.

    Its group may: systemd hands credentials over in such files.

    Raises:
        FileAccessError: it can not be read.
        UsageError: others can read it too.
    """
    try:
        mode = path.stat().st_mode
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        msg = f"{path}: {getattr(error, 'strerror', None) or error}"
        raise FileAccessError(msg) from error
    if mode & stat.S_IRWXO:
        msg = f"{path}: every user can read this secret (chmod o= {path})"
        raise UsageError(msg)
    return text


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask

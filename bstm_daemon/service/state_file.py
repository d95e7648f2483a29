"""The state file: the brakes' history over restarts and power cuts.

One line, then a JSON document::

    bstm-state <version> <BLAKE2s of the body, hex> <length of the body>
    {"...": ...}

A new document is written beside the old one, synced and renamed over it, so
that a power cut at any instant leaves the old or the new document intact.
Length and checksum reveal later damage by a failing medium. A bad file is set
aside, never repaired: a wrong history is worse than none.

One process at a time owns the file, by :func:`lock`.
"""

import errno
import fcntl
import hashlib
import json
import math
import os
import re
import stat
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, NoReturn

from bstm_daemon.errors import StateLockedError, UsageError

Document = dict[str, Any]

VERSION: Final = 1
SIZE_LIMIT_BYTES: Final = 2**20
KEPT_BAD_FILES: Final = 3

_HEAD = re.compile(rb"bstm-state ([0-9]{1,9}) ([0-9a-f]{64}) ([0-9]{1,9})")
_BAD_STAMP = re.compile(r"\d{8}T\d{6}\.\d{6}Z")
_TEMPORARY = re.compile(r"[a-z0-9_]{8}")  # what mkstemp appends
_SAFE_ID = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
_ENDS_LIKE_HASHED = re.compile(r"-[0-9a-f]{8}\Z")


@dataclass(frozen=True)
class Loaded:
    """The content of a state file.

    Without a file both are None. ``problem`` names the path, the defect and
    where the file is now; the history is then unknown.
    """

    document: Document | None = None
    problem: str | None = None


def encode(document: Document) -> bytes:
    """Return the bytes of the file that holds *document*.

    Every float comes back bit for bit; NaN and infinity are refused, since
    JSON has neither and a state that holds one is no state to start from.

    Raises:
        ValueError: not a dict of dicts with text keys, lists, texts, finite
            floats, integers of 64 bits, booleans and None, or more than
            ``SIZE_LIMIT_BYTES``.
    """
    try:
        text = json.dumps(document, allow_nan=False, separators=(",", ":"))
        body = text.encode() + b"\n"
        digest = hashlib.blake2s(body).hexdigest()
        head = f"bstm-state {VERSION} {digest} {len(body)}\n"
        data = head.encode() + body
        # tuples and keys that are not text would come back changed
        same = decode(data) == document
    except (TypeError, ValueError, RecursionError) as error:
        msg = f"not a document for a state file: {error}"
        raise ValueError(msg) from error
    if not same:
        msg = (
            "not a document for a state file: it would not come back the "
            "same (only lists, and dicts with text keys)"
        )
        raise ValueError(msg)
    return data


def decode(data: bytes) -> Document:
    """Return the document in *data*, the bytes of a whole file.

    Raises:
        ValueError: cut, altered, of another version, too large or no JSON
            document; the message completes "the file ...".
    """
    if len(data) > SIZE_LIMIT_BYTES:
        _refuse(f"is larger than {SIZE_LIMIT_BYTES} bytes")
    head, line_end, body = data.partition(b"\n")
    fields = _HEAD.fullmatch(head)
    if not fields or not line_end:
        _refuse("does not begin with the line of a state file")
    version, digest, length = fields.groups()
    if int(version) != VERSION:
        _refuse(f"has version {int(version)}, this program reads {VERSION}")
    if int(length) != len(body):
        _refuse(f"holds {len(body)} of {int(length)} bytes")
    if hashlib.blake2s(body).hexdigest().encode() != digest:
        _refuse("does not fit its checksum")
    try:
        document = json.loads(
            body.decode(),
            parse_float=_finite,
            parse_constant=_finite,
            parse_int=_whole,
        )
    except (ValueError, RecursionError) as error:
        _refuse(f"holds no JSON document: {error}")
    if not isinstance(document, dict):
        _refuse("holds JSON that is not a table of names")
    return document


def read(path: Path) -> Loaded:
    """Return what the state file at *path* holds and leave it as it is."""
    return _read(path)[0]


def load(path: Path) -> Loaded:
    """Return what the state file at *path* holds; set a bad one aside.

    A bad file becomes ``<name>.bad-<UTC stamp>``, of which the newest
    ``KEPT_BAD_FILES`` stay; where the folder does not allow it, and where
    *path* is no regular file, it stays in place. Never raises
    :class:`OSError`.
    """
    loaded, movable = _read(path)
    if loaded.problem is None:
        return loaded
    if not movable:
        return Loaded(None, f"{loaded.problem}; left in place")
    return Loaded(None, f"{loaded.problem}; {set_aside(path)}")


def set_aside(path: Path) -> str:
    """Rename the file *path* out of the way, as :func:`load` does.

    Returns what was done. Never raises :class:`OSError`.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")
    aside = path.with_name(f"{path.name}.bad-{stamp}")
    try:
        path.rename(aside)
    except OSError as error:
        return f"left in place: {_reason(error)}"
    with suppress(OSError):
        # the clock may be in 1970: always keep the one just set aside
        older = _siblings(path, f"{path.name}.bad-", _BAD_STAMP) - {aside}
        for surplus in sorted(older)[: -(KEPT_BAD_FILES - 1)]:
            surplus.unlink()
    return f"set aside as {aside.name}"


def save(path: Path, data: bytes) -> None:
    """Replace the state file at *path* by *data*, made by :func:`encode`.

    On return it is on the medium. The file has mode 0600; a missing folder
    is made.

    Raises:
        OSError: it could not be written; the old file stands, or, where only
            the last sync failed, the new one.
    """
    _make_folder(path)
    if path.exists() and not path.is_file():
        # renaming over a device file would remove it for the whole system
        raise OSError(errno.EINVAL, "is not a regular file", str(path))
    _remove_leftovers(path)
    handle, name = tempfile.mkstemp(
        dir=path.parent, prefix=_temporary_prefix(path)
    )
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with suppress(OSError):
            temporary.unlink()
        raise
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


class StateLock:
    """The right to write a state file, kept until closed or process end.

    ``problem`` says why no lock could be taken, other than for a second
    instance; None where this process has it.
    """

    def __init__(self, file: int | None, problem: str | None = None) -> None:
        """Own the open *file* that is locked, or none with a *problem*."""
        self._file = file
        self.problem = problem

    def close(self) -> None:
        """Give the lock back; again does nothing."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


def lock(path: Path) -> StateLock:
    """Take the lock ``<path>.lock``; remove what a killed run left behind.

    The kernel's lock on the open file counts, not the file: it ends with the
    process however that ends, and the file with the process id stays.

    Raises:
        StateLockedError: another process holds it. A folder that cannot be
            written raises nothing: see :class:`StateLock`.
    """
    place = Path(f"{path}.lock")
    try:
        _make_folder(path)
        file = _open_lock(place)
    except OSError as error:
        return StateLock(None, f"{place}: no lock: {_reason(error)}")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        msg = (
            f"{path}: in use by {_holder(file)} ({place.name}); stop it, or "
            "give this instance its own state file"
        )
        os.close(file)
        raise StateLockedError(msg) from error
    except OSError as error:
        os.close(file)
        return StateLock(None, f"{place}: no lock: {_reason(error)}")
    with suppress(
        OSError
    ):  # the id is only informative: a full disk may refuse it
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
    with suppress(OSError):
        _remove_leftovers(path)
    return StateLock(file)


def state_path(
    configured: Path | str | None, vehicle_id: str, environ: Mapping[str, str]
) -> Path:
    """Return where the state of *vehicle_id* lies.

    The *configured* file as it is; else ``<vehicle id>.state`` in the first
    folder of ``$STATE_DIRECTORY`` (systemd.exec(5)), else in ``bstm`` below
    ``$XDG_STATE_HOME`` or ``~/.local/state`` (XDG Base Directory
    Specification, which has a relative one ignored).

    Raises:
        UsageError: nothing of all that is known.
    """
    if configured:
        return Path(configured)
    name = f"{safe_name(vehicle_id)}.state"
    service = environ.get("STATE_DIRECTORY", "").split(":", maxsplit=1)[0]
    if service:
        return Path(service) / name
    user = Path(environ.get("XDG_STATE_HOME", ""))
    if user.is_absolute():
        return user / "bstm" / name
    if home := environ.get("HOME"):
        return Path(home) / ".local" / "state" / "bstm" / name
    msg = (
        "no place for the state file: set 'file' in [state], or one of the "
        "variables STATE_DIRECTORY, XDG_STATE_HOME and HOME"
    )
    raise UsageError(msg)


def safe_name(vehicle_id: str) -> str:
    """Return a file name for *vehicle_id*, another one for every id.

    An id that is a plain file name stays; any other, also one that looks
    like the result of this, gets a hash of the whole id.
    """
    if _SAFE_ID.fullmatch(vehicle_id) and not _ENDS_LIKE_HASHED.search(
        vehicle_id
    ):
        return vehicle_id
    data = vehicle_id.encode(errors="surrogatepass")
    digest = hashlib.blake2s(data, digest_size=4).hexdigest()
    stem = re.sub(r"[^A-Za-z0-9_-]", "_", vehicle_id)[:40].lstrip("-")
    return f"{stem or 'vehicle'}-{digest}"


def _read(path: Path) -> tuple[Loaded, bool]:
    """Return what *path* holds, and whether a bad one may be renamed."""
    try:
        # non-blocking: a FIFO in its place must not delay the start
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        return Loaded(), False
    except OSError as error:
        return Loaded(None, f"{path}: {_reason(error)}"), True
    try:
        if not stat.S_ISREG(os.fstat(file).st_mode):
            return Loaded(None, f"{path}: is not a regular file"), False
        with os.fdopen(file, "rb", closefd=False) as stream:
            data = stream.read(SIZE_LIMIT_BYTES + 1)
        return Loaded(decode(data)), True
    except OSError as error:
        return Loaded(None, f"{path}: {_reason(error)}"), True
    except ValueError as error:
        return Loaded(None, f"{path}: {error}"), True
    finally:
        os.close(file)


def _refuse(reason: str) -> NoReturn:
    raise ValueError(reason)


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        _refuse(f"{text} is no number")
    return number


def _whole(text: str) -> int:
    number = int(text)
    if not -(2**63) <= number < 2**63:
        _refuse(f"{text} is beyond 64 bits")
    return number


def _open_lock(place: Path) -> int:
    """Open *place*; for reading only where writing is not allowed.

    On a medium that went read-only, an existing lock file still keeps
    instances apart.
    """
    try:
        return os.open(place, os.O_RDWR | os.O_CREAT, 0o600)
    except OSError as error:
        try:
            return os.open(place, os.O_RDONLY)
        except OSError:
            raise error from None


def _holder(file: int) -> str:
    text = b""
    with suppress(OSError):
        text = os.pread(file, 20, 0).strip()
    return f"process {text.decode()}" if text.isdigit() else "another process"


def _temporary_prefix(path: Path) -> str:
    return f".{path.name}.tmp-"


def _remove_leftovers(path: Path) -> None:
    """Remove the temporary files of runs that were killed while saving."""
    for leftover in _siblings(path, _temporary_prefix(path), _TEMPORARY):
        leftover.unlink(missing_ok=True)


def _siblings(path: Path, prefix: str, rest: re.Pattern[str]) -> set[Path]:
    """Return the files beside *path* named *prefix* and then *rest*."""
    return {
        other
        for other in path.parent.iterdir()
        if other.name.startswith(prefix)
        and rest.fullmatch(other.name.removeprefix(prefix))
    }


def _make_folder(path: Path) -> None:
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)


def _reason(error: OSError) -> str:
    return error.strerror or str(error)

"""The state file: whole or set aside, never half-believed."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import resource
import shutil
import stat
import subprocess
import sys
import tempfile
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bstm_daemon.errors import StateLockedError, UsageError
from bstm_daemon.service.state_file import (
    KEPT_BAD_FILES,
    SIZE_LIMIT_BYTES,
    Document,
    Loaded,
    decode,
    encode,
    load,
    lock,
    read,
    safe_name,
    save,
    state_path,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

NOBODY = 65534

DOCUMENT: Document = {
    "vehicle": "golf",
    "saved_unix_s": 1760000000.123456,
    "corner": {"FL": {"disc_k": 673.1500000000001, "pads_k": [1e-300, -0.0]}},
    "note": None,
    "settled": True,
}

plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(), inner, max_size=4)
    ),
    max_leaves=20,
)
documents = st.dictionaries(st.text(), plain, max_size=6)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def wrapped(body: bytes, version: int = 1) -> bytes:
    digest = hashlib.blake2s(body).hexdigest()
    return f"bstm-state {version} {digest} {len(body)}\n".encode() + body


@contextmanager
def file_size_limit(size_bytes: int) -> Iterator[None]:
    """Have every write beyond *size_bytes* of a file fail, as a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def owned_folder() -> Iterator[Path]:
    """Give a folder of a user whom permissions hold back, and be that one.

    Not a fixture: what runs between the test and its end is root's.
    """
    folder = Path(tempfile.mkdtemp())
    root = os.geteuid() == 0
    if root:
        os.chown(folder, NOBODY, NOBODY)
        os.seteuid(NOBODY)
    try:
        if not os.access(folder, os.W_OK, effective_ids=True):
            pytest.skip(f"{folder} is out of reach of an ordinary user")
        yield folder
    finally:
        if root:
            os.seteuid(0)
        folder.chmod(0o700)
        shutil.rmtree(folder)


# -- what is written


def test_a_document_comes_back(tmp_path: Path) -> None:
    """With its floats bit for bit, in the format the reference states."""
    path = tmp_path / "golf.state"
    save(path, encode(DOCUMENT))

    assert load(path) == Loaded(DOCUMENT, None)
    head, body = path.read_bytes().split(b"\n", 1)
    digest = hashlib.blake2s(body).hexdigest()
    assert head.decode() == f"bstm-state 1 {digest} {len(body)}"
    assert json.loads(body) == DOCUMENT


@given(documents)
@example({"": {"\ud800": ["\0", 2**63 - 1, -(2**63), -0.0, 5e-324]}})
def test_every_plain_document_comes_back(document: Document) -> None:
    """Equal, of the same types, and every float with its sign of zero."""
    again = decode(encode(document))

    assert repr(again) == repr(document)


@pytest.mark.parametrize(
    "value",
    [
        math.nan,
        math.inf,
        -math.inf,
        10**30,
        (1, 2),
        {1: "x"},
        {None: "x"},
        b"x",
        {"x"},
        object(),
        "x" * SIZE_LIMIT_BYTES,
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_would_not_come_back_is_refused(
    tmp_path: Path, value: Any
) -> None:
    """And the file from before stands."""
    path = tmp_path / "golf.state"
    save(path, encode(DOCUMENT))

    with pytest.raises(ValueError, match="not a document for a state file"):
        save(path, encode({"deep": [{"value": value}]}))
    assert load(path).document == DOCUMENT
    assert names(tmp_path) == {"golf.state"}


@pytest.mark.parametrize("document", [[], "x", 1.0, None])
def test_only_a_table_is_a_document(document: Any) -> None:
    with pytest.raises(ValueError, match="not a table of names"):
        encode(document)


def test_endless_nesting_is_refused() -> None:
    """In a document that holds itself, and in one merely too deep."""
    circle: Document = {}
    circle["self"] = circle
    deep: list[Any] = []
    for _ in range(100_000):
        deep = [deep]

    for document in (circle, {"deep": deep}):
        with pytest.raises(ValueError, match="not a document"):
            encode(document)


def test_the_file_is_private_and_its_folder_is_made(tmp_path: Path) -> None:
    """Whatever the umask would allow."""
    path = tmp_path / "state" / "bstm" / "golf.state"
    before = os.umask(0)
    try:
        save(path, encode(DOCUMENT))
    finally:
        os.umask(before)

    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_synced_before_it_takes_the_place_and_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The order that outlives a power cut, seen at the calls themselves."""
    path = tmp_path / "golf.state"
    steps = []
    fsync, replace = os.fsync, Path.replace

    def seen_fsync(file: int) -> None:
        mode = os.fstat(file).st_mode
        whole = None
        if stat.S_ISREG(mode):
            whole = decode(Path(f"/proc/self/fd/{file}").read_bytes())
        steps.append(("fsync", stat.S_ISDIR(mode), whole))
        fsync(file)

    def seen_replace(self: Path, target: Path) -> Path:
        steps.append(("replace", False, None))
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", seen_fsync)
    monkeypatch.setattr(Path, "replace", seen_replace)
    save(path, encode(DOCUMENT))

    assert steps == [
        ("fsync", False, DOCUMENT),
        ("replace", False, None),
        ("fsync", True, None),
    ]


def test_a_full_disk_leaves_the_old_file_alone(tmp_path: Path) -> None:
    """The error reaches the caller; no temporary file stays."""
    path = tmp_path / "golf.state"
    save(path, encode(DOCUMENT))

    with file_size_limit(100), pytest.raises(OSError, match="too large") as e:
        save(path, encode(DOCUMENT | {"more": "x" * 200}))

    assert e.value.errno == errno.EFBIG
    assert names(tmp_path) == {"golf.state"}
    assert load(path).document == DOCUMENT


def test_a_read_only_folder_is_an_error_for_save_alone() -> None:
    """Reading goes on."""
    with owned_folder() as folder:
        path = folder / "golf.state"
        save(path, encode(DOCUMENT))
        folder.chmod(0o500)

        with pytest.raises(PermissionError):
            save(path, encode({}))
        assert load(path).document == DOCUMENT


@pytest.mark.parametrize("kind", ["folder", "fifo", "device"])
def test_what_is_no_regular_file_is_never_replaced(
    tmp_path: Path, kind: str
) -> None:
    """A configured /dev/null must not lose its place, nor a folder."""
    path = tmp_path / "golf.state"
    if kind == "folder":
        path.mkdir()
    elif kind == "fifo":
        os.mkfifo(path)
    else:
        path.symlink_to(os.devnull)

    with pytest.raises(OSError, match="not a regular file"):
        save(path, encode(DOCUMENT))
    loaded = load(path)
    assert loaded.document is None
    assert loaded.problem == (f"{path}: is not a regular file; left in place")
    assert names(tmp_path) == {"golf.state"}


def test_leftovers_of_a_killed_run_go(tmp_path: Path) -> None:
    """At the next save and the next lock; reading touches nothing."""
    path = tmp_path / "golf.state"
    leftover = tmp_path / ".golf.state.tmp-ab_c1234"
    others = {
        ".golf.state.tmp-",
        ".golf.state.tmp-Kept.abc",
        ".polo.state.tmp-abcd1234",
        "golf.state.tmp-abcd1234",
    }
    for name in others:
        (tmp_path / name).touch()

    leftover.touch()
    save(path, encode(DOCUMENT))
    assert names(tmp_path) == others | {"golf.state"}

    leftover.touch()
    assert load(path).document == DOCUMENT
    assert leftover.exists()
    with closing(lock(path)):
        assert not leftover.exists()
    assert names(tmp_path) == others | {"golf.state", "golf.state.lock"}


# -- what is read


def test_no_file_is_no_problem(tmp_path: Path) -> None:
    assert load(tmp_path / "golf.state") == Loaded(None, None)
    assert load(tmp_path / "none" / "golf.state") == Loaded(None, None)


def test_a_cut_at_every_byte_is_seen() -> None:
    data = encode(DOCUMENT)

    for length in range(len(data)):
        with pytest.raises(ValueError, match=r"does not begin|holds \d+ of"):
            decode(data[:length])


def test_every_flipped_bit_is_seen() -> None:
    data = encode(DOCUMENT)

    for position in range(len(data)):
        for bit in range(8):
            altered = bytearray(data)
            altered[position] ^= 1 << bit
            with pytest.raises(ValueError, match=r"\w"):
                decode(bytes(altered))


@given(documents, st.data())
def test_a_cut_and_a_flipped_bit_anywhere_are_seen(
    document: Document, data: st.DataObject
) -> None:
    """In any document, also with something appended or two files in one."""
    whole = encode(document)
    cut = data.draw(st.integers(0, len(whole) - 1))
    altered = bytearray(whole)
    altered[cut] ^= 1 << data.draw(st.integers(0, 7))

    for bad in (
        whole[:cut],
        bytes(altered),
        whole + b"\n",
        whole + whole,
        whole[:cut] + b"\0" * (len(whole) - cut),
    ):
        if bad != whole:
            with pytest.raises(ValueError, match=r"\w"):
                decode(bad)


@pytest.mark.slow
@settings(max_examples=200)
@given(
    st.binary(max_size=300)
    | st.binary(max_size=300).map(wrapped)
    | st.text(max_size=100).map(lambda text: wrapped(text.encode("utf-16")))
    | plain.map(lambda value: wrapped(json.dumps(value).encode()))
)
@example(b"")
@example(b"\n")
@example(wrapped(b""))
@example(wrapped(b"{}"))
@example(wrapped(b"[" * 200_000))
@example(wrapped(b'{"a":' * 200_000))
@example(wrapped(b'{"a": NaN}'))
@example(wrapped(b'{"a": 1e999}'))
@example(wrapped(b'{"a": ' + b"9" * 5000 + b"}"))
@example(b"bstm-state 1 " + b"0" * 64 + b" " + b"9" * 5000 + b"\n{}")
def test_any_bytes_are_a_document_or_a_problem(data: bytes) -> None:
    """Never an exception, and a problem always leaves the place free."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "golf.state"
        path.write_bytes(data)
        untouched = read(path)
        loaded = load(path)
        found = names(path.parent)

    assert untouched.document == loaded.document
    if loaded.problem is None:
        assert isinstance(loaded.document, dict)
        assert repr(decode(encode(loaded.document))) == repr(loaded.document)
        assert found == {"golf.state"}
    else:
        assert loaded.document is None
        assert loaded.problem.startswith(f"{untouched.problem}; set aside")
        (aside,) = found
        assert aside in loaded.problem


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "does not begin with the line of a state file"),
        (b"\x80\x04\x95.", "does not begin with the line of a state file"),
        (encode(DOCUMENT)[:-1], r"holds \d+ of \d+ bytes"),
        (encode(DOCUMENT) + b" ", r"holds \d+ of \d+ bytes"),
        (encode({"a": 1}).replace(b"1}", b"2}"), "does not fit its checksum"),
        (wrapped(b"{}", 2), "has version 2, this program reads 1"),
        (wrapped(b"{"), "holds no JSON document: .*"),
        (wrapped(b'{"a":NaN}'), "holds no JSON document: NaN is no number"),
        (wrapped(b'{"a":1e999}'), "holds no JSON document: 1e999 is no .*"),
        (wrapped(b"{}\xff"), "holds no JSON document: .*"),
        (wrapped(b"[1]"), "holds JSON that is not a table of names"),
        (wrapped(b" " * SIZE_LIMIT_BYTES), r"is larger than 1048576 bytes"),
    ],
)
def test_a_bad_file_is_set_aside_with_its_reason(
    tmp_path: Path, data: bytes, reason: str
) -> None:
    """Under a dated name, as it was; the next start finds no file."""
    path = tmp_path / "golf.state"
    path.write_bytes(data)

    loaded = load(path)

    (aside,) = tmp_path.iterdir()
    assert loaded.document is None
    assert loaded.problem is not None
    assert re.fullmatch(
        f"{re.escape(str(path))}: {reason}; set aside as {aside.name}",
        loaded.problem,
    )
    assert re.fullmatch(r"golf\.state\.bad-\d{8}T\d{6}\.\d{6}Z", aside.name)
    assert aside.read_bytes() == data
    assert load(path) == Loaded(None, None)


def test_the_newest_bad_files_stay(tmp_path: Path) -> None:
    """Also the one set aside now, when the clock stands before the rest."""
    path = tmp_path / "golf.state"
    stands = {
        "golf.state.bad-29990101T000000.000000Z",
        "golf.state.bad-29990102T000000.000000Z",
    }
    others = {"golf.state.bad-note", "polo.state.bad-29990101T000000.000000Z"}
    for name in (
        *stands,
        *others,
        "golf.state.bad-29981231T000000.000000Z",
        "golf.state.bad-19990102T000000.000000Z",
    ):
        (tmp_path / name).touch()

    path.write_bytes(b"bad")
    problem = load(path).problem

    assert problem is not None
    aside = problem.split()[-1]
    assert names(tmp_path) == stands | others | {aside}
    for _ in range(5):
        path.write_bytes(b"bad")
        load(path)
    bad = names(tmp_path) - others
    assert len(bad) == KEPT_BAD_FILES


def test_a_bad_file_in_a_read_only_folder_stays() -> None:
    """Nothing is raised, and the problem says so."""
    with owned_folder() as folder:
        path = folder / "golf.state"
        path.write_bytes(b"bad")
        folder.chmod(0o500)

        assert load(path).problem == (
            f"{path}: does not begin with the line of a state file; left in "
            "place: Permission denied"
        )
        assert names(folder) == {"golf.state"}


def test_an_unreadable_file_is_set_aside() -> None:
    with owned_folder() as folder:
        path = folder / "golf.state"
        save(path, encode(DOCUMENT))
        path.chmod(0)

        problem = load(path).problem

        assert problem is not None
        assert problem.startswith(f"{path}: Permission denied; set aside as ")
        assert load(path) == Loaded(None, None)


def test_a_file_where_the_folder_should_be(tmp_path: Path) -> None:
    (tmp_path / "state").touch()
    path = tmp_path / "state" / "golf.state"

    assert load(path).problem == (
        f"{path}: Not a directory; left in place: Not a directory"
    )


# -- one process at a time


HOLDER = """
import sys
from pathlib import Path
from bstm_daemon.service.state_file import lock
held = lock(Path(sys.argv[1]))
print(held.problem is None, flush=True)
sys.stdin.read()
"""


def test_another_process_holds_the_lock(tmp_path: Path) -> None:
    """It is named, with the file; its end, by SIGKILL, ends the lock."""
    path = tmp_path / "new" / "golf.state"
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "True\n"

        with pytest.raises(StateLockedError) as caught:
            lock(path)
        assert str(caught.value).startswith(
            f"{path}: in use by process {holder.pid} (golf.state.lock); "
        )
        assert caught.value.exit_code == 75

        holder.kill()
        holder.wait()
    assert (path.parent / "golf.state.lock").read_text() == f"{holder.pid}\n"
    with closing(lock(path)) as held:
        assert held.problem is None
        assert held.problem is None


def test_the_lock_ends_with_release_and_its_file_stays(
    tmp_path: Path,
) -> None:
    path = tmp_path / "golf.state"

    with closing(lock(path)) as first:
        assert first.problem is None
        with pytest.raises(StateLockedError, match=f"process {os.getpid()} "):
            lock(path)
        with closing(lock(tmp_path / "polo.state")) as other:
            assert other.problem is None
    first.close()

    place = tmp_path / "golf.state.lock"
    assert place.read_text() == f"{os.getpid()}\n"
    assert stat.S_IMODE(place.stat().st_mode) == 0o600
    lock(path).close()


def test_the_process_id_is_overwritten_whole(tmp_path: Path) -> None:
    """A longer one from before leaves no digits; rubbish names nobody."""
    path = tmp_path / "golf.state"
    place = tmp_path / "golf.state.lock"
    place.write_text("123456789012\n")

    with closing(lock(path)):
        assert place.read_text() == f"{os.getpid()}\n"
        place.write_text("rubbish\n")
        with pytest.raises(StateLockedError, match="by another process "):
            lock(path)


def test_a_child_process_does_not_inherit_the_lock(tmp_path: Path) -> None:
    """A child that outlives the daemon must not block the next start."""
    path = tmp_path / "golf.state"
    held = lock(path)
    with subprocess.Popen(
        [sys.executable, "-c", "print(flush=True); input()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        close_fds=False,
    ) as child:
        assert child.stdout is not None
        assert child.stdin is not None
        assert child.stdout.readline() == b"\n"
        held.close()
        lock(path).close()
        assert child.poll() is None
        child.stdin.write(b"\n")


@pytest.mark.parametrize("place", ["file/golf.state", "file"])
def test_no_lock_where_none_can_be(tmp_path: Path, place: str) -> None:
    """A handle that says why, no exception: the daemon goes on."""
    (tmp_path / "file").touch()
    (tmp_path / "file.lock").symlink_to(tmp_path / "none" / "file.lock")
    path = tmp_path / place

    with closing(lock(path)) as held:
        assert held.problem is not None
        assert held.problem is not None
        assert held.problem.startswith(f"{path}.lock: no lock: ")


def test_a_read_only_folder_still_tells_two_instances_apart() -> None:
    """By the lock file from before; without one there is no lock."""
    with owned_folder() as folder:
        path = folder / "golf.state"
        lock(path).close()
        (folder / "golf.state.lock").chmod(0o400)
        folder.chmod(0o500)

        with closing(lock(path)) as held:
            assert held.problem is None
            with pytest.raises(StateLockedError):
                lock(path)
        with closing(lock(folder / "polo.state")) as other:
            assert other.problem == (
                f"{folder}/polo.state.lock: no lock: Permission denied"
            )


def test_a_full_disk_does_not_prevent_the_lock(tmp_path: Path) -> None:
    """Only the process id is missing then."""
    path = tmp_path / "golf.state"

    with file_size_limit(0), closing(lock(path)) as held:
        assert held.problem is None
        with pytest.raises(StateLockedError, match="by another process "):
            lock(path)


# -- where it lies


@pytest.mark.parametrize(
    ("configured", "environ", "expected"),
    [
        ("/data/x.state", {"STATE_DIRECTORY": "/s"}, "/data/x.state"),
        (Path("x"), {}, "x"),
        (None, {"STATE_DIRECTORY": "/s/bstm"}, "/s/bstm/golf.state"),
        (None, {"STATE_DIRECTORY": "/s/a:/s/b"}, "/s/a/golf.state"),
        (
            None,
            {"STATE_DIRECTORY": "/s", "XDG_STATE_HOME": "/x", "HOME": "/h"},
            "/s/golf.state",
        ),
        (
            None,
            {"STATE_DIRECTORY": "", "XDG_STATE_HOME": "/x", "HOME": "/h"},
            "/x/bstm/golf.state",
        ),
        (
            None,
            {"XDG_STATE_HOME": "relative", "HOME": "/h"},
            "/h/.local/state/bstm/golf.state",
        ),
        ("", {"HOME": "/h"}, "/h/.local/state/bstm/golf.state"),
    ],
)
def test_where_the_state_lies(
    configured: Path | str | None, environ: dict[str, str], expected: str
) -> None:
    assert state_path(configured, "golf", environ) == Path(expected)


def test_nowhere_to_put_the_state() -> None:
    with pytest.raises(UsageError, match=r"'file' in \[state\]"):
        state_path(None, "golf", {"HOME": ""})


@pytest.mark.parametrize("vehicle_id", ["golf", "Golf_7.5-GTI", "1" * 64])
def test_a_plain_id_is_its_own_name(vehicle_id: str) -> None:
    assert safe_name(vehicle_id) == vehicle_id


@pytest.mark.parametrize(
    ("vehicle_id", "stem"),
    [
        ("", "vehicle"),
        ("..", "__"),
        ("/etc/passwd", "_etc_passwd"),
        (".hidden", "_hidden"),
        ("-rf", "rf"),
        ("golf\n", "golf_"),
        ("Käfer", "K_fer"),
        ("1" * 65, "1" * 40),
        ("golf-0a1b2c3d", "golf-0a1b2c3d"),
    ],
)
def test_any_other_id_gets_a_hash(vehicle_id: str, stem: str) -> None:
    assert re.fullmatch(f"{stem}-[0-9a-f]{{8}}", safe_name(vehicle_id))


@given(
    st.lists(
        st.text(st.characters(), max_size=80)
        | st.text("aB0./-_ ", max_size=5)
        | st.text("a/", max_size=3).map(safe_name),
        min_size=2,
        max_size=2,
        unique=True,
    )
)
def test_every_id_has_a_file_of_its_own(ids: list[str]) -> None:
    first, second = (safe_name(vehicle_id) for vehicle_id in ids)

    assert first != second
    assert re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}", first)


def test_the_longest_name_fits_with_all_that_hangs_on_it(
    tmp_path: Path,
) -> None:
    """The lock, the temporary file and the one set aside."""
    path = state_path(None, "x" * 64, {"STATE_DIRECTORY": str(tmp_path)})

    with closing(lock(path)) as held:
        assert held.problem is None
        save(path, encode(DOCUMENT)[:-1])
        problem = load(path).problem
    assert problem is not None
    assert "set aside as" in problem
    with suppress(FileNotFoundError):
        path.unlink()
        pytest.fail("the bad file is still there")

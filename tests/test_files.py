"""Result files: whole or not at all."""

from __future__ import annotations

import os
import stat
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.errors import FileAccessError
from bstm_daemon.files import (
    ensure_writable,
    make_folder,
    replacing,
    shipped_file,
)

if TYPE_CHECKING:
    from pathlib import Path


def test_the_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    """Until then the old one stands, and afterwards nothing else."""
    path = tmp_path / "result.csv"
    path.write_text("old")

    with replacing(path) as temporary:
        temporary.write_text("new")
        assert temporary.parent == tmp_path
        assert path.read_text() == "old"

    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("had_one", [True, False])
@pytest.mark.parametrize(
    "broken", [KeyboardInterrupt, ValueError, SystemExit, MemoryError]
)
def test_what_breaks_leaves_things_as_they_were(
    tmp_path: Path,
    broken: type[BaseException],
    had_one: bool,  # noqa: FBT001
) -> None:
    """Whatever ends the writing, Ctrl-C included."""
    path = tmp_path / "result.csv"
    if had_one:
        path.write_text("old")

    def half_written() -> None:
        with replacing(path) as temporary:
            temporary.write_text("ne")
            raise broken

    with pytest.raises(broken):
        half_written()

    assert [p.name for p in tmp_path.iterdir()] == ["result.csv"] * had_one
    assert not had_one or path.read_text() == "old"


def test_a_full_disk_is_an_access_error(tmp_path: Path) -> None:
    """An OSError while writing names the file that was meant."""
    path = tmp_path / "result.csv"

    def full() -> None:
        with replacing(path) as temporary:
            temporary.write_text("ne")
            raise OSError(28, "No space left on device")

    with pytest.raises(
        FileAccessError, match=r"result\.csv: .* No space left on device"
    ):
        full()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["none/result.csv", "file/result.csv"])
def test_nowhere_to_write(tmp_path: Path, place: str) -> None:
    """A folder that is missing, or that is a file."""
    (tmp_path / "file").touch()

    with (
        pytest.raises(FileAccessError, match=r"result\.csv: cannot be writ"),
        replacing(tmp_path / place),
    ):
        pytest.fail("there is nothing to write to")


def test_a_folder_is_not_replaced(tmp_path: Path) -> None:
    """Its name may be taken by a folder; that stays, with what is in it."""
    (tmp_path / "result.csv").mkdir()
    (tmp_path / "result.csv" / "kept").touch()

    def write() -> None:
        with replacing(tmp_path / "result.csv") as temporary:
            temporary.write_text("new")

    with pytest.raises(FileAccessError):
        write()
    assert [p.name for p in tmp_path.rglob("*")] == ["result.csv", "kept"]


@pytest.mark.parametrize(
    ("mask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)]
)
def test_permissions_are_the_usual_ones(
    tmp_path: Path, mask: int, mode: int
) -> None:
    """As the user's umask has it; a temporary file alone would be private."""
    before = os.umask(mask)
    try:
        with replacing(tmp_path / "result.csv") as temporary:
            temporary.write_text("new")
        assert os.umask(mask) == mask
    finally:
        os.umask(before)

    path = tmp_path / "result.csv"
    assert stat.S_IMODE(path.stat().st_mode) == mode


def test_what_could_not_be_written_is_told_before(tmp_path: Path) -> None:
    """A missing folder, a file in its place, a folder as the target."""
    file = tmp_path / "file"
    file.write_text("old", "utf-8")
    for path, why in (
        (tmp_path / "no" / "x", "No such file"),
        (file / "x", "Not a directory"),
        (tmp_path, "Is a directory"),
    ):
        with pytest.raises(FileAccessError, match=why):
            ensure_writable(path)

    ensure_writable(file)
    ensure_writable(tmp_path / "new")

    assert file.read_text("utf-8") == "old"
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.skipif(os.geteuid() == 0, reason="root writes everywhere")
def test_a_read_only_folder_is_told_before(tmp_path: Path) -> None:
    tmp_path.chmod(0o555)
    try:
        with pytest.raises(FileAccessError, match="Permission denied"):
            ensure_writable(tmp_path / "new")
    finally:
        tmp_path.chmod(0o755)


def test_make_folder(tmp_path: Path) -> None:
    """With parents, again, and not over a file."""
    make_folder(tmp_path / "a" / "b")
    make_folder(tmp_path / "a" / "b")
    assert (tmp_path / "a" / "b").is_dir()
    (tmp_path / "file").touch()

    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(FileAccessError, match="cannot be created"):
            make_folder(path)


def test_shipped_files_are_found() -> None:
    """The program's own files, and an error that names what is missing."""
    assert shipped_file("dbc/bstm.dbc").is_file()
    assert shipped_file("config/example_vehicle.toml").is_file()

    with pytest.raises(FileAccessError, match=r"dbc/none\.dbc.*reinstall"):
        shipped_file("dbc/none.dbc")

"""Result files are whole or absent."""

import json
from pathlib import Path

import pytest

from bstm_daemon.cli.output import write_json, write_text
from bstm_daemon.errors import FileAccessError


def test_json_is_read_back(tmp_path: Path) -> None:
    """What is written is what is read."""
    path = tmp_path / "result.json"
    write_json(path, {"zeit": "ä", "values": [1.5, None]})

    assert json.loads(path.read_text(encoding="utf-8")) == {
        "zeit": "ä",
        "values": [1.5, None],
    }
    assert list(tmp_path.iterdir()) == [path]


def test_a_result_is_replaced(tmp_path: Path) -> None:
    """A second run overwrites the first one's result."""
    path = tmp_path / "result.txt"
    write_text(path, "first, and longer")
    write_text(path, "second")

    assert path.read_text(encoding="utf-8") == "second"


def test_nan_leaves_the_old_file(tmp_path: Path) -> None:
    """A value that JSON has not is refused before anything is touched."""
    path = tmp_path / "result.json"
    write_json(path, 1)

    with pytest.raises(ValueError, match="JSON"):
        write_json(path, float("nan"))

    assert path.read_text(encoding="utf-8") == "1\n"


def test_failure_leaves_no_remnant(tmp_path: Path) -> None:
    """When the name is taken by a folder, nothing else is left behind."""
    path = tmp_path / "result.json"
    path.mkdir()

    with pytest.raises(FileAccessError, match="cannot be written"):
        write_text(path, "x")

    assert list(tmp_path.iterdir()) == [path]

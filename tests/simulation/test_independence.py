"""The reality shares no physics with the estimator."""

import ast
from pathlib import Path

import pytest

import bstm_daemon.simulation

FOLDER = Path(bstm_daemon.simulation.__file__).parent
FORBIDDEN = {"model", "estimator", "engine", "analysis", "config"}


def imported(source: str) -> set[str]:
    """Return the rooms of the package that *source* imports."""
    rooms = set()
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module]
            if node.module == "bstm_daemon":
                names = [f"bstm_daemon.{a.name}" for a in node.names]
        rooms |= {
            name.split(".")[1]
            for name in names
            if name.startswith("bstm_daemon.")
        }
    return rooms


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.py")), ids=str)
def test_module_imports_nothing_of_the_estimator(path: Path) -> None:
    assert not imported(path.read_text(encoding="utf-8")) & FORBIDDEN


def test_imports_are_found() -> None:
    source = (
        "from bstm_daemon import engine\n"
        "import bstm_daemon.model.thermal.table"
    )

    assert imported(source) == {"engine", "model"}


def test_c_sources_include_only_their_own() -> None:
    for path in FOLDER.glob("*.[ch]"):
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.startswith('#include "'):
                name = line.split('"')[1]
                # the one that is generated, from the room's own tables
                assert name == "reality.h" or (FOLDER / name).exists()

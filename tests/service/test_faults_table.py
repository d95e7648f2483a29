"""Every fault in the list of ``docs/live.md`` has a test."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
SECTION: Final = (
    (ROOT / "docs" / "live.md")
    .read_text(encoding="utf-8")
    .partition("\n## Faults\n")[2]
    .partition("\n## ")[0]
)
ROWS: Final[list[tuple[str, str]]] = re.findall(
    r"^- \*\*(.+?)\*\*: (.+?)\.$", SECTION, re.DOTALL | re.MULTILINE
)
"""Each fault with its behaviour."""

NAMED: Final[dict[str, list[str]]] = tomllib.loads(
    (ROOT / "tests/service/faults.toml").read_text(encoding="utf-8")
)
"""Fault to its tests."""

TESTS: Final = {
    name
    for path in (ROOT / "tests").rglob("test_*.py")
    for name in re.findall(
        r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE
    )
}


def exists(name: str) -> bool:
    """Whether *name* is a file, a module of tests/vcan or a test."""
    if "/" in name:
        return (ROOT / name).exists()
    if (ROOT / "tests" / "vcan" / f"{name}.py").exists():
        return True
    pattern = re.escape(name).replace("…", r"\w+")
    return any(re.fullmatch(pattern, test) for test in TESTS)


def test_the_faults_are_those_of_the_list() -> None:
    assert [fault for fault, _ in ROWS] == list(NAMED)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_a_fault_has_its_test(row: tuple[str, str]) -> None:
    fault, behaviour = row
    assert behaviour
    names = NAMED[fault]
    assert names
    assert [name for name in names if not exists(name)] == []


def test_the_list_is_read() -> None:
    assert len(ROWS) > 30
    assert not exists("test_that_nobody_wrote")
    assert exists("…is_78")

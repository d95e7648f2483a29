"""``docs/live.md`` names a test for every fault, and there is one."""

from __future__ import annotations

import re
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
ROWS: Final = [
    [cell.strip() for cell in line.strip("|").split(" | ")]
    for line in SECTION.splitlines()
    if line.startswith("| ") and not line.startswith("| **")
][1:]
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


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_a_fault_has_its_test(row: list[str]) -> None:
    _, behaviour, places = row
    assert behaviour
    names = [
        name
        for name in re.findall(r"`([^`]+)`", places)
        if name.startswith(("tests/", "test_", "…"))
    ]
    assert names or places.startswith("the same")
    assert [name for name in names if not exists(name)] == []


def test_the_table_is_read() -> None:
    assert len(ROWS) > 30
    assert not exists("test_that_nobody_wrote")
    assert exists("…is_78")

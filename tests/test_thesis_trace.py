"""``docs/thesis.md`` leads from every item of the thesis to code and test."""

from __future__ import annotations

import ast
import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Final

import pytest

from bstm_daemon.config.sections import Config

ROOT: Final = Path(__file__).resolve().parents[1]
PACKAGE: Final = ROOT / "bstm_daemon"
DOCUMENT: Final = "\n".join(
    (ROOT / name).read_text(encoding="utf-8")
    for name in ("docs/thesis.md", "tests/thesis_trace.md")
)

EQUATIONS: Final = [
    *("2.1", "2.2a", "2.2b", "2.2c"),
    *(f"2.{i}" for i in range(3, 14)),
    *(f"4.{i}" for i in range(1, 22)),
    "5.1",
]
TABLES: Final = ["2.1", "4.1", "7.1", "7.2"]
FIGURES: Final = [
    *(f"2.{i}" for i in range(1, 8)),
    *(f"3.{i}" for i in range(1, 4)),
    *(f"4.{i}" for i in range(1, 14)),
    *("5.1", "5.2"),
    *(f"6.{i}" for i in range(1, 9)),
]
REQUIREMENTS: Final = [f"R{i}" for i in range(1, 8)]
FUTURE_WORK: Final = [
    *(f"9.1 {letter}" for letter in "abcdef"),
    *(f"9.2 {letter}" for letter in "abcdefgh"),
    "9.3 a",
]
SECTIONS: Final = [
    *("1", "1.1", "1.2", "1.3"),
    *("2", "2.1", "2.2", "2.3", "2.4", "2.4.1", "2.4.2"),
    *("2.5", "2.5.1", "2.5.2", "2.6", "2.7", "2.7.1", "2.7.2"),
    *("3", "3.1", "3.2", "3.3", "4", "4.1", "4.2", "4.2.1", "4.2.2"),
    *("4.2.2.1", "4.2.2.2", "4.2.2.3"),
    *("4.2.3", "4.2.3.1", "4.2.3.2", "4.2.3.3", "4.2.4"),
    *("4.3", "4.4", "4.5", "4.5.1", "4.5.2", "4.6", "4.7", "4.8"),
    *("5", "5.1", "5.1.1", "5.1.2", "5.1.3", "5.2", "5.2.1", "5.2.2"),
    *("6", "6.1", "6.1.1", "6.1.2"),
    *("6.2", "6.2.1", "6.2.2", "6.2.3", "6.2.4"),
    *("7", "7.1", "7.2", *(f"7.2.{i}" for i in range(1, 7))),
    *("8", "9", "9.1", "9.2", "9.3", "10"),
]
ITEMS: Final = {
    "Equations": EQUATIONS,
    "Tables": TABLES,
    "Figures": FIGURES,
    "Requirements": REQUIREMENTS,
    "Future work": FUTURE_WORK,
    "Sections": SECTIONS,
}
"""Heading of the document's chapter to the items of the thesis in it."""

EXCUSES: Final = re.compile(r"not modelled, because \w+")
REFERENCE: Final = re.compile(r"`([\w/.-]+\.py)::([\w.]+)`")
SETTING: Final = re.compile(r"`\[\[?(\w+)\]\]? ([\w.]+) = ([^`]+)`")


def rows_of(text: str) -> dict[str, list[tuple[str, str]]]:
    """Return (item, row) of each table of *text* by its heading's start."""
    found: dict[str, list[tuple[str, str]]] = {}
    heading = ""
    for line in text.splitlines():
        if line.startswith("## "):
            heading = line.removeprefix("## ").partition(" (")[0]
            found[heading] = []
        elif heading and re.match(r"\| \S*\d", line):
            found[heading].append((line.split("|")[1].strip(), line))
    return found


@cache
def names_in(path: Path) -> frozenset[str]:
    """Return what a Python file defines: names, ``Class.member`` too."""
    names: set[str] = set()

    def collect(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if isinstance(node, ast.ClassDef):
                names.add(prefix + node.name)
                collect(node.body, f"{prefix}{node.name}.")
            elif isinstance(node, ast.FunctionDef):
                names.add(prefix + node.name)
            elif isinstance(node, ast.Assign):
                targets = [t for t in node.targets if isinstance(t, ast.Name)]
                names.update(prefix + target.id for target in targets)
            elif isinstance(node, ast.AnnAssign):
                names.add(prefix + ast.unparse(node.target))

    collect(ast.parse(path.read_text(encoding="utf-8")).body, "")
    return frozenset(names)


def problem_of_setting(section: str, key: str, value: str) -> str | None:
    """Say what is wrong with ``[section] key = value``, None if nothing."""
    path = ROOT / "config" / "example_vehicle.toml"
    car = tomllib.loads(path.read_text(encoding="utf-8"))
    table = car.setdefault(section, {})
    if section == "corner":
        table = table[0]
    *parents, name = key.split(".")
    for parent in parents:
        table = table[parent]
    try:
        table[name] = tomllib.loads(f"value = {value}")["value"]
        Config.model_validate(car)
    except ValueError as error:
        return f"[{section}] {key} = {value}: {error}"
    return None


def problems_of_row(row: str) -> list[str]:
    """List what *row* names and does not exist, or what it leaves out."""
    found = []
    modules = tests = 0
    for file, name in REFERENCE.findall(row):
        is_test = file.startswith("tests/")
        path = ROOT / file if is_test else PACKAGE / file
        if not path.is_file():
            found.append(f"no file {file}")
        elif name not in names_in(path):
            found.append(f"no {name} in {file}")
        elif is_test and not name.startswith("test_"):
            found.append(f"{name} is no test")
        modules += not is_test
        tests += is_test
    for section, key, value in SETTING.findall(row):
        problem = problem_of_setting(section, key, value)
        if problem:
            found.append(problem)
    if not (modules and tests) and not EXCUSES.search(row):
        found.append("neither module with test nor an excuse")
    without = SETTING.sub("", REFERENCE.sub("", row))
    found += [
        f"unread: {span}" for span in re.findall(r"`[^`]*::.*?`", without)
    ]
    return found


ROWS: Final = rows_of(DOCUMENT)


@pytest.mark.parametrize("heading", ITEMS)
def test_every_item_stands_in_the_document_once(heading: str) -> None:
    """Nothing of the thesis is left out, nothing stands twice."""
    assert [item for item, _ in ROWS[heading]] == ITEMS[heading]


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, id=f"{heading} {item}")
        for heading, rows in ROWS.items()
        for item, row in rows
    ],
)
def test_row_names_what_exists(row: str) -> None:
    """Module, test and setting of each row are there, or it is excused."""
    assert problems_of_row(row) == []


GOOD_MODULE: Final = "`model/thermal/partition.py::disc_share`"
TESTS: Final = "tests/model/thermal/test_partition.py"
GOOD_TEST: Final = f"`{TESTS}::test_share_of_the_disc`"


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        (f"| 2.3 | {GOOD_MODULE} | {GOOD_TEST} |", None),
        ("| 2.3 | - | not modelled, because it is a sketch |", None),
        (
            "| 2.3 | - | not yet modelled: later |",
            "neither module with test nor an excuse",
        ),
        (f"| 2.3 | `thermal/lost.py::a` | {GOOD_TEST} |", "no file"),
        (
            f"| 2.3 | `model/thermal/partition.py::a` | {GOOD_TEST} |",
            "no a in",
        ),
        (
            f"| 2.3 | `config/sections.py::Config.lost` | {GOOD_TEST} |",
            "no Config.lost",
        ),
        (f"| 2.3 | {GOOD_MODULE} | `tests/a.py::test_a` |", "no file"),
        (f"| 2.3 | {GOOD_MODULE} | `{TESTS}::test_a` |", "no test_a in"),
        (f"| 2.3 | {GOOD_MODULE} | `{TESTS}::DISC` |", "DISC is no test"),
        (f"| 2.3 | {GOOD_MODULE} | - |", "neither"),
        (f"| 2.3 | - | {GOOD_TEST} |", "neither"),
        ("| 2.3 | - | not modelled |", "neither"),
        ("| 2.3 | - | not modelled, because |", "neither"),
        (f"| 2.3 | {GOOD_MODULE} | {GOOD_TEST}, `tests/a::b` |", "unread"),
        (
            f"| 2.3 | {GOOD_MODULE} | `[thermal] lost = 1.0` | {GOOD_TEST} |",
            "[thermal] lost",
        ),
        (
            f'| 2.3 | {GOOD_MODULE} | `[heat] slope = "a"` | {GOOD_TEST} |',
            "[heat] slope",
        ),
    ],
)
def test_the_check_sees_a_broken_row(row: str, problem: str | None) -> None:
    """The check itself: three good rows, and one of each mistake."""
    found = problems_of_row(row)

    if problem is None:
        assert found == []
    else:
        assert len(found) == 1
        assert problem in found[0]


def test_the_check_sees_a_missing_item() -> None:
    """A row that is gone, doubled or under another heading is seen."""
    text = "## Tables\n\n| Table | content |\n|---|---|\n| 2.1 | wear |\n"

    assert rows_of(text) == {"Tables": [("2.1", "| 2.1 | wear |")]}
    assert [item for item, _ in rows_of(text)["Tables"]] != TABLES

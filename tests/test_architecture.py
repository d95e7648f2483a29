"""The rooms of the house: imports run downwards, never in a circle."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from functools import cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

PACKAGE = Path(__file__).resolve().parents[1] / "bstm_daemon"

FLOORS = (
    (*("channels", "errors", "estimate", "files", "roles", "units"),),
    ("config", "native"),
    ("bus",),
    ("model", "simulation"),
    ("estimator",),
    ("advice", "forecast"),
    ("engine", "feed"),
    ("replay", "service"),
    ("analysis",),
    ("exchange", "watch"),
    ("report",),
    ("fleet",),
    ("api", "cli"),
)
"""The entries of the package, from the ground up. An entry imports from floors
below its own and from itself; the ground also from its own floor."""

FLOOR = {name: number for number, names in enumerate(FLOORS) for name in names}

ROOMS_BELOW = {
    "bus": {
        "output": set(),
        "signals": {"output"},
        "live": {"signals"},
        "logs": {"signals"},
        "tables": {"logs", "signals"},
        "opening": {"logs", "signals", "tables"},
    },
    "model": {
        "heat": set(),
        "thermal": set(),
        "risk": set(),
        "wear": {"heat", "thermal"},
        "compiled": {"heat", "thermal"},
        "effects": {"heat", "thermal"},
    },
    "analysis": {
        "statistics": set(),
        "quality": {"statistics"},
        "setup": {"quality", "statistics"},
        "identify": {"quality", "statistics"},
        "matching": {"identify", "statistics"},
        "gap": {"identify", "matching", "statistics"},
    },
}
"""Which of its own rooms a room of these entries may import. Heat knows
nothing of temperatures, nor temperatures of heat: the estimator couples
them."""

FORBIDDEN = {
    "simulation": {"model", "estimator"},
    "model": {"bus"},
    "estimator": {"bus"},
    "advice": {"bus"},
    "forecast": {"bus"},
    "analysis": {"service"},
    "report": {"service"},
}
"""What its floor alone would allow. The reality that makes data shares no
physics with the estimator; physics, estimate and what follows from it know
no CAN."""

C_ROOMS_BELOW = {
    "bus": set(),
    "heat": set(),
    "risk": set(),
    "thermal": set(),
    "python": {"heat", "risk", "thermal"},
    "simulation": set(),
    "wrapper": {"heat", "thermal"},
}
"""The same for folders with C."""

MOST_ENTRIES = 26
MOST_ARROWS = 140


def modules() -> dict[str, Path]:
    """Dotted name below the package to file."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(p for p in parts if p != "__init__")] = path
    return found


MODULES = {name: path for name, path in modules().items() if name}


def statements(
    body: Sequence[ast.AST], *, typing_too: bool
) -> Iterator[ast.AST]:
    """Yield *body* and what is nested in it; expressions import nothing."""
    for node in body:
        if (
            not typing_too
            and isinstance(node, ast.If)
            and ast.unparse(node.test).endswith("TYPE_CHECKING")
        ):
            continue
        yield node
        for part in ("body", "orelse", "handlers", "finalbody", "cases"):
            inner = getattr(node, part, ())
            yield from statements(inner, typing_too=typing_too)


parsed = cache(ast.parse)


def imports_of(source: str, *, typing_too: bool = True) -> set[str]:
    """Modules of the package that *source* imports.

    Those for types only count unless *typing_too* is false.

    ``from a import b`` is an import of ``a.b`` where that is a module, and of
    ``a`` otherwise; compiled modules import nothing and do not count.
    """
    known = set(MODULES)
    found = set()
    for node in statements(parsed(source).body, typing_too=typing_too):
        if isinstance(node, ast.Import):
            pairs = [("", alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, "relative import"
            pairs = [
                (node.module, f"{node.module}.{alias.name}")
                for alias in node.names
            ]
        else:
            continue
        for origin, name in pairs:
            inner = name.removeprefix("bstm_daemon.")
            outer = origin.removeprefix("bstm_daemon.")
            if inner in known:
                found.add(inner)
            elif outer in known:
                found.add(outer)
    return found


def entry(module: str) -> str:
    return module.split(".", maxsplit=1)[0]


@cache
def arrows(*, typing_too: bool = True) -> frozenset[tuple[str, str]]:
    """Each module with each one it imports, read when a test first asks."""
    return frozenset(
        (name, target)
        for name, path in MODULES.items()
        for target in imports_of(
            path.read_text(encoding="utf-8"), typing_too=typing_too
        )
    )


def test_every_entry_has_a_floor_and_they_are_few() -> None:
    entries = {entry(name) for name in MODULES}

    assert entries == set(FLOOR)
    assert len(entries) <= MOST_ENTRIES, sorted(entries)


def test_imports_run_downwards() -> None:
    wrong = []
    for name, target in sorted(arrows()):
        own, other = entry(name), entry(target)
        ground = FLOOR[own] == FLOOR[other] == 0
        allowed = other not in FORBIDDEN.get(own, set()) and (
            ground or FLOOR[other] < FLOOR[own]
        )
        if other != own and not allowed:
            wrong.append(f"{name} -> {target}")

    assert wrong == []


@pytest.mark.parametrize("outer", sorted(ROOMS_BELOW))
def test_rooms_of_an_entry_keep_their_order(outer: str) -> None:
    below = ROOMS_BELOW[outer]
    inside = [
        (name.split("."), target.split("."))
        for name, target in arrows()
        if entry(name) == entry(target) == outer
    ]

    assert {
        name.split(".")[1]
        for name in MODULES
        if "." in name and entry(name) == outer
    } == set(below)
    for name, target in inside:
        allowed = {name[1], *below[name[1]]}
        assert target[1] in allowed, f"{name} -> {target}"


def test_arrows_between_entries_are_few() -> None:
    """Counted without imports of names for typing."""
    pairs = {
        (entry(name), entry(target))
        for name, target in arrows(typing_too=False)
    }
    between = {(own, other) for own, other in pairs if own != other}
    print(f"{len(FLOOR)} entries, {len(between)} arrows")  # noqa: T201

    assert len(between) <= MOST_ARROWS


def assert_no_circle(graph: Mapping[str, set[str]]) -> None:
    finished: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, " -> ".join((*trail, name))
        if name not in finished:
            for target in graph[name]:
                visit(target, (*trail, name))
            finished.add(name)

    for name in graph:
        visit(name, ())


def test_there_is_no_circle() -> None:
    graph: dict[str, set[str]] = {name: set() for name in MODULES}
    for name, target in arrows():
        if target != name:
            graph[name].add(target)

    assert_no_circle(graph)


NO_CALL = re.compile(
    r"/\*.*?\*/|^\w[\w *]*\([^;{}]*\);", re.DOTALL | re.MULTILINE
)
"""Comments and declarations."""
C_FUNCTION = re.compile(
    r"^(?!static|INLINE)\w[\w *]*?(\w+)\([^;{}]*\)\s*\{", re.MULTILINE
)


def c_arrows() -> dict[str, set[str]]:
    """Each C file, with its header, and those that it includes or calls.

    A header of a name of its own is a file too; those that are generated are
    none.
    """
    text: dict[str, str] = {}
    for path in sorted(PACKAGE.rglob("*.[ch]")):
        name = f"{path.parent.name}/{path.stem}"
        source = NO_CALL.sub("", path.read_text(encoding="utf-8"))
        text[name] = text.get(name, "") + source
    home = {f"{name.partition('/')[2]}.h": name for name in text}
    for name, source in text.items():
        home |= dict.fromkeys(C_FUNCTION.findall(source), name)
    return {
        name: {
            home[word]
            for word in re.findall(r"\w+(?:\.h)?", source)
            if word in home
        }
        - {name}
        for name, source in text.items()
    }


def test_c_files_run_downwards_and_in_no_circle() -> None:
    graph = c_arrows()
    assert_no_circle(graph)
    assert graph["heat/sample_pass"] >= {"heat/checks", "heat/friction_law"}
    for name, targets in graph.items():
        room = name.partition("/")[0]
        allowed = {room, *C_ROOMS_BELOW[room]}
        for target in targets:
            assert target.partition("/")[0] in allowed, f"{name} -> {target}"


def test_the_check_itself_sees_imports_for_types_apart() -> None:
    source = (
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n"
        "    from bstm_daemon.model.thermal.table import Table\n"
    )

    assert imports_of(source) == {"model.thermal.table"}


def test_the_live_service_does_without_numpy() -> None:
    """It costs 15 MiB of a small computer's memory, and time at the start."""
    heavy = ("numpy", "scipy", "pyarrow", "plotly", "jinja2", "asammdf")
    code = (
        f"import sys\nsys.modules.update(dict.fromkeys({heavy}))\n"
        "from bstm_daemon.service import assembly, service\n"
        "from bstm_daemon.files import shipped_file\n"
        "car = shipped_file('config/example_vehicle.toml')\n"
        "engine = assembly.build_monitor(car, assembly.BusOverride()).engine\n"
        "engine.tick(1_700_000_000_000_000)\n"
        "print(len(engine.tick(1_700_000_020_000_000)))\n"
    )

    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        check=False,
        text=True,
    )

    assert done.stderr == ""
    assert int(done.stdout) > 1000


def test_a_module_can_be_read_in_one_sitting() -> None:
    lines = {
        name: path.read_text(encoding="utf-8").count("\n")
        for name, path in MODULES.items()
    }

    assert {name: n for name, n in lines.items() if n > 500} == {}


def test_the_top_level_holds_what_the_project_agreed_on() -> None:
    allowed = {
        *("pyproject.toml", "bstm_daemon", "dbc", "config"),
        "systemd",
        *("tests", "README.md", "docs", "LICENSE", "CHANGELOG.md"),
    }
    root = PACKAGE.parent
    if not (root / ".git").exists():
        pytest.skip("no clone: what belongs to it is not known")
    done = subprocess.run(
        ["git", "-c", f"safe.directory={root}", "ls-files"],
        cwd=root,
        capture_output=True,
        check=True,
        text=True,
    )

    found = {line.partition("/")[0] for line in done.stdout.splitlines()}
    assert {name for name in found if not name.startswith(".")} == allowed


def test_what_the_readme_makes_is_no_part_of_the_clone() -> None:
    ignored = (PACKAGE.parent / ".gitignore").read_text("utf-8").splitlines()

    for made in ("/results/", "/bstm-demo/", "/*.log", "/*.toml", "/*.html"):
        assert made in ignored


def test_lines_whose_mutants_survive_are_in_their_files() -> None:
    """Mutation testing refuses to begin where one is not."""
    named = PACKAGE.parent / "tests/benchmarks/mutants.toml"
    kinds = tomllib.loads(named.read_text("utf-8"))

    assert kinds.keys() == {"equivalent", "survivor"}
    for entry in chain(*kinds.values()):
        lines = (PACKAGE / entry["file"]).read_text("utf-8").splitlines()
        assert entry["before"] in map(str.strip, lines)
        assert entry["reason"]

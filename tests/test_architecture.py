"""The rooms of the house: imports run downwards, never in a circle."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "bstm_daemon"

FLOORS = {
    "errors": 0,
    "units": 0,
    "roles": 0,
    "files": 0,
    "native": 0,
    "shipped": 0,
    "config": 1,
    "config_accuracy": 1,
    "config_errors": 1,
    "config_file": 1,
    "config_fluid": 1,
    "config_rules": 1,
    "config_section": 1,
    "config_service": 1,
    "bus": 2,
    "thermal": 2,
    "heat": 2,
    "risk": 2,
    "config_advice": 1,
    "config_wear": 1,
    "advice": 3,
    "wear": 3,
    "quality": 3,
    "simulation": 3,
    "effects": 3,
    "setup": 3,
    "validity": 3,
    "journal": 3,
    "stretch": 3,
    "corner_model": 4,
    "estimator": 5,
    "carry_over": 6,
    "driver_side": 6,
    "model_check": 6,
    "forecast": 7,
    "advice_course": 8,
    "engine": 8,
    "results": 8,
    "identify": 9,
    "replay": 9,
    "frame_replay": 10,
    "matching": 10,
    "gap": 11,
    "report": 12,
    "daemon": 10,
    "watch": 13,
    "cli": 14,
}
"""A room may import from rooms on lower floors and from itself; the files of
floor 0 and of ``config`` may also import from their own floor."""

OPEN_FLOORS = {0, 1}

FORBIDDEN = {
    "simulation": {"thermal", "heat", "effects", "estimator", "wear"},
    "thermal": {"heat", "bus", "risk"},
    "heat": {"thermal", "bus", "risk"},
    "bus": {"thermal", "heat", "risk"},
}
"""The reality shares no physics with the estimator; power knows nothing of
temperature, neither knows CAN."""


def modules() -> dict[str, Path]:
    """Dotted name below the package to file."""
    found = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        found[".".join(p for p in parts if p != "__init__")] = path
    return found


def imports_of(source: str) -> set[str]:
    """Modules of the package that *source* imports, also for types only.

    ``from a import b`` is an import of ``a.b`` where that is a module, and of
    ``a`` otherwise; compiled modules import nothing and do not count.
    """
    known = set(modules()) - {""}
    compiled = {
        ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        for path in PACKAGE.rglob("*.c")
    }
    found = set()
    for node in ast.walk(ast.parse(source)):
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
            if inner in known | compiled:
                found.add(inner)
            elif outer in known:
                found.add(outer)
    return found & known


def room(module: str) -> str:
    return module.split(".", maxsplit=1)[0]


MODULES = {name: path for name, path in modules().items() if name}


def test_every_room_has_a_floor() -> None:
    assert {room(name) for name in MODULES} == set(FLOORS)


@pytest.mark.parametrize("name", sorted(MODULES))
def test_imports_run_downwards(name: str) -> None:
    own = room(name)
    for target in imports_of(MODULES[name].read_text(encoding="utf-8")):
        other = room(target)
        if other == own:
            continue
        assert other not in FORBIDDEN.get(own, set()), f"{name} -> {target}"
        same = FLOORS[other] == FLOORS[own] and FLOORS[own] in OPEN_FLOORS
        assert same or FLOORS[other] < FLOORS[own], f"{name} -> {target}"


def test_there_is_no_circle() -> None:
    graph = {
        name: imports_of(path.read_text(encoding="utf-8")) - {name}
        for name, path in MODULES.items()
    }
    finished: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, " -> ".join((*trail, name))
        if name not in finished:
            for target in graph[name]:
                visit(target, (*trail, name))
            finished.add(name)

    for name in graph:
        visit(name, ())


def test_the_check_itself_sees_an_import_for_types_only() -> None:
    source = (
        "from typing import TYPE_CHECKING\n"
        "if TYPE_CHECKING:\n"
        "    from bstm_daemon.thermal.table import Table\n"
    )

    assert imports_of(source) == {"thermal.table"}


def test_the_live_service_does_without_numpy() -> None:
    """It costs 15 MiB of a small computer's memory, and time at the start."""
    heavy = ("numpy", "scipy", "pyarrow", "plotly", "asammdf", "pandas")
    code = (
        f"import sys\nsys.modules.update(dict.fromkeys({heavy}))\n"
        "from bstm_daemon.daemon import monitor, service\n"
        "from bstm_daemon.shipped import shipped_file\n"
        "car = shipped_file('config/example_vehicle.toml')\n"
        "engine = monitor.build_monitor(car, monitor.BusOverride()).engine\n"
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


@pytest.mark.parametrize("name", sorted(MODULES))
def test_a_module_can_be_read_in_one_sitting(name: str) -> None:
    lines = MODULES[name].read_text(encoding="utf-8").count("\n")

    assert lines <= 500, f"{name} has {lines} lines"


def test_the_top_level_holds_what_the_project_agreed_on() -> None:
    allowed = {
        *("pyproject.toml", "bstm_daemon", "dbc", "config", "systemd"),
        *("tests", "README.md", "docs", "LICENSE", "CHANGELOG.md"),
    }
    made = {"build", "dist", "bstm-demo"}

    found = {
        path.name
        for path in PACKAGE.parent.iterdir()
        if not path.name.startswith(".")
        and not path.name.endswith(".egg-info")
    }

    assert found - made == allowed

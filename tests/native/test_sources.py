"""C and Python tell the same: names, numbers, hash of the sources."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from array import array
from dataclasses import dataclass
from typing import Annotated

import pytest

from bstm_daemon.errors import UsageError
from bstm_daemon.model.compiled import generated_header
from bstm_daemon.model.heat import memory, observer_rules
from bstm_daemon.native import layout, loader
from bstm_daemon.native.header import Header
from bstm_daemon.native.layout import Length
from bstm_daemon.native.sources import PACKAGE, SOURCES, TABLES, digest

HEAT = PACKAGE / "native" / "heat"
MIRRORED = sorted(path.stem for path in HEAT.glob("*.c"))
ONLY_PYTHON = {
    "checks": set(),
    "fusion": set(),
    "inputs": set(),
    "learned": {"of", "numbers", "copy", "learned_fault", "positive"},
    "motion_checks": set(),
    "observer": set(),
    "observer_faults": set(),
    "pressure_checks": set(),
    "sample_pass": {"store"},
}
"""What a module does for its surroundings, not in the pass."""

OTHER_NAMES = {"close": "close_step", "advance": "advance"}
DEFINITION = re.compile(
    r"^(?:static )?(?:inline )?(?:const )?"
    r"[A-Za-z_]\w*[ *]+(\w+)\([^;{]*\)\s*\{",
    re.MULTILINE,
)


def c_functions(name: str) -> set[str]:
    """Functions that the C file or its header defines."""
    found = set()
    for path in (HEAT / f"{name}.c", HEAT / f"{name}.h"):
        found |= set(DEFINITION.findall(path.read_text(encoding="utf-8")))
    return found


def python_functions(name: str) -> set[str]:
    """Functions and methods of the Python module, without underscores."""
    path = PACKAGE / "model" / "heat" / f"{name}.py"
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return {
        node.name.strip("_")
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and node.name != "__init__"
    }


@pytest.mark.parametrize("name", MIRRORED)
def test_each_function_has_one_of_its_name(name: str) -> None:
    """``observer_braking`` in C is ``Observer.braking``; no third form."""
    own = {
        function.removeprefix(f"{name}_") for function in c_functions(name)
    } - {"init"}
    python = python_functions(name) - ONLY_PYTHON[name]
    if name == "sample_pass":
        python = {OTHER_NAMES.get(one, one) for one in python}

    assert own ^ python <= EXTRA.get(name, set())


EXTRA = {
    # the part of admit that is seldom needed is no inline function; the air
    # has a module of its own in Python
    "checks": {"admit_unusual", "speed_contradictions", "compare_air"},
}


def test_no_constant_of_the_tables_stands_in_c_again() -> None:
    """The header is the only place that gives one a number."""
    shared = {name for name in vars(observer_rules) if name.isupper()} | set(
        re.findall(r"^#define (\w+)", generated_header(), re.MULTILINE)
    )
    for path in (PACKAGE / "native").glob("*/*.[ch]"):
        own = set(
            re.findall(r"#define (\w+)", path.read_text(encoding="utf-8"))
        )
        assert not own & shared, path


def test_the_header_has_numbers_tables_and_structs() -> None:
    text = generated_header()

    assert "#define ASSUMED_TORQUE_STD (0.2)" in text
    assert "#define FLAG_HEAT_UNKNOWN INT64_C(4194304)" in text
    assert "enum { VEHICLE_CHANNELS = 15 };" in text
    assert "#define NEVER INT64_MIN" in text
    assert "static const Hysteresis STUCK = {1.0, 10.0};" in text
    assert "    double cov[STATES * STATES];" in text
    assert "    ObserverMemory observer;\n} SampleMemoryFloats;" in text
    assert (
        "    double ground_speeds[GROUND_SPEEDS];\n    int steady;\n" in text
    )


def test_the_headers_need_the_standard_library_alone() -> None:
    """An isolated build, as of pip, has no other package."""
    code = (
        "import sys\nfrom importlib import import_module\n"
        "from types import ModuleType\n"
        f"root = {str(PACKAGE.parent)!r}\nsys.path.insert(0, root)\n"
        "for name in ('bstm_daemon', 'bstm_daemon.simulation'):\n"
        "    sys.modules[name] = ModuleType(name)\n"
        "    path = f'{root}/' + name.replace('.', '/')\n"
        "    sys.modules[name].__path__ = [path]\n"
        "for name in ('model.compiled', 'simulation.header'):\n"
        "    module = import_module(f'bstm_daemon.{name}')\n"
        "    print(len(module.generated_header()))\n"
    )

    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code],
        capture_output=True,
        check=False,
        text=True,
    )

    assert done.stderr == ""
    assert [int(size) > 1000 for size in done.stdout.split()] == [True, True]


def test_a_name_with_two_values_is_refused() -> None:
    header = Header()
    header.values_of("", {"one": 1})

    with pytest.raises(ValueError, match="ONE is 1 and 2"):
        header.values_of("", {"one": 2})


@dataclass
class Inner:
    """A part."""

    count: int
    level: Annotated[list[float], Length("MANY", 3)]


@dataclass
class Outer:
    """A layout with a part."""

    first: float
    inner: Inner
    last: int


def test_a_layout_says_where_each_field_lies() -> None:
    made = layout.unpack(Outer, iter([7, 8]), iter([1.0, 2.0, 3.0, 4.0]))
    ints: list[int] = []
    floats: list[float] = []
    layout.pack(made, ints, floats)

    assert made == Outer(1.0, Inner(7, [2.0, 3.0, 4.0]), 8)
    assert (ints, floats) == ([7, 8], [1.0, 2.0, 3.0, 4.0])
    assert layout.first(Outer, "inner.level") == 1
    assert layout.first(Outer, "last") == 1
    assert (layout.size(Outer, int), layout.size(Outer, float)) == (2, 4)
    assert layout.zeros(Outer) == Outer(0.0, Inner(0, [0.0] * 3), 0)
    with pytest.raises(KeyError):
        layout.first(Outer, "inner.depth")


@pytest.mark.parametrize("corners", range(1, 5))
def test_a_saved_state_has_what_its_car_uses(corners: int) -> None:
    """Nothing of corners that are not there; read back bit for bit."""
    state = memory.SampleState.new()
    state.numbers[:] = array("d", range(len(state.numbers)))
    times, numbers = state.exported(corners)

    back = memory.SampleState.imported(corners, times, numbers, [0])
    assert back.exported(corners) == (times, numbers)
    assert len(numbers) == len(state.numbers) - 22 * (4 - corners)
    with pytest.raises(ValueError, match="zip"):
        memory.SampleState.imported(corners, times, numbers[:-1], [0])


@pytest.mark.parametrize("name", SOURCES)
def test_each_module_has_the_hash_of_its_sources(name: str) -> None:
    module = loader.load_module(name)
    if module is None:
        pytest.skip("not built here")

    assert digest(name) == module.SOURCES
    assert all((PACKAGE / source).is_file() for source in SOURCES[name])


def test_every_table_of_the_header_counts() -> None:
    """What the header imports of the physics is part of the hash."""
    path = PACKAGE / "model" / "compiled.py"
    tree = ast.parse(path.read_text(encoding="utf-8"))
    imported = {
        f"{node.module}.{alias.name}".removeprefix("bstm_daemon.")
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module != "__future__"
        for alias in node.names
    } - {"native.header.Header", "native.sources.PACKAGE"}

    assert imported <= set(TABLES["native._kernel"])


def test_a_module_of_other_sources_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One line that says how to build it again."""
    if loader.load_module("native._kernel") is None:
        pytest.skip("not built here")
    monkeypatch.setattr(loader, "digest", lambda _: "another")
    loader.expected_sources.cache_clear()

    with pytest.raises(UsageError, match=r"rebuild it: pip install -e \."):
        loader.load_kernel()
    loader.expected_sources.cache_clear()


def test_without_sources_the_module_is_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An installed package has none beside it."""

    def none_here(_: str) -> str:
        raise FileNotFoundError

    module = loader.load_module("native._kernel")
    monkeypatch.setattr(loader, "digest", none_here)
    loader.expected_sources.cache_clear()

    assert loader.load_module("native._kernel") is module
    loader.expected_sources.cache_clear()

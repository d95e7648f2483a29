"""The compiled kernel refuses what it can not run, whatever it is given."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.network import (
    Link,
    Memory,
    Network,
    Node,
    Source,
    mean,
    value,
)
from bstm_daemon.model.thermal.program import (
    COUNTS,
    SECTIONS,
    compile_network,
)
from bstm_daemon.model.thermal.table import Table

if TYPE_CHECKING:
    from bstm_daemon.native.loader import Kernel

PROGRAM = compile_network(
    Network(
        ("air_k", "q"),
        (
            Node("air", 0.0, boundary_input="air_k"),
            Node("disc", 10.0, Table(250.0, 50.0, (1.0, 1.1, 1.3, 1.2))),
            Node("pad", 0.0),
            Node("fluid", 50.0),
        ),
        (
            Link(
                "a", "air", "disc", 1.0, (value("disc", Table(0, 1, (1, 2))),)
            ),
            Link("b", "disc", "pad", 1.0, (mean("disc", "pad"),)),
            Link("c", "pad", "fluid", 1.0),
            Link("d", "disc", "fluid", 1.0),
        ),
        (Source("q_w", "disc", 1.0, (value("q"),)),),
        (Memory("hot", "latch", 1.0, (value("disc"),), upper=1e3),),
    )
)
STEPS = 3
BUFFERS = (
    "ints",
    "floats",
    "state",
    "inputs",
    "input_set",
    "ledger",
    "out",
    "steps_s",
)
"""As :func:`arguments` has them, in front."""


def arguments(**changes: Any) -> list[Any]:
    """Return a good call of ``march`` with *changes*."""
    table: dict[str, Any] = {
        "ints": array("i", PROGRAM.ints),
        "floats": array("d", PROGRAM.floats),
        "state": array("d", PROGRAM.initial_state(300.0)),
        "inputs": array("d", [290.0, 100.0] * STEPS),
        "input_set": array("i", [0]),
        "ledger": array("d", [0.0] * 5),
        "out": array("d", [0.0] * (6 * STEPS)),
        "steps_s": array("d", [0.05]),
        "members": 1,
        "sets": 1,
        "steps": STEPS,
        "column": -1,
        "every": 1,
        "phase": 1,
        **changes,
    }
    return list(table.values())


def test_good_call(compiled: Kernel) -> None:
    """What the other tests break is whole."""
    call = arguments()
    compiled.march(*call)
    assert call[2][1] > 300.0


@settings(max_examples=500, deadline=None)
@given(
    changes=st.lists(
        st.tuples(
            st.integers(0, len(PROGRAM.ints) - 1),
            st.one_of(st.integers(-20, 20), st.integers(-(2**31), 2**31 - 1)),
        ),
        min_size=1,
        max_size=3,
    )
)
def test_malformed_ints(
    compiled: Kernel, changes: list[tuple[int, int]]
) -> None:
    """Any ints: marched inside the buffers, or refused with ValueError."""
    call = arguments()
    for index, number in changes:
        call[0][index] = number
    call[6].extend([1234.5] * 50)
    try:
        compiled.march(*call)
    except ValueError as error:
        assert str(error)  # noqa: PT017  (either outcome is right)
    assert set(call[6][6 * STEPS :]) == {1234.5}


LIMITS: dict[str, tuple[int | str, int | str]] = {
    "node_table": (-1, "tables"),
    "node_input": (-1, "inputs"),
    **dict.fromkeys(("link_a", "link_b", "source_node"), (0, "nodes")),
    "link_entry": (-1, "entries"),
    "memory_kind": (0, 2),
    "use_factor": (0, "factors"),
    "factor_kind": (0, 4),
    **dict.fromkeys(("factor_a", "factor_b"), (0, "slots")),
    "factor_table": (-1, "tables"),
    **dict.fromkeys(("pivot_node", "entry_row"), (0, "nodes")),
    **dict.fromkeys(("operation_left", "operation_right"), (0, "entries")),
    "operation_target": ("nodes", "entries"),
}
"""Least index of each section, and the count that is one too many."""


def begins_of_sections() -> tuple[dict[str, int], dict[str, int]]:
    """Return the counts of the program, and where each section begins."""
    counts = dict(zip(COUNTS, PROGRAM.ints, strict=False))
    begins, at = {}, len(COUNTS)
    for section in SECTIONS:
        begins[section] = at + 1
        at += 1 + PROGRAM.ints[at]
    return counts, begins


@pytest.mark.parametrize(
    ("section", "number"),
    [("table_points", 1), ("table_offset", -1), ("table_offset", None)],
)
def test_each_table_lies_within_the_floats(
    compiled: Kernel, section: str, number: int | None
) -> None:
    """It has two points at least, and so many numbers from its offset on."""
    counts, begins = begins_of_sections()
    for table in range(counts["tables"]):
        points = PROGRAM.ints[begins["table_points"] + table]
        call = arguments()
        last = counts["floats"] - points - 1
        call[0][begins[section] + table] = last if number is None else number
        with pytest.raises(ValueError, match="a table is out of range"):
            compiled.march(*call)


@pytest.mark.parametrize("name", LIMITS)
def test_each_index_is_of_what_there_is(compiled: Kernel, name: str) -> None:
    counts, begins = begins_of_sections()
    counts["slots"] = sum(counts[of] for of in ("nodes", "memories", "inputs"))
    first = begins[name]
    size = PROGRAM.ints[first - 1]
    assert size > 0
    least, past = LIMITS[name]
    lowest = least if isinstance(least, int) else -counts[least]
    highest = past if isinstance(past, int) else counts[past]

    for place in (first, first + size - 1):
        for number in (lowest - 1, highest):
            call = arguments()
            call[0][place] = number
            with pytest.raises(ValueError, match="an index is out of range"):
                compiled.march(*call)


@pytest.mark.parametrize("index", range(1, len(COUNTS)))
@pytest.mark.parametrize(
    ("number", "text"), [(2**31 - 1, "is too large"), (-1, "is negative")]
)
def test_a_count_that_cannot_be(
    compiled: Kernel, index: int, number: int, text: str
) -> None:
    """Sums of those that are refused as too large would overflow."""
    call = arguments()
    call[0][index] = number

    with pytest.raises(ValueError, match=f"a count {text}"):
        compiled.march(*call)


@settings(max_examples=300, deadline=None)
@given(
    changes=st.lists(
        st.tuples(st.integers(0, len(PROGRAM.floats) - 1), st.floats()),
        min_size=1,
        max_size=4,
    ),
    state=st.lists(st.floats(), min_size=5, max_size=5),
    inputs=st.lists(st.floats(), min_size=2 * STEPS, max_size=2 * STEPS),
)
def test_any_floats_end(
    compiled: Kernel,
    changes: list[tuple[int, float]],
    state: list[float],
    inputs: list[float],
) -> None:
    """No number, nan or infinity can hang or crash the march."""
    call = arguments(state=array("d", state), inputs=array("d", inputs))
    for index, number in changes:
        call[1][index] = number
    compiled.march(*call)


@pytest.mark.parametrize("length", [0, 1, len(COUNTS), len(COUNTS) + 5])
def test_truncated_ints(compiled: Kernel, length: int) -> None:
    """Cut anywhere, also inside the header."""
    with pytest.raises(ValueError, match=r"header|wrong length"):
        compiled.march(*arguments(ints=array("i", PROGRAM.ints[:length])))


@pytest.mark.parametrize(
    "changes",
    [
        {"floats": array("d", PROGRAM.floats[:-1])},
        {"state": array("d", [300.0] * 4)},
        {"inputs": array("d", [290.0])},
        {"input_set": array("i", [])},
        {"input_set": array("i", [1])},
        {"input_set": array("i", [-1])},
        {"ledger": array("d", [0.0])},
        {"out": array("d", [0.0] * (6 * STEPS - 1))},
        {"members": 2},
        {"members": -1},
        {"members": 2**62},
        {"sets": 0},
        {"sets": 2**32 + 1},
        {"steps": 2**32, "sets": 2**32, "inputs": array("d")},
        {"steps": 2**62, "sets": 2, "inputs": array("d")},
        {"steps": -1},
        {"steps": 2**62},
        {"steps_s": array("d")},
        {"steps_s": array("d", [0.05] * (STEPS - 1))},
        {"steps_s": array("d", [0.05, 0.0, 0.05])},
        {"steps_s": array("d", [float("nan")])},
        {"column": -2},
        {"column": 6},
        {"column": 0, "out": array("d", [0.0] * (STEPS - 1))},
        {"ledger": array("d")},
        {"ledger": array("d"), "column": 5},
        {"ledger": array("d", [0.0]), "column": 0},
        {"every": 0},
        {"phase": 0},
        {"phase": 2**40},
        {"ints": array("d", [1.0])},
        {"state": array("f", [0.0] * 5)},
    ],
)
def test_sizes_and_counts_that_do_not_fit(
    compiled: Kernel, changes: dict[str, Any]
) -> None:
    """Each buffer and number is checked before anything is touched."""
    call = arguments(**changes)
    with pytest.raises(ValueError, match=r"buffer|count|input set|step"):
        compiled.march(*call)


@pytest.mark.parametrize("name", BUFFERS)
def test_only_what_is_written_must_be_writable(
    compiled: Kernel, name: str
) -> None:
    """State, ledger and output."""
    call = arguments()
    place = BUFFERS.index(name)
    call[place] = memoryview(call[place]).toreadonly()

    if name in {"state", "ledger", "out"}:
        with pytest.raises(BufferError):
            compiled.march(*call)
    else:
        compiled.march(*call)


@pytest.mark.parametrize("members", [1, 3, 16, 21])
def test_held_inputs_march_as_repeated_ones(
    kernel: Kernel | None, members: int
) -> None:
    """To the last bit, in blocks of any width, whatever the steps."""
    steps_s = [5.0, 5.0, 20.0, 0.05, 0.05, 36.0]
    held, repeated = (
        Batch([PROGRAM] * members, 300.0, kernel=kernel) for _ in range(2)
    )
    inputs = array("d", [290.0, 100.0] * members)
    for member in range(members):
        inputs[2 * member] += member
        held.settle(300.0 + member, member)
    repeated.state = held.state[:]
    fluid = held.names.index("fluid")

    found = held.march_held(inputs, steps_s, fluid)

    rows = [repeated.march(inputs, 1, step_s) for step_s in steps_s]
    width = held.width + held.sources
    expected = [kelvin for row in rows for kelvin in row[fluid::width]]
    assert [*found] == expected
    assert held.state == repeated.state
    assert not any(held.ledger)
    assert min(repeated.ledger[-1], found[-1]) > 0.0
    assert len({*found}) == len(found)


@pytest.mark.parametrize(
    ("steps", "dt_s", "every", "inputs"),
    [(2, 0.05, 1, 2), (1, 0.0, 1, 2), (1, 0.05, 0, 2), (-1, 0.05, 1, 0)],
)
def test_batch_refuses_alike_in_both_forms(
    kernel: Kernel | None, steps: int, dt_s: float, every: int, inputs: int
) -> None:
    """Pure Python checks sizes too."""
    batch = Batch([PROGRAM], 300.0, kernel=kernel)
    with pytest.raises(ValueError, match=r"inputs for|step|count"):
        batch.march(array("d", [290.0] * inputs), steps, dt_s, every)

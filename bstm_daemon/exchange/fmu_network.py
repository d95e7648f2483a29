"""The numbers of an exported model as the C header ``network.h``."""

from collections.abc import Sequence
from hashlib import sha256
from math import isinf, isnan
from typing import Any
from uuid import UUID

from bstm_daemon.channels import CHANNELS
from bstm_daemon.estimator.blocks import channels_at_rest
from bstm_daemon.estimator.coupling import COUPLING_US
from bstm_daemon.estimator.estimator import STEP_US
from bstm_daemon.exchange.fmu_model import KINDS, FmuModel
from bstm_daemon.model.heat.memory import SampleState

TYPES = """
typedef struct { int ints, length, floats, state, ledger; int32_t set;
                 int disc, pad_front; } Corner;
typedef struct { int32_t slot; double gain, offset; int may_be_missing; }
    Input;
typedef struct { double start, lower, upper; } Tunable;
typedef struct { int tunable, number; double b, c; } Response;
typedef struct { int kind, index; } Variable;
"""


def network_header(model: FmuModel) -> tuple[str, str]:
    """Return the header of *model* and the token that stands for both."""
    ints: list[int] = []
    floats: list[float] = []
    states: list[float] = []
    corners: list[tuple[int, ...]] = []
    tunables: list[tuple[float, ...]] = []
    responses: list[tuple[float, ...]] = []
    ledger = 0
    for corner in model.corners:
        program = corner.program
        names = program.state_names
        for response in corner.responses:
            responses += [
                (len(tunables), len(floats) + place, b, c)
                for place, b, c in response.numbers
            ]
            tunables.append((response.start, response.lower, response.upper))
        corners.append(
            (
                *(len(ints), len(program.ints), len(floats), len(states)),
                *(ledger, corner.place, len(states) + names.index("disc")),
                len(states) + names.index("pad_front"),
            )
        )
        ints += program.ints
        floats += program.floats
        states += program.initial_state(model.initial_k)
        ledger += len(program.ledger_names)
    plan = model.plan
    counts = {
        "HEAT": int(plan is not None),
        "LAWS": int(plan is not None and plan.numbers.has_laws),
        "CORNERS": len(corners),
        "SETS": 1 if plan is None else len(plan.corners),
        "INPUTS": len(model.inputs),
        "TUNABLES": len(tunables),
        "RESPONSES": len(responses),
        "FLOATS": len(floats),
        "STATES": len(states),
        "LEDGERS": ledger,
        "VARIABLES": len(model.variables) + 1,
        "STEP_US": STEP_US,
        "COUPLING_US": COUPLING_US,
    }
    inputs = [
        (one.slot, one.gain, one.offset, int(one.may_be_missing))
        for one in model.inputs
    ]
    variables = [(KINDS.index("time"), 0)] + [
        (KINDS.index(one.kind), one.index) for one in model.variables
    ]
    tables: list[tuple[str, str, Sequence[Any]]] = [
        ("Corner", "FMU_CORNER", corners),
        ("int32_t", "FMU_INTS", ints),
        ("double", "FMU_NOMINAL_FLOATS", floats),
        ("double", "FMU_INITIAL_STATE", states),
        ("Input", "FMU_INPUT", inputs),
        ("double", "FMU_INPUT_START", [one.start for one in model.inputs]),
        ("Tunable", "FMU_TUNABLE", tunables or [(0.0, 0.0, 0.0)]),
        ("Response", "FMU_RESPONSE", responses or [(0, 0, 0.0, 0.0)]),
        ("Variable", "FMU_VARIABLE", variables),
        (
            *("double", "FMU_ROW_AT_REST"),
            [channels_at_rest(model.initial_k)[name] for name in CHANNELS],
        ),
    ]
    if plan is not None:
        start = SampleState.new()
        tables += [
            ("int64_t", "FMU_PLAN_INTS", plan.ints),
            ("double", "FMU_PLAN_FLOATS", plan.floats),
            ("int64_t", "FMU_TIMES", start.times),
            ("double", "FMU_NUMBERS", start.numbers),
        ]
    kinds = ", ".join(f"VARIABLE_{kind.upper()}" for kind in KINDS)
    text = "\n".join(
        (
            "#include <math.h>",
            "#include <stdint.h>",
            *(f"#define FMU_{name} {n}" for name, n in counts.items()),
            f"enum {{ {kinds} }};",
            TYPES.strip(),
            *(_table(*table) for table in tables),
            "",
        )
    )
    variable_names = [variable.name for variable in model.variables]
    found = sha256(repr((text, variable_names)).encode()).digest()
    token = f"{{{UUID(bytes=found[:16])}}}"
    guard = "BSTM_FMU_NETWORK_H"
    lines = (
        "/* Written by bstm fmu export. */",
        f"#ifndef {guard}",
        f"#define {guard}",
        f'#define FMU_TOKEN "{token}"',
        text,
        "#endif",
    )
    return "\n".join(lines), token


def _table(kind: str, name: str, values: Sequence[Any]) -> str:
    cells = ",\n".join(
        _number(value)
        if isinstance(value, int | float)
        else "{" + ", ".join(map(_number, value)) + "}"
        for value in values
    )
    return f"static const {kind} {name}[{len(values)}] = {{\n{cells}}};"


def _number(value: float) -> str:
    if isinstance(value, int):
        return "INT64_MIN" if value == -(2**63) else str(value)
    if isnan(value):
        return "NAN"
    if isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    return repr(value)

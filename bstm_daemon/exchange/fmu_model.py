"""What an exported model holds: its corners, variables and numbers."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from math import isnan
from typing import Final

from bstm_daemon.channels import CHANNELS, VEHICLE_CHANNELS
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import UsageError
from bstm_daemon.estimator.blocks import channels_at_rest
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.estimator.estimator import STEP_US, Estimator
from bstm_daemon.exchange.responses import Response, responses
from bstm_daemon.model.effects.catalogue import edited_inputs
from bstm_daemon.model.effects.model import corrections_by_role
from bstm_daemon.model.heat.sample_plan import SamplePlan
from bstm_daemon.model.thermal.program import Program
from bstm_daemon.roles import ROLES

KINDS: Final = (
    *("input", "tunable", "state", "row", "vehicle", "grid", "time"),
)
"""Where the value of a variable lies in the memory of an instance."""

NOT_HEAT: Final = frozenset(
    (
        *("pads_new", "pad_worn_1mm", "pad_2mm_left", "fluid_changed"),
        *("fluid_water_percent", "trailer_connected"),
    )
)
"""Roles that the pass over samples does not read."""

ROLE_UNITS: Final = {
    "speed": "m/s",
    "pressure": "Pa",
    "acceleration": "m/s2",
    "angular_speed": "rad/s",
    "angle": "rad",
    "torque": "N.m",
    "force": "N",
    "length": "m",
    "temperature": "K",
}

ENDINGS: Final = {
    "_ms": "m/s",
    "_ms2": "m/s2",
    "_pa": "Pa",
    "_k": "K",
    "_w": "W",
    "_j": "J",
    "_n": "N",
    "_m": "m",
    "_kg": "kg",
    "_s": "s",
}

CHANNEL_TEXTS: Final = {
    "speed_ms": "speed",
    "pressure_pa": "brake pressure",
    "brake_on": "share of the step in which the brake is applied, 0 to 1",
    "wetness": "rain, 0 dry to 1",
    "ambient_k": "temperature of the air",
    "brake_power_w": "brake power of the corner, disc and pads together",
    "brake_power_std_w": "standard deviation of the brake power",
    "brake_force_n": "brake force of the vehicle",
    "flags": "sum of the bits of findings (docs/validity.md)",
    "grade": "grade, rise over run",
    "mass_kg": "mass of the vehicle",
    "friction_scale": "learned factor on the friction of the pads",
}

CAR_ROWS: Final = ("pressure_pa", "brake_power_w", "ambient_k")
CAR_VALUES: Final = ("speed_ms", "brake_force_n", "flags")
LEARNED_VALUES: Final = ("grade", "mass_kg", "friction_scale")


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of the exported model, a real number.

    ``kind`` is of :data:`KINDS`, ``index`` the place there; without a
    ``start`` it can not be set.
    """

    name: str
    causality: str
    kind: str
    index: int
    unit: str
    description: str
    start: float | None = None
    bounds: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Input:
    """An input: its slot (role or channel), and gain and offset on it."""

    slot: int
    start: float
    gain: float = 1.0
    offset: float = 0.0
    may_be_missing: bool = False


@dataclass(frozen=True, slots=True)
class FmuCorner:
    """A corner: its network and its place in a row of channels."""

    name: str
    program: Program
    place: int
    responses: list[Response]


@dataclass(frozen=True, slots=True)
class FmuModel:
    """An exported model; without a ``plan`` its input is the brake power."""

    name: str
    text: str
    corners: list[FmuCorner]
    inputs: list[Input]
    variables: list[Variable]
    initial_k: float
    plan: SamplePlan | None = None


def corner_program(config: Config, corner: str) -> Program:
    """Return the network of the corner of that name, compiled.

    Raises:
        UsageError: there is no such disc corner.
        ConfigError: the corner can not be built.
    """
    known = {one.name: one for one in config.disc_corners()}
    if corner not in known:
        msg = f"--corner {corner}: no disc brake; there are {', '.join(known)}"
        raise UsageError(msg)
    return compile_corner(config, known[corner])


def corner_fmu(config: Config, corner: str) -> FmuModel:
    """Return the model of one corner, from brake power to temperatures.

    Raises:
        UsageError: there is no such disc corner.
        ConfigError: the corner can not be built.
    """
    program = corner_program(config, corner)
    initial_k = config.vehicle.ambient_k
    rest = channels_at_rest(initial_k)
    inputs: list[Input] = []
    variables: list[Variable] = []
    for name in _used_channels(program):
        measured = isnan(rest[name])
        text = CHANNEL_TEXTS.get(name, "measured; not a number: unknown")
        variables.append(
            Variable(
                *(name, "input", "input", len(inputs), _unit(name), text),
                rest[name],
            )
        )
        slot = CHANNELS.index(name)
        inputs.append(Input(slot, rest[name], may_be_missing=measured))
    corners = [FmuCorner(corner, program, 0, responses(config, corner))]
    return FmuModel(
        f"bstm_{corner}",
        f"brake temperatures of corner {corner} of {config.vehicle.id}",
        corners,
        inputs,
        [*variables, *_of_corners(corners, initial_k, prefixed=False)],
        initial_k,
    )


def car_fmu(config: Config, present: Mapping[int, int]) -> FmuModel:
    """Return the model of the car, from its signals to all temperatures.

    Args:
        config: the vehicle.
        present: role number to timeout [us] of each mapped role.

    Raises:
        ConfigError: the car can not be built.
    """
    estimator = Estimator(config, present, history_known=True)
    plan = estimator.plan
    initial_k = config.vehicle.ambient_k
    corrections = corrections_by_role(edited_inputs(config).corrections)
    inputs: list[Input] = []
    variables: list[Variable] = []
    for number, role in enumerate(ROLES):
        measured = role.name.startswith("temp_")
        if (
            number not in present
            or role.name in NOT_HEAT
            or (measured and config.heat.mode != "measured")
        ):
            continue
        air = role.quantities[0] == "temperature"
        start = initial_k if air else float(role.name == "ignition")
        unit = ROLE_UNITS.get(role.quantities[0], "1")
        text = f"role {role.name} of the configuration"
        variables.append(
            Variable(
                *(role.name, "input", "input", len(inputs), unit, text), start
            )
        )
        inputs.append(
            Input(number, start, *corrections.get(number, (1.0, 0.0)))
        )
    corners = [
        FmuCorner(
            name, program, plan.corners.index(name), responses(config, name)
        )
        for name, program in estimator.programs.items()
    ]
    variables += _of_corners(corners, initial_k, prefixed=True)
    for name in plan.corners:
        first = plan.corners.index(name) * len(CHANNELS)
        variables += [
            _output(
                f"{name}.{channel}", "row", first + CHANNELS.index(channel)
            )
            for channel in CAR_ROWS
        ]
    learned = LEARNED_VALUES if config.heat.mode == "fused" else ()
    variables += [
        _output(
            f"vehicle.{channel}", "vehicle", VEHICLE_CHANNELS.index(channel)
        )
        for channel in (*CAR_VALUES, *learned)
    ]
    return FmuModel(
        "bstm_car",
        f"brake temperatures of {config.vehicle.id} from its signals, heat "
        f"mode {config.heat.mode}",
        corners,
        inputs,
        variables,
        initial_k,
        plan,
    )


def _of_corners(
    corners: list[FmuCorner], initial_k: float, *, prefixed: bool
) -> Iterator[Variable]:
    """Yield temperatures, memories and tunables, and the time of the grid."""
    tunable = state = 0
    for corner in corners:
        before = f"{corner.name}." if prefixed else ""
        names = corner.program.state_names
        nodes = corner.program.network.nodes
        # what follows the air is no output
        boundaries = {
            n.name for n in nodes if n.boundary_input and n.capacity_j_k == 0.0
        }
        starts = corner.program.initial_state(initial_k)
        for i, (name, start) in enumerate(zip(names, starts, strict=True)):
            node = i < len(nodes)
            if node and name in boundaries:
                continue
            yield Variable(
                f"{before}{name}_k" if node else f"{before}{name}",
                "output" if node else "local",
                "state",
                state + i,
                "K" if node else _unit(name),
                f"temperature of {name}" if node else "memory of the network",
                start,
            )
        state += len(names)
        for one in corner.responses:
            yield Variable(
                *(f"{before}{one.key}", "parameter", "tunable", tunable),
                {"-": "1", "factor": "1", "x typical": "1"}.get(
                    one.unit, one.unit
                ),
                one.description,
                one.start,
                (one.lower, one.upper),
            )
            tunable += 1
    text = f"time of the outputs, a multiple of {STEP_US * 1e-6:g} s"
    yield Variable("grid_time_s", "output", "grid", 0, "s", text)


def _output(name: str, kind: str, index: int) -> Variable:
    channel = name.partition(".")[2]
    text = CHANNEL_TEXTS[channel]
    return Variable(name, "output", kind, index, _unit(channel), text)


def _used_channels(program: Program) -> list[str]:
    """Return the inputs that the network reads, in the order of a row."""
    net = program.network
    factors = chain.from_iterable(
        [
            *(node.factors for node in net.nodes),
            *(link.factors for link in net.links),
            *(source.factors for source in net.sources),
            *(memory.factors for memory in net.memories),
        ]
    )
    slots = {node.boundary_input for node in net.nodes}
    for factor in factors:
        slots |= {factor.a, factor.b}
    return [name for name in net.inputs if name in slots]


def _unit(name: str) -> str:
    return ENDINGS.get(f"_{name.rpartition('_')[2]}", "1")

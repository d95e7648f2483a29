"""State of the estimator as plain values, to save and restore it.

:func:`export_state` gives a document of names and numbers;
:func:`restore_state` takes it back into an estimator that may have been
reconfigured: nodes carry over by name, new ones start at the mean of their
neighbours. :func:`park` lets the brakes cool; :func:`correct_parked` is for a
clock that is set right later, and needs :func:`keep_input_history` before.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, Final

from bstm_daemon.channels import CHANNELS, FLAGS
from bstm_daemon.estimator.blocks import channels_at_rest
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.estimator.estimator import STEP_US, Estimator
from bstm_daemon.estimator.input_history import InputHistory
from bstm_daemon.estimator.memory import (
    Document,
    Machine,
    SavedLearned,
    SavedSamples,
    SavedState,
    StateError,
    checked,
)
from bstm_daemon.estimator.unseen import COARSE_STEPS, coarse_steps
from bstm_daemon.estimator.validity import HIGHEST_K, LOWEST_K
from bstm_daemon.model.heat.check_rules import AIR_NIGHT_K_S
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.model.heat.learned import LEARNED_NAMES, learned_fault
from bstm_daemon.model.heat.memory import NEVER, SampleState
from bstm_daemon.model.heat.sample_plan import PLAN_LAYOUT
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.network import Network
from bstm_daemon.model.thermal.settling import cooling_time_s
from bstm_daemon.model.wear.dose import DOSE
from bstm_daemon.model.wear.pads import Change
from bstm_daemon.roles import ROLES

RESUMABLE_US: Final = 60_000_000
"""A pause up to this is marched on the grid like a silent bus, so that a
replay from the same state gives the same bits; a longer one by :func:`park`.
"""

SAME_AXIS_US: Final = 10_000
"""Largest difference of time axes that count as one: two clocks can not be
read at once."""

AT_REST_K: Final = 0.01
"""A brake with all nodes closer than this to the air counts as cold."""


@dataclass(frozen=True, slots=True)
class Restored:
    """Result of a restore: ``corner.node`` names carried over and new.

    ``resumed``: the pass over samples continues where it was, with every
    value and its age; otherwise it starts without inputs. ``learned``: the
    learned parameters of the car were taken over.
    """

    carried: tuple[str, ...]
    new: tuple[str, ...]
    resumed: bool
    learned: bool = False


def export_state(estimator: Estimator) -> Document:
    """Return the memory of *estimator* as plain values.

    ``time_us`` is its time on the axis of the stamps, None before any.
    """
    samples = estimator.samples
    now = samples.times[0]
    times, numbers = samples.exported(len(estimator.plan.corners))
    return {
        "vehicle_id": estimator.config.vehicle.id,
        "time_us": None if now == NEVER else now,
        "ambient_k": estimator.air_k(),
        "air_k": samples.air_k,
        "speed_ms": samples.last_speed_ms,
        "corners": {
            name: estimator.state(name) for name in estimator.programs
        },
        "start_bound": estimator.start.states(),
        "wear": estimator.wear.export(),
        "samples": {
            "layout": _layout(estimator),
            "times": times,
            "numbers": [
                number if isfinite(number) else None for number in numbers
            ],
            "flags": list(samples.flags),
            "open_flags": estimator.open_flags,
        },
        "learned": _exported(estimator),
        "trust": estimator.trust.export(),
        "unproven": estimator.unproven.export(),
        "unseen": estimator.unseen.export(),
    }


def restore_state(
    estimator: Estimator, document: Mapping[str, Any], *, resume: bool
) -> Restored:
    """Put *document* into *estimator*, which has not marched yet.

    Args:
        estimator: the estimator of the present configuration.
        document: the result of :func:`export_state`.
        resume: continue with the samples too, if their layout is the same.

    Raises:
        StateError: a value is missing, of the wrong kind or no possible
            temperature; the estimator is as before.
    """
    saved = checked(SavedState, document)
    states, bounds, carried, new = {}, {}, [], []
    for name, program in estimator.programs.items():
        values = saved.corners.get(name)
        if values is None:
            new.append(name)
            continue
        nodes = [node.name for node in program.network.nodes]
        _check_nodes(name, nodes, values)
        states[name] = _completed(program.network, values)
        bound = saved.start_bound.get(name)
        if bound is not None:
            _check_nodes(name, nodes, bound)
            bounds[name] = _completed(program.network, bound)
        carried += [f"{name}.{key}" for key in nodes if key in values]
        new += [f"{name}.{key}" for key in nodes if key not in values]
    if not carried:
        msg = "no node of it has the name of a node of this car"
        raise StateError(msg)
    learned = _learned(estimator, saved)
    samples = _samples(estimator, saved, learned) if resume else None
    _restore_machines(estimator, saved)
    doses = {n: state[DOSE] for n, state in states.items() if DOSE in state}
    _restore_wear(estimator, saved.wear, doses)
    for batch, member, name in estimator.members():
        state = estimator.state(name) | states.get(name, {})
        batch.state[batch.part(member)] = array("d", state.values())
    estimator.start.end()
    estimator.start.begin(bounds.keys(), bounds)
    # a corner without saved values is as after a first start
    known = states.keys() if saved.history_left_us <= 0.0 else set()
    estimator.start.begin(estimator.programs.keys() - known - bounds.keys())
    if samples is not None:
        estimator.samples, estimator.open_flags = samples
    else:
        estimator.samples = SampleState.new(learned)
    return Restored(
        tuple(carried),
        tuple(new),
        resumed=samples is not None,
        learned=learned is not None,
    )


def resume_state(
    estimator: Estimator,
    document: Mapping[str, Any],
    parked_us: int | None,
    now_us: int,
    *,
    proven: bool = True,
) -> Restored:
    """Put *document* into *estimator* and let the brakes cool since.

    Where the parked time is not known the estimate is degraded until the
    brakes would be cold at a standstill.

    Args:
        estimator: has not marched yet.
        document: the result of :func:`export_state`.
        parked_us: time since then [us]; None if no clock knows it: then the
            brakes are as hot as they were.
        now_us: time now on the axis of the stamps [us].
        proven: whether the time since then was no longer.

    Raises:
        StateError: it is no state of this car; nothing was changed.
    """
    saved, own = checked(SavedState, document), estimator.config.vehicle.id
    if saved.vehicle_id != own:
        msg = f"it is of vehicle {saved.vehicle_id!r}, not {own!r}"
        raise StateError(msg)
    resume = (
        parked_us is not None
        and saved.time_us is not None
        and abs(now_us - parked_us - saved.time_us) <= SAME_AXIS_US
        and 0 <= parked_us <= RESUMABLE_US
    )
    restored = restore_state(estimator, document, resume=resume)
    if restored.resumed:
        return restored
    if saved.drove_unseen:
        estimator.open_flags |= FLAGS["driven_unseen"]
    air_k = saved.ambient_k
    if air_k is None or not LOWEST_K < air_k < HIGHEST_K:
        air_k = estimator.air_k()
    stood_us = max(parked_us or 0, 0)
    is_known = proven and parked_us is not None
    # how long a hole had lasted is known by the axis that it began on
    is_dated = saved.time_us is not None or not estimator.unseen.is_open
    saved_us = now_us if saved.time_us is None else saved.time_us
    estimator.begin_unseen(saved_us, saved.speed_ms)
    before_us = saved_us - estimator.unseen.since_us if is_dated else 0
    park(estimator, stood_us * 1e-6, air_k)
    estimator.unseen.move(
        now_us - stood_us - before_us, proven=is_known and is_dated
    )
    if is_known:
        fallen_k = AIR_NIGHT_K_S * stood_us * 1e-6
        estimator.samples.know_air(saved.air_k - fallen_k)
    else:
        row = array("d", channels_at_rest(air_k).values())
        cold_s = (cooling_time_s(b, row, air_k) for b, _ in estimator.batches)
        estimator.trust.hold(max(cold_s, default=0.0))
    return restored


def parked_before_us(document: Mapping[str, Any], first_us: int) -> int | None:
    """Return the time from the save to a log's first stamp [us].

    None where the log begins before the save, being of another drive, or
    where the wall clock of the save was not synchronised, unless the log goes
    on at once: then the brakes begin as they were.
    """
    wall_us = document.get("wall_us")
    if not isinstance(wall_us, int) or wall_us > first_us:
        return None
    since_us = first_us - wall_us
    # the service notes None; a document without that says nothing against it
    is_right = document.get("wall_error_us", 0) is not None
    return since_us if is_right or since_us <= RESUMABLE_US else None


def park(
    estimator: Estimator, parked_s: float, ambient_k: float | None = None
) -> None:
    """Let every brake cool for *parked_s* seconds and reset the inputs.

    The air is at *ambient_k* [K], by default the last known.
    """
    air_k = estimator.air_k() if ambient_k is None else ambient_k
    estimator.begin_unseen(*estimator.last_seen())
    estimator.unseen.move(estimator.unseen.since_us, proven=True)
    _stand(estimator, parked_s, air_k)
    estimator.park_doubts(parked_s)
    estimator.start.compare()
    learned = estimator.samples.learned()
    estimator.samples = SampleState.new(learned)
    estimator.samples.await_speed()


def keep_input_history(estimator: Estimator) -> None:
    """Keep the inputs since a restart whose parked time is uncertain."""
    width = len(estimator.plan.corners) * len(CHANNELS)
    estimator.input_history = InputHistory(width, 1_000_000 // STEP_US)


def correct_parked(
    estimator: Estimator, document: Mapping[str, Any], parked_s: float
) -> None:
    """Correct the parked time to *parked_s*, known only after the restart.

    *document* was restored with another parked time and
    :func:`keep_input_history` called; what has happened since is marched
    again, in steps of a second, from the right start.

    Raises:
        StateError: as :func:`restore_state`.
    """
    history = estimator.input_history
    if history is None:
        msg = "no input history was kept since the restart"
        raise StateError(msg)
    estimator.input_history = None
    rows = history.closed()
    air_k = estimator.air_k()
    running = estimator.samples, estimator.open_flags
    wear, unseen = estimator.wear, estimator.unseen.export()
    restore_state(estimator, document, resume=False)
    _stand(estimator, parked_s, air_k)
    for batch in _batches(estimator):
        ledger = batch.ledger[:]
        for steps, row in rows:
            batch.march(row, 1, steps * STEP_US * 1e-6)
        batch.ledger[:] = ledger
    estimator.start.compare()
    since = sum(steps for steps, _ in rows)
    estimator.samples, estimator.open_flags = running
    estimator.open_flags |= FLAGS["clock_jump"]
    estimator.wear = wear
    _rebuild(estimator)
    estimator.park_doubts(parked_s + since * STEP_US * 1e-6)
    gone = round(parked_s * 1e6) // STEP_US + since
    estimator.unseen.restore(unseen)
    if estimator.unseen.is_parked and rows:
        begun_us = estimator.samples.times[0] - gone * STEP_US
        estimator.unseen.move(begun_us, proven=True)


def _stand(estimator: Estimator, seconds: float, air_k: float) -> None:
    row = array("d", channels_at_rest(air_k).values())
    for batch in _batches(estimator):
        ledger = batch.ledger[:]
        inputs = row * batch.sets
        for step_s in coarse_steps(seconds):
            batch.march(inputs, 1, step_s)
            if step_s == COARSE_STEPS[-1][1] and _at_rest(batch, air_k):
                break
        batch.ledger[:] = ledger


def _batches(estimator: Estimator) -> list[Batch]:
    """Return the batches of the estimate and those of the hot bound."""
    return [batch for batch, _ in estimator.batches] + estimator.start.batches


def _at_rest(batch: Batch, air_k: float) -> bool:
    return all(
        abs(kelvin - air_k) < AT_REST_K
        for member, program in enumerate(batch.programs)
        for kelvin in batch.state[batch.part(member)][
            : len(program.network.nodes)
        ]
    )


def _restore_machines(estimator: Estimator, saved: SavedState) -> None:
    """Take over the state machines, all or none of them."""
    machines: tuple[tuple[str, Machine, Document | None], ...] = (
        ("trust", estimator.trust, saved.trust),
        ("unproven", estimator.unproven, saved.unproven),
        ("unseen", estimator.unseen, saved.unseen),
    )
    before = [(machine, machine.export()) for _, machine, _ in machines]
    for name, machine, own in machines:
        try:
            if own is not None:
                machine.restore(own)
        except (KeyError, TypeError, ValueError) as error:
            for other, kept in before:
                other.restore(kept)
            msg = f"{name}: not what this version saves"
            raise StateError(msg) from error


def _restore_wear(
    estimator: Estimator, saved: Document | None, doses_j: Mapping[str, float]
) -> None:
    """Take over the wear and its networks; a state without stays as it is."""
    if saved is None:
        return
    try:
        wear = estimator.wear.restored(saved, doses_j)
    except (KeyError, TypeError, ValueError) as error:
        msg = f"wear: {type(error).__name__} {error}"
        raise StateError(msg) from error
    estimator.wear = wear
    _rebuild(estimator)


def _rebuild(estimator: Estimator) -> None:
    """Build every network for the worn lining and disc."""
    for batch, member, name in estimator.members():
        corner = estimator.wear.built_corner(name)
        program = compile_corner(estimator.config, corner)
        batch.replace(member, program)
        estimator.start.exchange(name, program, Change.CORRECTED, air_k=0.0)
        estimator.programs[name] = program


def _completed(
    network: Network, values: Mapping[str, float]
) -> dict[str, float]:
    """Temperatures of all nodes of *network*, and its saved memories.

    A node without a value gets the mean of the neighbours that have one,
    nearest first.
    """
    names = [node.name for node in network.nodes]
    known = {name: values[name] for name in names if name in values}
    while len(known) < len(names):
        found = {}
        for name in names:
            near = {
                link.b if link.a == name else link.a
                for link in network.links
                if name in {link.a, link.b}
            }
            beside = [known[other] for other in near if other in known]
            if name not in known and beside:
                found[name] = sum(beside) / len(beside)
        if not found:
            mean_k = sum(known.values()) / len(known)
            found = {name: mean_k for name in names if name not in known}
        known |= found
    memories = {
        memory.name: min(max(values[memory.name], memory.lower), memory.upper)
        for memory in network.memories
        if memory.name in values
    }
    return {name: known[name] for name in names} | memories


def _check_nodes(
    corner: str, nodes: list[str], values: Mapping[str, float]
) -> None:
    if not any(node in values for node in nodes):
        msg = f"corner {corner}: no node has the name of a node of this car"
        raise StateError(msg)
    for node in nodes:
        kelvin = values.get(node, LOWEST_K + 1.0)
        if not LOWEST_K < kelvin < HIGHEST_K:
            msg = f"{corner}.{node} = {kelvin:g} K is no brake's temperature"
            raise StateError(msg)


def _samples(
    estimator: Estimator, saved: SavedState, learned: list[float] | None
) -> tuple[SampleState, int] | None:
    """Return the saved pass over samples; None of another layout.

    Without *learned*, of another car or none, the observer is reset.
    """
    if saved.samples.get("layout") != _layout(estimator):
        return None
    samples = checked(SavedSamples, saved.samples, "samples:")
    try:
        state = SampleState.imported(
            len(estimator.plan.corners),
            samples.times,
            [nan if number is None else number for number in samples.numbers],
            samples.flags,
        )
    except ValueError as error:
        msg = f"samples: {error}"
        raise StateError(msg) from error
    own = state.learned()
    if own is not None and (learned is None or learned_fault(own) is not None):
        state.unlearn()
    return state, samples.open_flags


def _exported(estimator: Estimator) -> Document | None:
    """Return the learned parameters and the configuration they belong to."""
    learned = estimator.samples.learned()
    if learned is None or learned_fault(learned) is not None:
        return None
    return {
        "vehicle": _nominal(estimator),
        "numbers": dict(zip(LEARNED_NAMES, learned, strict=True)),
    }


def _learned(estimator: Estimator, state: SavedState) -> list[float] | None:
    """Return the learned parameters in *state*, None if they do not apply.

    They do not apply to a car with other nominal values or to a model that
    does not learn; impossible values are rejected.
    """
    try:
        saved = SavedLearned.model_validate(state.learned)
        learned = [saved.numbers[name] for name in LEARNED_NAMES]
    except (KeyError, ValueError):
        return None
    fits = (
        estimator.config.heat.mode == "fused"
        and saved.vehicle == _nominal(estimator)
        and learned_fault(learned) is None
    )
    return learned if fits else None


def _nominal(estimator: Estimator) -> list[float]:
    """Return the nominal values to which the learned ones are relative."""
    vehicle = Vehicle.of_config(estimator.config.vehicle)
    return [
        *(vehicle.mass_kg, vehicle.rotating_mass_kg, vehicle.wheel_radius_m),
        *(vehicle.quadratic, vehicle.linear, vehicle.constant),
    ]


def _layout(estimator: Estimator) -> str:
    """Return all that determines the meaning of an array's entries."""
    roles = ",".join(role.name for role in ROLES)
    corners = ",".join(estimator.plan.corners)
    return f"{PLAN_LAYOUT};{STEP_US};{corners};{roles}"

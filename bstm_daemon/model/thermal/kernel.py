"""March members of one structure, compiled or in pure Python.

Corners of a car and members of an ensemble are the same thing here: rows of
one batch, each with its own numbers and state.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from itertools import groupby
from typing import Final, Literal

from bstm_daemon.model.thermal import reference
from bstm_daemon.model.thermal.network import NetworkError
from bstm_daemon.model.thermal.program import Program, same_structure
from bstm_daemon.native.loader import Kernel, load_kernel

ALL: Final = -1
"""Number for all columns of an output."""


class Batch:
    """Members that share a structure, their states and energy ledgers.

    ``state`` is [members, nodes + memories] flat, temperatures in kelvin;
    ``ledger`` is [members, links + sources] flat, energies in joules since
    the batch was made: a link's from its end a to its end b.
    """

    def __init__(
        self,
        programs: Sequence[Program],
        initial_k: float,
        input_set: Sequence[int] | None = None,
        kernel: Kernel | Literal["installed"] | None = "installed",
        sets: int | None = None,
    ) -> None:
        """Put every node of every member at *initial_k*.

        Args:
            programs: one per member, all of one structure.
            initial_k: starting temperature [K].
            input_set: per member the row of an input block it reads;
                default: member i reads row i.
            kernel: the compiled kernel, by default the installed one; None
                runs the reference step.
            sets: rows of an input block; default: as many as are read.

        Raises:
            NetworkError: the programs differ in structure.
            UsageError: ``BSTM_KERNEL`` asks for a kernel that is not there.
        """
        if not same_structure(programs):
            msg = "members of a batch need networks of one structure"
            raise NetworkError(msg)
        self.programs = tuple(programs)
        self.kernel = load_kernel() if kernel == "installed" else kernel
        self.input_set = array("i", input_set or range(len(programs)))
        self.sets = sets or max(self.input_set) + 1
        self.floats = array("d")
        self.state = array("d")
        for program in programs:
            self.floats.extend(program.floats)
            self.state.extend(program.initial_state(initial_k))
        first = programs[0]
        self.ints = first.ints
        self.names = first.state_names
        self.width = len(self.names)
        self.ledger_width = len(first.ledger_names)
        self.sources = len(first.network.sources)
        self.channels = len(first.network.inputs)
        self.ledger = array("d", bytes(8 * self.ledger_width * len(programs)))
        self._structure = (
            None if self.kernel else reference.Structure(first.ints)
        )

    def part(self, member: int) -> slice:
        """Return which entries of ``state`` are those of *member*."""
        return slice(member * self.width, (member + 1) * self.width)

    def named_state(self, member: int) -> dict[str, float]:
        """Return nodes [K] and memories of *member* by name."""
        own = self.state[self.part(member)]
        return dict(zip(self.names, own, strict=True))

    def replace(self, member: int, program: Program) -> None:
        """Let *member* go on with the numbers of *program*; its state stays.

        Raises:
            NetworkError: *program* is of another structure.
        """
        if not same_structure([self.programs[member], program]):
            msg = "a member can be replaced by one of its structure only"
            raise NetworkError(msg)
        size = len(program.floats)
        self.floats[member * size : (member + 1) * size] = program.floats
        programs = list(self.programs)
        programs[member] = program
        self.programs = tuple(programs)

    def settle(self, temperature_k: float, member: int) -> None:
        """Put every node of *member* at *temperature_k*; memories stay."""
        first = member * self.width
        nodes = len(self.programs[member].network.nodes)
        for i in range(first, first + nodes):
            self.state[i] = temperature_k

    def march(
        self,
        inputs: array[float] | memoryview,
        steps: int,
        dt_s: float,
        output_every: int = 1,
        output_phase: int = 1,
    ) -> array[float]:
        """Advance every member by *steps* of *dt_s* seconds.

        Args:
            inputs: [steps, sets, channels] flat, float64, constant in a step.
            steps: number of steps.
            dt_s: step [s].
            output_every: steps from one output to the next.
            output_phase: steps until the first output.

        Returns:
            [outputs, members, state + sources] flat: the state, then each
            source's running energy [J].

        Raises:
            ValueError: a size does not fit.
        """
        if (
            min(output_every, output_phase) < 1
            or not dt_s > 0.0
            or len(inputs) != steps * self.sets * self.channels
        ):
            msg = (
                f"{len(inputs)} inputs for {steps} steps of {self.sets} sets "
                f"of {self.channels} channels, step {dt_s} s"
            )
            raise ValueError(msg)
        members = len(self.programs)
        outputs = (
            0
            if steps < output_phase
            else 1 + (steps - output_phase) // output_every
        )
        row = members * (self.width + self.sources)
        out = array("d", bytes(8 * row * outputs))
        if self.kernel is not None:
            self._march_compiled(
                *(self.kernel, inputs, array("d", (dt_s,)), out, self.ledger),
                (steps, ALL, output_every, output_phase),
            )
            return out
        for member in range(members):
            self._march_reference(
                member, inputs, steps, dt_s, output_every, output_phase, out
            )
        return out

    def march_held(
        self, inputs: array[float], steps_s: Sequence[float], column: int
    ) -> array[float]:
        """Advance every member by *steps_s*, its inputs held all the time.

        The ledger stays as it is: a look ahead is no energy.

        Args:
            inputs: [sets, channels] flat, float64.
            steps_s: lengths of the steps [s].
            column: of the state, the one that is wanted.

        Returns:
            [steps, members] flat: *column* after each step.

        Raises:
            ValueError: a size does not fit.
        """
        if self.kernel is not None:
            out = array("d", bytes(8 * len(self.programs) * len(steps_s)))
            self._march_compiled(
                *(self.kernel, inputs, array("d", steps_s), out, array("d")),
                (len(steps_s), column, 1, 1),
            )
            return out
        found, ledger = array("d"), self.ledger[:]
        for step_s, run in groupby(steps_s):
            count = len([*run])
            out = self.march(inputs * count, count, step_s)
            found += out[column :: self.width + self.sources]
        self.ledger = ledger
        return found

    def _march_compiled(
        self,
        kernel: Kernel,
        inputs: array[float] | memoryview,
        steps_s: array[float],
        out: array[float],
        ledger: array[float],
        which: tuple[int, int, int, int],
    ) -> None:
        kernel.march(
            self.ints,
            self.floats,
            self.state,
            inputs,
            self.input_set,
            ledger,
            out,
            steps_s,
            len(self.programs),
            self.sets,
            *which,
        )

    def _march_reference(  # noqa: PLR0913, PLR0917
        self,
        member: int,
        inputs: array[float] | memoryview,
        steps: int,
        dt_s: float,
        output_every: int,
        output_phase: int,
        out: array[float],
    ) -> None:
        channels, sets = self.channels, self.sets
        first_set = self.input_set[member]
        starts = [
            (step * sets + first_set) * channels for step in range(steps)
        ]
        rows = [inputs[start : start + channels] for start in starts]
        width, wide = self.width, self.ledger_width
        members = len(self.programs)
        floats = self.programs[member].floats
        state = self.state[self.part(member)]
        ledger = self.ledger[member * wide : (member + 1) * wide]
        if self._structure is None:  # pragma: no cover
            msg = "the batch was made for the compiled kernel"
            raise RuntimeError(msg)
        results = reference.march(
            self._structure,
            floats,
            state,
            [list(r) for r in rows],
            dt_s,
            ledger,
            output_every,
            output_phase,
        )
        self.state[self.part(member)] = state
        self.ledger[member * wide : (member + 1) * wide] = ledger
        size = width + self.sources
        for i, result in enumerate(results):
            first = (i * members + member) * size
            out[first : first + size] = array("d", result)

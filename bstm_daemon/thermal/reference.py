"""The reference step in pure Python: fallback and oracle of the C kernel.

Scheme: two-stage L-stable Rosenbrock-W method ROS2 (Verwer et al. 1999,
gamma = 1 - 1/sqrt 2) in enthalpy form. With x the stage rates of
temperature, C the capacities and G the conductances at the start of a step::

    (C + gamma dt G) x1 = F(T0)
    (C + gamma dt G) x2 = F(T1) - 2 C x1        T1 from H0 + dt C x1
    H(T_new) = H0 + dt (3/2 C x1 + 1/2 C x2)

Heat, not temperature, is what a stage adds, and T(H) is inverted exactly on
the capacity tables, so energy is conserved to rounding whatever the tables.
A fixed node (boundary or forced) ramps to its input over the step.

The order of operations is that of ``_march.c``, line by line.
"""

from __future__ import annotations

from itertools import pairwise
from math import isnan, sqrt
from typing import TYPE_CHECKING, Final

from bstm_daemon.thermal.program import COUNTS, SECTIONS

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

GAMMA: Final = 1.0 - 1.0 / sqrt(2.0)


class Structure:
    """The ``ints`` of a program as named lists, parsed once."""

    def __init__(self, ints: Sequence[int]) -> None:
        """Split *ints* into its header and sections."""
        self.count = dict(zip(COUNTS, ints, strict=False))
        position = len(COUNTS)
        section: dict[str, list[int]] = {}
        for name in SECTIONS:
            length = ints[position]
            section[name] = list(ints[position + 1 : position + 1 + length])
            position += 1 + length
        self.section = section
        starts, uses = section["use_start"], section["use_factor"]
        self.uses = [uses[a:b] for a, b in pairwise(starts)]


def march(  # noqa: PLR0913, PLR0917  (the signature of the compiled kernel)
    structure: Structure,
    floats: Sequence[float],
    state: MutableSequence[float],
    inputs: Sequence[Sequence[float]],
    dt_s: float,
    ledger: MutableSequence[float],
    output_every: int,
    output_phase: int,
) -> list[list[float]]:
    """March one member through ``len(inputs)`` steps of *dt_s* seconds.

    Args:
        structure: the parsed ``ints`` of the program.
        floats: the member's numbers.
        state: nodes then memories, changed in place.
        inputs: one row of input channels per step, constant in a step.
        dt_s: step [s].
        ledger: energy per link, then per source [J], added to in place.
        output_every: steps between two outputs.
        output_phase: steps until the first output.

    Returns:
        One list per output: state, then each source's running energy [J].
    """
    step = _Step(structure, floats, dt_s)
    sources = structure.count["sources"]
    outputs: list[list[float]] = []
    due = output_phase
    for row in inputs:
        step.advance(state, row, ledger)
        due -= 1
        if due == 0:
            outputs.append([*state, *ledger[len(ledger) - sources :]])
            due = output_every
    return outputs


class _Step:
    """One member's step; the lists are work space."""

    def __init__(
        self, structure: Structure, floats: Sequence[float], dt_s: float
    ) -> None:
        self.s = structure
        self.f = floats
        self.dt = dt_s
        self.gdt = GAMMA * dt_s
        count = structure.count
        self.nodes = count["nodes"]
        self.links = count["links"]
        self.factor_value = [0.0] * count["factors"]
        self.fixed = [False] * self.nodes
        self.rate = [0.0] * self.nodes
        self.diagonal = [0.0] * self.nodes
        self.off = [0.0] * count["entries"]

    def advance(
        self,
        state: MutableSequence[float],
        row: Sequence[float],
        ledger: MutableSequence[float],
    ) -> None:
        """Advance *state* by one step with the inputs *row*."""
        n, dt, gdt = self.nodes, self.dt, self.gdt
        section = self.s.section
        link_a, link_b = section["link_a"], section["link_b"]
        memory_kind = section["memory_kind"]
        self._fix(state, row)
        fixed, rate = self.fixed, self.rate

        # stage 1
        self._evaluate([*state, *row], first=True)
        base = [self._product(i, self.f[i]) for i in range(n)]
        capacity = [base[i] * self._own_table(i, state[i]) for i in range(n)]
        g = self._conductances()
        heat = self._sources()
        value1 = self._memory_values()
        flow = [
            g[k] * (state[link_a[k]] - state[link_b[k]])
            for k in range(self.links)
        ]
        rhs = self._balance(flow, heat)
        self._factorise(capacity, g)
        x1 = self._solve(rhs, g, sign=1.0)
        energy1 = [
            flow[k] + gdt * (g[k] * (x1[link_a[k]] - x1[link_b[k]]))
            for k in range(self.links)
        ]
        predicted = list(state)
        for i in range(n):
            predicted[i] = (
                state[i] + dt * rate[i]
                if fixed[i]
                else self._heated(
                    i, state[i], base[i], capacity[i], dt * x1[i]
                )
            )
        for m, kind in enumerate(memory_kind):
            old = state[n + m]
            new = old + dt * value1[m] if kind == 0 else max(old, value1[m])
            predicted[n + m] = self._bounded(m, new)

        # stage 2
        self._evaluate([*predicted, *row], first=False)
        g2 = self._conductances()
        heat2 = self._sources()
        value2 = self._memory_values()
        flow2 = [
            g2[k] * (predicted[link_a[k]] - predicted[link_b[k]])
            for k in range(self.links)
        ]
        rhs = self._balance(flow2, heat2)
        for i in range(n):
            rhs[i] -= 2.0 * (capacity[i] * x1[i])
        x2 = self._solve(rhs, g, sign=-1.0)
        half = 0.5 * dt
        for k in range(self.links):
            energy2 = flow2[k] + gdt * (g[k] * (x2[link_a[k]] - x2[link_b[k]]))
            ledger[k] += half * (energy1[k] + energy2)
        for k, (first, second) in enumerate(zip(heat, heat2, strict=True)):
            ledger[self.links + k] += half * (first + second)
        for i in range(n):
            state[i] = (
                predicted[i]
                if fixed[i]
                else self._heated(
                    i,
                    state[i],
                    base[i],
                    capacity[i],
                    dt * (1.5 * x1[i] + 0.5 * x2[i]),
                )
            )
        for m, kind in enumerate(memory_kind):
            old = state[n + m]
            new = (
                old + half * (value1[m] + value2[m])
                if kind == 0
                else max(old, value2[m])
            )
            state[n + m] = self._bounded(m, new)

    def _fix(self, state: Sequence[float], row: Sequence[float]) -> None:
        """Decide per node whether its input fixes it in this step."""
        free = self.s.section["node_free"]
        for i, channel in enumerate(self.s.section["node_input"]):
            target = row[channel] if channel >= 0 else float("nan")
            gone = isnan(target)
            self.fixed[i] = not gone or not free[i]
            self.rate[i] = 0.0 if gone else (target - state[i]) / self.dt

    def _evaluate(self, slots: Sequence[float], *, first: bool) -> None:
        section = self.s.section
        value = self.factor_value
        tables = section["factor_table"]
        for j, kind in enumerate(section["factor_kind"]):
            if not first and section["factor_steady"][j]:
                continue
            a = slots[section["factor_a"][j]]
            b = slots[section["factor_b"][j]]
            if kind == 0:
                x = a
            elif kind == 1:
                x = a - b
            elif kind == 2:
                x = 0.5 * (a + b)
            else:
                x = (a * a + b * b) * (a + b)
            value[j] = x if tables[j] < 0 else self._look_up(tables[j], x)

    def _look_up(self, table: int, x: float) -> float:
        f = self.f
        offset = self.s.section["table_offset"][table]
        last = self.s.section["table_points"][table] - 1
        position = (x - f[offset]) * f[offset + 1]
        if not position > 0.0:
            position = 0.0
        position = min(position, float(last))
        index = min(int(position), last - 1)
        left = f[offset + 2 + index]
        right = f[offset + 3 + index]
        return left + (position - index) * (right - left)

    def _product(self, part: int, constant: float) -> float:
        for factor in self.s.uses[part]:
            constant *= self.factor_value[factor]
        return constant

    def _own_table(self, node: int, temperature_k: float) -> float:
        table = self.s.section["node_table"][node]
        return 1.0 if table < 0 else self._look_up(table, temperature_k)

    def _conductances(self) -> list[float]:
        n = self.nodes
        return [self._product(n + k, self.f[n + k]) for k in range(self.links)]

    def _sources(self) -> list[float]:
        first = self.nodes + self.links
        return [
            self._product(first + k, self.f[first + k])
            for k in range(self.s.count["sources"])
        ]

    def _memory_values(self) -> list[float]:
        first = self.nodes + self.links + self.s.count["sources"]
        return [
            self._product(first + m, self.f[first + 3 * m])
            for m in range(self.s.count["memories"])
        ]

    def _bounded(self, memory: int, new: float) -> float:
        first = self.nodes + self.links + self.s.count["sources"]
        lower = self.f[first + 3 * memory + 1]
        upper = self.f[first + 3 * memory + 2]
        return min(max(new, lower), upper)

    def _balance(
        self, flow: Sequence[float], heat: Sequence[float]
    ) -> list[float]:
        section = self.s.section
        net = [0.0] * self.nodes
        for k, q in enumerate(flow):
            net[section["link_a"][k]] -= q
            net[section["link_b"][k]] += q
        for k, node in enumerate(section["source_node"]):
            net[node] += heat[k]
        return net

    def _factorise(
        self, capacity: Sequence[float], g: Sequence[float]
    ) -> None:
        section = self.s.section
        d, off, fixed = self.diagonal, self.off, self.fixed
        d[:] = capacity
        off[:] = [0.0] * len(off)
        for k, conductance in enumerate(g):
            a, b = section["link_a"][k], section["link_b"][k]
            c = self.gdt * conductance
            d[a] += c
            d[b] += c
            entry = section["link_entry"][k]
            if entry >= 0 and not fixed[a] and not fixed[b]:
                off[entry] -= c
        for i in range(self.nodes):
            if fixed[i]:
                d[i] = 1.0
        # LDL^T: an entry holds L * D until its pivot's operations are done
        operation = section["pivot_operation_start"]
        start = section["pivot_entry_start"]
        for p, node in enumerate(section["pivot_node"]):
            # an algebraic node that nothing touches now stays as it is
            inverse = 0.0 if d[node] == 0.0 else 1.0 / d[node]
            for o in range(operation[p], operation[p + 1]):
                amount = (
                    off[section["operation_left"][o]]
                    * inverse
                    * off[section["operation_right"][o]]
                )
                target = section["operation_target"][o]
                if target >= 0:
                    off[target] -= amount
                else:
                    d[-1 - target] -= amount
            for e in range(start[p], start[p + 1]):
                off[e] *= inverse
            d[node] = inverse

    def _solve(
        self, rhs: list[float], g: Sequence[float], sign: float
    ) -> list[float]:
        section = self.s.section
        d, off, fixed, rate = self.diagonal, self.off, self.fixed, self.rate
        for k, conductance in enumerate(g):
            a, b = section["link_a"][k], section["link_b"][k]
            c = self.gdt * conductance * sign
            if fixed[b]:
                rhs[a] += c * rate[b]
            if fixed[a]:
                rhs[b] += c * rate[a]
        for i in range(self.nodes):
            if fixed[i]:
                rhs[i] = sign * rate[i]
        start, row = section["pivot_entry_start"], section["entry_row"]
        pivots = section["pivot_node"]
        for p, node in enumerate(pivots):
            known = rhs[node]
            for e in range(start[p], start[p + 1]):
                rhs[row[e]] -= off[e] * known
        for p in range(len(pivots) - 1, -1, -1):
            node = pivots[p]
            x = rhs[node] * d[node]
            for e in range(start[p], start[p + 1]):
                x -= off[e] * rhs[row[e]]
            rhs[node] = x
        return rhs

    def _heated(  # noqa: C901, PLR0912  (one walk, line by line as in C)
        self, node: int, t: float, base: float, capacity: float, rise: float
    ) -> float:
        """Temperature after the heat ``capacity * rise`` [J] has entered.

        Walks the capacity table cell by cell, because inside a cell the
        capacity is linear in temperature and the heat has a closed form.
        """
        table = self.s.section["node_table"][node]
        if table < 0 or not base > 0.0:
            return t + rise
        f = self.f
        offset = self.s.section["table_offset"][table] + 2
        last = self.s.section["table_points"][table] - 1
        x0, inverse_dx = f[offset - 2], f[offset - 1]
        heat = capacity * rise / base
        if isnan(t + heat):
            return t + heat
        position = (t - x0) * inverse_dx
        up = heat > 0.0
        if position <= 0.0:
            cell = -1
        elif position >= last:
            cell = last
        else:
            cell = int(position)
            if not up and position == cell:
                cell -= 1
        while True:
            if cell < 0:
                c = f[offset]
                if not up or heat <= c * (x0 - t):
                    return t + heat / c
                heat -= c * (x0 - t)
                t = x0
                cell = 0
            elif cell >= last:
                c = f[offset + last]
                edge = x0 + last / inverse_dx
                if up or heat >= c * (edge - t):
                    return t + heat / c
                heat -= c * (edge - t)
                t = edge
                cell = last - 1
            else:
                slope = (f[offset + cell + 1] - f[offset + cell]) * inverse_dx
                left = x0 + cell / inverse_dx
                c = f[offset + cell] + (t - left) * slope
                edge = x0 + (cell + 1) / inverse_dx if up else left
                to_edge = (c + 0.5 * slope * (edge - t)) * (edge - t)
                inside = heat <= to_edge if up else heat >= to_edge
                if inside:
                    return t + 2.0 * heat / (
                        c + sqrt(c * c + 2.0 * slope * heat)
                    )
                heat -= to_edge
                t = edge
                cell += 1 if up else -1

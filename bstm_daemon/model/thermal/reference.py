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

The order of operations is that of ``native/thermal/march.c``, line by line.
"""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence
from itertools import pairwise
from math import isnan, sqrt
from typing import Final

from bstm_daemon.model.thermal.program import COUNTS, SECTIONS

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
        self.uses = [tuple(uses[a:b]) for a, b in pairwise(starts)]
        self._lay_out()

    def _lay_out(self) -> None:
        """Put side by side what a step needs at the same time.

        Tables are pairs (place of the first number, last point), the place
        -1 where there is none.
        """
        count, section = self.count, self.section
        tables = [
            (offset, points - 1)
            for offset, points in zip(
                section["table_offset"], section["table_points"], strict=True
            )
        ]
        tables.append((-1, 0))
        self.factors = [
            (j, kind, first, second, *tables[table])
            for j, (kind, first, second, table) in enumerate(
                zip(
                    *(section["factor_kind"], section["factor_a"]),
                    *(section["factor_b"], section["factor_table"]),
                    strict=True,
                )
            )
        ]
        steady = section["factor_steady"]
        self.changing = [row for row in self.factors if not steady[row[0]]]
        self.node_tables = [tables[table] for table in section["node_table"]]
        places = range(count["nodes"] + count["links"] + count["sources"])
        products = list(zip(places, self.uses, strict=False))
        ends = (count["nodes"], count["nodes"] + count["links"])
        self.node_products = products[: ends[0]]
        self.link_products = products[ends[0] : ends[1]]
        self.source_products = products[ends[1] :]
        self.memory_products = [
            (len(products) + 3 * m, uses)
            for m, uses in enumerate(self.uses[len(products) :])
        ]
        self.ends = list(
            zip(section["link_a"], section["link_b"], strict=True)
        )
        operations = list(
            zip(
                section["operation_left"],
                section["operation_right"],
                section["operation_target"],
                strict=True,
            )
        )
        self.pivots = [
            (node, operations[o1:o2], range(e1, e2))
            for node, (o1, o2), (e1, e2) in zip(
                section["pivot_node"],
                pairwise(section["pivot_operation_start"]),
                pairwise(section["pivot_entry_start"]),
                strict=True,
            )
        ]
        rows = list(enumerate(section["entry_row"]))
        self.columns = [
            (node, rows[entries.start : entries.stop])
            for node, _, entries in self.pivots
        ]


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
        s, n, dt, gdt = self.s, self.nodes, self.dt, self.gdt
        ends = s.ends
        memory_kind = s.section["memory_kind"]
        self._fix(state, row)
        fixed, rate = self.fixed, self.rate

        # stage 1
        self._evaluate(s.factors, [*state, *row])
        base = self._products(s.node_products)
        capacity = [
            base[i] * self._look_up(offset, last, state[i])
            if offset >= 0
            else base[i]
            for i, (offset, last) in enumerate(s.node_tables)
        ]
        g = self._products(s.link_products)
        heat = self._products(s.source_products)
        value1 = self._products(s.memory_products)
        flow = [
            one * (state[a] - state[b])
            for one, (a, b) in zip(g, ends, strict=True)
        ]
        rhs = self._balance(flow, heat)
        self._factorise(capacity, g)
        x1 = self._solve(rhs, g, sign=1.0)
        energy1 = [
            q + gdt * (one * (x1[a] - x1[b]))
            for q, one, (a, b) in zip(flow, g, ends, strict=True)
        ]
        predicted = [
            state[i] + dt * rate[i]
            if fixed[i]
            else self._heated(i, state[i], base[i], capacity[i], dt * x1[i])
            for i in range(n)
        ]
        for m, kind in enumerate(memory_kind):
            old = state[n + m]
            new = old + dt * value1[m] if kind == 0 else max(old, value1[m])
            predicted.append(self._bounded(m, new))

        # stage 2
        self._evaluate(s.changing, [*predicted, *row])
        g2 = self._products(s.link_products)
        heat2 = self._products(s.source_products)
        value2 = self._products(s.memory_products)
        flow2 = [
            one * (predicted[a] - predicted[b])
            for one, (a, b) in zip(g2, ends, strict=True)
        ]
        rhs = self._balance(flow2, heat2)
        for i in range(n):
            rhs[i] -= 2.0 * (capacity[i] * x1[i])
        x2 = self._solve(rhs, g, sign=-1.0)
        half = 0.5 * dt
        for k, (a, b) in enumerate(ends):
            energy2 = flow2[k] + gdt * (g[k] * (x2[a] - x2[b]))
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

    def _evaluate(
        self,
        factors: Sequence[tuple[int, int, int, int, int, int]],
        slots: Sequence[float],
    ) -> None:
        value, look_up = self.factor_value, self._look_up
        for j, kind, first, second, offset, last in factors:
            x = slots[first]
            if kind == 1:
                x -= slots[second]
            elif kind == 2:
                x = 0.5 * (x + slots[second])
            elif kind:
                b = slots[second]
                x = (x * x + b * b) * (x + b)
            value[j] = x if offset < 0 else look_up(offset, last, x)

    def _look_up(self, offset: int, last: int, x: float) -> float:
        f = self.f
        position = (x - f[offset]) * f[offset + 1]
        if not position > 0.0:
            position = 0.0
        if position >= last:
            position = float(last)
            index = last - 1
        else:
            index = int(position)
        left = f[offset + 2 + index]
        return left + (position - index) * (f[offset + 3 + index] - left)

    def _products(
        self, parts: Sequence[tuple[int, tuple[int, ...]]]
    ) -> list[float]:
        """Return the constant of each part times its factors."""
        f, value = self.f, self.factor_value
        found = []
        for place, factors in parts:
            product = f[place]
            for factor in factors:
                product *= value[factor]
            found.append(product)
        return found

    def _bounded(self, memory: int, new: float) -> float:
        first = self.nodes + self.links + self.s.count["sources"]
        lower = self.f[first + 3 * memory + 1]
        upper = self.f[first + 3 * memory + 2]
        return min(max(new, lower), upper)

    def _balance(
        self, flow: Sequence[float], heat: Sequence[float]
    ) -> list[float]:
        net = [0.0] * self.nodes
        for q, (a, b) in zip(flow, self.s.ends, strict=True):
            net[a] -= q
            net[b] += q
        for node, power in zip(
            self.s.section["source_node"], heat, strict=True
        ):
            net[node] += power
        return net

    def _factorise(
        self, capacity: Sequence[float], g: Sequence[float]
    ) -> None:
        d, off, fixed, gdt = self.diagonal, self.off, self.fixed, self.gdt
        d[:] = capacity
        off[:] = [0.0] * len(off)
        for conductance, (a, b), entry in zip(
            g, self.s.ends, self.s.section["link_entry"], strict=True
        ):
            c = gdt * conductance
            d[a] += c
            d[b] += c
            if entry >= 0 and not fixed[a] and not fixed[b]:
                off[entry] -= c
        for i in range(self.nodes):
            if fixed[i]:
                d[i] = 1.0
        # LDL^T: an entry holds L * D until its pivot's operations are done
        for node, operations, entries in self.s.pivots:
            # an algebraic node that nothing touches now stays as it is
            inverse = 0.0 if d[node] == 0.0 else 1.0 / d[node]
            for left, right, target in operations:
                amount = off[left] * inverse * off[right]
                if target >= 0:
                    off[target] -= amount
                else:
                    d[-1 - target] -= amount
            for e in entries:
                off[e] *= inverse
            d[node] = inverse

    def _solve(
        self, rhs: list[float], g: Sequence[float], sign: float
    ) -> list[float]:
        d, off = self.diagonal, self.off
        if any(self.fixed):
            self._ramp(rhs, g, sign)
        columns = self.s.columns
        for node, entries in columns:
            known = rhs[node]
            for e, row in entries:
                rhs[row] -= off[e] * known
        for node, entries in reversed(columns):
            x = rhs[node] * d[node]
            for e, row in entries:
                x -= off[e] * rhs[row]
            rhs[node] = x
        return rhs

    def _ramp(self, rhs: list[float], g: Sequence[float], sign: float) -> None:
        """Let fixed nodes follow their inputs, and their neighbours them."""
        fixed, rate = self.fixed, self.rate
        for conductance, (a, b) in zip(g, self.s.ends, strict=True):
            c = self.gdt * conductance * sign
            if fixed[b]:
                rhs[a] += c * rate[b]
            if fixed[a]:
                rhs[b] += c * rate[a]
        for i in range(self.nodes):
            if fixed[i]:
                rhs[i] = sign * rate[i]

    def _heated(  # noqa: C901, PLR0912  (one walk, line by line as in C)
        self, node: int, t: float, base: float, capacity: float, rise: float
    ) -> float:
        """Temperature after the heat ``capacity * rise`` [J] has entered.

        Walks the capacity table cell by cell, because inside a cell the
        capacity is linear in temperature and the heat has a closed form.
        """
        offset, last = self.s.node_tables[node]
        if offset < 0 or not base > 0.0:
            return t + rise
        f = self.f
        offset += 2
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

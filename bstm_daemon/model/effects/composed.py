"""Composed effects: the grammar of heat paths that no catalogue has.

A term is a path and at most :data:`MOST_CLAUSES` clauses, each a form of a
driver, in the words of ``_data/composed.toml``: ``disc to air, driving, above
300 degC``. It is a parameter of ``[[effect]] name = "composed"``: the words
are its key, the size its value. Every form is between 0 and 1, so the size is
what the path has at most. A term becomes links, sources and memories of the
network, which live service and replay evaluate like any other effect's.

Signs: a new conductance is never below 0; a share of conductances or of the
brake heat takes away no more than all; a source has a cause (driving, speed,
pressure, time), and a sink is where its node is hot.
"""

from __future__ import annotations

import re
import tomllib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Final, Literal

from bstm_daemon.model.effects.effect import LAST, STRENGTH, Effect
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.thermal.network import (
    Factor,
    Link,
    Memory,
    Node,
    Source,
    difference,
    value,
    with_factors,
)
from bstm_daemon.model.thermal.table import Table

NAME: Final = "composed"
PREFIX: Final = f"{NAME}."
"""Of the name of a term as a candidate of the gap search."""

MOST_CLAUSES: Final = 2
NUMBERS: Final = 3.0
"""A number in words may be so many times beyond those that a search tries."""

Kind = Literal["link", "share", "source", "heat", "carried", "mass"]

SIZES: Final[dict[Kind, tuple[str, float, float]]] = {
    "link": ("W/K", 0.0, 500.0),
    "share": ("1", -1.0, 10.0),
    "source": ("W", -2e4, 2e4),
    "heat": ("1", -1.0, 2.0),
    "carried": ("W/K", 0.0, 20.0),
    "mass": ("W/K", 0.0, 100.0),
}
"""Unit and bounds of a size, by what kind of path it is of."""

AIR: Final = "air"
CAUSES: Final = frozenset({"speed", "pressure", "time"})
UNIT: Final = Table(0.0, 1.0, (0.0, 1.0))
WITH_SPEED: Final = Table(0.0, 40.0, (0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Form:
    """A form of a driver, as a row of ``_data/composed.toml``."""

    words: str
    driver: str
    over: str = ""
    x: Sequence[float] = (0.0, 1.0)
    y: Sequence[float] = (0.0, 1.0)
    scale: float = 0.0
    grid: Sequence[float] = (0.0,)
    also: str = ""
    memory: Literal["", "follows", "adds", "latches"] = ""

    def read(self, text: str) -> float | None:
        """Return the number in *text*, 0 if it has none; None if not it."""
        pattern = re.escape(self.words).replace(r"\{\}", r"(\d+(?:\.\d+)?)")
        found = re.fullmatch(pattern, text)
        if found is None:
            return None
        return float(found[1]) if found.groups() else 0.0

    def factors(self, node: str, number: float) -> tuple[Factor, ...]:
        """Return it of *node*, and what it is also of."""
        if self.memory:
            return (value(self.recalled(node, number)[0].name, UNIT),)
        also = FORMS[self.also].factors(node, 0.0) if self.also else ()
        return (*self._own(node, number), *also)

    def recalled(self, node: str, number: float) -> tuple[Memory, ...]:
        """Return what it looks back by, if it does."""
        words = self.words.format(f"{number:g}")
        name = re.sub(r"\W+", "_", f"{NAME} {node} {words}")
        if self.memory == "follows":
            table = Table.from_points(self.x, self.y)
            apart = (difference(self.over, name, table),)
            return (Memory(name, "integral", 1.0 / number, apart),)
        if self.memory == "adds":
            rate = 1e-6 / number
            return (Memory(name, "integral", rate, (value(self.over),)),)
        if self.memory == "latches":
            return (Memory(name, "latch", 1.0, self._own(node, number)),)
        return ()

    def _own(self, node: str, number: float) -> tuple[Factor, ...]:
        x = [one + self.scale * number for one in self.x]
        return (value(self.over or node, Table.from_points(x, self.y)),)


@dataclass(frozen=True, slots=True)
class Path:
    """Where a term's heat goes, as a row of ``_data/composed.toml``.

    ``size`` is the one that a search begins at.
    """

    text: str
    kind: Kind
    size: float
    a: str
    b: str = ""
    seconds: float = 0.0


GRAMMAR: Final = tomllib.loads(
    (FilePath(__file__).parent / "_data" / "composed.toml").read_text("utf-8")
)
FORMS: Final = {k: Form(k, **row) for k, row in GRAMMAR["form"].items()}
PATHS: Final = {k: Path(k, **row) for k, row in GRAMMAR["path"].items()}


@dataclass(frozen=True, slots=True)
class Term:
    """A path, its clauses, and its size in the path's unit."""

    path: Path
    clauses: tuple[tuple[Form, float], ...] = ()
    size: float = 1.0

    def __str__(self) -> str:
        """Return it in words, without the size."""
        clauses = (form.words.format(f"{n:g}") for form, n in self.clauses)
        return ", ".join((self.path.text, *clauses))

    @property
    def said(self) -> str:
        """The size in words."""
        unit = SIZES[self.path.kind][0]
        if unit == "1":
            more = "less" if self.size < 0.0 else "more"
            return f"{abs(100.0 * self.size):.0f} % {more}"
        return f"{self.size:.3g} {unit}"

    def within(self) -> Term:
        """Return it with a size that its path may have."""
        _, low, high = SIZES[self.path.kind]
        return replace(self, size=min(max(self.size, low), high))

    def problems(self) -> list[str]:
        """Return what physics has against it, a line each."""
        found = []
        unit, low, high = SIZES[self.path.kind]
        if not low <= self.size <= high:
            found.append(f"{self.size:g}: allowed {low:g} to {high:g} {unit}")
        drivers = [form.driver for form, _ in self.clauses]
        if len(set(drivers)) < len(drivers):
            found.append("two clauses on one driver")
        if len(drivers) > MOST_CLAUSES:
            found.append(f"more than {MOST_CLAUSES} clauses")
        for form, number in self.clauses:
            least, most = form.grid[0] / NUMBERS, form.grid[-1] * NUMBERS
            if not least <= number <= most:
                words = form.words.format(f"{number:g}")
                found.append(f"{words!r}: allowed {least:g} to {most:g}")
        if self.path.kind == "mass" and drivers:
            found.append("a mass takes no clause")
        if self.path.kind == "source":
            phases = {form.words for form, _ in self.clauses}
            if self.size < 0.0 and "temperature" not in drivers:
                found.append("a sink needs a temperature from which it acts")
            if not (CAUSES & set(drivers) or phases & {"braking", "driving"}):
                found.append("heat needs a cause: driving, speed, pressure...")
        return found

    def memories(self) -> tuple[Memory, ...]:
        """Return what its forms recall."""
        return tuple(
            memory
            for form, number in self.clauses
            for memory in form.recalled(self.path.a, number)
        )

    def masses(self) -> tuple[Node, ...]:
        """Return the mass beside the node of a ``mass``."""
        if self.path.kind != "mass":
            return ()
        capacity_j_k = max(self.size, 1e-9) * self.path.seconds
        return (Node(self.path.text.replace(" ", "_"), capacity_j_k),)

    def flows(self, model: CornerModel) -> tuple[Link | Source, ...]:
        """Return its heat flows in *model*; none if it has no such path."""
        path, text, size = self.path, str(self), self.size
        own = [
            factor
            for form, number in self.clauses
            for factor in form.factors(path.a, number)
        ]
        a, b = path.a, path.b
        if b == AIR:
            a = model.caliper if a == "fluid" else a
            b = model.surroundings
        if path.kind in {"link", "mass"}:
            b = b or self.masses()[0].name
            return (Link(text, a, b, size, (*own,)),)
        if path.kind == "source":
            return (Source(text, a, size, (*own,)),)
        if path.kind == "carried":
            warm = (difference(a, "ambient"), value("speed_ms", WITH_SPEED))
            return (Source(text, b, size, (*warm, *own)),)
        if path.kind == "heat":
            return tuple(
                replace(
                    with_factors(one, *own),
                    name=f"{text} {one.name}",
                    gain=size * one.gain,
                )
                for one in model.network.sources
                if "brake_power_w" in {factor.a for factor in one.factors}
            )
        return tuple(
            part
            for link in model.network.links
            if {link.a, link.b} == {a, b}
            for part in self._share(with_factors(link, *own))
        )

    def _share(self, link: Link) -> tuple[Link | Source, ...]:
        """Return the size's share of *link*: no link may be below 0."""
        name, w_k = f"{self} {link.name}", self.size * link.conductance_w_k
        if w_k >= 0.0:
            return (replace(link, name=name, conductance_w_k=w_k),)
        factors = (*link.factors, difference(link.a, link.b))
        return (
            Source(name, link.a, -w_k, factors),
            Source(f"{name} to {link.b}", link.b, w_k, factors),
        )

    def edit(self, model: CornerModel) -> CornerModel:
        """Return *model* with the term in it.

        Raises:
            ValueError: the corner has no such path.
        """
        flows = self.flows(model)
        if not flows:
            msg = f"no {self.path.text} in this structure"
            raise ValueError(msg)
        net = model.network
        there = {one.name for one in net.memories}
        return model.with_network(
            net.with_memory(
                *(one for one in self.memories() if one.name not in there)
            )
            .with_node(*self.masses())
            .with_link(*(one for one in flows if isinstance(one, Link)))
            .with_source(*(one for one in flows if isinstance(one, Source)))
        )


def read(text: str, size: float = 1.0) -> Term:
    """Return the term that *text* says, of *size*.

    Raises:
        ValueError: words that are not in the grammar.
    """
    first, *rest = text.split(", ")
    if first not in PATHS:
        msg = f"no path {first!r}; there are: {', '.join(PATHS)}"
        raise ValueError(msg)
    clauses = []
    for words in rest:
        found = [(form, form.read(words)) for form in FORMS.values()]
        clauses += [(form, n) for form, n in found if n is not None]
        if all(number is None for _, number in found):
            msg = f"no clause {words!r}; there are: {', '.join(FORMS)}"
            raise ValueError(msg)
    return Term(PATHS[first], tuple(clauses), size)


def bounded(sizes: Mapping[str, float]) -> dict[str, float]:
    """Return *sizes* by term, those of a path taking no more than there is."""
    taken: dict[str, float] = defaultdict(float)
    for text, size in sizes.items():
        taken[read(text).path.text] += min(size, 0.0)
    found = {}
    for text, size in sizes.items():
        path = read(text).path
        most, all_of = SIZES[path.kind][1], taken[path.text]
        over = size < 0.0 and all_of < most
        # the sum may not round to more than there is
        found[text] = size * (1.0 - 1e-12) * most / all_of if over else size
    return found


def is_composed(name: str) -> bool:
    """Whether the candidate *name* is a composed term."""
    return name.startswith(PREFIX)


class Composed(Effect):
    """Terms of the grammar as parameters: ``{"disc to air, wet" = 3.0}``."""

    number = 0
    description = "A heat path that no effect of the catalogue describes."
    signature = "What its terms say."
    stage = LAST + 1

    def __init__(self, values: Mapping[str, float]) -> None:
        """Take the strength, and sizes by term.

        Raises:
            ValueError: words that are no term, or a size that is none.
        """
        strength = values.get(STRENGTH.name, 1.0)
        super().__init__({STRENGTH.name: strength})
        if problems := self.problems(values):
            raise ValueError("\n".join(problems))
        self.terms = tuple(
            read(text, size * strength)
            for text, size in values.items()
            if text != STRENGTH.name
        )

    @classmethod
    def problems(cls, values: Mapping[str, float]) -> list[str]:
        """What is wrong with *values*: a line per term."""
        strength = values.get(STRENGTH.name, 1.0)
        found = super().problems({STRENGTH.name: strength})
        taken: dict[str, float] = defaultdict(float)
        for text, size in values.items():
            if text == STRENGTH.name:
                continue
            try:
                term = read(text, size * strength)
            except ValueError as error:
                found.append(f"parameters.'{text}': {error}")
                continue
            taken[term.path.text] += min(term.size, 0.0)
            problems = term.problems()
            if taken[term.path.text] < SIZES[term.path.kind][1]:
                problems = problems or ["the terms take away more than all"]
            found += [f"parameters.'{text}': {one}" for one in problems]
        return found

    def edit(self, model: CornerModel) -> CornerModel:
        """Edit one corner, term by term."""
        for term in self.terms:
            model = term.edit(model)
        return model

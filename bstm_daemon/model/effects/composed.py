"""Composed effects: the grammar of heat paths that no catalogue has.

A term is a path and at most :data:`MOST_CLAUSES` clauses, each a driver and a
form, in words: ``disc to air, driving, above 300 degC``. It is a parameter of
``[[effect]] name = "composed"``: the words are its key, the size its value.
Every form is between 0 and 1, so the size is what the path has at most. A
term becomes links, sources and memories of the network, which live service
and replay evaluate like those of any other effect.

Signs: a new conductance is never below 0; a share of conductances or of the
brake heat takes away no more than all; a source has a cause (driving, speed,
pressure, time), and a sink is where its node is hot.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

from bstm_daemon.model.effects.effect import LAST, STRENGTH, Effect
from bstm_daemon.model.effects.tables import RELEASED, ROOM_K
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
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bstm_daemon.model.effects.model import CornerModel

    Factors = Callable[[str, float], tuple[Factor, ...]]

NAME: Final = "composed"
PREFIX: Final = f"{NAME}."
"""Of the name of a term as a candidate of the gap search."""

MOST_CLAUSES: Final = 2
NUMBERS: Final = 3.0
"""A number in words may be so many times beyond those that a search tries."""

Driver = Literal["phase", "temperature", "speed", "pressure", "time", "energy"]
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

FASTEST_MS: Final = 40.0
HOT_K: Final = 600.0 + KELVIN_OFFSET
KMH: Final = 1.0 / 3.6


def _radiated(k: float) -> float:
    """Return the conductance of radiation to a room, 0 there and 1 hot."""
    room, k, hot = (
        (t * t + ROOM_K * ROOM_K) * (t + ROOM_K) for t in (ROOM_K, k, HOT_K)
    )
    return (k - room) / (hot - room)


UNIT: Final = Table(0.0, 1.0, (0.0, 1.0))
MOVING: Final = Table(0.5, 1.0, (0.0, 1.0))
STANDING: Final = Table(0.5, 1.0, (1.0, 0.0))
WITH_SPEED: Final = Table(0.0, FASTEST_MS, (0.0, 1.0))
ROOT_OF_SPEED: Final = Table.from_function(
    lambda v: (v / FASTEST_MS) ** 0.5, 0.0, FASTEST_MS, 81
)
AGAINST_SPEED: Final = Table.from_function(
    lambda v: 1.0 / (1.0 + v / 8.0), 0.0, 3.0 * FASTEST_MS, 241
)
RADIATION: Final = Table.from_function(
    lambda k: (
        (_radiated(k) - _radiated(ROOM_K))
        / (_radiated(HOT_K) - _radiated(ROOM_K))
    ),
    ROOM_K,
    HOT_K,
    101,
)


def _on(slot: str, table: Table) -> Factors:
    """Return *table* of *slot*, "" for the temperature of the node."""
    return lambda node, _: (value(slot or node, table),)


def _from(slot: str, width: float, scale: float = 1.0) -> Factors:
    """Return what rises from 0 at the number to 1 at *width* beyond it."""
    offset = 0.0 if slot else KELVIN_OFFSET

    def factors(node: str, number: float) -> tuple[Factor, ...]:
        ramp = Table(number * scale + offset, width, (0.0, 1.0))
        return (value(slot or node, ramp),)

    return factors


def _since_braking(_node: str, seconds: float) -> Memory:
    name = f"composed_braked_{seconds:g}_s"
    rate = 1.0 / seconds
    return Memory(name, "integral", rate, (difference("brake_on", name),))


def _braked(_node: str, megajoules: float) -> Memory:
    name = f"composed_braked_{megajoules:g}_mj"
    power = (value("brake_power_w"),)
    return Memory(name, "integral", 1e-6 / megajoules, power)


def _once(node: str, celsius: float) -> Memory:
    name = f"composed_{node}_once_{celsius:g}_c"
    return Memory(name, "latch", 1.0, _from("", 20.0)(node, celsius))


@dataclass(frozen=True, slots=True)
class Form:
    """A form of a driver, 0 to 1.

    ``words`` may hold a number; ``grid`` are those that a search tries.
    ``factors`` are of a node's name and the number, or ``memory`` is, which
    looks back.
    """

    words: str
    driver: Driver
    factors: Factors | None = None
    grid: tuple[float, ...] = (0.0,)
    memory: Callable[[str, float], Memory] | None = None

    def read(self, text: str) -> float | None:
        """Return the number in *text*, 0 if it has none; None if not it."""
        pattern = re.escape(self.words).replace(r"\{\}", r"(\d+(?:\.\d+)?)")
        found = re.fullmatch(pattern, text)
        if found is None:
            return None
        return float(found[1]) if found.groups() else 0.0


FORMS: Final = (
    Form("braking", "phase", _on("brake_on", UNIT)),
    Form(
        "driving",
        "phase",
        lambda *_: (value("speed_ms", MOVING), value("brake_on", RELEASED)),
    ),
    Form("parked", "phase", _on("speed_ms", STANDING)),
    Form("brake off", "phase", _on("brake_on", RELEASED)),
    Form("wet", "phase", _on("wetness", UNIT)),
    Form(
        *("above {} degC", "temperature", _from("", 20.0)),
        (100.0, 150.0, 200.0, 300.0, 400.0, 500.0, 600.0),
    ),
    Form(
        *("rising from {} degC", "temperature", _from("", 300.0)),
        (20.0, 100.0, 200.0, 300.0, 400.0),
    ),
    Form("like radiation", "temperature", _on("", RADIATION)),
    Form("rising with speed", "speed", _on("speed_ms", WITH_SPEED)),
    Form("with the root of speed", "speed", _on("speed_ms", ROOT_OF_SPEED)),
    Form("falling with speed", "speed", _on("speed_ms", AGAINST_SPEED)),
    Form(
        *("above {} km/h", "speed", _from("speed_ms", 2.0, KMH)),
        (30.0, 60.0, 90.0, 120.0),
    ),
    Form(
        "rising with pressure",
        "pressure",
        _on("pressure_pa", Table(0.0, 6e6, (0.0, 1.0))),
    ),
    Form(
        *("above {} bar", "pressure", _from("pressure_pa", 2e5, 1e5)),
        (5.0, 20.0),
    ),
    Form(
        *("fading within {} s after braking", "time", None, (60.0, 400.0)),
        _since_braking,
    ),
    Form(
        *("rising until {} MJ of braking", "energy", None, (3.0, 15.0)),
        _braked,
    ),
    Form(*("once above {} degC", "energy", None, (200.0, 350.0)), _once),
)

CAUSES: Final = frozenset({"speed", "pressure", "time"})
AIR: Final = "air"


@dataclass(frozen=True, slots=True)
class Path:
    """Where a term's heat goes, as ``text`` says.

    ``link``: a further conductance a to b. ``share``: of the conductances
    there are between them. ``source``: heat into a. ``heat``: share of the
    brake heat. ``carried``: air that a has warmed brings its excess to b, as
    far as the car's speed drives it. ``mass``: a has a mass beside it that
    follows within ``seconds``. ``typical`` is the size that a search begins
    at.
    """

    text: str
    kind: Kind
    typical: float
    a: str
    b: str = ""
    seconds: int = 0


PATHS: Final = {
    path.text: path
    for path in (
        Path("disc to air", "link", 5.0, "disc", AIR),
        Path("pad_front to air", "link", 1.0, "pad_front", AIR),
        Path("pad_back to air", "link", 0.4, "pad_back", AIR),
        Path("fluid to air", "link", 0.5, "fluid", AIR),
        Path("disc to pad_front", "link", 3.0, "disc", "pad_front"),
        Path("disc to pad_back", "link", 0.3, "disc", "pad_back"),
        Path("disc to fluid", "link", 0.3, "disc", "fluid"),
        Path("pad_back to fluid", "link", 0.5, "pad_back", "fluid"),
        Path("share of disc to air", "share", 0.3, "disc", AIR),
        Path("share of fluid to air", "share", 0.3, "fluid", AIR),
        Path("share of disc to pad_front", "share", 0.3, "disc", "pad_front"),
        Path(
            "share of backplate to fluid", "share", 0.3, "backplate", "fluid"
        ),
        Path("disc by air to pad_back", "carried", 0.2, "disc", "pad_back"),
        Path("disc by air to fluid", "carried", 0.2, "disc", "fluid"),
        Path("heat at disc", "source", 300.0, "disc"),
        Path("heat at pad_front", "source", 100.0, "pad_front"),
        Path("heat at pad_back", "source", 40.0, "pad_back"),
        Path("heat at fluid", "source", 30.0, "fluid"),
        Path("share of the brake heat", "heat", 0.1, "disc"),
        *(
            Path(f"{node} to a mass within {s} s", "mass", w_k, node, "", s)
            for node, w_k in (("disc", 1.0), ("pad_back", 0.3), ("fluid", 0.3))
            for s in (120, 1500)
        ),
    )
}


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
            form.memory(self.path.a, number)
            for form, number in self.clauses
            if form.memory is not None
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
        own = [value(one.name, UNIT) for one in self.memories()]
        for form, number in self.clauses:
            if form.factors is not None:
                own += form.factors(path.a, number)
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
        found = [(form, form.read(words)) for form in FORMS]
        clauses += [(form, n) for form, n in found if n is not None]
        if all(number is None for _, number in found):
            known = ", ".join(form.words for form in FORMS)
            msg = f"no clause {words!r}; there are: {known}"
            raise ValueError(msg)
    return Term(PATHS[first], tuple(clauses), size)


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
        for text, size in values.items():
            if text == STRENGTH.name:
                continue
            try:
                problems = read(text, size * strength).problems()
            except ValueError as error:
                problems = [str(error)]
            found += [f"parameters.'{text}': {one}" for one in problems]
        return found

    def edit(self, model: CornerModel) -> CornerModel:
        """Edit one corner, term by term."""
        for term in self.terms:
            model = term.edit(model)
        return model

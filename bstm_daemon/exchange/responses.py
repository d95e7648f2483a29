"""How the numbers of a compiled network follow its tunables.

An exported model has no Python that builds its network, so what a tunable
does to each number is found here, by building it at other values: the number
is multiplied by ``(1 + b d) / (1 + c d)``, where d is how far the tunable is
from its configured value. That covers every number that is proportional to
the tunable or to its inverse, and the exchange of two grey plates. A tunable
that acts otherwise is left out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.analysis.matching.effect_values import split_key
from bstm_daemon.analysis.matching.tunables import (
    BEYOND_MS,
    DRAG,
    EFFECT,
    S_SPEEDS_MS,
    SIDES,
    TUNABLES,
    Target,
    usable,
)
from bstm_daemon.config.schema import meanings
from bstm_daemon.config.section import Section
from bstm_daemon.config.sections import Config
from bstm_daemon.config.thermal import CoolingConfig, ThermalConfig
from bstm_daemon.errors import BstmError
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.model.effects.catalogue import effect_class

TOLERANCE: Final = 1e-9
"""Largest error of a response, relative, alone and with others."""

LEFT_OUT: Final = (DRAG, *S_SPEEDS_MS, *BEYOND_MS, *SIDES)
"""No value of the corner; the S-table as a whole has a factor."""

COMBINATIONS: Final = 3


@dataclass(frozen=True, slots=True)
class Response:
    """A tunable and the numbers that follow it: (place, b, c) each."""

    key: str
    start: float
    lower: float
    upper: float
    unit: str
    description: str
    numbers: tuple[tuple[int, float, float], ...]

    def factors(self, value: float, count: int) -> npt.NDArray[np.float64]:
        """Return the factors on all *count* numbers at *value*."""
        found = np.ones(count)
        d = value - self.start
        for place, b, c in self.numbers:
            found[place] = (1.0 + b * d) / (1.0 + c * d)
        return found


def responses(config: Config, corner: str) -> list[Response]:
    """Return the tunables of *corner* that an exported model can have.

    Raises:
        ConfigError: the corner can not be built.
    """
    target = Target(config, (corner,))
    nominal = _Numbers(target)
    random = np.random.default_rng(1)
    accepted: list[Response] = []
    keys = [key for key in TUNABLES if key not in LEFT_OUT]
    for key in usable(target, keys)[0]:
        found = _response(target, nominal, key)
        if found is not None and _agree(nominal, [*accepted, found], random):
            accepted.append(found)
    return accepted


class _Numbers:
    """The numbers of a target's network, at the values of tunables."""

    def __init__(self, target: Target) -> None:
        self.target = target
        self.program = compile_corner(target.config, target.corner)
        self.floats = np.array(self.program.floats)

    def at(
        self, values: Mapping[str, float]
    ) -> npt.NDArray[np.float64] | None:
        """Return the numbers, None where it is another structure."""
        try:
            changed = self.target.changed(dict(values))
            program = compile_corner(changed.config, changed.corner)
        except (BstmError, ValueError):
            return None
        same = program.ints == self.program.ints
        return np.array(program.floats) if same else None

    def confirm(
        self, values: Mapping[str, float], factors: npt.NDArray[np.float64]
    ) -> bool:
        """Whether the numbers at *values* are the nominal times *factors*."""
        built = self.at(values)
        return built is not None and np.allclose(
            self.floats * factors, built, rtol=TOLERANCE, atol=0.0
        )


def _response(target: Target, nominal: _Numbers, key: str) -> Response | None:
    one = target.tunable(key)
    start = target.value(one)
    lower, upper = min(one.lower, start), max(one.upper, start)
    d1, d2 = 0.5 * (lower - start), 0.5 * (upper - start)
    if d1 == 0.0 or d2 == 0.0:
        d1, d2 = 0.4 * (lower + upper - 2 * start), 0.5 * (d1 + d2)
    low = nominal.at({key: start + d1})
    high = nominal.at({key: start + d2})
    if low is None or high is None:
        return None
    moved = np.flatnonzero((low != nominal.floats) | (high != nominal.floats))
    base = nominal.floats[moved]
    if not len(moved) or np.any(base == 0.0):
        return None
    r1, r2 = low[moved] / base, high[moved] / base
    if np.any(r1 == r2):
        return None
    slope1, slope2 = (r1 - 1.0) / d1, (r2 - 1.0) / d2
    c = (slope1 - slope2) / (r2 - r1)
    # rounding must not bend what is straight
    c[np.abs(c) * (upper - lower) < TOLERANCE] = 0.0
    b = slope1 + c * r1
    found = Response(
        key,
        start,
        lower,
        upper,
        one.unit,
        _meaning(key),
        tuple(zip(moved.tolist(), b.tolist(), c.tolist(), strict=True)),
    )
    for value in (lower, upper, 0.3 * lower + 0.7 * upper):
        factors = found.factors(value, len(nominal.floats))
        if not nominal.confirm({key: value}, factors):
            return None
    return found


def _agree(
    nominal: _Numbers,
    together: Sequence[Response],
    random: np.random.Generator,
) -> bool:
    """Whether the responses still hold when all are changed at once."""
    for _ in range(COMBINATIONS):
        values = {r.key: random.uniform(r.lower, r.upper) for r in together}
        factors = np.ones(len(nominal.floats))
        for one in together:
            factors *= one.factors(values[one.key], len(factors))
        if not nominal.confirm(values, factors):
            return False
    return True


def _meaning(key: str) -> str:
    section, name = split_key(key)
    if section == EFFECT:
        return effect_class(split_key(name)[0]).description
    models: dict[str, type[Section]] = {
        "thermal": ThermalConfig,
        "cooling": CoolingConfig,
    }
    known = meanings(models[section]) if section in models else {}
    return known.get(name, f"[{section}] {name}")

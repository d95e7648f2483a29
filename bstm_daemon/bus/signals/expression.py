"""Arithmetic over the signals of one frame: parsed, never run as code.

Grammar (blanks between tokens are free)::

    sum     = product {("+" | "-") product}
    product = factor {("*" | "/") factor}
    factor  = ("+" | "-") factor | number | name
            | "(" sum ")" | ("abs" | "min" | "max") "(" sum {"," sum} ")"

A division by zero, and ``min`` or ``max`` of a nan, give nan: no sample.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from bstm_daemon.config import limits

_TOKEN: Final = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign>[-+*/(),]))",
    re.ASCII,
)
_TERMS: Final = ("number", "name")
_FUNCTIONS: Final = {"abs": (1, 1), "min": (2, 8), "max": (2, 8)}


class ExpressionError(ValueError):
    """The text is not an expression; the message names the position."""


@dataclass(frozen=True, slots=True)
class Number:
    """A constant."""

    value: float


@dataclass(frozen=True, slots=True)
class Name:
    """A signal of the frame."""

    name: str


@dataclass(frozen=True, slots=True)
class Apply:
    """An operation (``+ - * / negate abs min max``) on its arguments."""

    operation: str
    arguments: "tuple[Expression, ...]"


Expression = Number | Name | Apply


def parse_expression(text: str) -> Expression:
    """Return the tree of *text*.

    Raises :class:`ExpressionError` with the position (the first character is
    1) of what is wrong, also when *text* names no signal at all.
    """
    if len(text) > limits.EXPRESSION_CHARACTERS:
        msg = (
            f"has {len(text)} characters, at most "
            f"{limits.EXPRESSION_CHARACTERS} are read"
        )
        raise ExpressionError(msg)
    tree = _Parser(text).parse()
    if not signal_names(tree):
        msg = "names no signal"
        raise ExpressionError(msg)
    return tree


def signal_names(tree: Expression) -> tuple[str, ...]:
    """Return the signals named in *tree*, each once, in order of first use."""
    if isinstance(tree, Name):
        return (tree.name,)
    if isinstance(tree, Apply):
        found = (
            name for part in tree.arguments for name in signal_names(part)
        )
        return tuple(dict.fromkeys(found))
    return ()


def evaluate(tree: Expression, values: Mapping[str, float]) -> float:
    """Return *tree* over *values*, by the names of its signals."""
    if isinstance(tree, Name):
        return values[tree.name]
    if isinstance(tree, Number):
        return tree.value
    arguments = [evaluate(part, values) for part in tree.arguments]
    return _OPERATIONS[tree.operation](*arguments)


def _divide(numerator: float, denominator: float) -> float:
    return numerator / denominator if denominator else math.nan


def _least(first: float, *others: float) -> float:
    for other in others:
        if math.isnan(first) or math.isnan(other):
            return math.nan
        # of equal values, also of 0.0 and -0.0, the first
        first = other if other < first else first  # noqa: FURB136
    return first


def _greatest(first: float, *others: float) -> float:
    for other in others:
        if math.isnan(first) or math.isnan(other):
            return math.nan
        first = other if other > first else first  # noqa: FURB136
    return first


_OPERATIONS: Final[Mapping[str, Callable[..., float]]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": _divide,
    "negate": lambda a: -a,
    "abs": abs,
    "min": _least,
    "max": _greatest,
}


class _Parser:
    """Recursive descent over the tokens of one text."""

    def __init__(self, text: str) -> None:
        self._tokens = _tokenize(text)
        terms = [at for kind, _, at in self._tokens if kind in _TERMS]
        if len(terms) > limits.EXPRESSION_TERMS:
            msg = (
                f"position {terms[limits.EXPRESSION_TERMS]}: more than "
                f"{limits.EXPRESSION_TERMS} numbers and names"
            )
            raise ExpressionError(msg)
        self._at = 0
        self._depth = 0

    def parse(self) -> Expression:
        tree = self._sum()
        if self._kind() != "end":
            self._fail("an operator or the end is expected")
        return tree

    def _sum(self) -> Expression:
        self._depth += 1
        if self._depth > limits.EXPRESSION_DEPTH:
            self._fail(f"nested deeper than {limits.EXPRESSION_DEPTH}")
        tree = self._product()
        while self._text() in ("+", "-"):
            sign = self._next()
            tree = Apply(sign, (tree, self._product()))
        self._depth -= 1
        return tree

    def _product(self) -> Expression:
        tree = self._factor()
        while self._text() in ("*", "/"):
            sign = self._next()
            tree = Apply(sign, (tree, self._factor()))
        return tree

    def _factor(self) -> Expression:
        negative = False
        while self._text() in ("+", "-"):
            negative ^= self._next() == "-"
        tree = self._atom()
        return Apply("negate", (tree,)) if negative else tree

    def _atom(self) -> Expression:
        if self._kind() == "number":
            value = float(self._text())
            if math.isinf(value):
                self._fail("the number is too large")
            self._at += 1
            return Number(value)
        if self._kind() == "name":
            return self._named()
        if self._text() != "(":
            self._fail("a number, a signal or '(' is expected")
        self._at += 1
        tree = self._sum()
        self._expect(")")
        return tree

    def _named(self) -> Expression:
        start = self._at
        name = self._next()
        if self._text() != "(":
            return Name(name)
        if name not in _FUNCTIONS:
            self._at = start
            self._fail("the functions are abs, min and max")
        self._at += 1
        arguments = [self._sum()]
        while self._text() == ",":
            self._at += 1
            arguments.append(self._sum())
        self._expect(")")
        fewest, most = _FUNCTIONS[name]
        if not fewest <= len(arguments) <= most:
            self._at = start
            takes = "one value" if most == 1 else f"{fewest} to {most} values"
            self._fail(f"{name} takes {takes}")
        return Apply(name, tuple(arguments))

    def _expect(self, text: str) -> None:
        if self._text() != text:
            self._fail(f"{text!r} is expected")
        self._at += 1

    def _kind(self) -> str:
        return self._tokens[self._at][0]

    def _text(self) -> str:
        return self._tokens[self._at][1]

    def _next(self) -> str:
        self._at += 1
        return self._tokens[self._at - 1][1]

    def _fail(self, reason: str) -> None:
        _, text, position = self._tokens[self._at]
        found = f"{text!r}" if text else "the end"
        msg = f"position {position}: {reason}, found {found}"
        raise ExpressionError(msg)


def _tokenize(text: str) -> list[tuple[str, str, int]]:
    tokens = []
    at = 0
    end = len(text.rstrip())
    while at < end:
        match = _TOKEN.match(text, at)
        if match is None or match.lastgroup is None:
            at += len(text[at:]) - len(text[at:].lstrip())
            msg = f"position {at + 1}: {text[at]!r} has no meaning here"
            raise ExpressionError(msg)
        kind = match.lastgroup
        tokens.append((kind, match[kind], match.start(kind) + 1))
        at = match.end()
    tokens.append(("end", "", end + 1))
    return tokens

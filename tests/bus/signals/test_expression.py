"""Expressions: the tree, the errors, the values."""

import ast
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.bus.signals.expression import (
    Apply,
    ExpressionError,
    Name,
    Number,
    evaluate,
    parse_expression,
    signal_names,
)


def value_of(text: str, **values: float) -> float:
    return evaluate(parse_expression(text), values)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a", 3.0),
        ("a + b * 2", 13.0),
        ("(a + b) * 2", 16.0),
        ("a - b - 1", -3.0),
        ("a / b / 2", 0.3),
        ("-a + +b", 2.0),
        ("--a", 3.0),
        ("2 * -a", -6.0),
        ("abs(a - b) + min(a, b) + max(a, b, 7)", 12.0),
        ("  .5e1*a  ", 15.0),
        ("1.*a - 1e-1*a", 2.7),
    ],
)
def test_arithmetic(text: str, expected: float) -> None:
    assert value_of(text, a=3.0, b=5.0) == pytest.approx(expected)


def test_a_signal_may_be_named_like_a_function() -> None:
    assert value_of("min + abs(max)", min=1.0, max=-2.0) == 3.0


def test_the_tree_keeps_the_order_of_writing() -> None:
    assert parse_expression("a - 1 - b") == Apply(
        "-", (Apply("-", (Name("a"), Number(1.0))), Name("b"))
    )


def test_signals_are_listed_once() -> None:
    assert signal_names(parse_expression("b*b + max(a, b) / c")) == (
        "b",
        "a",
        "c",
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"position 1: a number, a signal or '\(' is expected"),
        ("a +", "position 4: .* found the end"),
        ("a b", "position 3: an operator or the end is expected, found 'b'"),
        ("a $ b", r"position 3: '\$' has no meaning here"),
        ("(a", r"position 3: '\)' is expected, found the end"),
        ("a)", r"position 2: an operator or the end is expected"),
        ("sin(a)", "position 1: the functions are abs, min and max"),
        ("abs(a, b)", "position 1: abs takes one value"),
        ("2 * min(a)", "position 5: min takes 2 to 8 values"),
        ("a ** 2", r"position 4: .* found '\*'"),
        ("a * 1e999", "position 5: the number is too large"),
        ("__import__('os')", 'position 12: "\'" has no meaning'),
        ("a.b", "position 2: '.' has no meaning"),
        ("1 + 2", "names no signal"),
        ("(" * 60 + "a" + ")" * 60, "nested deeper than 50"),
    ],
)
def test_an_error_names_the_position(text: str, message: str) -> None:
    with pytest.raises(ExpressionError, match=message):
        parse_expression(text)


@pytest.mark.parametrize(
    "text",
    [
        *("a / b", "1 / (b - b)"),
        *(
            f"{name}({of})"
            for name in ("min", "max")
            for of in ("a / b, a", "a, a / b")
        ),
    ],
)
def test_a_division_by_zero_is_no_number(text: str) -> None:
    assert math.isnan(value_of(text, a=1.0, b=0.0))
    assert math.isnan(value_of(text, a=1.0, b=-0.0))


NAMES = ["a", "b", "c"]
TEXTS = st.recursive(
    st.one_of(
        st.sampled_from(NAMES),
        st.floats(0, 1e6, allow_nan=False).map(repr),
        st.integers(0, 100).map(str),
    ),
    lambda parts: st.one_of(
        st.tuples(parts, st.sampled_from("+-*/"), parts).map(
            lambda p: f"({p[0]} {p[1]} {p[2]})"
        ),
        st.tuples(parts, st.sampled_from("+-*"), parts).map("".join),
        parts.map(lambda p: f"-{p}"),
        parts.map(lambda p: f"abs({p})"),
        st.tuples(st.sampled_from(["min", "max"]), parts, parts, parts).map(
            lambda p: f"{p[0]}({p[1]}, {p[2]},{p[3]})"
        ),
    ),
    max_leaves=12,
).map(lambda text: f"{text} + a * 0")


@pytest.mark.parametrize("text", ["min(a, b)", "max(a, b)"])
def test_of_equal_values_the_first_counts(text: str) -> None:
    assert math.copysign(1.0, value_of(text, a=0.0, b=-0.0)) == 1.0
    assert math.copysign(1.0, value_of(text, a=-0.0, b=0.0)) == -1.0


@settings(max_examples=200, deadline=None)
@given(text=TEXTS, row=st.tuples(*[st.floats(-1e3, 1e3)] * 3))
def test_values_are_those_of_python(text: str, row: tuple[float, ...]) -> None:
    """Python reads the same text; the test trusts what it generated."""
    values = dict(zip(NAMES, row, strict=True))
    code = compile(ast.parse(text, mode="eval"), "<test>", "eval")
    try:
        expected = eval(code, {"abs": abs, "min": min, "max": max}, values)  # noqa: S307
    except ZeroDivisionError:
        assert math.isnan(value_of(text, **values))
        return

    found = value_of(text, **values)

    assert math.isnan(found) == math.isnan(expected)
    assert found == expected or math.isnan(expected)


@given(text=st.text(max_size=30))
def test_any_text_is_a_tree_or_an_error(text: str) -> None:
    try:
        assert signal_names(parse_expression(text))
    except ExpressionError as error:
        said = str(error)
    else:
        return
    assert said.startswith(("position ", "names no signal"))


def test_the_limits_are_what_is_still_read() -> None:
    """50 levels, the outermost included, and 200 numbers and names."""
    deep = "(" * 49 + "a" + ")" * 49
    assert value_of(deep, a=3.0) == 3.0
    with pytest.raises(ExpressionError, match="nested deeper than 50"):
        parse_expression(f"({deep})")

    beside = "+".join(["(a)"] * 60)
    assert value_of(beside, a=3.0) == 180.0

    wide = "+".join(["a"] * 200)
    assert value_of(wide, a=3.0) == 600.0
    with pytest.raises(ExpressionError, match=r"^position 401: more than 200"):
        parse_expression(f"{wide}+a")

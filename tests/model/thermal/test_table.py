"""Look-up tables: what they hold, between the points and outside."""

from itertools import pairwise
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.model.thermal.table import (
    GRID_LIMIT,
    RESAMPLED_POINTS,
    Table,
)

NUMBERS = st.floats(-1e6, 1e6)


@st.composite
def points(draw: st.DrawFn) -> tuple[list[float], list[float]]:
    """Draw points whose x are whole multiples of one step, as rated data."""
    places = draw(st.lists(st.integers(0, 200), min_size=2, unique=True))
    step = draw(st.floats(0.01, 100.0))
    start = draw(st.floats(-500.0, 500.0))
    x = [start + step * place for place in sorted(places)]
    y = draw(st.lists(NUMBERS, min_size=len(x), max_size=len(x)))
    return x, y


@st.composite
def tables(draw: st.DrawFn) -> Table:
    """Draw any table."""
    values = draw(st.lists(NUMBERS, min_size=2, max_size=20))
    return Table(
        draw(st.floats(-100, 100)), draw(st.floats(0.1, 10)), tuple(values)
    )


@given(points())
def test_every_point_is_hit(pair: tuple[list[float], list[float]]) -> None:
    """A uniform grid that has all breakpoints reproduces them."""
    x, y = pair
    table = Table.from_points(x, y)
    scale = max(map(abs, y)) + 1.0
    for at, expected in zip(x, y, strict=True):
        assert table(at) == pytest.approx(expected, abs=1e-7 * scale)


@given(points(), st.floats(0.0, 1.0))
def test_linear_between_points(
    pair: tuple[list[float], list[float]], part: float
) -> None:
    """Between two neighbours lies the straight line."""
    x, y = pair
    table = Table.from_points(x, y)
    scale = max(map(abs, y)) + 1.0
    for i in range(len(x) - 1):
        at = x[i] + part * (x[i + 1] - x[i])
        line = y[i] + part * (y[i + 1] - y[i])
        assert table(at) == pytest.approx(line, abs=1e-6 * scale)


def test_points_that_fit_no_grid_are_resampled_closely() -> None:
    """A corner cut by resampling errs at most half a cell's kink."""
    x = [0.0, 0.12345678, 1.0]
    table = Table.from_points(x, [0.0, 1.0, 0.0])
    assert len(table.values) == RESAMPLED_POINTS
    kink = 1.0 / x[1] + 1.0 / (1.0 - x[1])
    assert table(x[1]) == pytest.approx(1.0, abs=0.5 * table.dx * kink)
    assert table(0.5) == pytest.approx(0.5 / (1.0 - x[1]), abs=1e-9)


def test_points_closer_than_the_grid_are_passed() -> None:
    table = Table.from_points(
        [0.0, 1e-4, 3e-4, 7e-4, 1.0], [0.0, 9.0, 9.0, 0.0, 1.0]
    )

    expected = (table.dx - 7e-4) / (1.0 - 7e-4)
    assert table(table.dx) == pytest.approx(expected)


@given(tables(), st.floats(1e-3, 1e9))
def test_outside_the_end_value_is_kept(table: Table, beyond: float) -> None:
    """Clamping on both sides, at any distance, infinity included."""
    last = table.values[-1]
    scale = max(map(abs, table.values)) + 1.0
    assert table(table.x0 - beyond) == table.values[0]
    assert table(-inf) == table.values[0]
    assert table(table.x1 + beyond) == pytest.approx(last, abs=1e-9 * scale)
    assert table(inf) == pytest.approx(last, abs=1e-9 * scale)


@given(tables(), st.floats(-50.0, 150.0), st.floats(-50.0, 150.0))
def test_integral_is_the_area(table: Table, a: float, b: float) -> None:
    """Compared with the trapezoid sum over all kinks between a and b."""
    low, high = sorted((a, b))
    kinks = [table.x0 + i * table.dx for i in range(len(table.values))]
    places = [low, *(k for k in kinks if low < k < high), high]
    area = sum(
        0.5 * (table(left) + table(right)) * (right - left)
        for left, right in pairwise(places)
    )
    found = table.integral(high) - table.integral(low)
    scale = (max(map(abs, table.values)) + 1.0) * 400.0
    assert found == pytest.approx(area, abs=1e-9 * scale)


@given(
    st.floats(0.1, 10.0),
    st.lists(NUMBERS, min_size=2, max_size=20),
    st.lists(NUMBERS, min_size=2, max_size=20),
)
def test_product_at_the_points_of_a_common_grid(
    dx: float, left: list[float], right: list[float]
) -> None:
    """At each point of a grid that both share the product is exact."""
    one, two = Table(3.0, dx, tuple(left)), Table(3.0, dx, tuple(right))
    product = one.times(two)
    scale = (max(map(abs, left)) + 1.0) * (max(map(abs, right)) + 1.0)
    for i in range(max(len(left), len(right))):
        at = 3.0 + i * dx
        expected = one(at) * two(at)
        assert product(at) == pytest.approx(expected, abs=1e-9 * scale)


def test_a_product_has_no_more_points_than_the_limit() -> None:
    fine = Table(0.0, 1e-3, (1.0, 1.0, 1.0))

    product = fine.times(Table(0.0, 10.0, (1.0, 2.0)))

    assert len(product.values) == GRID_LIMIT
    assert product(10.0) == 2.0


def test_product_covers_both_ranges() -> None:
    """A table that ends earlier keeps its end value in the product."""
    short = Table(0.0, 1.0, (1.0, 2.0))
    long = Table(0.0, 0.5, (3.0, 3.0, 3.0, 3.0, 5.0))
    product = short.times(long)
    assert (product.x0, product.x1) == (0.0, 2.0)
    assert product(2.0) == pytest.approx(10.0)
    assert product(1.0) == pytest.approx(6.0)


@given(tables(), NUMBERS, st.floats(-200.0, 200.0))
def test_scaled(table: Table, factor: float, x: float) -> None:
    """Scaling the table scales the look-up."""
    scale = (max(map(abs, table.values)) + 1.0) * (abs(factor) + 1.0)
    expected = factor * table(x)
    assert table.scaled(factor)(x) == pytest.approx(expected, abs=1e-9 * scale)


def test_from_function_is_exact_at_its_places() -> None:
    """The parabola at the places it was sampled."""
    table = Table.from_function(lambda x: x * x, 0.0, 2.0, 5)
    assert [table(0.5 * i) for i in range(5)] == [0.0, 0.25, 1.0, 2.25, 4.0]


@pytest.mark.parametrize(
    ("x0", "dx", "values", "named"),
    [
        (0.0, 1.0, (1.0,), "two values"),
        (0.0, 0.0, (1.0, 2.0), "positive"),
        (0.0, -1.0, (1.0, 2.0), "positive"),
        (0.0, nan, (1.0, 2.0), "positive"),
        (0.0, inf, (1.0, 2.0), "finite"),
        (nan, 1.0, (1.0, 2.0), "finite"),
        (0.0, 1.0, (1.0, nan), "not finite"),
        (0.0, 1.0, (1.0, inf), "not finite"),
    ],
)
def test_refused(
    x0: float, dx: float, values: tuple[float, ...], named: str
) -> None:
    """What could not be looked up is refused and named."""
    with pytest.raises(ValueError, match=named):
        Table(x0, dx, values)


@pytest.mark.parametrize(
    ("x", "y"),
    [([0.0], [1.0]), ([0.0, 1.0], [1.0]), ([0.0, 0.0], [1.0, 2.0])],
)
def test_refused_points(x: list[float], y: list[float]) -> None:
    """Too few, unequal or not rising."""
    with pytest.raises(ValueError, match=r"need the same|must rise"):
        Table.from_points(x, y)


def test_a_continued_table_keeps_every_bit_of_what_was_there() -> None:
    table = Table.from_points([0.0, 5.0, 13.89, 41.67], [1.0, 2.0, 4.0, 9.0])

    longer = table.continued(lambda x: 9.0 * x / 41.67, 120.0)

    assert longer.values[: len(table.values)] == table.values
    assert longer.x1 >= 120.0
    assert longer(100.0) == pytest.approx(9.0 * 100.0 / 41.67)
    assert all(longer(x) == table(x) for x in (0.0, 3.3, 20.0, 41.66))

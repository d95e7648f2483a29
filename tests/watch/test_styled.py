"""Spans and lines."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.watch.styled import (
    Span,
    beside,
    fitted,
    flowed,
    length,
    painted,
)

spans = st.builds(
    Span, st.text("abc ", max_size=12), st.sampled_from(["plain", "bad"])
)


@given(line=st.lists(spans).map(tuple), width=st.integers(0, 40))
def test_a_fitted_line_is_as_wide_as_asked(
    line: tuple[Span, ...], width: int
) -> None:
    whole = painted(line, use_color=False)
    shown = painted(fitted(line, width), use_color=False)

    assert len(shown) == width
    assert shown.rstrip() == whole[:width].rstrip()


@given(words=st.lists(spans, max_size=20), width=st.integers(12, 40))
def test_flowed_lines_are_within_the_width(
    words: list[Span], width: int
) -> None:
    lines = flowed(words, width)

    assert all(length(line) <= width for line in lines)
    assert [s for line in lines for s in line if s.text != "  "] == [
        word for word in words if word.text != "  "
    ]


def test_side_by_side() -> None:
    left, right = [(Span("a"),), (Span("b"),)], [(Span("c"),), (Span("d"),)]

    lines = beside(left, right)

    assert [painted(line, use_color=False) for line in lines] == [
        "a  c",
        "b  d",
    ]


def test_colour_is_closed_again() -> None:
    line = (Span("a"), Span("b", "bad"), Span("", "bad"))

    assert painted(line, use_color=True) == "a\x1b[31mb\x1b[m"
    assert painted(line, use_color=False) == "ab"

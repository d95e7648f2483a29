"""Thinning for a plot keeps every extreme and every gap."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.report.decimation import (
    BUCKETS,
    SPANS_DRAWN,
    SPARE,
    Buckets,
    ThinCurve,
    validity_spans,
)

SERIES = st.lists(
    st.one_of(
        st.floats(-1e6, 1e6, allow_nan=False),
        st.just(float("nan")),
    ),
    max_size=400,
).map(np.array)


def kept_rows(values: np.ndarray, limit: int, at_once: int = 0) -> np.ndarray:
    """Return the rows of *values* that are left, *at_once* rows at a time."""
    curve = ThinCurve(limit)
    rows = np.arange(float(len(values)))
    step = at_once or max(len(values), 1)
    for first in range(0, len(values), step):
        curve.add(rows[first : first + step], values[first : first + step])
    x, y = curve.points()
    kept = x.astype(int)
    assert np.array_equal(y, values[kept], equal_nan=True)
    return kept


def test_a_short_series_stays_whole() -> None:
    values = np.arange(50.0)

    assert kept_rows(values, 50).tolist() == list(range(50))


@pytest.mark.parametrize("row", [0, 1, 17_777, 35_998, 35_999])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_peak_of_one_row_survives_in_an_hour(row: int, sign: float) -> None:
    values = np.sin(np.arange(36_000) / 500)
    values[row] = sign * 50.0

    rows = kept_rows(values, 4000)

    assert row in rows
    assert len(rows) <= 4000


@settings(deadline=None)
@given(SERIES, st.integers(8, 120), st.integers(1, 500))
def test_kept_rows_rise_and_hold_extremes_and_ends(
    values: np.ndarray, limit: int, at_once: int
) -> None:
    rows = kept_rows(values, limit, at_once)

    assert len(rows) <= max(limit, 0)
    assert (np.diff(rows) > 0).all()
    if len(values):
        assert rows[0] == 0
        assert rows[-1] == len(values) - 1
    known = values[~np.isnan(values)]
    if len(known):
        assert np.nanmax(values[rows]) == known.max()
        assert np.nanmin(values[rows]) == known.min()


def test_a_gap_breaks_the_line_where_it_did() -> None:
    """Also one of a single row, which a bucket could swallow."""
    values = np.sin(np.arange(36_000) / 500)
    values[12_345] = np.nan
    values[20_000:25_000] = np.nan

    rows = kept_rows(values, 300)

    assert 12_345 in rows
    assert ((rows >= 20_000) & (rows < 25_000)).any()
    drawn = rows[~np.isnan(values[rows])]
    assert not ((drawn >= 20_000) & (drawn < 25_000)).any()


@pytest.mark.parametrize("at_once", [1024, 1000, 40_000])
def test_extremes_of_every_bucket_are_kept(at_once: int) -> None:
    """The drawn band of a noisy signal is as wide as the signal's.

    A point on the edge of a bucket may stand for the next one too, so the
    band is looked at with twice the width.
    """
    values = np.random.default_rng(3).normal(size=40_000)

    rows = kept_rows(values, 402, at_once)

    assert 300 < len(rows) <= 402
    for bucket in range(200):
        part = np.arange(bucket * 200, (bucket + 1) * 200)
        near = rows[(rows >= part[0] - 200) & (rows <= part[-1] + 200)]
        assert values[near].max() >= values[part].max()
        assert values[near].min() <= values[part].min()


def test_what_is_held_does_not_grow() -> None:
    """A day of ten rows a second, in the memory of some minutes."""
    rng = np.random.default_rng(5)
    curve = ThinCurve(400)
    most = 0
    for first in range(0, 864_000, 1024):
        rows = np.arange(first, first + 1024.0)
        curve.add(rows, rng.normal(size=1024))
        most = max(most, sum(part.shape[1] for part in curve._parts))

    assert most <= SPARE * 400


def test_each_stretch_has_code_start_and_end() -> None:
    elapsed_s = np.arange(10.0)
    validity = np.array([0, 1, 1, 2, 0, 0, 1, 0, 0, 2], float)

    assert validity_spans(elapsed_s, validity) == [
        (1, 1.0, 3.0),
        (2, 3.0, 4.0),
        (1, 6.0, 7.0),
        (2, 9.0, 9.0),
    ]


def test_all_valid_and_all_invalid() -> None:
    elapsed_s = np.arange(5.0)

    assert validity_spans(elapsed_s, np.zeros(5)) == []
    assert validity_spans(elapsed_s, np.full(5, 2.0)) == [(2, 0.0, 4.0)]
    assert validity_spans(elapsed_s, np.full(5, np.nan)) == []


def test_flicker_is_merged_to_what_a_screen_shows() -> None:
    """The worse code wins, and a valid hour stays clear."""
    elapsed_s = np.arange(36_000) / 10
    validity = (np.arange(36_000) % 2).astype(float)
    validity[12_001] = 2.0
    validity[18_000:] = 0.0

    spans = validity_spans(elapsed_s, validity)

    assert 0 < len(spans) <= SPANS_DRAWN
    assert any(code == 2 and a <= 1200.1 < b for code, a, b in spans)
    assert max(end for _, _, end in spans) <= 1800.0


@pytest.mark.parametrize("rows", [1000, 1024, 300_000])
def test_a_long_drive_is_held_in_few_buckets(rows: int) -> None:
    """One row in a day is found again, in a bucket of some rows."""
    count = 864_000
    elapsed_s = np.arange(count) / 10
    validity = np.zeros(count)
    validity[500_003] = 2.0
    starts_s, worst = Buckets(np.minimum), Buckets(np.maximum)

    for first in range(0, count, rows):
        starts_s.add(elapsed_s[first : first + rows])
        worst.add(validity[first : first + rows])

    assert BUCKETS // 2 < len(worst.values) <= BUCKETS
    assert (starts_s.values == elapsed_s[::16]).all()
    assert validity_spans(starts_s.values, worst.values) == [
        (2, 50_000.0, 50_001.6)
    ]

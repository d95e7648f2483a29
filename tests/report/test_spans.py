"""Stretches without a valid estimate."""

import numpy as np
import pytest

from bstm_daemon.report.spans import (
    BUCKETS,
    SPANS_DRAWN,
    Buckets,
    validity_spans,
)


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

"""Whatever a log holds, it is judged: no crash, no claim without data."""

from collections.abc import Callable

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from bstm_daemon.analysis.quality.finding import Quality
from bstm_daemon.analysis.quality.recording import Recording, Series
from bstm_daemon.report.check import (
    comparison_plots,
    quality_json,
    quality_text,
)

KINDS = st.sampled_from(["constant", "noise", "ramp", "steps", "single"])
SIZES = st.sampled_from([0.0, 1e-9, 1.0, 30.0, 1e6, -1e6, 1e300])


def series_of(kind: str, size: float, rate_hz: float, seed: int) -> Series:
    rng = np.random.default_rng(seed)
    count = 1 if kind == "single" else round(20.0 * rate_hz)
    time_s = np.arange(count) / rate_hz
    value = {
        "constant": np.ones(count),
        "noise": rng.normal(0.0, 1.0, count),
        "ramp": np.linspace(0.0, 1.0, count),
        "steps": np.repeat(rng.normal(0, 1, count // 40 + 1), 40)[:count],
        "single": np.ones(count),
    }[kind]
    return Series(time_s, value * size)


CHANNELS = st.lists(
    st.tuples(
        st.integers(0, 60),
        KINDS,
        SIZES,
        st.sampled_from([1.0, 10.0, 100.0]),
        st.integers(0, 5),
    ),
    min_size=1,
    max_size=8,
)


@settings(max_examples=60, deadline=None)
@given(CHANNELS)
@example([(32, "constant", 1e300, 10.0, 0), (33, "constant", 0.0, 10.0, 0)])
def test_no_recording_breaks_the_check(
    role_names: list[str],
    judged: Callable[[Recording], Quality],
    channels: list[tuple[int, str, float, float, int]],
) -> None:
    series = {
        role_names[number % len(role_names)]: series_of(
            kind, size, rate_hz, seed
        )
        for number, kind, size, rate_hz, seed in channels
    }
    end_s = max(float(one.time_s[-1]) for one in series.values())

    quality = judged(Recording(series, end_s, {}, {}))

    found = {role.role for role in quality.roles if role.statistics}
    assert found == set(series)
    for finding in quality.findings:
        if finding.fault != "missing":
            assert set(finding.roles) <= found
    assert quality_text(quality)
    assert quality_json(quality)["roles"]
    for comparison in quality.comparisons:
        (_, over_time), _ = comparison_plots(comparison, end_s)
        assert over_time.data

"""Risk along the publications: when, how often, and never by the chunk."""

from __future__ import annotations

from array import array
from dataclasses import replace
from math import inf, isnan, nan
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimate import RiskLevel, Validity
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.state import export_state, restore_state
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast import course_risk
from bstm_daemon.forecast.course_risk import PYTHON_MEMBERS
from bstm_daemon.forecast.fluid import CHANGED_ROLE, WATER_ROLE
from bstm_daemon.forecast.monitor import RiskMonitor
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimate import CarRisk
    from bstm_daemon.estimator.blocks import Block

    SAMPLES = tuple[array[int], array[int], array[float]]

START_US = 1_700_000_000_000_000
SPEED = ROLE_INDEX["vehicle_speed"]
PRESSURE = ROLE_INDEX["primary_pressure"]
MAPPED = dict.fromkeys((SPEED, PRESSURE), 500_000)

pytestmark = pytest.mark.skipif(
    load_kernel() is None, reason="minutes in pure Python"
)


def car() -> Config:
    """Return the example car with its front left corner alone."""
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    corners = [c for c in config.corner if c.name == "FL"]
    return config.model_copy(update={"corner": corners})


def drive(moving_s: int, standing_s: int, pressure_pa: float = 8e5) -> SAMPLES:
    """Return samples of a braked drive at 12 m/s and the time after it."""
    times, roles, values = array("q"), array("i"), array("d")
    for tenth in range(10 * (moving_s + standing_s)):
        moves = tenth < 10 * moving_s
        for role, value in (
            (SPEED, 12.0 if moves else 0.0),
            (PRESSURE, pressure_pa if moves else 0.0),
        ):
            times.append(START_US + 100_000 * tenth)
            roles.append(role)
            values.append(value)
    return times, roles, values


def run(
    config: Config, samples: SAMPLES, cut: int = 10**9
) -> tuple[RiskMonitor, Estimator, list[int], list[CarRisk]]:
    """Run *samples*, at most *cut* at a time."""
    estimator = Estimator(config, MAPPED, history_known=True)
    monitor = RiskMonitor(config, estimator)
    times: list[int] = []
    found: list[CarRisk] = []
    for first in range(0, len(samples[0]), cut):
        part = [column[first : first + cut] for column in samples]
        monitor.ingest(*part)
        for block in estimator.blocks(*part):
            times += block.times_us
            found += monitor.add(block)
    return monitor, estimator, times, found


def told(record: CarRisk) -> str:
    """Return all of a record; NaN equals NaN as text."""
    return repr(record)


def test_how_samples_are_cut_changes_nothing() -> None:
    """Live, a few at a time; in replay, all at once."""
    samples = drive(25, 15)
    *_, whole = run(car(), samples)
    *_, cut = run(car(), samples, 7)

    assert list(map(told, whole)) == list(map(told, cut))


def test_networks_of_worn_linings_change_nothing_by_the_cut() -> None:
    """Exchanged on the minute; a forecast goes by those of its time."""
    config = car()
    followed = {"pad_wear_m3_j": 1e-10, "model_follows": True}
    wear = config.wear.model_copy(update=followed)
    worn = config.model_copy(update={"wear": wear})
    samples = drive(65, 15)
    _, estimator, _, whole = run(worn, samples)
    *_, cut = run(worn, samples, 7)
    *_, fresh = run(config, samples)

    built = estimator.wear.built_corner("FL").pad
    assert built is not None
    assert config.corner[0].pad is not None
    assert built.thickness_m < config.corner[0].pad.thickness_m - 5e-4
    assert list(map(told, whole)) == list(map(told, cut))
    thin, thick = (r[-1].corners["FL"].peak_k for r in (whole, fresh))
    assert thin != pytest.approx(thick, abs=0.3)


def test_a_forecast_every_ten_seconds_and_at_the_stop() -> None:
    """Begun on the grid of data time; the stop does not wait for it."""
    _, _, times, found = run(car(), drive(33, 12))

    begun = sorted(
        {
            (record.forecast_us - START_US) / 1e6
            for record in found
            if record.forecast_us is not None
        }
    )
    assert begun[0] <= 0.1
    assert begun[1:4] == [10.0, 20.0, 30.0]
    assert begun[4] == pytest.approx(33.1, abs=0.15)
    assert begun[5:] == [40.0]
    stop = next(
        i
        for i, record in enumerate(found)
        if record.forecast_us == round(START_US + begun[4] * 1e6)
    )
    assert (times[stop] - START_US) / 1e6 - begun[4] < 1.0


def test_the_forecast_is_what_comes() -> None:
    """The peak told at the stop, against the estimator parked."""
    config = car()
    _, estimator, _, found = run(config, drive(240, 3, 15e5))
    corner = found[-1].corners["FL"]
    fluid = []
    now = START_US + 243 * 1_000_000
    for minute in range(30):
        at = now + 60_000_000 * (minute + 1)
        estimator.advance(
            array("q", [at]), array("i", [SPEED]), array("d", [0])
        )
        fluid.append(estimator.state("FL")["fluid"])

    assert corner.peak_k == pytest.approx(max(fluid), abs=1.0)
    after = 60.0 * (fluid.index(max(fluid)) + 1)
    assert corner.peak_in_s == pytest.approx(after, abs=90.0)
    assert corner.duty_peak_k > 0.0


def blocks(config: Config, samples: SAMPLES) -> list[Block]:
    estimator = Estimator(config, MAPPED, history_known=True)
    return estimator.advance(*samples)


def test_no_level_of_an_invalid_estimate() -> None:
    """Whatever the probability says."""
    config = car()
    (block,) = blocks(config, drive(5, 5))
    monitor = RiskMonitor(
        config, Estimator(config, MAPPED, history_known=True)
    )
    assert {r.level for r in monitor.add(block)[20:]} == {RiskLevel.NORMAL}

    invalid = replace(
        block,
        validity={"FL": array("b", [Validity.INVALID] * len(block.times_us))},
    )
    fresh = RiskMonitor(config, Estimator(config, MAPPED, history_known=True))
    for record in fresh.add(invalid):
        assert record.level is RiskLevel.UNKNOWN
        assert record.corners["FL"].level is RiskLevel.UNKNOWN
        assert record.corners["FL"].sure_level is RiskLevel.UNKNOWN
        assert record.corners["FL"].fade is RiskLevel.UNKNOWN


def test_an_unknown_start_is_told_by_the_hot_bound() -> None:
    """The risk is that of a car that was as hot; what is sure is less."""
    config, samples = car(), drive(25, 15)
    unknown = Estimator(config, MAPPED)
    hot = Estimator(config, MAPPED, history_known=True)
    ((batch, _),) = hot.batches
    batch.state = array("d", unknown.start.states()["FL"].values())
    monitor, witness = RiskMonitor(config, unknown), RiskMonitor(config, hot)
    found: list[CarRisk] = []
    expected: list[CarRisk] = []
    for mine, other in zip(
        unknown.advance(*samples), hot.advance(*samples), strict=True
    ):
        found += monitor.add(mine)
        # as uncertain as what is degraded
        expected += witness.add(replace(other, validity=mine.validity))

    for one, two in zip(found, expected, strict=True):
        corner, hottest = one.corners["FL"], two.corners["FL"]
        assert corner.probability_now == hottest.probability_now
        assert corner.fluid_deviation_k < hottest.fluid_deviation_k
        assert corner.sure_level is RiskLevel.UNKNOWN
        assert corner.level is hottest.level
    one, two = found[-1].corners["FL"], expected[-1].corners["FL"]
    assert one.peak_k == pytest.approx(two.peak_k, abs=0.5)
    # what no level needs is an upper bound
    assert two.probability <= one.probability < two.probability + 0.05
    assert two.safe_in_s <= one.safe_in_s < 1.2 * two.safe_in_s
    assert found[-1].level is expected[-1].level is RiskLevel.CRITICAL
    *_, known = run(config, samples)
    assert known[-1].corners["FL"].sure_level is RiskLevel.NORMAL


def test_levels_of_the_bound_go_over_a_restart() -> None:
    config, samples = car(), drive(25, 15)
    first = Estimator(config, MAPPED)
    monitor = RiskMonitor(config, first)
    for block in first.advance(*samples):
        monitor.add(block)
    document = export_state(first) | {"risk": monitor.export()}
    second = Estimator(config, MAPPED)
    restore_state(second, document, resume=True)

    resumed = RiskMonitor(config, second)
    resumed.resume(document, 0, START_US + 40_000_000)

    assert {n: m.level for n, m in resumed.memories().items()} == {
        n: m.level for n, m in monitor.memories().items()
    }
    bound = resumed.memories()["bound.FL.fluid"]
    assert bound.level is RiskLevel.CRITICAL


def test_vapour_while_away_counts_for_the_bound_alone() -> None:
    """The estimate was cold, a brake as hot as the bound was not."""
    config = car()
    first = Estimator(config, MAPPED)
    second = Estimator(config, MAPPED)
    restore_state(second, export_state(first), resume=False)
    monitor = RiskMonitor(config, second)

    monitor.resume(export_state(first), 600_000_000, START_US)

    levels = {name: one.level for name, one in monitor.memories().items()}
    assert levels["bound.car"] is RiskLevel.CRITICAL
    assert levels["bound.FL.fluid"] is RiskLevel.CRITICAL
    assert levels["car"] is levels["FL.fluid"] is RiskLevel.NORMAL


def test_hot_brakes_raise_the_levels() -> None:
    """A wet fluid on a hard descent: elevated before the stop, then more."""
    config = car()
    fluid = config.fluid.model_copy(
        update={"grade": "DOT3", "water_percent": 5.0}
    )
    config = config.model_copy(update={"fluid": fluid})
    _, _, _, found = run(config, drive(900, 4, 12e5))

    corner = found[-1].corners["FL"]
    assert found[-1].level >= RiskLevel.HIGH
    assert found[-1].level is not RiskLevel.UNKNOWN
    assert corner.fade >= RiskLevel.ELEVATED
    assert found[-1].probability == pytest.approx(corner.probability)
    assert corner.probability >= corner.probability_now
    assert corner.safe_in_s > 0.0
    assert corner.duty_in_s < inf
    levels = [r.level for r in found]
    assert levels[50] is RiskLevel.NORMAL


def test_more_water_more_risk_over_the_bus() -> None:
    """Both roles of the fluid count from their stamps on."""
    config = car()
    samples = drive(10, 10)
    wet = tuple(column[:] for column in samples)
    at = START_US + 12_000_000
    for column, value in zip(wet, (at, WATER_ROLE, 0.06), strict=True):
        column.append(value)
    *_, dry_found = run(config, samples)
    *_, wet_found = run(config, wet)

    assert wet_found[100].boiling_k == dry_found[100].boiling_k
    assert wet_found[-1].water_percent == pytest.approx(6.0)
    assert wet_found[-1].boiling_k < dry_found[-1].boiling_k - 5.0

    fresh = tuple(column[:] for column in samples)
    for column, value in zip(fresh, (at, CHANGED_ROLE, 1.0), strict=True):
        column.append(value)
    *_, fresh_found = run(config, fresh)
    assert fresh_found[-1].boiling_k > dry_found[-1].boiling_k + 20.0


def test_a_gap_begins_anew() -> None:
    """What was foreseen before a jump of the data's time says nothing."""
    config = car()
    (block,) = blocks(config, drive(5, 5))
    later = array("q", [t + 3_600_000_000 for t in block.times_us])
    monitor = RiskMonitor(
        config, Estimator(config, MAPPED, history_known=True)
    )

    before = monitor.add(block)[-1]
    after = monitor.add(replace(block, times_us=later))

    assert before.corners["FL"].peak_in_s > 60.0
    assert isnan(after[0].corners["FL"].duty_peak_k)
    assert after[0].corners["FL"].probability_now >= 0.0
    assert after[-1].forecast_us is not None
    assert all(
        record.forecast_us is None or record.forecast_us >= later[0]
        for record in after
    )


def test_temperatures_that_are_no_numbers_foresee_nothing() -> None:
    """Neither a traceback nor a brake that seems safe."""
    config = car()
    (block,) = blocks(config, drive(5, 5))
    outputs = tuple(array("d", [nan] * len(o)) for o in block.outputs)
    lost = replace(
        block,
        outputs=outputs,
        validity={"FL": array("b", [Validity.INVALID] * len(block.times_us))},
    )
    monitor = RiskMonitor(
        config, Estimator(config, MAPPED, history_known=True)
    )

    for record in monitor.add(lost)[20:]:
        assert record.level is RiskLevel.UNKNOWN
        assert isnan(record.probability)
        assert isnan(record.corners["FL"].probability)
        assert isnan(record.corners["FL"].peak_k)


def test_slow_traffic_does_not_keep_forecasts_from_coming(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Stops every 6 s, in pure Python, where a forecast takes 10 s."""
    monkeypatch.setenv("BSTM_KERNEL", "reference")
    config = car()
    times, roles, values = drive(30, 0)
    for i, role in enumerate(roles):
        if role == SPEED and (times[i] - START_US) // 3_000_000 % 2:
            values[i] = 0.0
    estimator = Estimator(config, MAPPED, history_known=True)
    monitor = RiskMonitor(config, estimator)
    found = []
    for block in estimator.advance(times, roles, values):
        found += monitor.add(block)

    assert found[-1].forecast_us is not None
    assert not isnan(found[-1].corners["FL"].peak_k)


def test_members_without_the_compiled_kernel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Eight, one step a publication, and still a forecast."""
    monkeypatch.setenv("BSTM_KERNEL", "reference")
    config = car()
    estimator = Estimator(config, MAPPED, history_known=True)
    monitor = RiskMonitor(config, estimator)
    found = []
    for block in estimator.advance(*drive(2, 12)):
        found += monitor.add(block)

    assert found[-1].members == PYTHON_MEMBERS
    assert not isnan(found[-1].corners["FL"].peak_k)


def test_levels_and_fluid_go_over_a_restart() -> None:
    config = car()
    samples = drive(5, 5)
    for column, value in zip(
        samples, (START_US + 9_000_000, WATER_ROLE, 0.05), strict=True
    ):
        column.append(value)
    monitor, estimator, *_ = run(config, samples)
    document = {"risk": monitor.export()} | export_state(estimator)
    again = RiskMonitor(config, estimator)
    again.resume(document, 0, START_US + 20_000_000)

    assert again.export() == monitor.export()
    assert isnan(again.course.away)


def test_vapour_while_the_computer_was_off() -> None:
    """Powered off at the stop, the fluid peaks with nobody watching."""
    config = car()
    fluid = config.fluid.model_copy(
        update={"grade": "DOT3", "water_percent": 5.0}
    )
    config = config.model_copy(update={"fluid": fluid})
    monitor, estimator, times, found = run(config, drive(900, 1, 10.3e5))
    document = {"risk": monitor.export()} | export_state(estimator)
    again = RiskMonitor(config, estimator)
    again.resume(document, 1_200_000_000, times[-1])

    expected = found[-1].corners["FL"].probability
    assert again.course.away == pytest.approx(expected, abs=0.1)
    assert again.course.away > found[-1].corners["FL"].probability_now


@pytest.mark.parametrize(
    "damaged",
    [
        None,
        "text",
        {"levels": 7, "fluid": []},
        {"levels": {"car": [99, 1], "FL.fluid": ["high"]}},
        {"fluid": {"changed": "yesterday", "percent": "much", "flag": 3}},
    ],
)
def test_a_damaged_memory_is_left(damaged: object) -> None:
    config = car()
    monitor = RiskMonitor(
        config, Estimator(config, MAPPED, history_known=True)
    )
    before = monitor.export()
    monitor.resume({"risk": damaged}, None, START_US)

    assert monitor.export() == before
    assert monitor.fluid.boiling(0).quantile(0.5) > 0.0


def test_the_forecast_in_pure_python_has_the_same_bits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With as many members and portions; parked from a hot start, and duty."""
    monkeypatch.setattr(course_risk, "PYTHON_STEPS", 50)
    config = car()
    forecast = config.forecast.model_copy(update={"members": PYTHON_MEMBERS})
    config = config.model_copy(update={"forecast": forecast})
    samples = drive(2, 3)

    def records(*, is_compiled: bool) -> list[str]:
        estimator = Estimator(config, MAPPED)
        assert (estimator.kernel is not None) is is_compiled
        monitor = RiskMonitor(config, estimator)
        return [
            told(record)
            for block in estimator.advance(*samples)
            for record in monitor.add(block)
        ]

    compiled = records(is_compiled=True)
    monkeypatch.setenv("BSTM_KERNEL", "reference")
    assert records(is_compiled=False) == compiled
    assert "duty_peak_k=nan" not in compiled[-1]

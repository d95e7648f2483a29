"""Two corners, one of them hot: what is published, with values."""

from __future__ import annotations

from array import array
from dataclasses import replace
from math import inf, isnan, nan
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.estimates import MatchedConfig
from bstm_daemon.estimate import RiskLevel, Validity
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast import corner_march, course_risk, march
from bstm_daemon.forecast.car_forecast import CarForecast
from bstm_daemon.forecast.corner_march import Range
from bstm_daemon.forecast.course_risk import REFRESH_US
from bstm_daemon.forecast.fluid import FluidKnowledge
from bstm_daemon.forecast.march import (
    HORIZON_S,
    Conditions,
    Course,
    parked_course,
)
from bstm_daemon.forecast.monitor import RiskMonitor
from bstm_daemon.model.risk.levels import LevelMemory
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimate import CarRisk, CornerRisk
    from bstm_daemon.estimator.blocks import Block

START_US = 1_700_000_000_000_000
SPEED = ROLE_INDEX["vehicle_speed"]
PRESSURE = ROLE_INDEX["primary_pressure"]
MAPPED = dict.fromkeys((SPEED, PRESSURE), 500_000)
BOILING_K = 162.04 + KELVIN_OFFSET
"""Median of what the fluid of these cars boils at, +- 5 K."""

WARM_K = 430.0
"""Temperature at which one in 500 of these fluids boils."""

HOT_PADS_K = dict.fromkeys(
    ("pad_back", "backplate", *(f"pad_{i}" for i in range(1, 11))), 760.0
)
"""They heat the fluid for some minutes more."""

pytestmark = [
    pytest.mark.usefixtures("all_verified"),
    pytest.mark.skipif(load_kernel() is None, reason="minutes in pure Python"),
]


def car(*names: str) -> Config:
    """Return a car whose fluid is known: 265 and 165 degC, 3.7 % water."""
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    corners = [replace_name(config, name) for name in names]
    fluid = config.fluid.model_copy(
        update={
            "grade": "DOT4",
            "dry_boiling_point_c": 265.0,
            "wet_boiling_point_c": 165.0,
            "water_percent": 3.7,
            "water_accuracy": 1e-6,
        }
    )
    return config.model_copy(update={"corner": corners, "fluid": fluid})


def replace_name(config: Config, name: str) -> Any:
    """Return the front left corner as *name*."""
    (corner,) = (c for c in config.corner if c.name == "FL")
    return corner.model_copy(update={"name": name})


class Watched:
    """A monitor that is shown a car at rest, with nodes as they are set."""

    def __init__(self, *names: str) -> None:
        self.config = car(*names)
        self.estimator = Estimator(self.config, MAPPED, history_known=True)
        self.monitor = RiskMonitor(self.config, self.estimator)
        self.names = names

    def at_rest(self, seconds: int, first_s: int = 0) -> Block:
        """Return the publications of a car that stands."""
        times, roles, values = array("q"), array("i"), array("d")
        for tenth in range(10 * first_s, 10 * (first_s + seconds)):
            for role in (SPEED, PRESSURE):
                times.append(START_US + 100_000 * tenth)
                roles.append(role)
                values.append(0.0)
        (block,) = self.estimator.advance(times, roles, values)
        return block

    def state(self, **nodes_k: float) -> list[float]:
        """Return a state of a corner in air of 10 degC, but for *nodes_k*."""
        program = self.estimator.programs[self.names[0]]
        state = list(program.initial_state(283.15))
        for node, kelvin in nodes_k.items():
            state[program.state_names.index(node)] = kelvin
        return state

    def saved(self, states: Mapping[str, list[float]]) -> dict[str, Any]:
        """Return a state file's document with *states* by corner."""
        names = self.estimator.programs[self.names[0]].state_names
        return {
            "ambient_k": 283.15,
            "samples": {},
            "corners": {
                corner: dict(zip(names, state, strict=True))
                for corner, state in states.items()
            },
        }

    def put(
        self, block: Block, corner: str, from_i: int = 0, **nodes_k: float
    ) -> None:
        """Set nodes of *corner* [K] from publication *from_i* on."""
        number, first, stride, group = block.layout.modelled[corner]
        for i in range(from_i, len(block.times_us)):
            for node, kelvin in nodes_k.items():
                place = first + i * stride + group.state_names.index(node)
                block.outputs[number][place] = kelvin


def first_forecast(found: list[CarRisk]) -> int:
    """Return the publication at which a forecast is first told."""
    return next(i for i, one in enumerate(found) if one.forecast_us)


def test_the_car_is_as_near_to_vapour_as_its_hottest_corner() -> None:
    """Not as the mean of its corners, now and ahead."""
    watched = Watched("FL", "FR")
    block = watched.at_rest(2)
    watched.put(block, "FL", fluid=BOILING_K, backplate=BOILING_K)
    found = watched.monitor.add(block)

    now, ahead = found[0], found[-1]
    assert now.probability_now == pytest.approx(0.5, abs=0.02)
    assert now.corners["FL"].probability_now == now.probability_now
    assert now.corners["FR"].probability_now == 0.0
    assert ahead.forecast_us == block.times_us[0]
    assert ahead.probability == pytest.approx(
        ahead.corners["FL"].probability, abs=1e-9
    )
    assert ahead.probability > 0.45
    assert ahead.corners["FR"].probability == 0.0


def test_each_fluid_may_be_the_hottest() -> None:
    """Of two corners alike, the hotter one of each member counts."""
    watched = Watched("FL", "FR")
    block = watched.at_rest(1)
    for name in ("FL", "FR"):
        watched.put(block, name, fluid=BOILING_K - 3.0, backplate=400.0)
    found = watched.monitor.add(block)[-1]

    each = [found.corners[name].probability for name in ("FL", "FR")]
    assert each[0] == each[1] == pytest.approx(0.25, abs=0.1)
    # the heat so far is common to both
    assert found.probability == pytest.approx(each[0], abs=1e-9)
    peaks = watched.monitor.peaks_k()
    assert peaks["FL"] == peaks["FR"]
    assert len(peaks["FL"]) == found.members


@pytest.mark.parametrize(("other_k", "ensembles"), [(400.0, 1), (401.0, 2)])
def test_corners_that_are_the_same_are_marched_once(
    other_k: float, ensembles: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And give what each would alone; a kelvin makes them two."""
    begun: list[march.Job] = []
    of_members = march.Job.of_members

    def counted(*args: Any, **kwargs: Any) -> march.Job:
        begun.append(of_members(*args, **kwargs))
        return begun[-1]

    def risks(*names: str) -> Mapping[str, CornerRisk]:
        watched = Watched(*names)
        block = watched.at_rest(2)
        for name, fluid_k in {"FL": 400.0, "FR": other_k}.items():
            if name in names:
                watched.put(block, name, fluid=fluid_k, **HOT_PADS_K)
        return watched.monitor.add(block)[-1].corners

    alone = risks("FL") | risks("FR")
    monkeypatch.setattr(march.Job, "of_members", counted)

    assert risks("FL", "FR") == alone
    assert len(begun) == ensembles


def test_corners_of_other_parts_are_each_foreseen() -> None:
    """They are marched apart, as their networks have other nodes."""
    watched = Watched("FL", "FR")
    left, right = watched.config.corner
    assert right.pad is not None
    pad = right.pad.model_copy(update={"slabs": right.pad.slabs + 2})
    other = right.model_copy(update={"pad": pad})
    watched.config = watched.config.model_copy(
        update={"corner": [left, other]}
    )
    watched.estimator = Estimator(watched.config, MAPPED, history_known=True)
    watched.monitor = RiskMonitor(watched.config, watched.estimator)
    block = watched.at_rest(3)
    watched.put(block, "FL", fluid=400.0, **HOT_PADS_K)
    watched.put(block, "FR", fluid=330.0)

    found = watched.monitor.add(block)[-1].corners

    assert found["FL"].level is RiskLevel.CRITICAL
    assert found["FL"].peak_k > 430.0
    assert found["FR"].level is RiskLevel.NORMAL
    assert found["FR"].peak_k == pytest.approx(330.0, abs=1.0)


def test_what_was_not_matched_is_less_certain() -> None:
    """A matched corner, one alike and one that was not, the same inside."""
    watched = Watched("FL", "FR", "RL")
    known = MatchedConfig(
        corners=["FL"],
        alike=["FR"],
        names=[],
        values=[],
        factor=[],
        form_k={"fluid": 1.0},
    )
    unset = watched.config.forecast.model_copy(update={"uncertainty": None})
    watched.config = watched.config.model_copy(
        update={"matched": [known], "forecast": unset}
    )
    watched.monitor = RiskMonitor(watched.config, watched.estimator)
    block = watched.at_rest(3)
    for name in watched.names:
        watched.put(block, name, fluid=380.0)

    found = watched.monitor.add(block)[-1].corners

    one_k = found["FL"].fluid_deviation_k
    assert one_k > 1.0
    assert found["FR"].fluid_deviation_k == pytest.approx(3.0 * one_k)
    assert found["RL"].fluid_deviation_k == pytest.approx(6.0 * one_k)
    sure, open_ = found["FL"].probability, found["RL"].probability
    assert sure < 1e-3
    assert open_ > 0.01
    blind = known.model_copy(update={"form_k": {"disc": 1.0}})
    of_disc = watched.config.model_copy(update={"matched": [blind]})
    assert of_disc.uncertainty_of("FL") == 6.0
    # its own match counts, whatever it had of another before
    own = known.model_copy(update={"corners": ["FR"], "alike": []})
    both = watched.config.model_copy(update={"matched": [known, own]})
    assert both.uncertainty_of("FR") == 1.0
    given = unset.model_copy(update={"uncertainty": 2.0})
    told = watched.config.model_copy(update={"forecast": given})
    assert [told.uncertainty_of(one) for one in ("FL", "RL")] == [2.0, 2.0]


def test_vapour_ahead_counts_though_the_fluid_is_cold_now() -> None:
    """A hot backplate behind a cold fluid."""
    watched = Watched("FL", "FR")
    block = watched.at_rest(3)
    watched.put(block, "FR", fluid=400.0, **HOT_PADS_K)
    found = watched.monitor.add(block)[-1]

    assert found.probability_now < 0.1
    assert found.probability > 0.9
    assert found.level is RiskLevel.CRITICAL
    assert found.corners["FR"].probability_now == found.probability_now
    assert found.corners["FR"].probability == found.probability
    assert found.corners["FR"].level is RiskLevel.CRITICAL
    assert found.corners["FL"].level is RiskLevel.NORMAL


def test_vapour_now_counts_though_the_forecast_saw_none() -> None:
    """The fluid gets hot after the forecast has begun, and cools again."""
    watched = Watched("FL", "FR")
    block = watched.at_rest(9)
    watched.put(block, "FL", 10, fluid=BOILING_K + 40.0)
    watched.put(block, "FL", 50, fluid=300.0)
    found = watched.monitor.add(block)

    whole = next(
        i
        for i, time_us in enumerate(block.times_us)
        if i >= 10 and time_us % 1_000_000 == 0
    )
    hot, cooled = found[whole], found[-1]
    assert hot.forecast_us == block.times_us[0]
    assert hot.probability_now == hot.probability == 1.0
    assert hot.level is RiskLevel.CRITICAL
    corner = hot.corners["FL"]
    assert corner.probability_now == corner.probability == 1.0
    assert corner.level is RiskLevel.CRITICAL
    assert cooled.probability_now == cooled.probability == 0.0
    assert cooled.level is RiskLevel.CRITICAL


def test_a_late_forecast_does_not_hide_vapour_now(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It began cold and is told when the fluid boils already."""
    monkeypatch.setattr(course_risk, "COMPILED_STEPS", 10)
    watched = Watched("FL", "FR")
    block = watched.at_rest(6)
    watched.put(block, "FL", 5, fluid=BOILING_K + 40.0)
    found = watched.monitor.add(block)

    # ten publications a corner, then the result
    told = first_forecast(found)
    assert told == 20
    for record in (found[told - 1], found[told]):
        assert record.probability == 1.0
        assert record.corners["FL"].probability == 1.0
        assert record.corners["FL"].level is RiskLevel.CRITICAL
    assert found[told].corners["FL"].peak_k < 300.0


def test_a_forecast_speaks_of_half_an_hour() -> None:
    """Peaks, their time, and when it is safe, of a brake that parks hot."""
    watched = Watched("FL", "FR")
    block = watched.at_rest(2)
    watched.put(block, "FR", fluid=390.0, **HOT_PADS_K)
    found = watched.monitor.add(block)[-1]
    monitor = watched.monitor
    corner = monitor.course._corners[1]
    course = parked_course(
        corner.ensemble,
        monitor.course._kernel,
        list(block.at(0).state("FR").values()),
        block.at(0).channel("FR", "ambient_k"),
        factor=1.0,
    )
    boiling = monitor.fluid.boiling(block.times_us[0])

    told = found.corners["FR"]
    peaks = [max(one[:68]) for one in course.fluid_k]
    assert course.times_s[67] == HORIZON_S == 1800.0
    assert list(monitor.peaks_k()["FR"]) == peaks
    assert (told.peak_k, told.peak_in_s) == course.peak(1800.0)
    assert 0.01 < told.probability < 0.99
    assert told.probability == boiling.mean_probability(peaks)
    assert told.safe_in_s == course.safe_in_s(boiling, 0.01)
    assert told.safe_in_s > course.safe_in_s(boiling, 0.1) > told.peak_in_s
    cold = found.corners["FL"]
    assert cold.safe_in_s == 0.0
    assert cold.duty_in_s == inf


def test_on_duty_only_a_corner_within_reach_is_marched(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of the other the bound is told: its hottest node, as it has no power."""
    marched = []
    begin = march.Job.of_corners.__func__

    def begun(cls: type, batch: Any, states: Any, *of: Any) -> march.Job:
        marched.append((len(states), of[1]))
        job: march.Job = begin(cls, batch, states, *of)
        return job

    monkeypatch.setattr(march.Job, "of_corners", classmethod(begun))
    watched = Watched("FL", "FR")
    block = watched.at_rest(3)
    watched.put(block, "FL", disc=330.0)
    watched.put(block, "FR", fluid=390.0, **HOT_PADS_K)
    found = watched.monitor.add(block)[-1].corners

    parked, duty = (2, march.NEAR_STEPS), (2, march.DUTY_STEPS)
    assert marched == [parked, duty]
    assert found["FL"].duty_in_s == inf
    # three deviations of 3 % and a margin of 1 K above 330 K
    assert 330.0 < found["FL"].duty_peak_k < 336.0
    assert found["FR"].duty_peak_k > 390.0
    assert found["FR"].duty_in_s < inf


def test_a_fluid_that_goes_on_to_warm_is_told_up_to_the_horizon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A course of 90 min that rises by 1 K a minute, whoever marches."""
    times = tuple(60.0 * i for i in range(91))
    rising = tuple(410.0 + i for i in range(91))
    monkeypatch.setattr(
        march.Job, "course", lambda job: Course(times, [rising] * job.lanes)
    )
    monkeypatch.setattr(
        corner_march.CornerMarch,
        "range_k",
        lambda *_, is_present: Range([0.0] * 64, [inf] * 64),  # noqa: ARG005
    )
    monkeypatch.setattr(
        corner_march.CornerMarch,
        "on_duty_k",
        lambda *_, is_present: inf,  # noqa: ARG005
    )
    watched = Watched("FL")
    found = watched.monitor.add(watched.at_rest(3))[-1].corners["FL"]

    assert watched.monitor.peaks_k() == {"FL": (440.0,) * 64}
    assert (found.peak_k, found.peak_in_s) == (440.0, 1800.0)
    assert found.duty_peak_k == 440.0
    assert found.safe_in_s == inf
    # a tenth of the fluids and deviations boil before the median does
    assert 900.0 < found.duty_in_s < 60.0 * (BOILING_K - 410.0)


def levels(**corners: RiskLevel) -> dict[str, Any]:
    """Return a saved memory with levels of the fluid at each corner."""
    saved = {f"{c}.fluid": [int(level), None] for c, level in corners.items()}
    return {"levels": saved}


def after(
    validity: Mapping[str, Validity], **raised: RiskLevel
) -> tuple[CarRisk, RiskMonitor]:
    """Return the first risk of cold brakes with *raised* levels before."""
    watched = Watched(*validity)
    watched.monitor.resume({"risk": levels(**raised)}, None, START_US)
    block = watched.at_rest(1)
    count = len(block.times_us)
    codes = {n: array("b", [v] * count) for n, v in validity.items()}
    found = watched.monitor.add(replace(block, validity=codes))
    return found[-1], watched.monitor


def test_a_corner_without_an_estimate_hides_no_raised_level() -> None:
    """The worst of what is known is that of the car."""
    validity = {
        "FL": Validity.VALID,
        "FR": Validity.INVALID,
        "RL": Validity.DEGRADED,
    }
    found, _ = after(
        validity,
        FL=RiskLevel.ELEVATED,
        FR=RiskLevel.CRITICAL,
        RL=RiskLevel.HIGH,
    )

    assert found.level is RiskLevel.HIGH
    assert found.corners["FL"].level is RiskLevel.ELEVATED
    assert found.corners["FR"].level is RiskLevel.UNKNOWN
    assert found.corners["RL"].level is RiskLevel.HIGH


def test_a_corner_without_an_estimate_is_no_normal_car() -> None:
    """Nothing is raised, and one corner is not known."""
    found, _ = after({"FL": Validity.VALID, "FR": Validity.INVALID})

    assert found.level is RiskLevel.UNKNOWN
    assert found.corners["FL"].level is RiskLevel.NORMAL


def test_levels_of_valid_corners_and_the_car_s_own() -> None:
    """The car has a memory of its own; corners have theirs."""
    validity = dict.fromkeys(("FL", "FR"), Validity.DEGRADED)
    found, _ = after(validity, FR=RiskLevel.HIGH)

    assert found.level is RiskLevel.NORMAL
    assert found.corners["FR"].level is RiskLevel.HIGH


def test_a_degraded_corner_is_twice_as_uncertain() -> None:
    """Its fluid now, and its forecast."""
    found = {}
    for validity in (Validity.VALID, Validity.DEGRADED):
        watched = Watched("FL")
        block = watched.at_rest(2)
        watched.put(block, "FL", fluid=400.0, backplate=450.0)
        codes = {"FL": array("b", [validity] * len(block.times_us))}
        record = watched.monitor.add(replace(block, validity=codes))[-1]
        peaks = watched.monitor.peaks_k()["FL"]
        found[validity] = (
            record.corners["FL"].fluid_deviation_k,
            max(peaks) - min(peaks),
        )

    once, twice = found[Validity.VALID], found[Validity.DEGRADED]
    rise_k = 400.0 - watched.at_rest(1, 2).at(0).channel("FL", "ambient_k")
    assert once[0] ** 2 == pytest.approx(13e-4 * rise_k**2 + 1.0)
    assert twice[0] == pytest.approx(2.0 * once[0])
    assert twice[1] > 1.3 * once[1]


@pytest.mark.parametrize(
    ("node", "kelvin", "level"),
    [
        ("disc", 0.5, RiskLevel.ELEVATED),
        ("disc", -0.5, RiskLevel.NORMAL),
        ("pad_front", 0.5, RiskLevel.ELEVATED),
        ("pad_front", -0.5, RiskLevel.NORMAL),
    ],
)
def test_fade_goes_by_disc_and_pads_each_with_its_limits(
    node: str, kelvin: float, level: RiskLevel
) -> None:
    watched = Watched("FL", "FR")
    forecast = watched.config.forecast
    limits = {
        "disc": forecast.disc_limits_c,
        "pad_front": forecast.pad_limits_c,
    }
    assert limits["disc"] != limits["pad_front"]
    block = watched.at_rest(1)
    at_k = limits[node][0] + KELVIN_OFFSET + kelvin
    watched.put(block, "FR", **{node: at_k})
    found = watched.monitor.add(block)[-1]

    assert found.corners["FR"].fade is level
    assert found.corners["FL"].fade is RiskLevel.NORMAL
    assert found.level is RiskLevel.NORMAL


def test_a_hole_ends_the_duty_and_what_was_foreseen() -> None:
    """More than two seconds without a publication; less is none."""
    watched = Watched("FL", "FR")
    block = watched.at_rest(10)
    monitor = watched.monitor
    monitor.add(block)
    duties = [corner.duty for corner in monitor.course._corners]
    for duty in duties:
        duty._means, duty._weight = [12.0, 8e5, 1.0, 4e3], 1.0
    last_us = block.times_us[-1]

    def go_on(after_us: int) -> CarRisk:
        shifted = [
            last_us + after_us + t - block.times_us[0] for t in block.times_us
        ]
        one = replace(block, times_us=array("q", shifted[:1]))
        return monitor.add(one)[0]

    assert go_on(2_000_000).forecast_us is not None
    assert [d.conditions(283.15).speed_ms for d in duties] == (
        pytest.approx([12.0, 12.0], abs=0.4)
    )
    assert all(monitor.peaks_k().values())

    found = go_on(4_000_001)
    assert [d.conditions(283.15) for d in duties] == [Conditions(283.15)] * 2
    assert found.forecast_us is None
    assert not any(monitor.peaks_k().values())
    assert isnan(found.corners["FL"].peak_k)


def test_vapour_while_away_within_the_time_it_was_parked() -> None:
    """A minute is too short for the fluid to get hot; 20 min are not."""
    away = {}
    for parked_s in (60.0, 1200.0):
        watched = Watched("FL", "FR")
        states = {
            "FL": watched.state(),
            "FR": watched.state(fluid=400.0, **HOT_PADS_K),
        }
        monitor = watched.monitor
        parked_us = round(parked_s * 1e6)
        monitor.resume(watched.saved(states), parked_us, START_US)
        away[parked_s] = monitor.course.away
        by_corner = [c.level.level for c in monitor.course._corners]
        hot = parked_s > 60.0
        assert by_corner[0] is RiskLevel.NORMAL
        assert (by_corner[1] is RiskLevel.CRITICAL) == hot
        assert (monitor.course._level.level is RiskLevel.CRITICAL) == hot

    assert away[60.0] < 0.01
    assert away[1200.0] > 0.6

    # the same where the time is corrected after the start
    monitor = watched.monitor
    saved = watched.saved(states)
    late = Watched("FL", "FR").monitor
    late.resume(saved, 60_000_000, START_US)
    late.look_back(saved, 1_200_000_000, START_US + 5_000_000)
    assert late.course.away == monitor.course.away
    assert late.course._level.level is RiskLevel.CRITICAL


def test_a_state_without_a_corner_or_time_says_nothing_of_it() -> None:
    """The other corner counts alone; no time away is no vapour."""
    watched = Watched("FL", "FR")
    hot = watched.state(fluid=BOILING_K + 40.0)
    saved = watched.saved({"FR": hot})
    watched.monitor.resume(saved, 1_000_000, START_US)
    assert watched.monitor.course.away == 1.0
    assert watched.monitor.course._corners[0].level == LevelMemory()

    watched = Watched("FL", "FR")
    for parked_us in (None, 0):
        watched.monitor.resume(saved, parked_us, START_US)
        assert isnan(watched.monitor.course.away)


@pytest.mark.parametrize("air_c", [-20.0, 45.0])
def test_a_car_away_cooled_in_the_air_of_its_configuration(
    air_c: float,
) -> None:
    """Where its state tells of none."""
    found = []
    for told in (True, False):
        watched = Watched("FL")
        vehicle = watched.config.vehicle.model_copy(
            update={"ambient_c": air_c}
        )
        config = watched.config.model_copy(update={"vehicle": vehicle})
        monitor = RiskMonitor(config, watched.estimator)
        saved = watched.saved({"FL": watched.state(fluid=420.0, **HOT_PADS_K)})
        saved["ambient_k"] = air_c + KELVIN_OFFSET if told else None
        monitor.resume(saved, 600_000_000, START_US)
        found.append(monitor.course.away)

    assert found[0] == found[1] > 0.0


def test_a_duty_that_goes_on_is_foreseen_from_the_braking_so_far() -> None:
    """12 m/s at 8 bar: by its own mean power, and hotter than parked."""
    watched = Watched("FL")
    times, roles, values = array("q"), array("i"), array("d")
    for tenth in range(145):
        for role, one in ((SPEED, 12.0), (PRESSURE, 8e5)):
            times.append(START_US + 100_000 * tenth)
            roles.append(role)
            values.append(one)
    (block,) = watched.estimator.advance(times, roles, values)
    found = watched.monitor.add(block)[-1].corners["FL"]

    duty = watched.monitor.course._corners[0].duty.conditions(283.15)
    assert duty.speed_ms == pytest.approx(12.0)
    assert duty.pressure_pa == pytest.approx(8e5)
    assert duty.brake_on == pytest.approx(1.0)
    power_w = block.at(140).channel("FL", "brake_power_w")
    assert power_w > 1000.0
    assert duty.power_w == pytest.approx(power_w, rel=1e-6)
    assert found.duty_peak_k > found.peak_k + 20.0


def test_a_record_is_the_same_object_until_something_changes() -> None:
    """Ten publications share one; another validity makes a new one."""
    watched = Watched("FL")
    block = watched.at_rest(4)
    count = len(block.times_us)
    codes = array("b", [Validity.VALID] * count)
    codes[25] = Validity.DEGRADED
    found = watched.monitor.add(replace(block, validity={"FL": codes}))

    changed = [i for i in range(20, 30) if found[i] is not found[i - 1]]
    whole = [i for i in range(20, 30) if block.times_us[i] % 1_000_000 == 0]
    assert changed == sorted({25, 26, *whole})


LIKELY_K = 431.0
"""Temperature at which vapour is elevated, but not high."""


@pytest.mark.parametrize(
    ("level", "peaks_k", "sure"),
    [
        (RiskLevel.NORMAL, [(0.0, 300.0), (0.0, 310.0)], [True, True]),
        (RiskLevel.NORMAL, [(0.0, WARM_K), (0.0, 300.0)], [True, True]),
        (RiskLevel.NORMAL, [(0.0, inf), (0.0, 300.0)], [False, True]),
        # it may be the hotter one of a member, so the car's level needs it
        (RiskLevel.NORMAL, [(0.0, inf), (0.0, WARM_K)], [False, False]),
        # unless another one is
        (RiskLevel.NORMAL, [(600.0, 600.0), (0.0, WARM_K)], [True, True]),
        # whatever it is, a level that is raised stays, or falls
        (RiskLevel.CRITICAL, [(600.0, inf), (600.0, inf)], [True, True]),
        (RiskLevel.CRITICAL, [(0.0, 600.0), (0.0, 300.0)], [False, True]),
        (RiskLevel.ELEVATED, [(0.0, LIKELY_K), (0.0, 300.0)], [False, True]),
        (
            RiskLevel.ELEVATED,
            [(LIKELY_K, LIKELY_K), (0.0, WARM_K)],
            [True, True],
        ),
    ],
)
def test_members_that_decide_no_level_are_not_marched(
    level: RiskLevel, peaks_k: list[tuple[float, float]], sure: list[bool]
) -> None:
    course = Watched("FL", "FR").monitor.course
    for memory in course.memories().values():
        memory.level = level
    boiling = FluidKnowledge(car("FL").fluid).boiling(START_US)
    assert 0.0 < boiling.probability(WARM_K) < 0.005
    assert 0.01 < boiling.probability(LIKELY_K) < 0.1
    for corner in course._corners:
        corner.march.raised_us = START_US
    ranges = [Range([least] * 8, [most] * 8) for least, most in peaks_k]
    forecast = CarForecast(
        *(course._marched, START_US, [], ranges, boiling),
        at_stop=False,
        wait=0,
    )

    assert [forecast.is_sure(i) for i in (0, 1)] == sure


@pytest.mark.parametrize(
    ("marched", "bound", "ahead", "age_us", "asked"),
    [
        # its own march is there: wherever it is of use
        (True, False, 0.0, 0, ["of use"]),
        (True, True, 0.5, 0, ["of use"]),
        # of the bound, too, for the time until it is safe, now and then
        (False, True, 0.5, None, ["always"]),
        (False, True, nan, None, ["always"]),
        (False, True, 0.5, REFRESH_US, ["always"]),
        (False, True, 0.5, REFRESH_US - 1, []),
        (False, True, 0.0, None, []),
        (False, False, 0.5, None, []),
    ],
)
def test_when_a_march_is_begun_for_later_forecasts(
    monkeypatch: pytest.MonkeyPatch,
    *,
    marched: bool,
    bound: bool,
    ahead: float,
    age_us: int | None,
    asked: list[str],
) -> None:
    course = Watched("FL").monitor.course
    (corner,) = course._corners
    corner.ahead, course._is_bound = ahead, bound
    ours = corner.march
    ours.raised_us = None if age_us is None else START_US - age_us
    found = []

    def raise_ceiling(_start: Any, _most_k: Any, is_of_use: Any) -> bool:
        found.append("always" if is_of_use is None else "of use")
        return True

    monkeypatch.setattr(ours, "raise_ceiling", raise_ceiling)
    boiling = FluidKnowledge(car("FL").fluid).boiling(START_US)
    forecast: Any = CarForecast(
        *(course._marched, START_US, [None], [Range([0.0], [inf])], boiling),
        at_stop=False,
        wait=0,
    )
    forecast.marched = {0: None} if marched else {}

    course._raise_ceiling(forecast, 0)

    assert found == asked
    assert course._raising == [ours] * len(asked)
    if asked:
        assert ours.raised_us == START_US


def test_a_ceiling_of_one_corner_is_of_use_beside_a_hotter_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    course = Watched("FL", "FR").monitor.course
    found = []

    def raise_ceiling(_start: Any, _most_k: Any, is_of_use: Any) -> bool:
        found.extend(map(is_of_use, (0.0, 0.005, 1.0)))
        return False

    monkeypatch.setattr(
        course._corners[0].march, "raise_ceiling", raise_ceiling
    )
    boiling = FluidKnowledge(car("FL").fluid).boiling(START_US)
    ranges = [Range([300.0], [300.0]), Range([LIKELY_K], [inf])]
    assert 0.01 < boiling.probability(LIKELY_K) < 0.1
    forecast: Any = CarForecast(
        *(course._marched, START_US, [None, None], ranges, boiling),
        at_stop=False,
        wait=0,
    )
    forecast.marched = {0: None}

    course._raise_ceiling(forecast, 0)

    assert found == [True, True, False]

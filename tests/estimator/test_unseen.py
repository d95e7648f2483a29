"""Driving that nobody saw: a hole in the data has the heat of the history."""

from __future__ import annotations

import json
from array import array
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.channels import FLAGS
from bstm_daemon.estimate import Validity
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.state import (
    export_state,
    park,
    restore_state,
    resume_state,
)
from bstm_daemon.estimator.trust import MEMORY
from bstm_daemon.estimator.unseen import (
    KEPT,
    LEAST_S,
    Unseen,
    coarse_steps,
)
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.model.thermal.regrid import heat_above_j
from bstm_daemon.model.wear.dose import DOSE
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config.sections import Config, CornerConfig

pytestmark = pytest.mark.usefixtures("all_verified")

SECOND = 1_000_000
HOUR_S = 3600.0
SPEED, PRESSURE = ROLE_INDEX["vehicle_speed"], ROLE_INDEX["primary_pressure"]
PRESENT = {SPEED: 500_000, PRESSURE: 500_000}
AIR_K = 293.15
MASS_KG = 2194.0
CORNERS = ("FL", "RL")
POWER = "brake_power_w"

Samples = list[tuple[int, int, float]]


@pytest.fixture(scope="session")
def config(
    make_car: Callable[..., Config], make_corner: Callable[..., CornerConfig]
) -> Config:
    return make_car(make_corner("FL"), make_corner("RL"))


class Drive:
    """A car whose bus, clock and computer the test stops."""

    def __init__(self, config: Config, *, ticks: bool = False) -> None:
        self.estimator = Estimator(config, PRESENT, history_known=True)
        self.now_us = 0
        self.blocks: list[Any] = []
        self._ticks = ticks

    def feed(self, samples: Samples) -> None:
        """Feed all at once, or as a live service does."""
        step = 7 if self._ticks else len(samples)
        parts = [
            samples[first : first + step]
            for first in range(0, len(samples), step)
        ]
        for part in parts:
            times, roles, values = zip(*part, strict=True)
            self.blocks += self.estimator.advance(
                array("q", times), array("i", roles), array("d", values)
            )

    def go(
        self,
        seconds: float,
        speed_ms: float = 20.0,
        pressure_pa: float = 0.0,
        every_us: int = 100_000,
    ) -> Drive:
        """Go on; samples come every *every_us* [us]."""
        until_us = self.now_us + round(seconds * 1e6)
        self.feed(
            [
                (at, role, value)
                for at in range(self.now_us, until_us, every_us)
                for role, value in ((SPEED, speed_ms), (PRESSURE, pressure_pa))
            ]
        )
        self.now_us = until_us
        return self

    def descend(self, seconds: float, speed_ms: float = 20.0) -> Drive:
        """Brake with 5 bar: about 4 kW a corner at 20 m/s."""
        return self.go(seconds, speed_ms, 5e5)

    def hole(self, seconds: float) -> Drive:
        """Let nothing come; a live service ticks meanwhile."""
        until_us = self.now_us + round(seconds * 1e6)
        if self._ticks:
            self.feed(
                [
                    (at, TICK, 0.0)
                    for at in range(self.now_us, until_us, 50_000)
                ]
            )
        self.now_us = until_us
        return self

    def sleep(self, seconds: float) -> Drive:
        """Stop the process."""
        park(self.estimator, seconds)
        self.now_us += round(seconds * 1e6)
        return self

    def restart(self, seconds: float, parked_s: float | None = None) -> Drive:
        """Start again after *seconds*, which the clocks prove."""
        return self.start(seconds, proven_s=seconds, is_exact=True)

    def start(
        self, seconds: float, *, proven_s: float | None, is_exact: bool
    ) -> Drive:
        """Start again after *seconds*, of which *proven_s* are proven."""
        self.feed([(self.now_us, TICK, 0.0)])
        document = json.loads(
            json.dumps(export_state(self.estimator), allow_nan=False)
        )
        proven_us = None
        if proven_s is not None:
            proven_us = round(proven_s * 1e6)
            if document["time_us"] is not None:
                proven_us += self.now_us - document["time_us"]
        self.now_us += round(seconds * 1e6)
        self.estimator = Estimator(self.estimator.config, PRESENT)
        resume_state(
            self.estimator, document, proven_us, self.now_us, proven=is_exact
        )
        return self

    def nodes_k(self, corner: str = "FL") -> dict[str, float]:
        state = self.estimator.state(corner)
        nodes = self.estimator.programs[corner].network.nodes
        return {node.name: state[node.name] for node in nodes}

    def validity(self) -> int:
        """Return that of the last publication."""
        found: int = self.blocks[-1].validity["FL"][-1]
        return found

    def flags(self) -> int:
        """Return those of all publications since the last call, or-ed."""
        flags = 0
        for block in self.blocks:
            for one in block.flags:
                flags |= one
        self.blocks.clear()
        return flags


def hotter(drive: Drive, other: Drive, by_k: float = 0.0) -> bool:
    """Whether no node of *drive* is colder than in *other*."""
    return all(
        kelvin >= other.nodes_k(corner)[node] + by_k
        for corner in CORNERS
        for node, kelvin in drive.nodes_k(corner).items()
    )


def blind(config: Config) -> Drive:
    """Return a car that takes every hole for parking."""
    drive = Drive(config)
    drive.estimator.unseen._heat = (  # type: ignore[method-assign]
        lambda *_args, **_options: None
    )
    return drive


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [75.0, 600.0])
def test_a_steady_load_goes_on_in_the_hole(
    config: Config, seconds: float
) -> None:
    """The hole has the same power for the same time: within a few kelvin."""
    seen = Drive(config).descend(900.0).descend(seconds).descend(1.0)
    unseen = Drive(config).descend(900.0).hole(seconds).descend(1.0)
    parked = blind(config).descend(900.0).hole(seconds).descend(1.0)

    assert seen.nodes_k()["disc"] > AIR_K + 100.0
    for corner in CORNERS:
        for node, kelvin in seen.nodes_k(corner).items():
            unseen_k = unseen.nodes_k(corner)[node]
            assert kelvin - 0.3 < unseen_k < kelvin + 12.0, node
    drop_k = seen.nodes_k()["disc"] - parked.nodes_k()["disc"]
    assert drop_k > 20.0


def test_the_energy_is_power_times_duration(config: Config) -> None:
    """A minute at 4 kW into brakes at the temperature of the air."""
    drive = Drive(config).descend(120.0)
    batch, _ = drive.estimator.batches[0]
    place = batch.programs[0].ledger_names.index("disc_heat")
    booked_j = batch.ledger[place]
    for batch, member, _ in drive.estimator.members():
        batch.settle(AIR_K, member)
    power_w = drive.blocks[-1].at(0).channel("FL", POWER)
    drive.hole(61.0).go(0.02)

    network = drive.estimator.programs["FL"].network
    nodes_k = list(drive.nodes_k().values())
    stored_j = heat_above_j(network, nodes_k, AIR_K)
    heated_j = power_w * 61.0
    assert power_w > 3e3
    # the rest is what the air took in that minute
    assert 0.8 * heated_j < stored_j < heated_j
    # what is assumed is not booked; pressure counts until its time-out
    assert batch.ledger[place] - booked_j < 0.6 * power_w


def test_a_short_hole_may_have_one_full_stop(config: Config) -> None:
    """From 30 m/s, with nothing in the history; half by the front axle."""
    drive = Drive(config).go(90.0, 30.0).hole(10.0).go(0.02, 10.0)
    network = drive.estimator.programs["FL"].network
    stored_j = heat_above_j(network, list(drive.nodes_k().values()), AIR_K)
    share = drive.estimator.plan.numbers.force_share[0]
    stop_j = share * 0.5 * MASS_KG * 30.0**2
    assert 0.85 * stop_j < stored_j < stop_j


def test_the_hottest_minutes_count(config: Config) -> None:
    """Two minutes of a descent a quarter of an hour ago."""
    gentle = Drive(config).go(1020.0).hole(100.0).go(0.02)
    steep = Drive(config).descend(120.0).go(900.0).hole(100.0).go(0.02)
    forgotten = Drive(config).descend(120.0).go(60.0 * KEPT)
    forgotten.hole(100.0).go(0.02)

    disc_k = [d.nodes_k()["disc"] for d in (gentle, forgotten, steep)]
    assert disc_k[2] > disc_k[1] + 30.0
    assert disc_k[1] == pytest.approx(disc_k[0], abs=3.0)


@pytest.mark.slow
def test_a_long_hole_ends_with_the_hottest_stretch(config: Config) -> None:
    """Before that it has the mean: the disc has forgotten which was first."""
    drives = [Drive(config).descend(600.0).go(900.0) for _ in range(2)]
    steady = Drive(config).descend(600.0)
    for drive, hole_s in zip(
        (*drives, steady), (600, 3000, 3000), strict=True
    ):
        drive.hole(hole_s).go(0.02)
    short, long, hot = (drive.nodes_k() for drive in (*drives, steady))
    assert long["disc"] == pytest.approx(short["disc"], abs=25.0)
    assert short["disc"] > AIR_K + 100.0
    assert long["fluid"] > short["fluid"] + 1.0
    assert hot["fluid"] > long["fluid"] + 5.0


def test_tyres_limit_the_heat(config: Config) -> None:
    """Full braking for a minute and a hole of 6 s: 1 g at 20 m/s."""
    drive = Drive(config).go(60.0, 20.0, 1.5e7, every_us=20_000)
    for batch, member, _ in drive.estimator.members():
        batch.settle(AIR_K, member)
    drive.hole(6.0).go(0.02)
    networks = [drive.estimator.programs[c].network for c in CORNERS]
    stored_j = sum(
        heat_above_j(network, list(drive.nodes_k(c).values()), AIR_K)
        for network, c in zip(networks, CORNERS, strict=True)
    )
    # as long as the last pressure counts, and the hole
    seen_j = 0.5 * sum(
        drive.blocks[0].at(9).channel(c, POWER) for c in CORNERS
    )
    assert seen_j > 1e5
    assert stored_j < seen_j + 9.80665 * MASS_KG * 20.0 * 6.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before_ms", "after_ms", "stop"),
    [
        (20.0, 0.0, lambda drive: drive.restart(300.0)),
        (20.0, 0.0, lambda drive: drive.sleep(300.0)),
        (20.0, 0.0, lambda drive: drive.hole(2 * HOUR_S)),
        (4.0, 20.0, lambda drive: drive.hole(300.0)),
        (0.0, 20.0, lambda drive: drive.restart(300.0)),
        (0.0, 0.0, lambda drive: drive.hole(300.0)),
    ],
)
def test_a_car_that_stood_on_one_side_was_parked(
    config: Config,
    before_ms: float,
    after_ms: float,
    stop: Callable[[Drive], Drive],
) -> None:
    drive = Drive(config).descend(120.0).go(1.0, before_ms)
    hot_k = drive.nodes_k()["disc"]
    stop(drive).go(1.0, after_ms)
    assert not drive.flags() & FLAGS["driven_unseen"]
    assert drive.nodes_k()["disc"] < hot_k - 20.0


@pytest.mark.slow
def test_a_bus_that_falls_silent_at_speed(config: Config) -> None:
    """The car came to a stop unseen: as hot as if it still drove."""
    drives = [Drive(config), Drive(config)]
    for drive, after_ms in zip(drives, (0.0, 20.0), strict=True):
        drive.descend(600.0).hole(300.0).go(0.02, after_ms)
        assert drive.estimator.unseen.driven == 1
    assert drives[0].nodes_k() == drives[1].nodes_k()


@pytest.mark.parametrize("speeds_ms", [(20.0, 0.0), (0.0, 20.0)])
def test_a_silence_that_may_hide_braking_degrades(
    config: Config, speeds_ms: tuple[float, float]
) -> None:
    """The car came to a stop in it, or set off."""
    before_ms, after_ms = speeds_ms
    drive = Drive(config).descend(60.0).go(2.0, before_ms)
    drive.hole(20.0).go(1.0, after_ms)
    assert drive.validity() == Validity.DEGRADED
    drive.go(MEMORY * 20.0 - 30.0, after_ms)
    assert drive.validity() == Validity.DEGRADED
    # speeds that jump are suspect for two seconds, too
    drive.go(100.0, after_ms)
    assert drive.validity() == Validity.VALID


def test_a_car_that_stands_a_day_later_is_cold(config: Config) -> None:
    drive = Drive(config).descend(300.0).hole(24 * HOUR_S).go(5.0, 0.0)
    assert drive.validity() == Validity.VALID
    for kelvin in drive.nodes_k().values():
        assert kelvin == pytest.approx(AIR_K, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "stop",
    [
        lambda drive: drive.hole(75.0),
        lambda drive: drive.sleep(75.0),
        lambda drive: drive.restart(30.0),
        lambda drive: drive.restart(75.0),
    ],
    ids=["silence", "sleep", "restart of 30 s", "restart of 75 s"],
)
def test_every_kind_of_hole(
    config: Config, stop: Callable[[Drive], Drive]
) -> None:
    """Degraded for 30 times as long as it was; a flag says why."""
    start_us = Drive(config).descend(600.0).now_us
    drive = Drive(config).descend(600.0)
    parked = blind(config).descend(600.0)
    assert drive.validity() == Validity.VALID
    hole_s = (stop(drive).now_us - start_us) * 1e-6
    parked.hole(hole_s)
    drive.flags()

    drive.descend(1.0)
    parked.descend(1.0)

    assert hotter(drive, parked)
    assert drive.nodes_k()["disc"] > parked.nodes_k()["disc"] + 15.0
    assert drive.validity() == Validity.DEGRADED
    assert drive.flags() & FLAGS["driven_unseen"]
    drive.descend(MEMORY * hole_s - 10.0)
    assert drive.validity() == Validity.DEGRADED
    drive.descend(15.0)
    assert drive.validity() == Validity.VALID
    assert not drive.flags() & FLAGS["driven_unseen"]


@pytest.mark.slow
@pytest.mark.parametrize("hours", [2.0, 24.0, 29.0 * 24.0])
def test_a_clock_that_jumps_ahead_cools_nothing(
    config: Config, hours: float
) -> None:
    """It may have been set, or hours of driving may be missing."""
    drive = Drive(config).descend(600.0)
    before = {corner: drive.nodes_k(corner) for corner in CORNERS}
    drive.hole(hours * HOUR_S).descend(0.06)
    for corner, nodes_k in before.items():
        for node, kelvin in drive.nodes_k(corner).items():
            assert kelvin > nodes_k[node] - 0.2
    drive.descend(60.0)
    assert drive.validity() == Validity.DEGRADED


def test_a_clock_set_back_within_a_hole(config: Config) -> None:
    """How long it lasted nobody knows."""
    drive = Drive(config).descend(600.0)
    before = drive.nodes_k()
    drive.hole(120.0)
    drive.feed([(drive.now_us, TICK, 0.0)])
    drive.now_us = -500 * SECOND
    drive.descend(0.2)
    for node, kelvin in drive.nodes_k().items():
        assert kelvin > before[node] - 0.5
    drive.descend(60.0)
    assert drive.validity() == Validity.DEGRADED


@pytest.mark.slow
def test_within_an_hour_a_clock_is_believed(config: Config) -> None:
    """What was hot when the hole began has cooled in it."""
    drive = Drive(config).go(900.0).go(20.0, 20.0, 5e6)
    begun = drive.nodes_k()
    drive.hole(3000.0).go(0.02)
    assert drive.estimator.unseen.driven == 1
    assert drive.nodes_k()["pad_front"] < begun["pad_front"] - 200.0


def test_a_night_is_one(config: Config) -> None:
    """Parked, by the clocks; then the car drives off."""
    drive = Drive(config).descend(300.0).go(2.0, 0.0).restart(12 * HOUR_S)
    drive.go(5.0, 0.0).go(60.0)
    assert drive.validity() == Validity.VALID
    assert drive.nodes_k()["disc"] < AIR_K + 10.0


@pytest.mark.slow
def test_long_holes_come_to_the_balance_of_the_load(config: Config) -> None:
    """A day that the clocks prove: as hot as by driving on for hours."""
    unseen = Drive(config).descend(900.0).restart(24 * HOUR_S).descend(0.02)
    seen = Drive(config).go(2.5 * HOUR_S, 20.0, 5e5, every_us=400_000)
    for node, kelvin in seen.nodes_k().items():
        # linings that were hot for a day conduct less
        assert unseen.nodes_k()[node] == pytest.approx(kelvin, abs=25.0)


@pytest.mark.slow
@pytest.mark.parametrize("proven_s", [100.0, None])
def test_a_parked_time_that_is_not_proven_is_no_start(
    config: Config, proven_s: float | None
) -> None:
    """The brakes are as hot as the clocks prove, and degraded."""
    drive = Drive(config).descend(300.0).go(2.0, 0.0)
    hot_k = drive.nodes_k()["disc"]
    drive.start(600.0, proven_s=proven_s, is_exact=False).go(1.0, 0.0)
    left_k = drive.nodes_k()["disc"] - AIR_K
    assert left_k > (0.9 if proven_s is None else 0.7) * (hot_k - AIR_K)
    assert drive.validity() == Validity.DEGRADED
    for _ in range(5):
        drive.go(HOUR_S, 0.0, every_us=400_000)
    assert drive.validity() == Validity.VALID


def test_cold_brakes_are_known_without_a_clock(config: Config) -> None:
    """Parked brakes that were cold are cold."""
    drive = Drive(config).go(60.0).go(1.0, 0.0)
    drive.start(600.0, proven_s=None, is_exact=False).go(1.0, 0.0)
    assert drive.validity() == Validity.VALID


def test_an_absurd_saved_speed_ends_nothing(config: Config) -> None:
    """The stop at the end of the hole is one from 150 m/s at most."""
    drive = Drive(config).descend(60.0)
    document = export_state(drive.estimator) | {"speed_ms": 1e200}
    estimator = Estimator(config, PRESENT)
    now_us = document["time_us"] + 600 * SECOND
    resume_state(estimator, document, 600 * SECOND, now_us)
    estimator.advance(
        array("q", [now_us + SECOND]), array("i", [SPEED]), array("d", [20.0])
    )
    assert 300.0 < estimator.state("FL")["disc"] < 1800.0


PARTS = st.lists(
    st.tuples(
        st.sampled_from(["drive", "hole", "sleep", "restart", "stand"]),
        st.integers(min_value=1, max_value=90),
    ),
    min_size=2,
    max_size=6,
)


def lead(drive: Drive, parts: list[tuple[str, int]]) -> None:
    """Let *drive* go through *parts*, and drive on at the end."""
    drive.descend(30.0)
    for kind, seconds in parts:
        if kind == "drive":
            drive.descend(seconds)
        elif kind == "stand":
            drive.go(seconds, 0.0)
        elif kind == "hole":
            drive.hole(seconds)
        elif kind == "sleep":
            drive.sleep(60.0 + seconds)
        else:
            drive.restart(seconds)
    drive.descend(1.0)


def test_the_history_has_all_that_had_a_speed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of one block, before and after its speed was missing; by minutes."""
    added: list[tuple[int, int]] = []
    monkeypatch.setattr(
        Unseen, "_add", lambda _self, _block, *ends: added.append(ends)
    )
    missing = FLAGS["speed_missing"]
    block: Any = SimpleNamespace(flags=[0, 0, missing, 0, 0, 0, missing, 0])

    unseen = Unseen([0.5], 2000.0, 2)
    unseen.add(block)
    # a hole is no history
    unseen._open = True
    unseen.add(block)

    assert added == [(0, 2), (3, 5), (5, 6), (7, 8)]


@pytest.mark.slow
@settings(max_examples=10)
@given(parts=PARTS)
def test_no_hole_is_colder_than_parking(
    config: Config, parts: list[tuple[str, int]]
) -> None:
    drive, parked = Drive(config), blind(config)
    heat = Unseen._heat
    lead(drive, parts)
    Unseen._heat = lambda *_args, **_options: None  # type: ignore[method-assign]
    try:
        lead(parked, parts)
    finally:
        Unseen._heat = heat  # type: ignore[method-assign]
    assert hotter(drive, parked, -1e-6)


@pytest.mark.slow
@settings(max_examples=10)
@given(
    hole_s=st.integers(min_value=6, max_value=400),
    speed_ms=st.floats(min_value=6.0, max_value=50.0),
    pressure_pa=st.floats(min_value=0.0, max_value=3e5),
)
def test_no_hole_is_colder_than_the_mean_load(
    config: Config, hole_s: int, speed_ms: float, pressure_pa: float
) -> None:
    drives = [Drive(config), Drive(config)]
    for drive in drives:
        drive.go(150.0, speed_ms, pressure_pa)
    drives[0].hole(hole_s)
    drives[1].go(hole_s, speed_ms, pressure_pa)
    for drive in drives:
        drive.go(0.1, speed_ms, pressure_pa)
    # in the second until a bus is silent half the heat is missing
    above_k = drives[1].nodes_k()["disc"] - AIR_K
    assert hotter(drives[0], drives[1], -1.0 - 0.02 * above_k)


@settings(max_examples=5)
@given(parts=PARTS)
def test_live_and_replay_are_equal(
    config: Config, parts: list[tuple[str, int]]
) -> None:
    """Ticks through the holes, and a few samples at a time."""
    # a replay begins with a sample
    parts = [
        one
        for part in parts
        if part[0] != "sleep"
        for one in (part, ("drive", 1))
    ]
    live, replay = Drive(config, ticks=True), Drive(config)
    for drive in (live, replay):
        lead(drive, parts)
    for corner in CORNERS:
        assert live.nodes_k(corner) == replay.nodes_k(corner)
    assert (
        export_state(live.estimator)["unseen"]
        == (export_state(replay.estimator)["unseen"])
    )
    assert live.flags() == replay.flags()


def test_a_restart_within_a_hole_changes_no_bit(config: Config) -> None:
    whole = Drive(config, ticks=True).descend(100.0).hole(40.0).descend(1.0)
    first = Drive(config, ticks=True).descend(100.0).hole(20.0)
    document = json.loads(json.dumps(export_state(first.estimator)))
    second = Drive(config, ticks=True)
    assert restore_state(second.estimator, document, resume=True).resumed
    second.now_us = first.now_us
    second.hole(20.0).descend(1.0)
    assert second.nodes_k() == whole.nodes_k()


def test_wear_is_of_braking_that_was_seen(config: Config) -> None:
    drives = [Drive(config), blind(config)]
    doses = []
    for drive in drives:
        drive.descend(60.0).hole(600.0).go(1.0)
        doses.append(drive.estimator.state("FL")[DOSE])
    assert doses[0] == doses[1] > 0.0


def test_the_history_of_another_car_is_left_out(
    config: Config, make_car: Callable[..., Config], make_corner: Any
) -> None:
    saved = Drive(config).descend(150.0).estimator.unseen.export()
    unseen = Unseen([0.3] * 4, MASS_KG, 600)
    unseen.restore(saved)
    assert unseen.export()["_minutes"] == []
    unseen.restore(
        saved | {"_minutes": [], "_sums": [0.0] * 16, "_count": 600}
    )
    assert unseen.export()["_count"] == 0
    own = Unseen([0.3] * 2, MASS_KG, 600)
    own.restore(saved)
    assert len(own.export()["_minutes"]) == 2


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("_minutes", [[1.0, "fast"]]),
        ("_sums", None),
        ("_count", -1),
        ("_nodes", {"FL": [20.0]}),
        ("_open", "yes"),
        ("since_us", 1.5),
    ],
)
def test_a_bad_memory_is_refused(key: str, value: Any) -> None:
    unseen = Unseen([0.5], MASS_KG, 600)
    with pytest.raises(ValueError, match="validation error"):
        unseen.restore(unseen.export() | {key: value})


def test_coarse_steps_add_up() -> None:
    for seconds in (0.0, LEAST_S, 75.3, 4000.0, 86_400.0):
        assert sum(coarse_steps(seconds)) == pytest.approx(seconds)

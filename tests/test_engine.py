"""Frames in, frames out: one path whatever the ticks, and a silent bus."""

from __future__ import annotations

import random
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
from cantools.database.can import Database

from bstm_daemon.bus.opening import EventLog, open_log
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.estimator.estimator import (
    PUBLISH_US,
    ROWS,
    STEP_US,
    Estimator,
)
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bstm_daemon.engine import Published
    from bstm_daemon.estimator.blocks import Block

ROOT = Path(__file__).parents[1]
CAR = ROOT / "config" / "example_vehicle.toml"
SECOND = 1_000_000
WHEEL_SPEEDS = 0x1A0
BRAKE_PRESSURE = 0x1A4
INERTIAL = 0x1B0
START_US = 1_700_000_000 * SECOND

# the bus falls silent under braking: values run out of time mid-step
DRIVE = """
[drive]
name = "short"
description = "two stops, the bus silent in the second one"
ambient_c = 10.0
[[segment]]
speed_kmh = 72.0
rate_ms2 = 4.0
gear = 3
duration_s = 8.0
[[segment]]
speed_kmh = 30.0
rate_ms2 = 4.0
gear = 3
[[segment]]
speed_kmh = 20.0
rate_ms2 = 2.0
ignition = false
duration_s = 3.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 4.0
[[segment]]
parked = true
duration_s = 3.0
"""

DATABASE = Database()
DATABASE.add_dbc_file(ROOT / "dbc" / "bstm.dbc")


class Frame(NamedTuple):
    """A frame of the log."""

    stamp_us: int
    can_id: int
    data: bytes


class Run(NamedTuple):
    """What an engine gave."""

    engine: Engine
    blocks: list[Block]
    published: list[Published]

    def values(self, name: str) -> list[dict[str, Any]]:
        """Return the decoded frames *name*, with the time as ``at_us``."""
        found = []
        for at_us, frame in self.published:
            if frame.name == name:
                values = DATABASE.decode_message(frame.can_id, frame.data)
                assert isinstance(values, dict)
                found.append({**values, "at_us": at_us})
        return found


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of the drive."""
    path = tmp_path_factory.mktemp("engine") / "short.log"
    encoder = Encoder(ROOT / "dbc" / "example_vehicle.dbc")
    write_candump(path, simulate(parse_drive(DRIVE, "short")), encoder)
    return path


@pytest.fixture(scope="module")
def frames(log: Path) -> list[Frame]:
    """Return its frames."""
    return [
        Frame(*row)
        for chunk in open_log(log).chunks()
        for row in zip(
            chunk.time_us.tolist(),
            chunk.can_id.tolist(),
            [row.tobytes() for row in chunk.data],
            strict=True,
        )
    ]


def make_engine(**options: Any) -> Engine:
    """Return an engine of the example car."""
    config, signal_map = load_vehicle(CAR)
    return Engine(config, signal_map, **options)


def run(
    engine: Engine,
    frames: list[Frame],
    ticks: Iterator[int],
    until_us: int | None = None,
) -> Run:
    """Feed *frames* with a tick as soon as each of *ticks* has come."""
    result = Run(engine, [], [])

    def tick(at_us: int) -> None:
        result.published.extend(engine.tick(at_us))
        result.blocks.extend(engine.blocks)

    next_us = next(ticks)
    for stamp_us, can_id, data in frames:
        while next_us <= stamp_us:
            tick(next_us)
            next_us = next(ticks)
        engine.frame(0, can_id, False, data, stamp_us)
    end_us = frames[-1].stamp_us if until_us is None else until_us
    while next_us < end_us:
        tick(next_us)
        next_us = next(ticks)
    tick(end_us)
    return result


def every(step_us: int, start_us: int = START_US) -> Iterator[int]:
    """Yield a tick every *step_us*."""
    at_us = start_us
    while True:
        at_us += step_us
        yield at_us


def at_random(seed: int) -> Iterator[int]:
    """Yield ticks 1 us to 0.3 s apart."""
    chance = random.Random(seed)  # noqa: S311
    at_us = START_US
    while True:
        at_us += chance.randrange(1, 300_000)
        yield at_us


def flat(blocks: list[Block]) -> dict[str, bytes]:
    """Return every number of *blocks*, joined, as bytes."""
    parts: dict[str, list[bytes]] = {}

    def add(name: str, data: Any) -> None:
        parts.setdefault(name, []).append(data.tobytes())

    for block in blocks:
        for name in ("times_us", "rows", "vehicle", "flags"):
            add(name, getattr(block, name))
        for number, output in enumerate(block.outputs):
            add(f"group {number}", output)
        for corner, validity in block.validity.items():
            add(corner, validity)
    return {name: b"".join(pieces) for name, pieces in parts.items()}


@pytest.fixture(scope="module")
def ten_ms(frames: list[Frame]) -> Run:
    """Return what the engine gives when ticked as the service does."""
    return run(make_engine(), frames, every(10_000))


def test_columns_and_frames_give_the_same_bits(log: Path, ten_ms: Run) -> None:
    """Replay over columns is the engine frame by frame, ticks and all."""
    config, signal_map = load_vehicle(CAR)
    estimator = Estimator(config, present_roles(signal_map))
    blocks: list[Block] = []
    for events in EventLog(log, signal_map).events():
        blocks += estimator.advance(events.time_us, events.role, events.value)

    columns, live = flat(blocks), flat(ten_ms.blocks)

    assert columns.keys() == live.keys()
    for name, data in columns.items():
        assert live[name] == data, name
    assert len(ten_ms.blocks[0].times_us) == 1
    assert len(columns["times_us"]) == 8 * sum(
        len(block.times_us) for block in ten_ms.blocks
    )


@pytest.mark.parametrize(
    "ticks",
    [
        lambda: every(50_000),
        lambda: every(100_000),
        lambda: every(7_001),
        lambda: every(2 * SECOND),
        lambda: every(10_000, START_US - 3_333),
        lambda: at_random(1),
        lambda: at_random(2),
    ],
    ids=["50 ms", "100 ms", "7 ms", "2 s", "off grid", "random", "random 2"],
)
def test_ticks_change_no_bit(
    frames: list[Frame], ten_ms: Run, ticks: Any
) -> None:
    """Estimates and published bytes are the same however one ticks."""
    other = run(make_engine(), frames, ticks())

    assert flat(other.blocks) == flat(ten_ms.blocks)
    assert other.published == ten_ms.published
    assert other.engine.estimator.counts == ten_ms.engine.estimator.counts


@pytest.mark.slow
def test_a_gap_of_hours_comes_in_parts(frames: list[Frame]) -> None:
    """The same frames; of them as many at a time as one march has room for.

    Four times that room here, and eleven hours change nothing but the number
    of parts.
    """
    gap_us = 4 * ROWS * STEP_US
    later = [f._replace(stamp_us=f.stamp_us + gap_us) for f in frames[400:]]
    whole, parted = make_engine(), make_engine()
    run(whole, frames[:400], every(10_000))
    run(parted, frames[:400], every(10_000))
    for engine in (whole, parted):
        for stamp_us, can_id, data in later[:2]:
            engine.frame(0, can_id, False, data, stamp_us)

    published = whole.tick(later[1].stamp_us)
    parts, blocks = [], []
    for part in parted.parts_of_tick(later[1].stamp_us):
        parts.append(part)
        blocks += parted.blocks

    assert [item for part in parts for item in part] == published
    assert flat(blocks) == flat(whole.blocks)
    span_us = published[-1].time_us - published[0].time_us
    assert span_us >= gap_us - SECOND
    names = len({item.frame.name for item in published})
    assert len(parts) >= 4
    assert max(map(len, parts)) <= names * ROWS * STEP_US // PUBLISH_US
    # and both go on alike
    assert run(
        whole, later[2:], every(10_000, later[2].stamp_us)
    ).published == (
        run(parted, later[2:], every(10_000, later[2].stamp_us)).published
    )


@pytest.mark.slow
def test_silence_shows_and_cools(frames: list[Frame]) -> None:
    """No frame for ten minutes: ticks alone cool, and the frames say why."""
    end_us = frames[-1].stamp_us + 600 * SECOND
    result = run(make_engine(), frames, every(50_000), end_us)
    status = result.values("BSTM_Status")
    discs = [row["Disc"] for row in result.values("BSTM_FL_Temperatures")]
    silent = [row for row in status if row["at_us"] > frames[-1].stamp_us]

    # the speed times out after 0.5 s, silence is said after 1 s
    assert {str(row["State"]) for row in silent[6:9]} == {"degraded"}
    assert {str(row["State"]) for row in silent[11:]} == {"no_input"}
    for name in ("SpeedStale", "PressureStale"):
        assert {str(row[name]) for row in silent[6:]} == {"stale"}
        assert str(silent[0][name]) == "fresh"
    assert str(silent[-1]["AmbientStale"]) == "stale"
    assert silent[100]["OldestInputAge"] == pytest.approx(10.1, abs=0.15)
    assert silent[-1]["OldestInputAge"] == pytest.approx(25.3)
    assert max(discs) > 30.0
    parked = discs[-5 * 600 :]
    assert all(np.diff(parked) <= 0.0)
    assert parked[-1] < parked[0] - 1.0
    # and the frames kept coming
    assert np.diff([row["at_us"] for row in status]).tolist() == (
        [100_000] * (len(status) - 1)
    )


def test_a_missing_speed_is_not_silence(frames: list[Frame]) -> None:
    """What has no speed is degraded, not without input."""
    without = [f for f in frames if f.can_id not in {WHEEL_SPEEDS, INERTIAL}]
    result = run(make_engine(history_known=True), without, every(50_000))

    last = result.values("BSTM_Status")[20]
    assert (str(last["State"]), str(last["SpeedStale"])) == (
        "degraded",
        "stale",
    )


def test_a_suspect_input_is_published(frames: list[Frame]) -> None:
    """A wheel that stands while the car drives on."""
    dead = [
        f._replace(data=bytes(2) + f.data[2:])
        if f.can_id == WHEEL_SPEEDS
        else f
        for f in frames
    ]
    sound, harmed = (
        run(make_engine(history_known=True), fed, every(50_000)).values(
            "BSTM_Status"
        )
        for fed in (frames, dead)
    )

    assert {str(row["InputSuspect"]) for row in sound} == {"none"}
    first = [str(row["InputSuspect"]) for row in harmed].index("suspect")
    assert 10 < first < 40
    assert str(harmed[first]["State"]) == "degraded"
    # until the bus falls silent: what is not there can not be suspect
    driving = harmed[first:110]
    assert {str(row["InputSuspect"]) for row in driving} == {"suspect"}


def test_substituted_heat_is_published(frames: list[Frame]) -> None:
    """Feed-Forward without a pressure goes by Feed-Back while braking."""
    without = [f for f in frames if f.can_id != BRAKE_PRESSURE]
    own, other = (
        run(make_engine(history_known=True), fed, every(50_000)).values(
            "BSTM_Status"
        )
        for fed in (frames, without)
    )

    driving = slice(10, 80)
    assert {str(r["HeatSubstituted"]) for r in own[driving]} == {"own"}
    found = [str(row["HeatSubstituted"]) for row in other[driving]]
    assert "substituted" in found


def test_state_and_history(frames: list[Frame]) -> None:
    """Running only with known history and fresh inputs."""
    unknown = run(make_engine(), frames[:500], every(10_000))
    known = run(make_engine(history_known=True), frames[:500], every(10_000))

    last = unknown.values("BSTM_Status")[-1]
    assert (str(last["State"]), str(last["HistoryKnown"])) == (
        "degraded",
        "unknown",
    )
    assert str(last["Validity"]) == "degraded"
    last = known.values("BSTM_Status")[-1]
    assert (str(last["State"]), str(last["HistoryKnown"])) == (
        "running",
        "known",
    )
    assert str(last["Validity"]) == "valid"
    assert str(last["HeatMode"]) == "fused"


def test_stale_is_only_what_the_heat_mode_uses(frames: list[Frame]) -> None:
    """Feed-Forward needs no torque; Feed-Back says that it is missing."""
    without = [f for f in frames[:500] if f.can_id not in {0x110, 0x3F0}]
    config, signal_map = load_vehicle(CAR)
    for mode, torque in (("ff", "fresh"), ("fb", "stale")):
        heat = config.heat.model_copy(update={"mode": mode})
        engine = Engine(config.model_copy(update={"heat": heat}), signal_map)
        last = run(engine, without, every(50_000)).values("BSTM_Status")[-1]
        assert str(last["TorqueStale"]) == torque
        assert str(last["AmbientStale"]) == "stale"
        assert str(last["SpeedStale"]) == "fresh"


def test_an_input_without_a_source_is_not_stale() -> None:
    """The Subaru has no ambient temperature and no torque on its bus."""
    config, signal_map = load_vehicle(ROOT / "config" / "subaru_wrx_sti.toml")
    engine = Engine(config, signal_map)
    engine.tick(START_US)
    (first, *_) = engine.tick(START_US + 500_000)

    values = DATABASE.decode_message(first.frame.can_id, first.frame.data)
    assert isinstance(values, dict)
    assert str(values["State"]) == "no_input"
    assert str(values["SpeedStale"]) == str(values["PressureStale"]) == "stale"
    assert str(values["TorqueStale"]) == str(values["AmbientStale"]) == "fresh"


def test_frames_that_are_no_data_are_counted(frames: list[Frame]) -> None:
    """Error, remote and short frames of wanted ids are refused and said."""
    plain = run(make_engine(), frames[:500], every(10_000))
    engine = make_engine()
    stamp_us, can_id, data = frames[0]
    for is_error, is_remote, payload in (
        (True, False, data),
        (False, True, data),
        (False, False, data[:5]),
    ):
        engine.frame(
            *(0, can_id, False, payload, stamp_us),
            is_error=is_error,
            is_remote=is_remote,
        )
    noisy = run(engine, frames[:500], every(10_000))

    assert noisy.values("BSTM_Status")[0]["RejectedFrames"] == 3
    assert flat(noisy.blocks) == flat(plain.blocks)


def test_a_stray_stamp_moves_nothing(frames: list[Frame], ten_ms: Run) -> None:
    """One frame from next year: its values go, nothing else changes."""
    stray = frames[700]._replace(stamp_us=frames[700].stamp_us + 10**13)
    altered = [*frames[:700], stray, *frames[701:]]

    engine = make_engine()
    result = Run(engine, [], [])
    for index, (stamp_us, can_id, data) in enumerate(altered):
        engine.frame(0, can_id, False, data, stamp_us)
        if index % 10 == 9:
            # the clock of the ticks is right
            result.published.extend(engine.tick(frames[index].stamp_us))
            result.blocks.extend(engine.blocks)

    counts = engine.estimator.counts
    assert counts["dropped"] >= 1
    assert counts["jumps"] == 0
    times = [at for block in result.blocks for at in block.times_us]
    reference = [at for block in ten_ms.blocks for at in block.times_us]
    assert times == reference[: len(times)]
    assert len(times) > len(reference) - 3


def test_clock_set_back_goes_on_from_there(frames: list[Frame]) -> None:
    """An hour back: said once, temperatures stay, publication goes on."""
    back = [
        f._replace(stamp_us=f.stamp_us - 3600 * SECOND) for f in frames[600:]
    ]
    engine = make_engine()
    first = run(engine, frames[:600], every(10_000))
    start_us = back[0].stamp_us // 10_000 * 10_000
    second = run(engine, back, every(10_000, start_us))

    before = first.values("BSTM_FL_Temperatures")[-1]["PadFront"]
    status = second.values("BSTM_Status")
    assert engine.estimator.counts["jumps"] == 1
    assert [str(row["ClockJump"]) for row in status].count("jumped") == 1
    assert status[0]["at_us"] < START_US
    after = second.values("BSTM_FL_Temperatures")[0]["PadFront"]
    assert abs(after - before) < 5.0


def test_parked_for_days_is_cold_and_known(frames: list[Frame]) -> None:
    """Three days without power: at ambient, and the history is known."""
    engine = make_engine()
    hot = run(engine, frames, every(10_000))
    away = 3 * 86_400 * SECOND
    later = [f._replace(stamp_us=f.stamp_us + away) for f in frames[:300]]
    start_us = later[0].stamp_us // 10_000 * 10_000
    cold = run(engine, later, every(10_000, start_us))

    assert hot.values("BSTM_FL_Temperatures")[-1]["Disc"] > 20.0
    first = cold.values("BSTM_FL_Temperatures")[0]
    assert first["Disc"] == pytest.approx(10.0, abs=0.5)
    assert first["Fluid"] == pytest.approx(10.0, abs=0.1)
    assert str(cold.values("BSTM_Status")[-1]["HistoryKnown"]) == "known"

"""The computer sleeps: the brakes stand, and the loop comes back at once."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.bus.live.link import Frame, LinkEvent, LinkState, SendResult
from bstm_daemon.files import shipped_file
from bstm_daemon.service import service as module
from bstm_daemon.service.clock import SteadyAxis
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.notify import Notifier
from bstm_daemon.service.service import Options, Service

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

START_NS = 1_800_000_000 * 10**9
SECOND_NS = 10**9
HOUR_S = 3600.0
INERTIAL = 0x1B0
DATA = bytes(6) + (7200).to_bytes(2, "little")  # 72 km/h


class Lines:
    """Keeps what is logged."""

    def __init__(self) -> None:
        self.said: list[tuple[str, dict[str, Any]]] = []

    def info(self, event: str, **fields: Any) -> None:
        self.said.append((event, fields))

    debug = warning = error = info


class Script:
    """A link whose frames and stamps the test writes."""

    channel = "can0"
    state = LinkState.UP
    reason = ""
    receive_buffer_bytes = None
    dropped = 0

    def __init__(self) -> None:
        self.counts: Counter[LinkEvent] = Counter()
        self.waiting: list[Frame] = []
        self.drained: Callable[[], None] = lambda: None

    def open(self) -> bool:
        return True

    def drain(self) -> list[Frame]:
        frames, self.waiting = self.waiting, []
        self.drained()
        return frames

    def poll(self) -> None:
        pass

    def send(self, *_: object) -> SendResult:
        return SendResult.OK

    def close(self) -> None:
        pass


class Computer:
    """A service on a computer whose clocks the test moves."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_ns = START_NS
        monkeypatch.setattr(
            module,
            "SteadyAxis",
            lambda: SteadyAxis(lambda: self.now_ns, lambda: self.now_ns),
        )
        self.lines = Lines()
        options = Options(
            shipped_file("config/example_vehicle.toml"), folder / "a.state"
        )
        self.service = Service(options, Notifier(), ServiceLog(self.lines))
        self.link = Script()
        self.service._intake.replace([self.link])
        self.service._begin()

    def pass_by(self, seconds: float) -> None:
        self.now_ns += round(seconds * SECOND_NS)

    def frame(self) -> None:
        self.link.waiting.append(
            Frame(self.now_ns, INERTIAL, False, DATA, False, False)
        )

    def cycle(self) -> None:
        self.service._cycle(self.now_ns // 1000)

    def disc_k(self) -> float:
        engine = self.service._monitor.engine
        return engine.estimator.state("FL")["disc"]


@pytest.fixture
def computer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Computer:
    """Return one with hot brakes after two seconds of the road."""
    made = Computer(tmp_path, monkeypatch)
    for _ in range(200):
        made.pass_by(0.01)
        made.frame()
        made.cycle()
    engine = made.service._monitor.engine
    document = engine.export_state()
    for corner in document["corners"].values():
        corner["disc"] = 600.0
    engine.resume(document, 0, document["time_us"])
    return made


@pytest.mark.parametrize("frames", [(), (-1,), (1,), (-1, 1)])
def test_the_brakes_stand_while_the_computer_sleeps(
    computer: Computer, frames: tuple[int, ...]
) -> None:
    """Whether a frame came last before it (-1), or first after it (1)."""
    computer.pass_by(0.005)
    if -1 in frames:
        computer.frame()
    computer.pass_by(HOUR_S)
    if 1 in frames:
        computer.frame()
    computer.pass_by(0.004)
    ticked: list[int] = []
    engine = computer.service._monitor.engine
    tick: Callable[[int], Any] = engine.tick

    def counted(time_us: int) -> Any:
        published = tick(time_us)
        ticked.append(len(published))
        return published

    engine.tick = counted  # type: ignore[method-assign]
    computer.cycle()

    slept = [fields for name, fields in computer.lines.said if "slept" in name]
    assert len(slept) == 1
    assert slept[0]["asleep_s"] == pytest.approx(HOUR_S, abs=0.02)
    assert computer.disc_k() < 400.0
    # no hour of publications
    assert sum(ticked) < 20
    computer.pass_by(0.5)
    computer.frame()
    computer.cycle()
    assert sum(ticked) < 100
    assert computer.disc_k() < 400.0


def test_a_slow_cycle_costs_no_publication(computer: Computer) -> None:
    """It ends behind the next line; each line has a tick of its own."""
    service = computer.service
    engine = service._monitor.engine
    tick: Callable[[int], Any] = engine.tick
    ticked: list[set[int]] = []

    def seen(time_us: int) -> Any:
        published = tick(time_us)
        ticked.append({item.time_us for item in published})
        return published

    engine.tick = seen  # type: ignore[method-assign]
    deadline_us = service._finish(computer.now_ns // 1000, 0)
    for slow_s in (0.0, 0.0, 0.13, 0.0, 0.0, 0.11, 0.08, 0.0):
        computer.now_ns = max(computer.now_ns, deadline_us * 1000)
        begin_us = computer.now_ns // 1000
        computer.link.drained = partial(computer.pass_by, slow_s)
        deadline_us = service._cycle(deadline_us)
        assert begin_us < deadline_us <= begin_us + 100_000
    assert [len(times) for times in ticked] == [1] * 8
    assert len(set.union(*ticked)) == 8


def test_a_stopped_process_of_a_car_that_drives(computer: Computer) -> None:
    """SIGSTOP for 75 s at 72 km/h on both sides: said, and not parking."""
    engine = computer.service._monitor.engine
    air_k = engine.estimator.air_k()
    for batch, member, _ in engine.estimator.members():
        batch.settle(air_k, member)
    computer.pass_by(75.0)
    for _ in range(150):
        computer.pass_by(0.01)
        computer.frame()
        computer.cycle()

    faults = [f["fault"] for n, f in computer.lines.said if n == "input_fault"]
    assert faults.count("driven while nothing was received") == 1
    slept = [n for n, _ in computer.lines.said if n == "computer_slept"]
    assert len(slept) == 1
    # one full stop from 72 km/h; a parked disc stays cold
    mass_kg = engine.config.vehicle.mass_kg
    share = engine.estimator.plan.numbers.force_share[2]
    disc = next(c for c in engine.config.corner if c.name == "RL").disc
    stop_k = share * 0.5 * mass_kg * 20.0**2 / (disc.mass_kg * 500.0)
    rise_k = engine.estimator.state("RL")["disc"] - air_k
    assert 0.5 * stop_k < rise_k < stop_k
    computer.pass_by(2.0)
    computer.cycle()
    computer.cycle()
    over = [f["fault"] for n, f in computer.lines.said if n.endswith("_over")]
    assert "driven while nothing was received" in over

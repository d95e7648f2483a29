"""Steps of the wall clock: the drive goes on, the parked time is put right."""

from __future__ import annotations

import ctypes
import itertools
import signal
import time
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.service.assembly import BusOverride, build_monitor
from bstm_daemon.service.clock import kernel_error_us
from bstm_daemon.service.state_file import encode, save

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from .daemon_process import Daemon
    from .peers import Car, Ear

pytestmark = pytest.mark.vcan

BASE = 0x5B0
HOUR_S = 3600


def step_clock(step_s: float) -> None:
    now_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
    time.clock_settime_ns(time.CLOCK_REALTIME, now_ns + round(step_s * 1e9))


def synchronise_clock() -> None:
    """Tell the kernel that the wall clock is right, as chrony does.

    Setting the clock takes that back.
    """
    status, max_error_us, est_error_us = 0x10, 0x04, 0x08
    modes = ctypes.c_uint(status | max_error_us | est_error_us)
    timex = ctypes.create_string_buffer(bytes(modes), 512)
    assert ctypes.CDLL(None).adjtimex(timex) >= 0
    assert kernel_error_us() == 0


@pytest.mark.parametrize("step_s", [HOUR_S, -HOUR_S])
def test_brakes_neither_cool_nor_stand_still_over_a_step(  # noqa: PLR0917
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    marched: Callable[..., dict[str, dict[str, Any]]],
    vcan0: str,
    own_clock: None,
    step_s: float,
) -> None:
    """Against the same frames, by their time since boot."""
    heard = ear(vcan0)
    running = daemon()
    driven = car()
    heard.wait(15, BASE)

    step_clock(step_s)

    stepped = running.event("clock_stepped")
    assert stepped["step_s"] == pytest.approx(step_s, abs=0.05)
    heard.wait(15, BASE, since=len(heard.frames))
    assert running.end() == 0
    counters = [f.data[1] & 0x0F for f in heard.frames if f.can_id == BASE]
    steps = [(b - a) % 16 for a, b in itertools.pairwise(counters)]
    assert set(steps) == {1}
    assert len(running.said("clock_stepped")) == 1
    assert not running.said("computer_slept")
    document = running.document()
    expected = marched(running.config, driven.sent, document, 0.5)
    for name, corner in document["corners"].items():
        assert corner == expected[name]
    assert document["corners"]["FL"]["disc"] > 287.0
    # wall time as it is now dates the state
    now_us = time.clock_gettime_ns(time.CLOCK_REALTIME) // 1000
    assert 0 <= now_us - document["wall_us"] < 30e6


def hot_state(
    daemon: Callable[..., Daemon], path: Path, **changes: Any
) -> dict[str, Any]:
    """Save the state of a car parked hot, as another boot left it."""
    cold = daemon(state=path)
    assert cold.end() == 0
    document: dict[str, Any] = cold.document()
    for corner in document["corners"].values():
        for node in corner:
            if node != "ambient":
                corner[node] = max(corner[node], 600.0)
    document |= {"boot_id": "another boot", "wall_error_us": 0, **changes}
    save(path, encode(document))
    return document


def expected_c(
    running: Daemon, document: dict[str, Any], parked_s: float
) -> float:
    """Return the disc of *document* after *parked_s* at standstill."""
    parked_us = round(parked_s * 1e6)
    engine = build_monitor(running.config, BusOverride()).engine
    # another axis, as after a power cut: it stands, and does not go on
    engine.resume(document, parked_us, document["time_us"] + 2 * parked_us)
    return engine.estimator.state("FL")["disc"] - 273.15


@pytest.mark.parametrize("reload", [False, True])
def test_a_clock_synchronised_after_the_start_corrects_the_parked_time(
    daemon: Callable[..., Daemon],
    ear: Callable[..., Ear],
    vcan0: str,
    own_clock: None,
    tmp_path: Path,
    reload: bool,  # noqa: FBT001
) -> None:
    """A power cut, and a clock that begins behind where it was.

    Also where the configuration was read again meanwhile.
    """
    state = tmp_path / "hot.state"
    document = hot_state(daemon, state)
    step_clock(-2 * HOUR_S)
    heard = ear(vcan0)
    running = daemon(state=state)
    # no clock can tell for how long, but the computer is up since
    loaded = running.event("state_loaded")
    assert not loaded["exact"]
    up_s = time.clock_gettime(time.CLOCK_BOOTTIME)
    assert up_s - 60.0 < loaded["age_s"] < up_s
    heard.wait(5, BASE)
    hot_c = expected_c(running, document, loaded["age_s"])
    assert disc_c(heard) == pytest.approx(hot_c, abs=6.0)

    if reload:
        running.process.send_signal(signal.SIGHUP)
        running.event("config_reloaded")
    step_clock(4 * HOUR_S)
    running.event("clock_stepped")
    heard.wait(5, BASE, since=len(heard.frames))
    assert disc_c(heard) == pytest.approx(hot_c, abs=6.0)
    synchronise_clock()

    corrected = running.event("parked_time_corrected")
    assert corrected["assumed_s"] == loaded["age_s"]
    assert corrected["parked_s"] == pytest.approx(2 * HOUR_S, abs=30.0)
    heard.wait(5, BASE, since=len(heard.frames))
    # as if it had been known at the start
    assert disc_c(heard) == pytest.approx(
        expected_c(running, document, corrected["parked_s"]), abs=1.0
    )
    assert disc_c(heard) < 100.0
    assert running.end() == 0


def test_a_clock_that_was_late_at_the_save_corrects_nothing(
    daemon: Callable[..., Daemon],
    ear: Callable[..., Ear],
    vcan0: str,
    own_clock: None,
    tmp_path: Path,
) -> None:
    state = tmp_path / "hot.state"
    document = hot_state(daemon, state, wall_error_us=None)
    heard = ear(vcan0)
    running = daemon(state=state)
    loaded = running.event("state_loaded")
    step_clock(72 * HOUR_S)
    synchronise_clock()

    running.event("clock_stepped")
    heard.wait(10, BASE, since=len(heard.frames))
    hot_c = expected_c(running, document, loaded["age_s"])
    assert disc_c(heard) == pytest.approx(hot_c, abs=6.0)
    assert not running.said("parked_time_corrected")
    assert running.document()["boot_id"] != "another boot"
    assert running.end() == 0
    # what it saves from now on is dated by a clock that is right
    assert 0 < running.document()["wall_error_us"] < 1_000_000


def disc_c(heard: Ear) -> float:
    """Return the newest disc temperature on the bus."""
    data = [f.data for f in heard.frames if f.can_id == BASE + 4][-1]
    return (int.from_bytes(data, "little") >> 16 & 0xFFF) * 0.5 - 60.0


def test_within_one_boot_a_step_changes_no_parked_time(
    daemon: Callable[..., Daemon],
    vcan0: str,
    own_clock: None,
    tmp_path: Path,
) -> None:
    state = tmp_path / "car.state"
    assert daemon(state=state).end() == 0
    step_clock(HOUR_S)
    running = daemon(state=state)

    assert running.event("state_loaded")["age_s"] < 60.0
    step_clock(-HOUR_S)
    running.event("clock_stepped")
    for _ in range(2):
        running.notice("STATUS=", since=len(running.notices))
    assert not running.said("parked_time_corrected")
    assert running.end() == 0

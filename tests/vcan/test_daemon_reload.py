"""SIGHUP, SIGTERM, and what ends the process at its start."""

from __future__ import annotations

import itertools
import signal
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.bus.output.layout import ADVICE_OFFSET, own_ids
from bstm_daemon.roles import CORNERS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from .daemon_process import Daemon
    from .peers import Car, Ear

pytestmark = pytest.mark.vcan

BASE = 0x5B0
OTHER_BASE = 0x600


def test_a_bad_configuration_changes_nothing(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
) -> None:
    heard = ear(vcan0)
    car()
    running = daemon()
    heard.wait(5, BASE)

    good = running.config.read_text("utf-8")
    bad = good.replace("mass_kg = 2194.0", "mass_kg = -1.0")
    running.config.write_text(bad, "utf-8")
    running.process.send_signal(signal.SIGHUP)

    refused = running.event("config_refused", config=str(running.config))
    assert len(refused["problems"]) == 1
    assert "mass_kg" in refused["problems"][0]
    counters = [
        frame.data[1] & 0x0F
        for frame in heard.wait(10, BASE, since=len(heard.frames))
    ]
    steps = {b - a for a, b in itertools.pairwise(counters)}
    assert steps <= {1, -15}

    dbc = good.partition('\ndbc = "')[2].partition('"')[0]
    broken = running.config.with_name("broken.dbc")
    broken.write_bytes(b"BO_ 272 Powertrain: 8\xff\0")
    for text in (
        b"\xff\xfe\0 = [",
        b"",
        good.replace(dbc, "absent.dbc").encode(),
        good.replace(dbc, str(broken)).encode(),
        good.replace('channel = "vcan0"', 'channel = "a b"').encode(),
        good.replace('interface = "socketcan"', 'interface = "no"').encode(),
        good.replace("id_base = 0x5B0", "id_base = 0x1A0").encode(),
    ):
        assert text != good.encode()
        running.config.write_bytes(text)
        since = len(running.events)
        running.process.send_signal(signal.SIGHUP)
        assert running.event("config_refused", since=since)["problems"]

    # another vehicle, no file at all
    other = good.replace('id = "example-vehicle"', 'id = "another"')
    running.config.write_text(other, "utf-8")
    since = len(running.events)
    running.process.send_signal(signal.SIGHUP)
    refused = running.event("config_refused", since=since)
    assert "another vehicle needs a restart" in refused["problems"][0]
    running.config.unlink()
    since = len(running.events)
    running.process.send_signal(signal.SIGHUP)
    refused = running.event("config_refused", since=since)
    assert str(running.config) in refused["problems"][0]
    heard.wait(3, BASE, since=len(heard.frames))

    assert running.end() == 0


def test_a_good_configuration_goes_on_where_the_old_one_was(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    marched: Callable[..., dict[str, dict[str, Any]]],
    vcan0: str,
) -> None:
    heard = ear(vcan0, BASE, OTHER_BASE + 20)
    running = daemon()
    driven = car()
    heard.wait(20, BASE)

    text = running.config.read_text("utf-8")
    running.config.write_text(
        text.replace("id_base = 0x5B0", "id_base = 0x600"), "utf-8"
    )
    running.process.send_signal(signal.SIGHUP)
    running.event("config_reloaded", config=str(running.config))
    heard.wait(20, OTHER_BASE)

    # in the order of the bus: the log may overtake the last frames before it
    ids = [frame.can_id for frame in heard.frames]
    assert min(ids[ids.index(OTHER_BASE) :]) == OTHER_BASE
    before = [f.data[1] & 0x0F for f in heard.frames if f.can_id == BASE]
    after = [f.data[1] & 0x0F for f in heard.frames if f.can_id == OTHER_BASE]
    assert after[0] == (before[-1] + 1) % 16
    assert running.end() == 0
    document = running.document()
    expected = marched(running.config, driven.sent, document, 0.2)
    for name, corner in document["corners"].items():
        assert corner == expected[name]


def test_a_reload_may_change_the_bus(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    vcan1: str,
) -> None:
    heard = ear(vcan1)
    running = daemon()
    running.event("bus_up", channel="vcan0")
    text = running.config.read_text("utf-8")
    running.config.write_text(
        text.replace('channel = "vcan0"', 'channel = "vcan1"'), "utf-8"
    )
    running.process.send_signal(signal.SIGHUP)

    running.event("bus_up", channel="vcan1")
    car(vcan1)
    heard.wait(5, BASE)
    running.notice("disc F[LR] 1[1-9] degC")
    assert running.end() == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_end_saves_and_says_not_available(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    number: signal.Signals,
) -> None:
    heard = ear(vcan0)
    car()
    running = daemon({"state.interval_s": 3600.0})
    heard.wait(10, BASE)

    assert running.end(number) == 0

    running.notice("STOPPING=1")
    running.event("service_stopping", reason="signal")
    assert not running.other_lines
    last = {}
    for frame in heard.frames:
        last[frame.can_id] = frame
    # all but the requests, which are off
    assert set(last) == set(own_ids(BASE, CORNERS)) - {BASE + ADVICE_OFFSET}
    # State in the high nibble of byte 2, validity in that of byte 1
    assert last[BASE].data[2] >> 4 == 4
    assert {frame.data[1] >> 4 for frame in last.values()} == {15}
    document = running.document()
    assert document["counters"]["BSTM_Status"] == last[BASE].data[1] & 0x0F
    assert document["corners"]["FL"]["disc"] > 283.5
    assert not running.metrics_file.exists()

    again = daemon(state=running.state)
    loaded = again.event("state_loaded", new_nodes=[])
    assert 0.0 <= loaded["age_s"] < 30.0
    assert again.end() == 0


def test_a_signal_before_it_is_ready_ends_it_cleanly(
    daemon: Callable[..., Daemon], vcan0: str
) -> None:
    running = daemon(ready=False)
    running.event("service_started")
    assert running.end() == 0
    assert running.document()["vehicle_id"] == "example-vehicle"


def test_a_configuration_error_is_78(daemon: Callable[..., Daemon]) -> None:
    running = daemon({"vehicle.mass_kg": -1.0}, ready=False)
    assert running.exit_code() == 78
    assert any("mass_kg" in line for line in running.other_lines)


def test_a_second_instance_is_75(daemon: Callable[..., Daemon]) -> None:
    first = daemon()
    second = daemon(state=first.state, ready=False)
    assert second.exit_code() == 75
    assert any(
        f"process {first.process.pid}" in line for line in second.other_lines
    )
    assert first.process.poll() is None
    assert first.end() == 0


@pytest.mark.parametrize(
    "content", [b"", b"bstm-state 1 00 5\n{}", b"\0" * 99]
)
def test_a_bad_state_is_set_aside_and_the_start_goes_on(
    daemon: Callable[..., Daemon], tmp_path: Path, content: bytes
) -> None:
    state = tmp_path / "bad.state"
    state.write_bytes(content)
    running = daemon(state=state)

    discarded = running.event("state_discarded", file=str(state))
    assert "set aside as bad.state.bad-" in discarded["reason"]
    (aside,) = tmp_path.glob("bad.state.bad-*")
    assert aside.read_bytes() == content
    assert running.end() == 0
    assert running.document()["vehicle_id"] == "example-vehicle"

"""The whole service in this process, on python-can's virtual bus."""

from __future__ import annotations

import gc
import itertools
import json
import os
import signal
import socket
import threading
import time
import weakref
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import pytest
from cantools.database.can import Database

from bstm_daemon.bus.output.e2e import CheckStatus, Profile2Checker
from bstm_daemon.bus.output.layout import (
    ADVICE_OFFSET,
    own_ids,
    published_frames,
)
from bstm_daemon.cli.main import main
from bstm_daemon.engine import Engine
from bstm_daemon.errors import ConfigError, StateLockedError
from bstm_daemon.service import assembly
from bstm_daemon.service.assembly import BusOverride, Monitor
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.notify import Notifier
from bstm_daemon.service.service import Options, Service
from bstm_daemon.service.state_file import read
from bstm_daemon.service.wake import SignalWaiter

ROOT = Path(__file__).parents[2]
DATABASE = Database()
DATABASE.add_dbc_file(ROOT / "dbc" / "bstm.dbc")
INPUTS = Database()
INPUTS.add_dbc_file(ROOT / "dbc" / "example_vehicle.dbc")
ID_BASE = 0x5B0
CORNERS = ("FL", "FR", "RL", "RR")
OWN = own_ids(ID_BASE, CORNERS)
LIMIT_S = 30.0


class Lines:
    """Takes what is logged, and lets a thread wait for an event."""

    def __init__(self) -> None:
        self.said: list[tuple[str, dict[str, Any]]] = []
        self.peer: Peer
        self._news = threading.Condition()

    def _take(self, event: str, **fields: Any) -> None:
        with self._news:
            self.said.append((event, fields))
            self._news.notify_all()

    debug = info = warning = error = _take

    def names(self) -> list[str]:
        return [name for name, _ in self.said]

    def wait_for(self, name: str, count: int = 1) -> None:
        with self._news:
            assert self._news.wait_for(
                lambda: self.names().count(name) >= count, LIMIT_S
            )


class Peer:
    """Another node on the virtual bus: sends a car, hears everything."""

    def __init__(self, channel: str) -> None:
        self.bus = can.Bus(interface="virtual", channel=channel)
        self.heard: list[can.Message] = []

    def drive(self, seconds: float, without: str = "") -> None:
        """Send every input of the example car at rest, at 50 Hz.

        *without* names a message that is not sent.
        """
        frames = []
        for message in INPUTS.messages:
            if message.name == without:
                continue
            values = {
                signal_.name: max(signal_.minimum or 0.0, 0.0)
                for signal_ in message.signals
            }
            data = message.encode(values, strict=False)
            frames.append((message.frame_id, data))
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            for can_id, data in frames:
                self.send(can_id, data)
            self.hear(0.02)

    def send(self, can_id: int, data: bytes) -> None:
        self.bus.send(
            can.Message(arbitration_id=can_id, data=data, is_extended_id=False)
        )

    def hear(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            message = self.bus.recv(left_s)
            if message is not None:
                self.heard.append(message)

    def own(self, name: str) -> list[dict[str, Any]]:
        """Return the values of our frames *name*."""
        message = DATABASE.get_message_by_name(name)
        return [
            dict(message.decode(m.data))  # type: ignore[arg-type]
            for m in self.heard
            if m.arbitration_id == message.frame_id
        ]


def car(folder: Path, channel: str, *changes: tuple[str, str]) -> Path:
    """Write a publishing example car with *changes* of its text."""
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    head, publish, tail = text.partition("[publish]")
    tail = tail.replace("enabled = false", "enabled = true", 1)
    text = head + publish + tail
    for old, new in (
        ('"../dbc/', f'"{ROOT}/dbc/'),
        ('channel = "can0"', f'channel = "{channel}"'),
        ('interface = "socketcan"', 'interface = "virtual"'),
        *changes,
    ):
        assert old in text
        text = text.replace(old, new)
    path = folder / "car.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def channel(request: pytest.FixtureRequest) -> str:
    return str(request.node.name)


Run = Callable[..., Lines]


@pytest.fixture
def run(tmp_path: Path, channel: str) -> Run:
    """Return what runs a service while a function plays the peer."""

    def start(
        play: Callable[[Peer, Lines], None],
        *,
        config: Path | None = None,
        notifier: Notifier | None = None,
    ) -> Lines:
        lines, peer = Lines(), Peer(channel)
        failed: list[BaseException] = []

        def other() -> None:
            try:
                lines.wait_for("bus_up")
                play(peer, lines)
            except BaseException as error:  # noqa: BLE001  (told below)
                failed.append(error)
            finally:
                os.kill(os.getpid(), signal.SIGTERM)

        options = Options(
            config or car(tmp_path, channel), tmp_path / "car.state"
        )
        thread = threading.Thread(target=other)
        with SignalWaiter() as waiter:
            service = Service(
                options, notifier or Notifier(), ServiceLog(lines)
            )
            thread.start()
            service.run(waiter)
        thread.join()
        peer.hear(0.0)
        while (message := peer.bus.recv(0)) is not None:
            peer.heard.append(message)
        peer.bus.shutdown()
        if failed:
            raise failed[0]
        lines.peer = peer
        return lines

    return start


@pytest.mark.slow
def test_a_drive_is_published_and_ends_not_available(
    run: Run, tmp_path: Path
) -> None:
    lines = run(lambda peer, _: peer.drive(1.5))
    peer = lines.peer

    status = peer.own("BSTM_Status")
    assert len(status) >= 10
    assert status[-1]["State"] == "stopping"
    assert status[-1]["Validity"] == "not_available"
    running = {str(values["State"]) for values in status[2:-1]}
    assert running == {"degraded"}
    temperatures = peer.own("BSTM_FL_Temperatures")
    assert temperatures[-1]["Disc"] == "not_available"
    assert temperatures[-2]["Disc"] == pytest.approx(10.0, abs=0.6)
    # advice needs the second switch
    advice = ID_BASE + ADVICE_OFFSET
    assert not [m for m in peer.heard if m.arbitration_id == advice]
    for frame in published_frames(CORNERS):
        if frame.id_offset == ADVICE_OFFSET:
            continue
        checker = Profile2Checker(frame.data_ids)
        verdicts = [
            checker.check(m.data)
            for m in peer.heard
            if m.arbitration_id == ID_BASE + frame.id_offset
        ]
        assert set(verdicts) == {CheckStatus.OK}
    assert {"service_started", "publishing_started"} <= set(lines.names())
    document = read(tmp_path / "car.state").document
    assert document is not None
    assert set(document["corners"]) == set(CORNERS)


@pytest.mark.slow
def test_the_next_run_goes_on_where_the_last_one_ended(
    run: Run, tmp_path: Path
) -> None:
    first = run(lambda peer, _: peer.drive(0.5)).peer
    counter = first.own("BSTM_Status")[-1]["Counter"]

    lines = run(lambda peer, _: peer.drive(0.5))

    assert "state_loaded" in lines.names()
    gap = lines.peer.own("BSTM_Status")[0]["Counter"] - counter
    assert gap % 16 >= 1


@pytest.mark.slow
def test_the_feed_has_what_the_frames_have(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "feed.sock"
    name = "test_the_feed_has_what_the_frames_have"
    config = car(
        tmp_path,
        name,
        ('# socket = "/run/bstm/feed.sock"', f'socket = "{path}"'),
    )
    records: list[dict[str, Any]] = []

    def play(peer: Peer, lines: Lines) -> None:
        driving = threading.Thread(target=peer.drive, args=(1.5,))
        driving.start()
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as feed:
            feed.settimeout(LIMIT_S)
            while feed.connect_ex(str(path)):
                driving.join(0.01)
            driving.join()
            with feed.makefile() as text:
                records.extend(json.loads(text.readline()) for _ in range(3))

    lines = run(play, config=config)

    assert [one["seq"] for one in records] == sorted(
        one["seq"] for one in records
    )
    last = records[-1]
    assert last["vehicle"] == "example-vehicle"
    assert last["corners"]["FL"]["disc_c"] == pytest.approx(10.0, abs=0.6)
    assert last["corners"]["FL"]["validity"] == "degraded"
    assert "feed_failed" not in lines.names()
    assert not path.exists(), "it goes with the service"


@pytest.mark.slow
def test_a_feed_that_cannot_be_opened_ends_nothing(
    run: Run, tmp_path: Path
) -> None:
    name = "test_a_feed_that_cannot_be_opened_ends_nothing"
    path = tmp_path / "missing" / "feed.sock"
    config = car(
        tmp_path,
        name,
        ('# socket = "/run/bstm/feed.sock"', f'socket = "{path}"'),
    )

    def play(peer: Peer, lines: Lines) -> None:
        lines.wait_for("feed_failed")
        path.parent.mkdir()
        end_s = time.monotonic() + LIMIT_S
        while not path.exists() and time.monotonic() < end_s:
            peer.hear(0.05)
        assert path.is_socket(), "it is tried again"

    lines = run(play, config=config)

    assert lines.peer.own("BSTM_Status")


@pytest.mark.slow
def test_without_publish_nothing_is_sent(run: Run, tmp_path: Path) -> None:
    quiet = car(
        tmp_path,
        "test_without_publish_nothing_is_sent",
        ("[publish]\n", "[publish]\n# "),
    )
    text = quiet.read_text("utf-8")
    head, _, tail = text.partition("[publish]")
    tail = tail.replace("enabled = true", "enabled = false", 1)
    quiet.write_text(head + "[publish]" + tail, encoding="utf-8")

    lines = run(lambda peer, _: peer.drive(0.5), config=quiet)

    assert lines.peer.heard == []
    assert "publishing_started" not in lines.names()


@pytest.mark.slow
def test_a_stall_of_the_loop_leaves_no_gap_in_the_counters(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    poll = Service._poll_and_report
    cycles = []

    def stalls(service: Service, now_us: int) -> None:
        cycles.append(now_us)
        if len(cycles) % 6 == 0:
            time.sleep(0.45)
        poll(service, now_us)

    monkeypatch.setattr(Service, "_poll_and_report", stalls)

    lines = run(lambda peer, _: peer.drive(2.0))

    counters = [
        message.data[1] & 0x0F
        for message in lines.peer.heard
        if message.arbitration_id == ID_BASE
    ]
    assert len(cycles) > 6
    assert len(counters) > 6
    assert {(b - a) % 16 for a, b in itertools.pairwise(counters)} == {1}


@pytest.mark.slow
def test_a_missing_input_is_told_everywhere(
    run: Run, tmp_path: Path, channel: str
) -> None:
    """In the log, in the metrics and on the bus."""
    page = tmp_path / "bstm.prom"
    written = (
        (
            "enabled = false\n# A path, optional; default bstm.prom",
            'enabled = true\nfile = "bstm.prom"\n#',
        ),
        ("interval_s = 10.0", "interval_s = 0.5"),
    )

    def play(peer: Peer, _: Lines) -> None:
        deadline_s = time.monotonic() + LIMIT_S
        # in the first second nothing is known yet
        wanted = {
            'bstm_input_fault{fault="pressure_missing"} 1.0',
            'bstm_input_fault{fault="speed_missing"} 0.0',
        }
        while not (
            page.exists() and wanted <= {*page.read_text("utf-8").split("\n")}
        ):
            assert time.monotonic() < deadline_s
            peer.drive(0.2, without="BrakePressure")

    lines = run(play, config=car(tmp_path, channel, *written))

    said = [f["fault"] for name, f in lines.said if name == "input_fault"]
    assert "pressure missing" in said
    last = lines.peer.own("BSTM_Status")[-2]
    assert (last["PressureStale"], last["State"]) == ("stale", "degraded")


@pytest.mark.slow
def test_a_foreign_sender_of_our_id_ends_ours(run: Run) -> None:
    def play(peer: Peer, lines: Lines) -> None:
        peer.drive(0.3)
        assert peer.heard
        peer.send(OWN[0], bytes(8))
        lines.wait_for("foreign_frame")
        peer.hear(0.1)  # what was under way
        peer.heard.clear()
        peer.drive(0.4)

    lines = run(play)

    assert lines.peer.heard == []
    assert lines.names().count("foreign_frame") == 1


@pytest.mark.slow
def test_a_reload_keeps_the_brakes_and_a_bad_one_the_configuration(
    run: Run, tmp_path: Path, channel: str
) -> None:
    path = car(tmp_path, channel)
    good = path.read_text("utf-8")

    def play(peer: Peer, lines: Lines) -> None:
        peer.drive(0.3)
        path.write_text(good.replace("mass_kg = ", "mass_kh = ", 1))
        os.kill(os.getpid(), signal.SIGHUP)
        lines.wait_for("config_refused")
        peer.drive(0.2)
        path.write_text(
            good.replace("id_base = 0x5B0", "id_base = 0x600"), "utf-8"
        )
        os.kill(os.getpid(), signal.SIGHUP)
        lines.wait_for("config_reloaded")
        peer.hear(0.1)  # what was under way
        peer.heard.clear()
        peer.drive(0.4)

    lines = run(play, config=path)

    refused = dict(lines.said)["config_refused"]
    assert any("mass_kh" in problem for problem in refused["problems"])
    ids = {message.arbitration_id for message in lines.peer.heard}
    assert ids <= set(own_ids(0x600, CORNERS))
    assert 0x600 in ids


FAILURES = (
    RecursionError("maximum recursion depth exceeded"),
    MemoryError(),
    ValueError("Exceeds the limit (4300 digits)\nfor integer string"),
    OverflowError("int too large to convert to float"),
    KeyError("spare"),
    OSError(5, "Input/output error"),
    AssertionError(),
)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["compile_signal_map", "Engine", "links"])
def test_a_reload_that_fails_in_any_way_leaves_the_old_engine_running(
    run: Run,
    tmp_path: Path,
    channel: str,
    monkeypatch: pytest.MonkeyPatch,
    part: str,
) -> None:
    path = car(tmp_path, channel)
    owner: Any = Monitor if part == "links" else assembly
    works = getattr(owner, part)
    waiting = list(FAILURES)

    def play(peer: Peer, lines: Lines) -> None:
        def fail(*_: Any, **__: Any) -> None:
            raise waiting[0]

        if part == "links":
            text = path.read_text("utf-8").replace(
                "drain_s = 0.1", "drain_s = 0.05"
            )
            path.write_text(text, "utf-8")
        for number, _ in enumerate(FAILURES, 1):
            monkeypatch.setattr(owner, part, fail)
            os.kill(os.getpid(), signal.SIGHUP)
            lines.wait_for("config_refused", number)
            del waiting[0]
        peer.hear(0.1)
        peer.heard.clear()
        peer.drive(0.5)
        assert any(m.arbitration_id == ID_BASE for m in peer.heard)
        monkeypatch.setattr(owner, part, works)
        os.kill(os.getpid(), signal.SIGHUP)
        lines.wait_for("config_reloaded")

    lines = run(play, config=path)

    refused = [
        f["problems"] for name, f in lines.said if name == "config_refused"
    ]
    assert len(refused) == len(FAILURES)
    for problems, error in zip(refused, FAILURES, strict=True):
        [line] = problems
        assert line.startswith(
            f"{path}: cannot be used: {type(error).__name__}"
        )
        assert "\n" not in line


@pytest.mark.slow
def test_a_state_that_the_new_engine_can_not_take_leaves_the_old_one(
    run: Run, tmp_path: Path, channel: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = car(tmp_path, channel)
    closed: list[str] = []

    def play(peer: Peer, lines: Lines) -> None:
        def fail(*_: Any) -> None:
            raise RecursionError

        text = path.read_text("utf-8").replace(
            "drain_s = 0.1", "drain_s = 0.05"
        )
        path.write_text(text, "utf-8")
        peer.drive(0.3)
        monkeypatch.setattr(assembly.Monitor, "links", links)
        monkeypatch.setattr(Engine, "resume", fail)
        os.kill(os.getpid(), signal.SIGHUP)
        lines.wait_for("config_refused")
        peer.heard.clear()
        peer.drive(0.3)
        assert any(m.arbitration_id == ID_BASE for m in peer.heard)

    def links(monitor: Monitor) -> list[Any]:
        link = SimpleNamespace(close=lambda: closed.append("closed"))
        return [link for _ in monitor.config.bus]

    lines = run(play, config=path)

    assert (
        "RecursionError" in dict(lines.said)["config_refused"]["problems"][0]
    )
    assert closed == ["closed"]


@pytest.mark.slow
def test_while_a_configuration_is_built_the_cycle_goes_on(
    run: Run, tmp_path: Path, channel: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signal meanwhile asks for one more: the file may have changed."""
    path = car(tmp_path, channel)
    build = assembly.build_monitor
    go_on = threading.Event()
    began = []

    def slow(*args: Any, **options: Any) -> Monitor:
        began.append(threading.current_thread().name)
        if len(began) > 1:
            assert go_on.wait(LIMIT_S)
        return build(*args, **options)

    monkeypatch.setattr(assembly, "build_monitor", slow)

    def play(peer: Peer, lines: Lines) -> None:
        peer.drive(0.2)
        os.kill(os.getpid(), signal.SIGHUP)
        peer.drive(0.3)
        os.kill(os.getpid(), signal.SIGHUP)
        peer.heard.clear()
        end_s = time.monotonic() + LIMIT_S
        while len([m for m in peer.heard if m.arbitration_id == ID_BASE]) < 7:
            assert time.monotonic() < end_s
            peer.drive(0.2)
        assert "config_reloaded" not in lines.names()
        go_on.set()
        lines.wait_for("config_reloaded", 2)

    run(play, config=path)

    assert began == ["MainThread", "build", "build"]


@pytest.mark.parametrize("error", FAILURES, ids=lambda e: type(e).__name__)
def test_a_start_that_fails_in_any_way_ends_with_78(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
) -> None:
    config = car(tmp_path, "nobody")

    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(assembly, "compile_signal_map", fail)

    code = main(
        ["run", "-c", str(config), "--state", str(tmp_path / "car.state")]
    )

    lines = capsys.readouterr().err.splitlines()
    assert code == ConfigError.exit_code
    assert lines[0].startswith(f"{config}: cannot be used: ")
    assert len(lines) == 1


def test_the_collector_passes_over_no_vehicle_and_a_reload_leaves_none(
    run: Run, tmp_path: Path, channel: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pass over one takes 25 ms; what is left out is never freed."""
    path = car(tmp_path, channel)
    built: list[weakref.ref[Engine]] = []
    build = assembly.build_monitor

    def watched(*args: Any, **options: Any) -> Monitor:
        monitor = build(*args, **options)
        built.append(weakref.ref(monitor.engine))
        return monitor

    monkeypatch.setattr(assembly, "build_monitor", watched)
    gc.unfreeze()
    left_out = []
    here = []
    passed_over = []

    def play(peer: Peer, lines: Lines) -> None:
        peer.drive(0.2)
        left_out.append(gc.get_freeze_count())
        os.kill(os.getpid(), signal.SIGHUP)
        lines.wait_for("config_reloaded")
        here.extend(engine() is not None for engine in built)
        new = built[-1]()
        passed_over.extend(one is new for one in gc.get_objects())

    try:
        run(play, config=path)
    finally:
        gc.unfreeze()

    assert left_out[0] > 10_000
    assert here == [False, True]
    assert not any(passed_over)


@pytest.mark.slow
def test_the_service_manager_hears_ready_status_watchdog_and_stopping(
    run: Run, tmp_path: Path
) -> None:
    notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    notices.bind(str(tmp_path / "notify"))
    notices.setblocking(False)
    said: list[str] = []

    def listen() -> None:
        with suppress(BlockingIOError):
            while True:
                said.append(notices.recv(4096).decode())

    def play(peer: Peer, _: Lines) -> None:
        for _tenth in range(15):
            peer.drive(0.1)
            listen()  # a socket holds but ten messages

    run(play, notifier=Notifier(str(tmp_path / "notify"), 0.2))
    listen()
    notices.close()

    kinds = [text.partition("=")[0] for text in said]
    assert kinds[0] == "READY"
    assert kinds[-1] == "STOPPING"
    assert kinds.count("WATCHDOG") >= 3
    assert any("degraded" in t for t in said if t.startswith("STATUS="))


def test_a_second_instance_is_refused_before_it_starts(
    run: Run, tmp_path: Path, channel: str
) -> None:
    second = tmp_path / "second"
    second.mkdir()
    config = car(second, channel)

    def play(peer: Peer, lines: Lines) -> None:
        with pytest.raises(StateLockedError):
            Service(
                Options(config, tmp_path / "car.state"),
                Notifier(),
                ServiceLog(Lines()),
            )

    run(play)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("id_base = 0x5B0", "id_base = 0x10C"), "id_base = 0x10C"),
        (('interface = "virtual"', 'interface = "none"'), "none"),
        (("mass_kg = ", "mass_kh = "), "mass_kh"),
    ],
)
def test_a_configuration_that_can_not_work_ends_with_78(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    change: tuple[str, str],
    words: str,
) -> None:
    config = car(tmp_path, "nobody", change)
    state = tmp_path / "car.state"

    code = main(["run", "-c", str(config), "--state", str(state)])

    error = capsys.readouterr().err
    assert code == ConfigError.exit_code
    assert words in error
    assert "Traceback" not in error


def test_another_channel_from_the_command_line(
    tmp_path: Path, channel: str
) -> None:
    lines = Lines()
    options = Options(
        car(tmp_path, "nobody"),
        tmp_path / "car.state",
        BusOverride(channel=channel),
        until_us=100_000,
    )
    with SignalWaiter() as waiter:
        Service(options, Notifier(), ServiceLog(lines)).run(waiter)

    assert dict(lines.said)["bus_up"]["channel"] == channel
    assert lines.said[-1] == ("service_stopping", {"reason": "time"})

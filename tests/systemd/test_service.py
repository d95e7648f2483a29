"""The live service under systemd: installed, started, driven, disturbed."""

import contextlib
import itertools
import json
import os
import re
import shutil
import signal
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cantools
import pytest
from cantools.database.can import Database

from .commands import DEADLINE_S, run, until
from .conftest import Unit

pytestmark = pytest.mark.systemd

FIRST_DYNAMIC_USER = 61184
NOBODY = 65534
PORT = 9745

SOURCE = Path(__file__).parents[2]
SHIPPED = Path(sys.prefix) / "share" / "bstm-daemon" / "systemd"
BSTM = Path(sys.prefix) / "bin" / "bstm"
UNITS = Path("/etc/systemd/system")
CONFIG = Path("/etc/bstm/vehicle.toml")
STATE = Path("/var/lib/bstm/example-vehicle.state")
METRICS = Path("/run/bstm/bstm.prom")
ID_BASE = 0x5B0


def configure(path: Path = CONFIG, **changes: str) -> None:
    """Write the example car on vcan0, with *changes* of single lines."""
    text = (SOURCE / "config" / "example_vehicle.toml").read_text()
    lines = {
        "dbc": '"example_vehicle.dbc"',
        "channel": '"vcan0"',
        **changes,
    }
    text = text.replace(
        "[publish]\n# Send frames; otherwise the daemon only listens. true or "
        "false, default false.\nenabled = false",
        "[publish]\nenabled = true",
    )
    assert "enabled = true\n# A name of a [[bus]]" in text
    head, section, tail = text.partition("[metrics]")
    text = head + section + tail.replace("enabled = false", "enabled = true")
    for key, value in lines.items():
        text, count = re.subn(
            rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE
        )
        assert count == 1, key
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    shutil.copy(SOURCE / "dbc" / "example_vehicle.dbc", path.parent)


@pytest.fixture
def service(
    installed: None, unit_named: Callable[[str], Unit]
) -> Iterator[Unit]:
    """Return the configured service, not started."""
    configure()
    unit = unit_named("bstm.service")
    yield unit
    for name in ("bstm.service", "bstm@second.service"):
        unit_named(name).control("stop")
        unit_named(name).control("reset-failed", check=False)
    run("journalctl", "--rotate")
    run("journalctl", "--vacuum-time=1s")
    shutil.rmtree("/etc/bstm")
    for folder in ("private/bstm", "private/bstm-second"):
        shutil.rmtree(Path("/var/lib", folder), ignore_errors=True)
    for path in Path("/var/lib").glob("bstm*"):
        path.unlink()


@pytest.fixture
def started(service: Unit) -> Unit:
    """Return the started service."""
    service.control("start")
    return service


@pytest.fixture
def drop_in() -> Iterator[Callable[[str, str], None]]:
    """Return what changes a unit by a text."""
    with contextlib.ExitStack() as made:

        def put(name: str, text: str) -> None:
            folder = UNITS / f"{name}.d"
            folder.mkdir()
            made.callback(run, "systemctl", "daemon-reload")
            made.callback(shutil.rmtree, folder)
            (folder / "test.conf").write_text(text)
            run("systemctl", "daemon-reload")

        yield put


def database(name: str) -> Database:
    found = cantools.database.load_file(SOURCE / "dbc" / f"{name}.dbc")
    assert isinstance(found, Database)
    return found


def published(offset: int = 4, base: int = ID_BASE) -> dict[str, Any]:
    """Return the next frame at *offset*, decoded: FL's temperatures."""
    found = run(
        *("candump", "-L", "-n", "1", "-T", str(round(DEADLINE_S * 1e3))),
        f"vcan0,{base + offset:X}:7FF",
    )
    data = bytes.fromhex(found.stdout.split("#")[1])
    message = database("bstm").get_message_by_frame_id(ID_BASE + offset)
    return dict(message.decode_simple(data, decode_choices=False))


def brake(folder: Path) -> None:
    """Let the car brake from 30 m/s with 5 m/s2 for 4 s, by canplayer."""
    messages = database("example_vehicle")
    lines = []
    for step in range(200):
        time_s = step * 0.02
        speed_kmh = (30.0 - 5.0 * time_s) * 3.6
        values: dict[str, dict[str, float]] = {
            "WheelSpeeds": dict.fromkeys(
                (f"WheelSpeed{c}" for c in ("FL", "FR", "RL", "RR")), speed_kmh
            ),
            "Inertial": {
                "AccelLongitudinal": -5.0,
                "AccelLateral": 0.0,
                "YawRate": 0.0,
                "VehicleSpeed": speed_kmh,
            },
            "BrakePressure": {"PressurePrimary": 45, "PressureSecondary": 45},
            "Ambient": {"AmbientTemperature": 20, "RainIntensity": 0},
        }
        for name, signals in values.items():
            message = messages.get_message_by_name(name)
            data = message.encode(signals).hex().upper()
            lines.append(
                f"({1 + time_s:.6f}) vcan0 {message.frame_id:03X}#{data}\n"
            )
    log = folder / "brake.log"
    log.write_text("".join(lines))
    run("canplayer", "-I", log)


def process_status(unit: Unit) -> dict[str, str]:
    text = Path("/proc", unit.property("MainPID"), "status").read_text()
    return dict(line.split(":", 1) for line in text.splitlines())


def test_start_waits_for_ready_and_shows_a_status(service: Unit) -> None:
    service.control("start")
    assert service.property("ActiveState") == "active"
    until(lambda: "no_input" in service.property("StatusText"), service)
    assert "history unknown" in service.property("StatusText")
    assert "service_started" in service.journal()


def test_the_sandbox_holds(started: Unit) -> None:
    fields = process_status(started)
    assert int(fields["Uid"].split()[0]) >= FIRST_DYNAMIC_USER
    for kind in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb"):
        assert int(fields[kind], 16) == 0, kind
    assert int(fields["NoNewPrivs"]) == 1
    assert int(fields["Seccomp"]) == 2
    root = Path("/proc", started.property("MainPID"), "root")
    assert not list((root / "root").iterdir())
    assert not list((root / "home").iterdir())


def test_the_service_warms_the_discs_of_a_braking_car(
    started: Unit, tmp_path: Path
) -> None:
    before = published()
    brake(tmp_path)
    after = published()
    assert after["Disc"] > before["Disc"] + 10.0
    assert after["PadFront"] > before["PadFront"] + 10.0
    until(lambda: "800 frames" in started.property("StatusText"), started)


@pytest.mark.full
def test_frames_from_elsewhere_with_our_id_end_publication(
    started: Unit,
) -> None:
    published()
    run("cansend", "vcan0", f"{ID_BASE:X}#0011223344556677")
    until(lambda: "NOT PUBLISHING" in started.property("StatusText"), started)
    assert "foreign_frame" in started.journal()
    assert started.property("ActiveState") == "active"


def test_a_reload_takes_a_good_configuration(started: Unit) -> None:
    process = started.property("MainPID")
    published()
    configure(id_base="0x600")
    started.control("reload")
    published(base=0x600)
    assert "config_reloaded" in started.journal()
    assert started.property("MainPID") == process


@pytest.mark.full
def test_a_reload_refuses_a_bad_configuration(started: Unit) -> None:
    process = started.property("MainPID")
    configure(wheel_radius_m="-1.0")
    started.control("reload")
    until(lambda: "config_refused" in started.journal(), started)
    assert "[vehicle] wheel_radius_m" in started.journal()
    published()
    assert started.property("MainPID") == process


def test_a_stop_is_clean_and_leaves_the_state(started: Unit) -> None:
    published()
    started.control("stop")
    assert started.property("Result") == "success"
    assert "service_stopping" in started.journal()
    assert STATE.stat().st_size > 1000
    assert STATE.stat().st_mode & 0o077 == 0
    assert not METRICS.exists()


def test_a_restart_knows_the_brakes(started: Unit, tmp_path: Path) -> None:
    brake(tmp_path)
    hot = published()
    started.control("restart")
    assert "state_loaded" in started.journal()
    again = published()
    assert again["Disc"] == pytest.approx(hot["Disc"], abs=10.0)
    assert again["Disc"] > 25.0


@pytest.mark.full
def test_the_state_names_the_boot(started: Unit) -> None:
    """By it the time parked is certain; ProcSubset=pid would hide it."""
    started.control("stop")
    body = STATE.read_text().splitlines()[1]
    boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    assert json.loads(body)["boot_id"] == boot


def test_a_crash_is_followed_by_a_restart(started: Unit) -> None:
    os.kill(int(started.property("MainPID")), signal.SIGKILL)
    started.wait_for("NRestarts", "1")
    started.wait_for("ActiveState", "active")
    published()
    assert "state_loaded" in started.journal()


def test_the_watchdog_ends_a_hang_and_tells_where(started: Unit) -> None:
    published()
    os.kill(int(started.property("MainPID")), signal.SIGSTOP)
    started.wait_for("NRestarts", "1")
    started.wait_for("ActiveState", "active")
    published()
    journal = started.journal()
    assert "Watchdog timeout (limit 10s)" in journal
    assert "Fatal Python error: Aborted" in journal
    assert "bstm_daemon/service/service.py" in journal


def test_a_wrong_configuration_is_not_tried_again(service: Unit) -> None:
    configure(wheel_radius_m="-1.0")
    assert service.control("start", check=False) != 0
    # with a restart ahead it would be "activating"
    service.wait_for("ActiveState", "failed")
    assert service.property("ExecMainStatus") == "78"
    assert service.property("NRestarts") == "0"
    assert "[vehicle] wheel_radius_m" in service.journal()


@pytest.mark.full
def test_a_second_owner_of_the_state_is_not_tried_again(
    started: Unit,
    unit_named: Callable[[str], Unit],
    drop_in: Callable[[str, str], None],
) -> None:
    published()
    configure(CONFIG.with_name("second.toml"), id_base="0x600")
    drop_in(
        "bstm@second.service",
        "[Service]\nStateDirectory=\nStateDirectory=bstm\n",
    )
    second = unit_named("bstm@second.service")
    assert second.control("start", check=False) != 0
    second.wait_for("ActiveState", "failed")
    assert second.property("ExecMainStatus") == "75"
    assert second.property("NRestarts") == "0"
    assert started.property("ActiveState") == "active"


def test_a_missing_configuration_is_waited_for(service: Unit) -> None:
    CONFIG.unlink()
    assert service.control("start", check=False) != 0
    # the next try, a second later, has an ExecMainStatus of its own
    assert "status=74" in service.journal()
    configure()
    service.wait_for("ActiveState", "active")


@pytest.mark.full
def test_an_instance_runs_beside_and_outlives_the_other(
    started: Unit, unit_named: Callable[[str], Unit]
) -> None:
    configure(CONFIG.with_name("second.toml"), id_base="0x600")
    second = unit_named("bstm@second.service")
    second.control("start")
    published()
    published(base=0x600)
    metrics = Path("/run/bstm-second/bstm.prom")
    until(metrics.exists, second)
    started.control("stop")
    assert metrics.exists()
    second.control("stop")
    assert Path("/var/lib/bstm-second/example-vehicle.state").exists()


def test_the_interface_may_go_and_come(started: Unit) -> None:
    process = started.property("MainPID")
    published()
    run("ip", "link", "del", "vcan0")
    try:
        until(lambda: "vcan0" in started.property("StatusText"), started)
    finally:
        run("ip", "link", "add", "vcan0", "type", "vcan")
        run("ip", "link", "set", "vcan0", "up")
    published()
    until(lambda: "vcan0" not in started.property("StatusText"), started)
    assert started.property("MainPID") == process
    assert started.property("NRestarts") == "0"


def test_it_starts_before_its_interface(service: Unit) -> None:
    run("ip", "link", "del", "vcan0")
    try:
        service.control("start")
        until(
            lambda: "no interface vcan0" in service.property("StatusText"),
            service,
        )
    finally:
        run("ip", "link", "add", "vcan0", "type", "vcan")
        run("ip", "link", "set", "vcan0", "up")
    published()


@pytest.mark.full
def test_every_user_may_read_the_metrics(started: Unit) -> None:
    until(METRICS.exists, started)
    text = run("cat", METRICS, user=NOBODY).stdout
    assert "bstm_build_info{" in text


@pytest.mark.full
def test_the_drop_in_serves_metrics_on_loopback(service: Unit) -> None:
    run(BSTM, "install-service", "--metrics-port", str(PORT))
    run("systemctl", "daemon-reload")
    try:
        done = run("systemd-analyze", "verify", service.name)
        assert (done.stdout, done.stderr) == ("", "")
        service.control("start")
        until(lambda: get("/healthz") == (200, "ok\n"), service)
        status, text = get("/metrics")
        assert (status, "bstm_build_info{" in text) == (200, True)
        listening = run("ss", "-Hltn").stdout.split()
        assert [w for w in listening if w.endswith(f":{PORT}")] == [
            f"127.0.0.1:{PORT}"
        ]
        published()
    finally:
        service.control("stop")
        shutil.rmtree(UNITS / "bstm.service.d")
        run("systemctl", "daemon-reload")


def get(path: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(
            f"http://127.0.0.1:{PORT}{path}", timeout=DEADLINE_S
        ) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


@pytest.mark.full
def test_the_sysctl_file_gives_the_whole_receive_buffer(service: Unit) -> None:
    key = Path("/proc/sys/net/core/rmem_max")
    before = key.read_text()
    run("sysctl", "-p", SHIPPED / "90-bstm-can.conf")
    try:
        service.control("start")
        # the kernel counts twice what is asked for
        until(
            lambda: '"given_bytes": 8388608' in service.journal(),
            service,
        )
    finally:
        key.write_text(before)


FEED = Path("/run/bstm/feed.sock")


@pytest.fixture
def with_feed(service: Unit) -> Iterator[Unit]:
    """Return the service with a feed, page and bridge beside it, started."""
    text = CONFIG.read_text()
    CONFIG.write_text(text.replace('# socket = "/run', 'socket = "/run'))
    # nobody listens there: the bridge waits
    (CONFIG.parent / "mqtt.toml").write_text('broker = "mqtt://127.0.0.1:9"\n')
    (CONFIG.parent / "mqtt.toml").chmod(0o600)
    run(BSTM, "install-service", "--with", "view", "--with", "mqtt")
    run("systemctl", "daemon-reload")
    service.control("start")
    until(FEED.exists, service)
    yield service
    for name in ("bstm-view", "bstm-mqtt"):
        run("systemctl", "stop", name)
        (UNITS / f"{name}.service").unlink()
    run("systemctl", "daemon-reload")


def page() -> int:
    """Return the status of the page; 0 where there is none."""
    try:
        with urllib.request.urlopen(
            "http://127.0.0.1:8080/", timeout=DEADLINE_S
        ) as answer:
            return int(answer.status)
    except OSError:
        return 0


def test_the_feed_is_for_its_group_only(with_feed: Unit) -> None:
    # first it is bound, then opened to the group, then listened on
    until(lambda: FEED.stat().st_mode & 0o777 == 0o660, with_feed)
    status = FEED.stat()
    assert status.st_uid >= FIRST_DYNAMIC_USER
    code = f"import socket;socket.socket(1).connect({str(FEED)!r})"
    refused = run(sys.executable, "-c", code, user=NOBODY, check=False)
    assert "PermissionError" in refused.stderr
    run(sys.executable, "-c", code, user=NOBODY, group=status.st_gid)


@pytest.mark.full
@pytest.mark.parametrize("name", ["bstm-view.service", "bstm-mqtt.service"])
def test_the_units_beside_the_service_are_sound(
    with_feed: Unit, name: str
) -> None:
    done = run("systemd-analyze", "verify", name)
    assert (done.stdout, done.stderr) == ("", "")
    run("systemctl", "start", name)
    found = run("systemd-analyze", "security", name, "--no-pager").stdout
    exposure = re.search(r"Overall exposure level.*: ([\d.]+)", found)
    assert exposure is not None
    assert float(exposure[1]) <= 1.9, found


def test_page_and_bridge_that_die_change_no_frame(
    with_feed: Unit, unit_named: Callable[[str], Unit]
) -> None:
    process = with_feed.property("MainPID")
    beside = [unit_named(f"bstm-{name}.service") for name in ("view", "mqtt")]
    for unit in beside:
        unit.control("start")
    view, bridge = beside
    until(lambda: page() == 200, view)
    listening = run("ss", "-Hltn").stdout.split()
    assert [word for word in listening if word.endswith(":8080")] == [
        "127.0.0.1:8080"
    ]
    before = counters()
    for unit in beside:
        unit.control("kill", check=True)
        unit.control("stop")
    for unit in beside:
        unit.control("start")
    until(lambda: page() == 200, view)
    for unit in beside:
        run("systemctl", "kill", "-s", "KILL", unit.name)
    until(lambda: bridge.property("NRestarts") == "1", bridge)
    until(lambda: page() == 200, view)
    after = counters()

    assert with_feed.property("MainPID") == process
    assert with_feed.property("NRestarts") == "0"
    # frame after frame, each with the next counter
    for seen in (before, after):
        steps = [(b - a) % 16 for a, b in itertools.pairwise(seen)]
        assert steps == [1] * len(steps)


def counters() -> list[int]:
    """Return the counters of the next frames of BSTM_Status."""
    found = run("candump", "-L", "-n", "12", f"vcan0,{ID_BASE:X}:7FF").stdout
    return [
        bytes.fromhex(line.split("#")[1])[1] & 0xF
        for line in found.splitlines()
    ]


def test_the_service_outlives_and_precedes_what_reads_it(
    service: Unit, with_feed: Unit, unit_named: Callable[[str], Unit]
) -> None:
    view = unit_named("bstm-view.service")
    view.control("start")
    until(lambda: page() == 200, view)
    with_feed.control("stop")
    assert not FEED.exists()
    assert page() == 200, "the page stays, and says that there is no data"
    with_feed.control("start")
    until(FEED.exists, with_feed)
    assert view.property("NRestarts") == "0"

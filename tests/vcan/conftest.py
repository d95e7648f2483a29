"""Fixtures of tests on real SocketCAN interfaces (``pytest -m vcan``)."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import pytest

from bstm_daemon.model.wear.dose import DISTANCE, DOSE
from bstm_daemon.service.assembly import BusOverride, build_monitor

from .daemon_process import Daemon, Forked, Forks
from .peers import DEADLINE_S, Car, Ear, Sent, wait_until

ROOT = Path(__file__).resolve().parents[2]
IFF_UP = 1
CAP_NET_ADMIN = 12
ID_BASE = 0x5B0
Recorder = Callable[..., subprocess.Popen[str]]


def missing(reason: str) -> NoReturn:
    """Skip for *reason*; in the rig, which has everything, fail."""
    if os.environ.get("BSTM_RIG") == "required":
        pytest.fail(f"in the rig: {reason}")
    pytest.skip(reason)


def interface(name: str) -> str:
    """Return *name* of an interface that is there and up."""
    flags = Path("/sys/class/net", name, "flags")
    if not flags.exists():
        missing(f"no interface {name}")
    if not int(flags.read_text(), 16) & IFF_UP:
        missing(f"{name} is down")
    return name


@pytest.fixture
def vcan0() -> str:
    """Return the name of the first interface."""
    return interface("vcan0")


@pytest.fixture
def vcan1() -> str:
    """Return the name of the second interface."""
    return interface("vcan1")


@pytest.fixture
def net_admin() -> None:
    """Demand the right to set interfaces up and down."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    effective = int(status.partition("CapEff:")[2].split()[0], 16)
    if not effective >> CAP_NET_ADMIN & 1:
        missing("needs CAP_NET_ADMIN")


@pytest.fixture
def own_clock() -> Iterator[None]:
    """Allow the test to step the wall clock, and set it right again."""
    if os.environ.get("BSTM_RIG") != "required":
        pytest.skip("steps the wall clock: in the rig only")
    boot_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
    yield
    passed_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - boot_ns
    time.clock_settime_ns(time.CLOCK_REALTIME, wall_ns + passed_ns)


@pytest.fixture
def program() -> Callable[[str], str]:
    """Return what finds a program of can-utils or iproute2."""

    def find(name: str) -> str:
        found = shutil.which(name)
        if not found:
            missing(f"no {name}: apt install can-utils iproute2")
        return found

    return find


@pytest.fixture
def candump(program: Callable[[str], str]) -> Iterator[Recorder]:
    """Return what starts ``candump`` and waits until it listens.

    Its arguments are candump's; standard output is a pipe of text.
    """
    path = program("candump")
    with contextlib.ExitStack() as running:

        def start(*arguments: str) -> subprocess.Popen[str]:
            before = receivers()
            process = subprocess.Popen(
                [path, *arguments], stdout=subprocess.PIPE, text=True
            )
            running.callback(stop, process)
            wait_until(
                lambda: receivers() > before or process.poll() is not None,
                f"candump {arguments} listens",
            )
            return process

        yield start


def stop(process: subprocess.Popen[str]) -> None:
    """End *process* and close its pipe."""
    process.terminate()
    process.communicate(timeout=DEADLINE_S)


def receivers() -> int:
    """Return how many receivers raw sockets have registered."""
    lists = Path("/proc/net/can").glob("rcvlist_*")
    return sum(
        line.endswith(" raw")
        for path in lists
        for line in path.read_text(encoding="ascii").splitlines()
    )


def configured(changes: Mapping[str, Any]) -> str:
    """Return the example car's configuration on vcan0 with *changes*.

    Their keys are ``section.key``; a key that is a comment in the example
    may be changed too.
    """
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    settings = {
        "bus.channel": "vcan0",
        "bus.dbc": str(ROOT / "dbc" / "example_vehicle.dbc"),
        "publish.enabled": True,
        "daemon.reopen_s": 0.1,
        "metrics.enabled": True,
        "metrics.interval_s": 0.5,
        **changes,
    }
    for name, value in settings.items():
        section, _, key = name.rpartition(".")
        pattern = (
            rf"(?ms)(^\[\[?{re.escape(section)}\]\]?$(?:(?!^\[).)*?)"
            rf"^(?:# )?{key} = [^\n]*"
        )
        line = f"{key} = {json.dumps(value)}"
        text, count = re.subn(
            pattern, lambda found, line=line: found[1] + line, text, count=1
        )
        assert count, f"no {name} in the example"
    return text


@pytest.fixture
def car(vcan0: str) -> Iterator[Callable[..., Car]]:
    """Return what sends a car off, by default on vcan0."""
    with contextlib.ExitStack() as cars:

        def start(*buses: str, places: Mapping[int, int] | None = None) -> Car:
            made = Car(list(buses) or [vcan0], places)
            cars.callback(made.close)
            return made

        yield start


@pytest.fixture
def ear() -> Iterator[Callable[..., Ear]]:
    """Return what listens on an interface, by default for our frames."""
    with contextlib.ExitStack() as ears:

        def listen(
            interface: str, low_id: int = ID_BASE, high_id: int = ID_BASE + 20
        ) -> Ear:
            made = Ear(interface, low_id, high_id)
            ears.callback(made.close)
            return made

        yield listen


@pytest.fixture(scope="session")
def forks() -> Iterator[Forks]:
    """Return the process that services are forked from."""
    made = Forks()
    yield made
    made.close()


@pytest.fixture
def daemon(
    tmp_path: Path, vcan0: str, forks: Forks
) -> Iterator[Callable[..., Daemon]]:
    """Return what starts ``bstm run`` and waits until it is ready.

    Its arguments: changes of the example's configuration by ``section.key``;
    ``more`` is text added to it, ``edit`` a function of the whole text;
    ``state`` the state file, ``folder`` that of all files; ``arguments`` are
    further ones of the command line. With ``ready=False`` nothing is waited
    for.
    """
    with contextlib.ExitStack() as daemons:

        def start(
            changes: Mapping[str, Any] | None = None,
            *,
            more: str = "",
            edit: Callable[[str], str] = str,
            state: Path | None = None,
            arguments: Iterable[str] = (),
            ready: bool = True,
        ) -> Daemon:
            number = len(list(tmp_path.glob("daemon*")))
            folder = tmp_path / f"daemon{number}"
            folder.mkdir()
            config = folder / "car.toml"
            metrics_file = folder / "bstm.prom"
            settings = {"metrics.file": str(metrics_file), **(changes or {})}
            config.write_text(edit(configured(settings)) + more, "utf-8")
            state = state or folder / "car.state"
            notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            notify.settimeout(0.1)
            notify.bind(str(folder / "notify"))
            process = Forked(
                forks,
                ["run", "-c", f"{config}", "--state", f"{state}", *arguments],
                {"NOTIFY_SOCKET": str(folder / "notify")},
            )
            made = Daemon(process, notify, config, state, metrics_file)
            daemons.callback(made.close)
            if ready:
                made.notice("READY=1")
            return made

        yield start


@pytest.fixture
def ip(
    net_admin: None, program: Callable[[str], str], vcan0: str
) -> Iterator[Callable[..., None]]:
    """Return ``ip link``; afterwards the interfaces are as before."""
    path = program("ip")

    def run(*arguments: str, check: bool = True) -> None:
        subprocess.run(
            [path, "link", *arguments], check=check, capture_output=not check
        )

    yield run
    run("set", vcan0, "up")
    run("delete", "vcan9", check=False)


@pytest.fixture
def marched() -> Callable[..., dict[str, dict[str, Any]]]:
    """Return what gives the memory that frames lead to.

    Frames carry their time since boot, which no step of the wall clock
    moves: the result is that of a drive without one, at the time of a saved
    *document*. To be compared: temperatures within *off_k* [K], the sums of
    a drive within 0.5 %, as stamps of a busy machine differ by milliseconds.
    """

    def march(
        config: Path,
        sent: Iterable[Sent],
        document: Mapping[str, Any],
        off_k: float,
    ) -> dict[str, dict[str, Any]]:
        engine = build_monitor(config, BusOverride()).engine
        until_us = document["time_us"]
        # as on the axis of the service, for the same grid
        shift_us = until_us - document["boot_us"]
        for frame in sent:
            stamp_us = frame.boot_us + shift_us
            if stamp_us <= until_us:
                engine.frame(
                    frame.bus, frame.can_id, False, frame.data, stamp_us
                )
        engine.tick(until_us)
        corners: dict[str, dict[str, float]] = engine.export_state()["corners"]
        return {
            name: {
                key: pytest.approx(value, rel=5e-3)
                if key in (DOSE, DISTANCE)
                else pytest.approx(value, abs=off_k)
                for key, value in corner.items()
            }
            for name, corner in corners.items()
        }

    return march


@pytest.fixture
def medium(
    tmp_path: Path, net_admin: None, program: Callable[[str], str]
) -> Iterator[Path]:
    """Return a file system of 256 KiB of its own."""
    place = tmp_path / "medium"
    place.mkdir()
    mount = program("mount")
    subprocess.run(
        [mount, "-t", "tmpfs", "-o", "size=256k", "none", str(place)],
        check=True,
    )
    yield place
    subprocess.run([program("umount"), "-l", str(place)], check=True)

"""Fixtures of tests under a real systemd (``pytest -m systemd``).

They run as root inside the machine that systemd manages and install units in
it, which is nothing to do to a machine in use: only in the rig's box, where
BSTM_RIG is ``required``.
"""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

UNITS = Path("/run/systemd/system")
INSTALLED = Path("/etc/systemd/system")
DEADLINE_S = 60.0
"""For what takes a second or less: reached only where it never comes."""

Install = Callable[[str, str], "Unit"]


class Unit:
    """A unit in the box, under test."""

    def __init__(self, name: str) -> None:
        self.name = name

    def control(self, verb: str, *, check: bool = True) -> int:
        """Run ``systemctl VERB``; return its exit code.

        Raises:
            AssertionError: it failed although *check*; with the journal.
        """
        done = subprocess.run(
            ["systemctl", verb, self.name],
            capture_output=True,
            text=True,
            check=False,
            timeout=DEADLINE_S,
        )
        assert not check or done.returncode == 0, (
            f"systemctl {verb} {self.name}: {done.stderr}\n{self.journal()}"
        )
        return done.returncode

    def property(self, name: str) -> str:
        """Return the unit's property *name* as systemd writes it."""
        return _output("systemctl", "show", "--value", "-p", name, self.name)

    def journal(self) -> str:
        """Return what the unit has written and systemd about it."""
        _output("journalctl", "--sync")
        return _output("journalctl", "-o", "cat", "-u", self.name)

    def wait_for(self, name: str, value: str) -> None:
        """Return once property *name* is *value*; fail if it never is."""
        deadline_s = time.monotonic() + DEADLINE_S
        while (found := self.property(name)) != value:
            if time.monotonic() > deadline_s:
                pytest.fail(
                    f"{self.name}: {name} is {found}, never {value}\n"
                    + self.journal()
                )
            time.sleep(0.05)


def _output(*command: str) -> str:
    """Return what *command* prints."""
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        timeout=DEADLINE_S,
    )
    return done.stdout.strip()


@pytest.fixture(scope="session")
def box() -> None:
    """Demand the rig's box: root, and systemd as PID 1 of a guest."""
    if os.environ.get("BSTM_RIG") != "required":
        pytest.skip("installs units as root: in the rig's box only")
    first = Path("/proc/1/comm").read_text(encoding="ascii").strip()
    if first != "systemd" or os.geteuid() != 0:
        pytest.fail(f"in the rig: PID 1 is {first}, user {os.geteuid()}")


@pytest.fixture
def install(box: None) -> Iterator[Install]:
    """Return what installs a unit file by name; stops and removes it after."""
    with contextlib.ExitStack() as installed:

        def put(name: str, text: str) -> Unit:
            path = UNITS / name
            path.write_text(text)
            installed.callback(_remove, path)
            _output("systemctl", "daemon-reload")
            return Unit(name)

        yield put


def _remove(path: Path) -> None:
    """Stop the unit of *path* and forget it."""
    subprocess.run(["systemctl", "stop", path.name], check=True)
    path.unlink()
    _output("systemctl", "daemon-reload")


@pytest.fixture(scope="session")
def interpreter(box: None) -> str:
    """Return the Python of the tests, which a sandboxed unit can start too."""
    return sys.executable


@pytest.fixture
def unit_named(box: None) -> Callable[[str], Unit]:
    """Return what gives the installed unit of a name."""
    return Unit


@pytest.fixture(scope="module")
def installed(box: None) -> Iterator[None]:
    """Install both units of the service, as a user does."""
    bstm = str(Path(sys.prefix) / "bin" / "bstm")
    _output(bstm, "install-service")
    _output(bstm, "install-service", "--instance", "second")
    _output("systemctl", "daemon-reload")
    yield
    for path in INSTALLED.glob("bstm*"):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
    _output("systemctl", "daemon-reload")

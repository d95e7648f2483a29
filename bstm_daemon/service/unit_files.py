"""The units of the service, fitted to the interpreter that is to run them.

The shipped units are whole and valid. Only what depends on the computer is
replaced: the program, the configuration and the port of the metrics. An
interpreter that the sandbox of the unit would hide from the service is
refused here, and not after the next start of the car.
"""

import importlib.util
import os
import re
import stat
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from bstm_daemon.errors import UsageError
from bstm_daemon.files import make_folder, replacing, shipped_file

UNIT_FOLDER: Final = Path("/etc/systemd/system")
CONFIG_FOLDER: Final = Path("/etc/bstm")
DEFAULT_CONFIG: Final = CONFIG_FOLDER / "vehicle.toml"
PROGRAM: Final = "/opt/bstm/bin/bstm"
"""What stands for the program in the shipped units."""

PORT: Final = "--metrics-port 9745"
"""What stands for the port in the shipped drop-in."""

HIDDEN: Final = {
    Path("/home"): "ProtectHome=",
    Path("/root"): "ProtectHome=",
    Path("/run/user"): "ProtectHome=",
    Path("/tmp"): "PrivateTmp=",  # noqa: S108  (nothing is written there)
    Path("/var/tmp"): "PrivateTmp=",  # noqa: S108
}
"""Folders that the service can not see, and what hides them."""

COMPANIONS: Final = ("view", "mqtt")
"""Units that read the feed of the service."""

UNIT_MODE: Final = 0o644

_PACKAGES: Final = (
    "bstm_daemon",
    "can",
    "cantools",
    "numpy",
    "pydantic",
    "structlog",
)
_PLAIN: Final = re.compile(r"/[A-Za-z0-9_./+:@~,=-]*")
_INSTANCE: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.:-]{0,63}")
_PORT_MAX: Final = 65535


@dataclass(frozen=True, slots=True)
class UnitFile:
    """A file of systemd: where it goes and what it holds."""

    path: Path
    text: str

    def write(self) -> bool:
        """Write it unless it exists already; return whether it was written.

        Raises:
            FileAccessError: the folder can not be made or written.
        """
        if self.is_there():
            return False
        make_folder(self.path.parent)
        with replacing(self.path) as temporary:
            temporary.write_text(self.text, "utf-8")
            # systemctl cat and the like, for every user
            temporary.chmod(UNIT_MODE)
        return True

    def is_there(self) -> bool:
        """Whether the file holds just this text."""
        return self.path.is_file() and self.path.read_bytes() == (
            self.text.encode()
        )


@dataclass(frozen=True, slots=True)
class ServiceUnit:
    """What is to be installed: one car, or a named one of several."""

    program: str
    """The command line up to ``run``."""
    config: Path = DEFAULT_CONFIG
    instance: str | None = None
    metrics_port: int | None = None
    companions: tuple[str, ...] = ()
    """Units beside the service, of :data:`COMPANIONS`."""

    @property
    def name(self) -> str:
        """Name of the unit to start."""
        return (
            "bstm.service"
            if self.instance is None
            else f"bstm@{self.instance}.service"
        )

    def files(self, folder: Path) -> list[UnitFile]:
        """Return the unit, a drop-in for metrics, and the companions.

        Raises:
            UsageError: an instance or a port that can not be.
            FileAccessError: the shipped units are missing.
        """
        template = "bstm.service"
        if self.instance is not None:
            template = "bstm@.service"
            if not _INSTANCE.fullmatch(self.instance):
                msg = (
                    f"--instance {self.instance}: letters, digits and _ . : - "
                    "name an instance"
                )
                raise UsageError(msg)
        text = _shipped(template).replace(PROGRAM, self.program)
        text = text.replace(str(DEFAULT_CONFIG), str(self.config))
        files = [UnitFile(folder / template, text)]
        if self.metrics_port is not None:
            files.append(
                UnitFile(
                    folder / f"{self.name}.d" / "metrics-http.conf",
                    _drop_in(self.metrics_port),
                )
            )
        for name in self.companions:
            unit = f"bstm-{name}.service"
            text = _shipped(unit).replace(PROGRAM, self.program)
            files.append(UnitFile(folder / unit, text))
        return files


def program_places() -> list[Path]:
    """Return what of the disk the running program consists of.

    The environment, what it is based on, the interpreter as it was called,
    which makes an environment what it is, and the packages.
    """
    specs = (importlib.util.find_spec(name) for name in _PACKAGES)
    packages = [
        Path(spec.origin) for spec in specs if spec and spec.origin is not None
    ]
    return [
        Path(sys.prefix),
        Path(sys.base_prefix),
        Path(sys.executable),
        Path(os.__file__),
        *packages,
    ]


def program_command(python: Path) -> str:
    """Return the command line that starts this program by *python*.

    ``-P``: modules are looked for in the environment only, not in the folder
    the service starts in.

    Raises:
        UsageError: see :func:`require_plain`.
    """
    return f"{require_plain(python)} -P -m bstm_daemon.cli.main"


def require_plain(path: Path) -> Path:
    """Return *path*, absolute, if it may stand in a unit as it is.

    Raises:
        UsageError: it has blanks, quotes or specifiers.
    """
    # absolute, but not resolved: the link into an environment counts
    text = os.path.abspath(path)  # noqa: PTH100
    if not _PLAIN.fullmatch(text):
        msg = (
            f"{text}: blanks and special characters are not allowed in a "
            "unit; "
            "choose another path"
        )
        raise UsageError(msg)
    return Path(text)


def obstacles(
    places: Iterable[Path], hidden: dict[Path, str] | None = None
) -> list[str]:
    """Return why the service could not read each of *places*, if so.

    A place is looked at as it is written and with all links resolved; what
    lies below one that is refused already is not named again. *hidden* is
    ``HIDDEN`` by default.
    """
    folders = HIDDEN if hidden is None else hidden
    found: list[str] = []
    refused: list[Path] = []
    for place in places:
        # resolved as well: a link may lead anywhere
        for path in (Path(os.path.abspath(place)), place.resolve()):  # noqa: PTH100
            reason = _hiding(path, folders) or _closed(path)
            if reason is None or reason in found:
                continue
            if not any(path.is_relative_to(known) for known in refused):
                found.append(reason)
                refused.append(path)
    return found


def refuse_hidden(places: Sequence[Path]) -> None:
    """Accept a program that the service can run.

    Raises:
        UsageError: with every obstacle, and where to install instead.
    """
    found = obstacles(places)
    if found:
        listed = "\n  ".join(found)
        msg = (
            "install-service: the service could not run this program:\n"
            f"  {listed}\n"
            "Install it where every user may read, and run it from there:\n"
            "  /usr/bin/python3 -m venv /opt/bstm\n"
            "  /opt/bstm/bin/pip install bstm-daemon\n"
            "  /opt/bstm/bin/bstm install-service"
        )
        raise UsageError(msg)


def _hiding(path: Path, folders: dict[Path, str]) -> str | None:
    for folder, setting in folders.items():
        if path.is_relative_to(folder) or path.is_relative_to(
            folder.resolve()
        ):
            return f"{path} is in {folder}, which {setting} hides from it"
    return None


def _closed(path: Path) -> str | None:
    """Return what keeps other users from *path*; None if it is missing."""
    try:
        for folder in reversed(path.parents):
            if not folder.stat().st_mode & stat.S_IXOTH:
                return f"{folder} is closed to other users (chmod o+x)"
        mode = path.stat().st_mode
    except FileNotFoundError:
        return None
    needed = stat.S_IROTH | (stat.S_IXOTH if stat.S_ISDIR(mode) else 0)
    if mode & needed != needed:
        wanted = "rx" if stat.S_ISDIR(mode) else "r"
        return f"{path} is closed to other users (chmod o+{wanted})"
    return None


def _drop_in(port: int) -> str:
    if not 1 <= port <= _PORT_MAX:
        msg = f"--metrics-port {port}: must be from 1 to {_PORT_MAX}"
        raise UsageError(msg)
    text = _shipped("drop-ins/metrics-http.conf")
    fitted = text.replace(PORT, f"--metrics-port {port}")
    return fitted.replace(f":{PORT.split()[1]}/", f":{port}/")


def _shipped(name: str) -> str:
    return shipped_file(f"systemd/{name}").read_text("utf-8")

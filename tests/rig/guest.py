"""A guest: a User Mode Linux kernel with CAN, run as an ordinary process.

The guest needs neither KVM nor modules of the host. bubblewrap keeps the
host safe: to the kernel process every directory is read-only but the writable
shares, its network and processes are its own, and all of it ends with the
launcher. Inside, ``guest-init`` lays a RAM overlay over the tree.
"""

from __future__ import annotations

import contextlib
import os
import re
import selectors
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, TYPE_CHECKING, Literal, NoReturn

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

HERE = Path(__file__).resolve().parent

KERNEL_VARIABLE = "BSTM_RIG_KERNEL"
"""Environment variable that names another kernel than Debian's."""

REQUIRED_VARIABLE = "BSTM_RIG"
"""Set to ``required`` in the guest: there a test without its interface or its
service manager has failed, whereas elsewhere it is skipped."""

TIMED_OUT = 124
FAILED = 125

VIRTUAL_TIME = (
    "time-travel=inf-cpu",
    "time-travel-start=1700000000000000000",
)
"""Kernel arguments: code takes no time, sleeping none of the host's; the same
run gives the same time stamps."""


class RigError(Exception):
    """The rig can not work on this machine; the text is the reason."""


@dataclass(frozen=True)
class Share:
    """A directory *source* of the host, seen as *target* in the guest."""

    source: Path
    target: str
    writable: bool = False

    @classmethod
    def parse(cls, text: str, *, writable: bool = False) -> Share:
        """Return the share written as ``SOURCE[:TARGET]``."""
        source, _, target = text.partition(":")
        path = Path(source).resolve(strict=True)
        return cls(path, target or str(path), writable)


@dataclass(frozen=True)
class Guest:
    """What to boot and what to run in it.

    Attributes:
        script: bash text run as root; its exit code is the guest's.
        mode: ``command`` runs the script under a plain PID 1, ``systemd``
            boots systemd and runs it after basic.target.
        root: tree of the host that becomes the guest's root, with a RAM
            overlay.
        shares: further directories of the host.
        interfaces: vcan interfaces made and set up before anything runs.
        memory: the guest's RAM as the kernel reads it; overlay and tmpfs come
            out of it.
        timeout_s: wall time for boot and script.
        environment: variables exported to the script.
        directory: where the script starts.
        units: unit files by name (``systemd`` only).
        kernel: the kernel, an executable.
        arguments: further kernel arguments.
        verbose: show the kernel's console and the times at the end.
    """

    script: str
    mode: Literal["command", "systemd"] = "command"
    root: Path = Path("/")
    shares: tuple[Share, ...] = ()
    interfaces: tuple[str, ...] = ("vcan0", "vcan1")
    memory: str = "512M"
    timeout_s: float = 600.0
    environment: Mapping[str, str] = field(default_factory=dict)
    directory: str = "/"
    units: Mapping[str, str] = field(default_factory=dict)
    kernel: str = os.environ.get(KERNEL_VARIABLE, "linux.uml")
    arguments: tuple[str, ...] = ()
    verbose: bool = False


def boot(guest: Guest) -> int:
    """Run *guest* to its end; return its script's exit code.

    Standard output and error of the script go to those of this process.

    Returns:
        the script's exit code, `TIMED_OUT` or `FAILED`; with the last one the
        guest's console goes to standard error.

    Raises:
        RigError: a program the rig needs is missing.
    """
    needed_program(guest.kernel, "user-mode-linux")
    needed_program("bwrap", "bubblewrap")
    with (
        terminated_as_exception(),
        tempfile.TemporaryDirectory(prefix="rig-") as name,
    ):
        rig = Path(name)
        _prepare(rig, guest)
        command = _command(rig, guest)
        start_s = time.monotonic()
        with (rig / "console").open("wb") as console:
            in_time = _run(command, console, guest.timeout_s)
        wall_s = time.monotonic() - start_s
        code = _written_code(rig) if in_time else TIMED_OUT
        if not in_time:
            tell(f"stopped after {guest.timeout_s:g} s")
        booted = rig / "boot"
        if guest.verbose or code == FAILED or not booted.exists():
            text = (rig / "console").read_text(errors="replace")
            tell(f"guest's console:\n{text[-8000:]}")
            up = booted.read_text().strip() if booted.exists() else "never"
            tell(f"up after {up} s of guest time, {wall_s:.2f} s in all")
        return code


def needed_program(program: str, package: str) -> str:
    """Return where *program* is, or raise `RigError` naming *package*."""
    found = shutil.which(program)
    if not found:
        message = f"{program} is missing: apt install {package}"
        raise RigError(message)
    return found


def tell(text: str) -> None:
    """Write *text* to standard error, as the rig's."""
    sys.stderr.write(f"rig: {text}\n")


@contextlib.contextmanager
def terminated_as_exception() -> Iterator[None]:
    """Let SIGTERM unwind the stack: nothing is left in the temporary files."""

    def leave(number: int, _: object) -> NoReturn:
        sys.exit(128 + number)

    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _prepare(rig: Path, guest: Guest) -> None:
    """Write what ``guest-init`` reads into the directory *rig*."""
    exported = {
        name: value
        for name, value in guest.environment.items()
        if re.fullmatch(r"[A-Za-z_]\w*", name) and name not in {"_", "SHLVL"}
    } | {REQUIRED_VARIABLE: "required"}
    exports = "".join(
        f"export {name}={shlex.quote(value)}\n"
        for name, value in exported.items()
    )
    (rig / "script").write_text(
        f"{exports}cd {shlex.quote(guest.directory)} || exit {FAILED}\n"
        f"{guest.script}\n"
    )
    settings = {
        "mode": guest.mode,
        "root": str(guest.root.resolve(strict=True)),
        "interfaces": " ".join(guest.interfaces),
    }
    (rig / "settings").write_text(
        "".join(f"{k}={shlex.quote(v)}\n" for k, v in settings.items())
    )
    (rig / "shares").write_text(
        "".join(
            f"{'rw' if s.writable else 'ro'}\t{s.source}\t{s.target}\n"
            for s in guest.shares
        )
    )
    (rig / "units").mkdir()
    for name, text in guest.units.items():
        (rig / "units" / name).write_text(text)
    shutil.copy(HERE / "guest-init", rig / "init")
    (rig / "init").chmod(0o755)


def _command(rig: Path, guest: Guest) -> list[str]:
    """Return the kernel's command line, in bubblewrap, without consoles."""
    box = ["bwrap", "--ro-bind", "/", "/", "--dev", "/dev", "--proc", "/proc"]
    # the guest's memory is a file in TMPDIR, which must be RAM
    box += ["--tmpfs", "/dev/shm", "--setenv", "TMPDIR", "/dev/shm"]  # noqa: S108
    box += ["--bind", str(rig), str(rig)]
    for share in guest.shares:
        kind = "--bind" if share.writable else "--ro-bind"
        box += [kind, str(share.source), str(share.source)]
    box += ["--unshare-pid", "--unshare-net", "--unshare-ipc"]
    box += ["--die-with-parent", "--new-session"]
    if compiler := register_shim_compiler():
        box += ["--setenv", "LD_PRELOAD", str(_register_shim(rig, compiler))]
    box += [needed_program(guest.kernel, "user-mode-linux")]
    box += [f"mem={guest.memory}", "noreboot", f"uml_dir={rig}/uml"]
    box += ["root=none", "rootfstype=hostfs", "rootflags=/", "ro"]
    box += [f"init={rig}/init", f"RIG={rig}"]
    if guest.mode == "systemd":
        box += ["systemd.show_status=0", "systemd.log_color=0"]
    return [*box, *guest.arguments, *([] if guest.verbose else ["quiet"])]


def wide_registers() -> bool:
    """Tell whether the processor has more registers than the kernel saves.

    Linux 6.1 as User Mode Linux keeps 2696 bytes of registers per process,
    all up to AVX-512; the host refuses to set fewer than the processor has.
    """
    cpuinfo = Path("/proc/cpuinfo").read_text(encoding="ascii")
    return "amx_tile" in cpuinfo.partition("flags")[2].partition("\n")[0]


def register_shim_compiler() -> str | None:
    """Return the compiler for ``xstate.c``, None where it is not needed."""
    if not wide_registers():
        return None
    return needed_program("cc", "gcc libc6-dev (this processor has AMX)")


def _register_shim(rig: Path, compiler: str) -> Path:
    """Compile ``xstate.c`` into *rig* (0.1 s); return the library."""
    library = rig / "xstate.so"
    done = subprocess.run(
        [
            compiler,
            "-O2",
            "-shared",
            "-fPIC",
            "-o",
            library,
            HERE / "xstate.c",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        message = f"xstate.c does not compile: {done.stderr.strip()}"
        raise RigError(message)
    return library


def _run(command: list[str], console: IO[bytes], timeout_s: float) -> bool:
    """Run *command* until it ends; return whether it did so in time.

    The guest writes into pipes of its own and not into the caller's files: it
    would leave them non-blocking.
    """
    deadline_s = time.monotonic() + timeout_s
    out_read, out_write = os.pipe()
    err_read, err_write = os.pipe()
    kept = (out_write, err_write, console.fileno())
    consoles = [
        "con=null",
        f"con0=null,fd:{kept[2]}",
        f"con1=null,fd:{kept[0]}",
        f"con2=null,fd:{kept[1]}",
    ]
    process = subprocess.Popen(
        [*command, *consoles],
        stdin=subprocess.DEVNULL,
        stdout=console,
        stderr=console,
        pass_fds=kept,
    )
    os.close(out_write)
    os.close(err_write)
    sinks = {out_read: sys.stdout.buffer, err_read: sys.stderr.buffer}
    try:
        _forward(sinks, deadline_s)
        process.wait(max(0.0, deadline_s - time.monotonic()))
    except (TimeoutError, subprocess.TimeoutExpired):
        return False
    finally:
        # bubblewrap's end is the end of all processes of the guest
        process.kill()
        process.wait()
        os.close(out_read)
        os.close(err_read)
    return True


def _forward(sinks: Mapping[int, IO[bytes]], deadline_s: float) -> None:
    """Copy each descriptor to its sink until all are closed at their end.

    Raises:
        TimeoutError: the monotonic time *deadline_s* came first.
    """
    with selectors.DefaultSelector() as waiting:
        for source, sink in sinks.items():
            waiting.register(source, selectors.EVENT_READ, sink)
        while waiting.get_map():
            left_s = deadline_s - time.monotonic()
            if left_s <= 0:
                raise TimeoutError
            for key, _ in waiting.select(left_s):
                if chunk := os.read(key.fd, 65536):
                    key.data.write(chunk)
                    key.data.flush()
                else:
                    waiting.unregister(key.fd)


def _written_code(rig: Path) -> int:
    """Return the exit code the guest has left, `FAILED` without one."""
    try:
        return int((rig / "code").read_text())
    except (FileNotFoundError, ValueError):
        return FAILED

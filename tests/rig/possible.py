#!/usr/bin/env python3
"""Tell whether the rig works on this machine; takes as long as one boot.

Exit code 0 and no word where it does. Otherwise the reason, one line on
standard output, and exit code 1.
"""

import contextlib
import ctypes
import io
import os
import subprocess
import sys

from guest import (
    Guest,
    RigError,
    boot,
    needed_program,
    register_shim_compiler,
)

CODE = 7
"""Exit code of the trial: one that no failure gives by chance."""

TIMEOUT_S = 60.0
PTRACE_TRACEME = 0


def main() -> int:
    """Try from the cheapest to the whole; print the first reason found."""
    try:
        needed_program("ip", "iproute2")
        needed_program(Guest.kernel, "user-mode-linux")
        register_shim_compiler()
        try_ptrace()
        try_mounts()
        try_boot()
    except (RigError, OSError) as error:
        sys.stdout.write(f"{error}\n")
        return 1
    return 0


def try_ptrace() -> None:
    """Raise `RigError` where a process may not be traced."""
    child = os.fork()
    if child == 0:
        libc = ctypes.CDLL(None, use_errno=True)
        failed = libc.ptrace(PTRACE_TRACEME, 0, None, None) < 0
        os._exit(ctypes.get_errno() if failed else 0)
    _, status = os.waitpid(child, 0)
    if code := os.waitstatus_to_exitcode(status):
        message = f"ptrace is forbidden ({os.strerror(code)})"
        raise RigError(message)


def try_mounts() -> None:
    """Raise `RigError` where bubblewrap can not build the guest's view."""
    bwrap = needed_program("bwrap", "bubblewrap")
    box = ["--ro-bind", "/", "/", "--dev", "/dev", "--proc", "/proc"]
    box += ["--tmpfs", "/dev/shm", "--unshare-pid", "--unshare-net"]  # noqa: S108
    done = subprocess.run(
        [bwrap, *box, "--unshare-ipc", "true"],
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT_S,
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        message = f"mounts or namespaces are forbidden ({last})"
        raise RigError(message)


def try_boot() -> None:
    """Raise `RigError` unless a guest boots, has CAN and returns its code."""
    script = f"ip link show vcan0 && ip link show vcan1 && exit {CODE}"
    kept = io.TextIOWrapper(io.BytesIO())
    with (
        contextlib.redirect_stderr(kept),
        contextlib.redirect_stdout(io.TextIOWrapper(io.BytesIO())),
    ):
        code = boot(Guest(script=script, timeout_s=TIMEOUT_S))
    if code != CODE:
        kept.seek(0)
        said = kept.read()
        message = f"the guest does not boot: {_reason(said)}"
        raise RigError(message)


def _reason(said: str) -> str:
    """Return the line of the console that tells most."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    for mark in ("guest-init: failed", "ptrace", "panic", "stopped after"):
        for line in lines:
            if mark in line:
                return line
    return lines[-1] if lines else "no message"


if __name__ == "__main__":
    sys.exit(main())

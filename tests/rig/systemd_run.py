#!/usr/bin/env python3
"""Run a command in a guest whose PID 1 is a real systemd, with vcan0.

The command runs as root after basic.target, its output and exit code come
back: 124 after the timeout, 125 when the rig itself failed. Nothing is
written to this machine, but for the directories given with --write.
"""

import shlex
import sys
from pathlib import Path

from guest import Guest, Share
from options import make_parser, parse, run

TARGET = """\
[Unit]
Requires=basic.target
Wants=rig.service
After=basic.target
AllowIsolate=yes
"""

SERVICE = """\
[Unit]
Requires=basic.target
After=basic.target

[Service]
Type=exec
StandardInput=null
StandardOutput=file:/dev/tty1
StandardError=file:/dev/tty2
ExecStartPre=stty -F /dev/tty1 raw -echo
ExecStartPre=stty -F /dev/tty2 raw -echo
ExecStart=bash -c 'bash /run/rig/script; echo $? >/run/code; \\
    stty -F /dev/tty1 sane; stty -F /dev/tty2 sane; \\
    cp /run/code /run/rig/code; echo o >/proc/sysrq-trigger; sleep 60'
TimeoutStartSec=infinity
"""


def main() -> int:
    """Read the command line, boot, return the exit code."""
    parser = make_parser(
        __doc__,
        "systemd_run.py --root BOX --share venv:/opt/venv "
        "/opt/venv/bin/pytest -m systemd",
    )
    add = parser.add_argument
    add(
        "--root",
        type=Path,
        required=True,
        help="Debian tree with systemd and udev (make-box-tree)",
    )
    add(
        "--share",
        action="append",
        default=[],
        metavar="SOURCE[:TARGET]",
        help="directory of this machine the guest may read",
    )
    add(
        "--directory",
        default="/",
        help="the guest's directory the command starts in (/)",
    )
    add(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="environment variable of the command",
    )
    given = parse(parser)
    guest = Guest(
        mode="systemd",
        script=shlex.join(given.command),
        root=given.root,
        shares=tuple(Share.parse(text) for text in given.share),
        environment=dict(entry.split("=", 1) for entry in given.set),
        directory=given.directory,
        units={"rig.target": TARGET, "rig.service": SERVICE},
    )
    return run(guest, given)


if __name__ == "__main__":
    sys.exit(main())

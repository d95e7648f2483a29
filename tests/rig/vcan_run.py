#!/usr/bin/env python3
"""Run a command in a guest kernel that has real vcan0 and vcan1 interfaces.

The guest sees this machine's whole tree; what it writes goes to RAM and
vanishes, but for the directories given with --write. Environment and working
directory are the caller's. Exit code: the command's own, 124 after the
timeout, 125 when the rig itself failed.
"""

import os
import shlex
import sys
from pathlib import Path

from guest import Guest
from options import make_parser, parse, run


def main() -> int:
    """Read the command line, boot, return the exit code."""
    parser = make_parser(
        __doc__, "vcan_run.py -w reports .venv/bin/pytest -m vcan"
    )
    given = parse(parser)
    guest = Guest(
        script=shlex.join(given.command),
        environment=os.environ,
        directory=str(Path.cwd()),
    )
    return run(guest, given)


if __name__ == "__main__":
    sys.exit(main())

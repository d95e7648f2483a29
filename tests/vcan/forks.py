"""Forks services out of one process that has their modules loaded.

Loading them takes longer than most tests. Run as a program with the number
of a socket: each message is an order, answered by a number.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import traceback
from typing import Any


def serve(channel: socket.socket) -> None:
    """Obey the orders of *channel* until it is closed."""
    # asammdf, which python-can imports where it is, takes a second to load
    sys.modules["asammdf"] = None  # type: ignore[assignment]
    import bstm_daemon.cli.run  # noqa: F401, PLC0415

    while True:
        text, files, _, _ = socket.recv_fds(channel, 2**16, 1)
        if not text:
            return
        order = json.loads(text)
        if "reap" in order:
            _, status = os.waitpid(order["reap"], 0)
            answer = os.waitstatus_to_exitcode(status)
        else:
            answer = os.fork()
            if answer == 0:
                channel.close()
                os.dup2(files[0], 2)
                run(order)
        for file in files:
            os.close(file)
        channel.send(f"{answer}".encode())


def run(order: dict[str, Any]) -> None:
    """Be ``bstm`` with the arguments of *order*; does not return."""
    from bstm_daemon.cli.main import main  # noqa: PLC0415

    os.environ.update(order["environment"])
    code = 1
    try:
        code = main(order["arguments"])
    except BaseException:  # noqa: BLE001  (as the interpreter says it)
        traceback.print_exc()
    finally:
        os._exit(code)


if __name__ == "__main__":
    serve(socket.socket(fileno=int(sys.argv[1])))

"""``bstm run`` on a socket pair: ``live_daemon.py FD ARGUMENT...``.

The whole command as installed with its own dependencies only: extras that
happen to be there are hidden (python-can would load them), and the first bus
is the socket.
"""

from __future__ import annotations

import socket
import sys

EXTRAS = (
    *("asammdf", "greenlet", "h5py", "jinja2", "libxrk", "pandas", "plotly"),
    *("paho", "prometheus_client", "pyarrow", "rich", "scipy", "tomlkit"),
    "tornado",
)


def main() -> int:
    """Run the daemon."""
    for name in EXTRAS:
        sys.modules[name] = None  # type: ignore[assignment]
    from live_link import PairLink  # noqa: PLC0415  (the extras go first)

    from bstm_daemon.cli.main import main as command  # noqa: PLC0415
    from bstm_daemon.service import assembly  # noqa: PLC0415

    end = socket.socket(fileno=int(sys.argv[1]))
    assembly._link = lambda bus, wanted, buffer_bytes: PairLink(
        end, bus, wanted, buffer_bytes
    )
    return command(["run", *sys.argv[2:]])


if __name__ == "__main__":
    sys.exit(main())

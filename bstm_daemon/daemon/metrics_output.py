"""Where the metrics go: a file, a page, both or neither."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from bstm_daemon.daemon import events
from bstm_daemon.daemon.metrics import metrics_text, write_metrics
from bstm_daemon.errors import FileAccessError, UsageError

if TYPE_CHECKING:
    from bstm_daemon.daemon.events import ServiceLog
    from bstm_daemon.daemon.metrics_server import MetricsServer
    from bstm_daemon.daemon.monitor import Monitor
    from bstm_daemon.daemon.status import ServiceStatus


class MetricsOutput:
    """Renews the metrics every ``[metrics] interval_s``.

    A folder that is not there or full, and a port that is taken, are logged
    and tried again each time: neither ends the service.
    """

    def __init__(self, log: ServiceLog, port: int | None) -> None:
        """Serve a page on *port*; with None there is none."""
        self._log = log
        self._port = port
        self._server: MetricsServer | None = None
        self._file: Path | None = None
        self._interval_us = 0
        self._next_us = 0

    def begin(self, monitor: Monitor) -> None:
        """Write where the configuration of *monitor* says."""
        file = _file(monitor)
        if file != self._file:
            self._remove_file()
        self._file = file
        self._interval_us = round(monitor.config.metrics.interval_s * 1e6)

    def renew(self, status: ServiceStatus, now_us: int) -> None:
        """Write *status* if it is time to."""
        if now_us < self._next_us:
            return
        self._next_us = now_us + self._interval_us
        for way in (self._serve, self._write):
            try:
                way(status)
            except (FileAccessError, UsageError) as error:
                self._log.repeat(
                    events.METRICS_FAILED,
                    way.__name__,
                    now_us * 1e-6,
                    error=str(error),
                )

    def close(self) -> None:
        """End the page; take the metrics of a dead service away."""
        if self._server is not None:
            self._server.close()
        self._remove_file()

    def _remove_file(self) -> None:
        if self._file is not None:
            with suppress(OSError):  # a folder that went read-only keeps it
                self._file.unlink(missing_ok=True)

    def _write(self, status: ServiceStatus) -> None:
        """Replace the file.

        Raises:
            FileAccessError: it can not be written.
        """
        if self._file is not None:
            write_metrics(self._file, status)

    def _serve(self, status: ServiceStatus) -> None:
        """Put *status* on the page.

        Raises:
            UsageError: the port is taken or not allowed.
        """
        if self._port is None:
            return
        if self._server is None:
            # an HTTP server is loaded by those who ask for one
            from bstm_daemon.daemon.metrics_server import (  # noqa: PLC0415
                MetricsServer,
            )

            server = MetricsServer(self._port)
            server.start()
            self._server = server
        self._server.update(metrics_text(status))


def _file(monitor: Monitor) -> Path | None:
    metrics = monitor.config.metrics
    if not metrics.enabled:
        return None
    if metrics.file is not None:
        return monitor.path.parent / metrics.file
    folder = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return Path(folder) / "bstm.prom" if folder else None

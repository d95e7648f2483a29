"""Output of the metrics: a file, a page, both or neither."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

from bstm_daemon.errors import FileAccessError, UsageError, require_packages
from bstm_daemon.files import replacing
from bstm_daemon.service import events

if TYPE_CHECKING:
    from bstm_daemon.config.service import MetricsConfig
    from bstm_daemon.service.events import ServiceLog
    from bstm_daemon.service.metrics import StatusMetrics
    from bstm_daemon.service.metrics_server import MetricsServer
    from bstm_daemon.service.status import ServiceStatus

FILE_MODE: Final = 0o644
"""node_exporter runs as another user and must read the file."""


class MetricsOutput:
    """Keeps page and file up to date, the file every ``interval_s``.

    A folder that is missing or full, and a port that is taken, are logged
    and tried again each interval: neither ends the service.
    """

    def __init__(self, log: ServiceLog, port: int | None) -> None:
        """Serve a page on *port*; with None there is none.

        Raises:
            MissingExtraError: a page, and no prometheus-client.
        """
        if port is not None:
            require_packages(
                "prometheus-client", extra="metrics", purpose="--metrics-port"
            )
        self._log = log
        self._port = port
        self._metrics: StatusMetrics | None = None
        self._server: MetricsServer | None = None
        self._file: Path | None = None
        self._interval_us = 0
        self._next_us = 0

    def begin(self, config: MetricsConfig, folder: Path) -> None:
        """Apply *config*, whose paths are relative to *folder*."""
        file = _file(config, folder)
        if file != self._file:
            self._remove_file()
        self._file = file
        self._interval_us = round(config.interval_s * 1e6)
        if self._metrics is None and (file or self._port is not None):
            # prometheus-client is loaded by those who ask for metrics
            from bstm_daemon.service.metrics import StatusMetrics  # noqa: PLC0415

            self._metrics = StatusMetrics()

    def update(self, status: ServiceStatus, now_us: int) -> None:
        """Show *status* on the page, and in the file if it is time to."""
        if self._metrics is None:
            return
        self._metrics.update(status)
        if now_us < self._next_us:
            return
        self._next_us = now_us + self._interval_us
        for way in (self._serve, self._write):
            try:
                way(self._metrics)
            except (FileAccessError, UsageError) as error:
                failed = events.METRICS_FAILED
                text = str(error)
                self._log.repeat(failed, way.__name__, now_us, error=text)

    def close(self) -> None:
        """End the page; remove the metrics of a service that has ended."""
        if self._server is not None:
            self._server.close()
        self._remove_file()

    def _remove_file(self) -> None:
        if self._file is not None:
            with suppress(OSError):  # a folder that went read-only keeps it
                self._file.unlink(missing_ok=True)

    def _write(self, metrics: StatusMetrics) -> None:
        """Replace the file in one step.

        Raises:
            FileAccessError: the folder is missing or not writable.
        """
        if self._file is not None:
            with replacing(self._file) as temporary:
                temporary.write_bytes(metrics.text())
                temporary.chmod(FILE_MODE)

    def _serve(self, metrics: StatusMetrics) -> None:
        """Begin to serve the page.

        Raises:
            UsageError: the port is taken or not allowed.
        """
        if self._port is None or self._server is not None:
            return
        # an HTTP server is loaded by those who ask for a page
        from bstm_daemon.service.metrics_server import MetricsServer  # noqa: PLC0415

        self._server = MetricsServer(self._port, metrics)


def _file(config: MetricsConfig, folder: Path) -> Path | None:
    if not config.enabled:
        return None
    if config.file is not None:
        return folder / config.file
    runtime = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return Path(runtime) / "bstm.prom" if runtime else None

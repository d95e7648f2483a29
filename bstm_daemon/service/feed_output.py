"""The feed of the running service: opened, tried again, written."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from bstm_daemon.errors import FileAccessError
from bstm_daemon.feed.record import RecordWriter
from bstm_daemon.feed.server import FeedServer
from bstm_daemon.service import events

if TYPE_CHECKING:
    from pathlib import Path

    from bstm_daemon.config.sections import Config
    from bstm_daemon.config.service import FeedConfig
    from bstm_daemon.estimate import Estimate
    from bstm_daemon.service.events import ServiceLog

RETRY_US: Final = 1_000_000
"""Time between attempts to open the socket."""


class FeedOutput:
    """Publishes on the socket of ``[feed]``, where there is one.

    A folder that is missing and a socket that is taken are logged and tried
    again: neither ends the service.
    """

    def __init__(self, log: ServiceLog) -> None:
        """Log to *log*; nothing is open before :meth:`begin`."""
        self._log = log
        self._config: FeedConfig | None = None
        self._path: Path | None = None
        self._server: FeedServer | None = None
        self._retry_us = 0

    def begin(self, config: Config, folder: Path) -> None:
        """Apply *config*, whose path is relative to *folder*.

        Readers stay connected where ``[feed]`` is as before.
        """
        self._writer = RecordWriter(config)
        if config.feed != self._config:
            self.close()
            self._config = config.feed
            name = config.feed.socket
            self._path = None if name is None else folder / name
            self._retry_us = 0

    def publish(self, estimate: Estimate | None, now_us: int) -> None:
        """Send *estimate* to the readers there are at *now_us*."""
        if self._server is None and not self._open(now_us):
            return
        if self._server and self._server.has_readers and estimate is not None:
            self._server.send(self._writer.line(estimate))

    def close(self) -> None:
        """Disconnect all readers and remove the socket."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def _open(self, now_us: int) -> bool:
        if self._path is None or self._config is None:
            return False
        if now_us < self._retry_us:
            return False
        self._retry_us = now_us + RETRY_US
        try:
            self._server = FeedServer(self._path, self._config.group)
        except FileAccessError as error:
            self._log.repeat(
                events.FEED_FAILED, "feed", now_us * 1e-6, error=str(error)
            )
            return False
        return True

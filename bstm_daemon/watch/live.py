"""The view of a live bus, fed only by what is received from it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.live.portable import PortableLink

if TYPE_CHECKING:
    from bstm_daemon.bus.live.link import Link
    from bstm_daemon.config.sections import BusConfig
    from bstm_daemon.watch.board import Board
    from bstm_daemon.watch.lines import LineView

DRAIN_S: Final = 0.05
"""Half a cycle of the fastest frame."""

RETRY_S: Final = 1.0
"""Time between attempts to open a lost interface."""


def link_of(bus: BusConfig, board: Board) -> Link:
    """Return the link that receives the frames of *board* on *bus*.

    Raises :class:`~bstm_daemon.errors.ConfigError` for a channel that can
    not exist.
    """
    wanted = [(can_id, False) for can_id in board.ids]
    if bus.interface != "socketcan":
        return PortableLink(bus, wanted)
    from bstm_daemon.bus.live.socketcan import SocketcanLink  # noqa: PLC0415  (Linux)

    return SocketcanLink(bus, wanted)


def watch_link(link: Link, board: Board, view: LineView) -> None:
    """Show the frames of *link* until the user leaves; send nothing.

    An interface that is missing or disappears is reported and waited for.
    Raises :class:`~bstm_daemon.errors.ConfigError` where *link* can never
    work.
    """
    start_s = tried_s = time.monotonic()
    link.open()
    try:
        with view:
            while not view.has_left:
                now_s = time.monotonic()
                if now_s - tried_s >= RETRY_S:
                    tried_s = now_s
                    link.poll()
                now_us = round((now_s - start_s) * 1e6)
                for frame in link.drain():
                    if not (frame.is_error or frame.is_remote):
                        board.frame(
                            frame.can_id,
                            frame.data,
                            now_us,
                            extended=frame.extended,
                        )
                view.show(board, now_us, _source(link))
                view.pause(DRAIN_S)
    finally:
        link.close()


def _source(link: Link) -> str:
    if link.channel in link.reason:
        return link.reason
    return ": ".join(part for part in (link.channel, link.reason) if part)

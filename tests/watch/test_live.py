"""A live bus, python-can's virtual one."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import can
import pytest

from bstm_daemon.bus.live.portable import PortableLink
from bstm_daemon.bus.live.socketcan import SocketcanLink
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.watch.lines import LineView
from bstm_daemon.watch.live import link_of, watch_link

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.watch.board import Board

    from .conftest import Sender


class Visit(LineView):
    """Lines, and a user who does something at each pause and leaves."""

    def __init__(self, *doings: Callable[[], None]) -> None:
        """Leave after *doings*."""
        self.stream = io.StringIO()
        super().__init__(self.stream)
        self._doings = list(doings)

    @property
    def has_left(self) -> bool:
        """Whether all is done."""
        return not self._doings

    def pause(self, seconds: float) -> None:
        """Do the next thing instead of waiting."""
        assert seconds > 0
        self._doings.pop(0)()

    def show(
        self, board: Board, now_us: int, source: str, *, at_once: bool = False
    ) -> None:
        """Write a line each time."""
        super().show(board, now_us, source, at_once=not at_once)


def virtual(channel: str) -> BusConfig:
    """Return the virtual bus *channel*."""
    return BusConfig(
        name="v", dbc="none", interface="virtual", channel=channel
    )


def nothing() -> None:
    """Let the view show what it has."""


def test_frames_on_the_bus_are_shown(board: Board, sender: Sender) -> None:
    link = link_of(virtual("watch-1"), board)

    def send() -> None:
        with can.Bus(interface="virtual", channel="watch-1") as bus:
            for frame in sender.frames(disc_c=412.5, fluid_c=92.0):
                bus.send(
                    can.Message(
                        arbitration_id=frame.can_id,
                        data=frame.data,
                        is_extended_id=False,
                    )
                )
            noise = bytes(8)
            for message in (
                can.Message(arbitration_id=0x5B4, is_extended_id=True),
                can.Message(
                    arbitration_id=0x5B4,
                    is_remote_frame=True,
                    is_extended_id=False,
                ),
                can.Message(
                    arbitration_id=0x4,
                    is_error_frame=True,
                    is_extended_id=False,
                ),
                can.Message(
                    arbitration_id=0x100, data=noise, is_extended_id=False
                ),
            ):
                bus.send(message)

    view = Visit(send, nothing)
    watch_link(link, board, view)

    first, second = view.stream.getvalue().splitlines()
    assert "source=watch-1 state=none" in first
    assert "FL.disc_c=412.5" in second
    assert board.rejected == 0
    assert link.reason == "closed"


def test_an_absent_interface_is_said(board: Board) -> None:
    bus = BusConfig(name="v", dbc="none", channel="nocan0")
    link = link_of(bus, board)
    view = Visit(nothing)

    watch_link(link, board, view)

    assert "nocan0" in view.stream.getvalue()
    assert "state=none" in view.stream.getvalue()


def test_an_interface_that_can_never_work(board: Board) -> None:
    bus = BusConfig(name="v", dbc="none", interface="nonsense")

    with pytest.raises(ConfigError, match="nonsense"):
        watch_link(link_of(bus, board), board, Visit(nothing))


def test_which_link(board: Board) -> None:
    assert isinstance(link_of(virtual("x"), board), PortableLink)
    bus = BusConfig(name="v", dbc="none", interface="socketcan")
    assert isinstance(link_of(bus, board), SocketcanLink)

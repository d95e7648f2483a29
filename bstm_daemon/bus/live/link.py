"""Interface of a link to a live bus: receive, send, and its condition.

:class:`~bstm_daemon.bus.live.socketcan.SocketcanLink` reads a kernel
interface, :class:`~bstm_daemon.bus.live.portable.PortableLink` any adapter
that python-can knows. Neither has a thread or a queue of its own: the loop of
the service drains a link every few milliseconds and asks it now and then to
look after itself. A link never sends on its own account.
"""

from collections import Counter
from collections.abc import Collection
from enum import Enum, StrEnum
from typing import Final, NamedTuple, Protocol

Wanted = Collection[tuple[int, bool]] | None
"""The (id, extended) to receive; ``None`` receives every frame."""

DRAIN_LIMIT: Final = 8192
"""Frames of one drain: a bus that floods faster than it is read must not
keep the loop from its other work. The rest comes with the next drain."""

CLASSIC_BYTES: Final = 8
"""The longest payload of a classic frame, which is all that a link sends."""


class Frame(NamedTuple):
    """One received frame.

    ``stamp_ns`` is wall time (``CLOCK_REALTIME``, ns since 1970). ``can_id``
    of an error frame is its class bits (``linux/can/error.h``), never an id.
    """

    stamp_ns: int
    can_id: int
    extended: bool
    data: bytes
    is_error: bool
    is_remote: bool


def require_classic(data: bytes) -> None:
    """Raise :class:`ValueError` where *data* is too long to be sent."""
    if len(data) > CLASSIC_BYTES:
        msg = f"a classic frame has at most 8 bytes, {len(data)} given"
        raise ValueError(msg)


class LinkState(Enum):
    """Whether frames can come in."""

    UP = "up"
    DOWN = "down"
    """The interface is there but switched off."""
    GONE = "gone"
    """The interface is absent: never there, removed, or not usable."""


class SendResult(Enum):
    """Result of sending a frame; a lost one is not queued anywhere."""

    OK = "ok"
    LOST = "lost"


class LinkEvent(StrEnum):
    """What a link counts; the last eight come from error frames."""

    WENT_DOWN = "went_down"
    WENT_GONE = "went_gone"
    MALFORMED = "malformed"
    """A frame of an impossible length, refused."""
    ERROR_FRAME = "error_frame"
    """Any error frame, whatever it reports."""
    BUS_OFF = "bus_off"
    RESTARTED = "restarted"
    WARNING = "warning"
    """An error counter of the controller passed the warning limit, 96."""
    PASSIVE = "passive"
    """The controller became error-passive, at 128."""
    OVERRUN = "overrun"
    """The controller itself lost received frames."""
    TX_TIMEOUT = "tx_timeout"
    TRANSCEIVER = "transceiver"


class Link(Protocol):
    """One bus of the vehicle, live."""

    channel: str
    """Name of the interface or adapter."""
    state: LinkState
    """Condition as last seen."""
    receive_buffer_bytes: int | None
    """Receive buffer as the kernel counts it; None where unknown."""
    counts: Counter[LinkEvent]
    """All that happened since the start, but for frames ``dropped``."""

    @property
    def reason(self) -> str:
        """Why nothing can come in or go out; empty if all is well."""

    @property
    def dropped(self) -> int:
        """Frames lost because they were not read in time, since the start."""

    def open(self) -> bool:
        """Try to begin receiving; False, with ``reason``, where it fails.

        Raises:
            ConfigError: The configuration can never work.
        """

    def drain(self) -> list[Frame]:
        """Return the frames that wait, at most ``DRAIN_LIMIT``, no blocking.

        In order of arrival. What goes wrong ends in ``state``.
        """

    def poll(self) -> None:
        """Look after the link: to be called every ``reopen_s``.

        Opens what is closed and notices what no read reports. Frames that wait
        in a socket that is given up are lost: drain first.

        Raises:
            ConfigError: The configuration can never work.
        """

    def send(
        self,
        can_id: int,
        extended: bool,  # noqa: FBT001  (part of a frame's key)
        data: bytes,
    ) -> SendResult:
        """Send a classic frame now or never.

        Raises:
            ValueError: *data* is longer than ``CLASSIC_BYTES``.
        """

    def close(self) -> None:
        """End receiving; may be opened again."""

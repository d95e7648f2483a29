"""A bus through any adapter that python-can knows, ``virtual`` included.

Further options of an adapter come from python-can's own configuration (file
``can.conf`` or the variable ``CAN_CONFIG``); ``[[bus]]`` takes precedence.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.bus.live import link
from bstm_daemon.bus.signals.extraction import FD_LENGTHS
from bstm_daemon.errors import ConfigError, hint

if TYPE_CHECKING:
    import can

    from bstm_daemon.config.sections import BusConfig

STAMP_REACH_NS: Final = 1_000_000_000
"""A stamp this far from the time of reading, or more, is not wall time.

Some adapters count from their own zero, others drift or miss a step of the
wall clock; frames wait for milliseconds.
"""

ECHO_FRAMES: Final = 64
"""Some adapters give back what is sent (``udp_multicast`` always does): this
many frames are remembered, a second of ours. A frame that is one of them to
the byte, its counter and check value too, is an echo."""


class PortableLink:
    """A bus read and written through one ``can.BusABC``.

    Own frames do not come back, also where the adapter returns them.
    Frames are picked here and not by python-can, whose ``recv`` with no time
    to wait gives up at the first frame that its filter refuses.
    """

    def __init__(self, bus: BusConfig, wanted: link.Wanted = None) -> None:
        """Prepare the link of *bus* for *wanted*; nothing is opened yet."""
        self.channel = bus.channel
        self.state = link.LinkState.GONE
        self.reason = "not opened yet"
        self.receive_buffer_bytes: int | None = None
        self.dropped = 0
        """Stays 0: python-can does not report what an adapter loses."""
        self.counts: Counter[link.LinkEvent] = Counter()
        self._config = bus
        self._wanted = None if wanted is None else frozenset(wanted)
        self._bus: can.BusABC | None = None
        self._sent: deque[tuple[int, bool, bytes]] = deque(maxlen=ECHO_FRAMES)

    def open(self) -> bool:
        """Try to begin receiving; False, with ``reason``, where it fails.

        Raises:
            ConfigError: python-can does not know the interface, has no
                driver for it or refuses the channel.
        """
        import can  # noqa: PLC0415  (only where an adapter needs it)

        self.close()
        config = self._config
        options: dict[str, Any] = {"fd": True} if config.fd else {}
        if config.bitrate is not None:
            options["bitrate"] = config.bitrate
        try:
            self._bus = can.Bus(
                channel=config.channel, interface=config.interface, **options
            )
        except (can.CanInterfaceNotImplementedError, ValueError) as error:
            known = can.VALID_INTERFACES
            why = str(error)
            if config.interface not in known:
                others = "python-can's documentation lists them"
                why += f", {hint(config.interface, known, others)}"
            problem = (
                f"[[bus]] {config.name!r}: python-can cannot use "
                f"'interface' = {config.interface!r} with "
                f"'channel' = {config.channel!r}: {why}"
            )
            raise ConfigError([problem]) from error
        except (can.CanError, OSError) as error:
            self.reason = f"{self.channel}: {error}"
            return False
        self.state = link.LinkState.UP
        self.reason = ""
        return True

    def drain(self) -> list[link.Frame]:
        """Return the frames that wait, at most ``DRAIN_LIMIT``."""
        import can  # noqa: PLC0415

        frames: list[link.Frame] = []
        if self._bus is None:
            return frames
        try:
            for _ in range(link.DRAIN_LIMIT):
                message = self._bus.recv(timeout=0)
                if message is None:
                    break
                frame = self._frame(message)
                if frame is not None:
                    frames.append(frame)
        except (can.CanError, OSError) as error:
            self.close()
            self.counts[link.LinkEvent.WENT_GONE] += 1
            self.reason = f"{self.channel}: {error}"
        return frames

    def _frame(self, message: can.Message) -> link.Frame | None:
        """Return *message* as a frame; None for one not wanted."""
        can_id = message.arbitration_id
        extended = message.is_extended_id
        is_error = message.is_error_frame
        if is_error:
            self.counts[link.LinkEvent.ERROR_FRAME] += 1
            extended = False
        elif (
            self._wanted is not None and (can_id, extended) not in self._wanted
        ):
            return None
        data = b"" if message.is_remote_frame else bytes(message.data)
        sent = (can_id, extended, data)
        if sent in self._sent:
            self._sent.remove(sent)
            return None
        lengths = (
            FD_LENGTHS if message.is_fd else range(link.CLASSIC_BYTES + 1)
        )
        if len(data) not in lengths:
            self.counts[link.LinkEvent.MALFORMED] += 1
            return None
        return link.Frame(
            stamp_or_now_ns(message.timestamp, time.time_ns()),
            can_id,
            extended,
            data,
            is_error,
            message.is_remote_frame,
        )

    def poll(self) -> None:
        """Open what is closed; raises as :meth:`open`."""
        if self._bus is None:
            self.open()

    def send(
        self,
        can_id: int,
        extended: bool,  # noqa: FBT001  (part of a frame's key)
        data: bytes,
    ) -> link.SendResult:
        """Send a classic frame now or never, as :class:`Link` says."""
        import can  # noqa: PLC0415

        link.require_classic(data)
        if self._bus is None:
            return link.SendResult.LOST
        message = can.Message(
            arbitration_id=can_id, is_extended_id=extended, data=data
        )
        try:
            self._bus.send(message, timeout=0)
        except (can.CanError, OSError) as error:
            self.reason = f"{self.channel} takes no frames: {error}"
            return link.SendResult.LOST
        self.reason = ""
        self._sent.append((can_id, extended, data))
        return link.SendResult.OK

    def close(self) -> None:
        """End receiving; may be opened again."""
        import can  # noqa: PLC0415

        bus, self._bus = self._bus, None
        self.state = link.LinkState.GONE
        self.reason = "closed"
        if bus is not None:
            try:
                bus.shutdown()
            except (can.CanError, OSError) as error:
                # as of an adapter that was unplugged
                self.reason = f"closed: {error}"


def stamp_or_now_ns(stamp_s: float, now_ns: int) -> int:
    """Return *stamp_s* in ns, or *now_ns* where it cannot be wall time."""
    try:
        stamp_ns = round(stamp_s * 1_000_000) * 1000  # a float has no more
    except (ValueError, OverflowError):
        return now_ns
    return stamp_ns if abs(stamp_ns - now_ns) < STAMP_REACH_NS else now_ns

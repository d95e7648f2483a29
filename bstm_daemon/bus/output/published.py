"""Our own frames read back: id, bytes, physical values.

The inverse of :mod:`bstm_daemon.bus.output.publication` over the same table
(:mod:`bstm_daemon.bus.output.layout`), for a reader that sees only the bus.
A frame that is added to the table is decoded without a change here.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import inf, nan
from typing import Final

from bstm_daemon.bus.output.e2e import CheckStatus, Profile2Checker
from bstm_daemon.bus.output.layout import (
    CORNERS,
    FRAME_BYTES,
    Frame,
    Signal,
    own_ids,
    published_frames,
)

MAX_COUNTER_DELTA: Final = 3
"""Two frames of a name may be lost in a row (``docs/frames.md``)."""


@dataclass(frozen=True, slots=True)
class PublishedFrame:
    """One frame of ours as received.

    ``values`` maps the signals after CRC and counter to their physical
    values in the unit of the table (degC, K, %, s), choices and flags to
    their raw numbers. NaN is *not available* and infinity *error*, as the
    sender was given them. It is empty where ``verdict`` is ``WRONG_CRC``.
    """

    layout: Frame
    verdict: CheckStatus
    values: Mapping[str, float]

    @property
    def usable(self) -> bool:
        """Whether the end-to-end protection lets the values be used."""
        return self.verdict is CheckStatus.OK


class PublishedDecoder:
    """Reads the frames of one daemon, in the order they arrive."""

    def __init__(self, id_base: int, corners: Iterable[str] = CORNERS) -> None:
        """Expect the block of ids that begins at *id_base*.

        Raises :class:`~bstm_daemon.errors.ConfigError` where it does not fit
        into 11 bits and :class:`ValueError` for an unknown corner.
        """
        names = tuple(corners)
        self.ids = own_ids(id_base, names)
        """The standard (11-bit) ids, rising."""
        self._frames = dict(
            zip(self.ids, published_frames(names), strict=True)
        )
        self._checkers = {
            can_id: Profile2Checker(
                frame.data_ids, length=FRAME_BYTES, max_delta=MAX_COUNTER_DELTA
            )
            for can_id, frame in self._frames.items()
        }

    def decode(
        self, can_id: int, data: bytes | bytearray, *, extended: bool = False
    ) -> PublishedFrame | None:
        """Return the frame, or None where *can_id* is none of ours.

        Never raises, whatever *data* holds.
        """
        frame = None if extended else self._frames.get(can_id)
        if frame is None:
            return None
        verdict = self._checkers[can_id].check(data)
        if verdict is CheckStatus.WRONG_CRC:
            return PublishedFrame(frame, verdict, {})
        bits = int.from_bytes(data, "little")
        values = {
            signal.name: _physical(
                signal, bits >> signal.start & signal.not_available
            )
            for signal in frame.signals
            if signal.name not in ("CRC", "Counter")
        }
        return PublishedFrame(frame, verdict, values)


def _physical(signal: Signal, raw: int) -> float:
    if not signal.is_quantity:
        return raw
    if raw == signal.not_available:
        return nan
    value = signal.offset + signal.scale * raw
    # beyond the range of the table lies nothing that the sender may send
    beyond = signal.maximum is not None and value > signal.maximum
    return inf if raw == signal.error or beyond else value

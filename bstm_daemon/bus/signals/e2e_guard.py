"""Received frames that must carry the protection declared in ``[[e2e]]``.

Live frames and the frames of a log pass the same guard, in the same order,
so that both refuse the same ones. A refused frame is refused whole.
"""

from typing import Final

from bstm_daemon.bus.output import e2e
from bstm_daemon.bus.signals.decoder import Payload
from bstm_daemon.bus.signals.extraction import FrameKey
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.service import E2eConfig

_REFUSALS: Final = {
    e2e.CheckStatus.WRONG_CRC: RejectReason.WRONG_CRC,
    e2e.CheckStatus.REPEATED: RejectReason.REPEATED_COUNTER,
    e2e.CheckStatus.WRONG_SEQUENCE: RejectReason.WRONG_SEQUENCE,
}


class E2eGuard:
    """The checkers of all protected messages of one plan.

    It remembers the last counter of each message: one guard a stream of
    frames.
    """

    def __init__(self, signal_map: SignalMap) -> None:
        """Expect what ``signal_map.protected`` declares."""
        # looked up with plain tuples, which equal the keys and cost less
        self._checkers: dict[
            tuple[int, int, bool], tuple[int, e2e.Checker]
        ] = {}
        for key, config in signal_map.protected.items():
            length = signal_map.messages[key].length
            self._checkers[key] = length, _checker(config, length)
        self.keys: tuple[FrameKey, ...] = tuple(signal_map.protected)
        """The frames that are checked; all others pass."""

    def refusal(
        self,
        bus: int,
        can_id: int,
        extended: bool,  # noqa: FBT001  (part of a frame's key)
        data: Payload,
    ) -> RejectReason | None:
        """Return why the next data frame must not be used; None: it may.

        Error and remote frames are no data frames: do not ask.
        """
        found = self._checkers.get((bus, can_id, extended))
        if found is None:
            return None
        length, checker = found
        if len(data) != length:
            return RejectReason.WRONG_LENGTH
        status = checker.check(bytes(data))
        return _REFUSALS.get(status)


def _checker(config: E2eConfig, length: int) -> e2e.Checker:
    if config.profile == 2:
        return e2e.Profile2Checker(
            config.data_ids, length=length, max_delta=config.max_delta
        )
    return e2e.Profile5Checker(
        config.data_ids[0],
        length=length,
        offset_bytes=config.offset_bytes,
        max_delta=config.max_delta,
    )

"""AUTOSAR end-to-end protection, Profile 5: check a received frame.

Layout (AUTOSAR PRS E2E Protocol, Profile 5): at an offset the CRC, low byte
first, and behind it a counter 0..255. The CRC is CRC-16/CCITT-FALSE
(polynomial 0x1021, initial value 0xFFFF, nothing reflected, no final xor)
over the frame without the two bytes of the CRC and then the data id, low
byte first. The id is not sent.

``binascii.crc_hqx`` is that CRC with the initial value as an argument.
"""

from __future__ import annotations

from binascii import crc_hqx
from typing import Final

from bstm_daemon.bus.output.e2e import CheckStatus, sequence_status

PROFILE5_BYTES: Final = 3
"""CRC and counter."""

_COUNTER_COUNT: Final = 256
_CRC_BYTES: Final = 2
_INITIAL: Final = 0xFFFF


def profile5_crc(
    data: bytes | bytearray, data_id: int, offset_bytes: int = 0
) -> int:
    """Return the Profile 5 CRC of *data*, whatever its CRC bytes hold.

    *data_id* is 0..65535; the CRC lies at *offset_bytes*.
    """
    crc = crc_hqx(data[:offset_bytes], _INITIAL)
    crc = crc_hqx(data[offset_bytes + _CRC_BYTES :], crc)
    return crc_hqx(data_id.to_bytes(2, "little"), crc)


class Profile5Checker:
    """Checks the frames of one message in the order they arrive.

    The verdicts are those of
    :class:`~bstm_daemon.bus.output.e2e.Profile2Checker`, with a counter modulo
    256.
    """

    def __init__(
        self,
        data_id: int,
        *,
        length: int,
        offset_bytes: int = 0,
        max_delta: int = 1,
    ) -> None:
        """Expect frames of *length* bytes protected with *data_id*.

        Raises :class:`ValueError` where CRC and counter at *offset_bytes* do
        not fit into the frame.
        """
        if offset_bytes + PROFILE5_BYTES > length:
            msg = (
                f"Profile 5 at byte {offset_bytes} needs at least "
                f"{offset_bytes + PROFILE5_BYTES} bytes, got {length}"
            )
            raise ValueError(msg)
        self._data_id = data_id
        self._length = length
        self._offset_bytes = offset_bytes
        self._max_delta = max_delta
        self._last_counter: int | None = None

    def check(self, data: bytes | bytearray) -> CheckStatus:
        """Return the verdict on *data*, the next frame received."""
        if len(data) != self._length:
            return CheckStatus.WRONG_CRC
        at = self._offset_bytes
        crc = profile5_crc(data, self._data_id, at)
        if data[at] | data[at + 1] << 8 != crc:
            return CheckStatus.WRONG_CRC
        counter = data[at + _CRC_BYTES]
        last, self._last_counter = self._last_counter, counter
        return sequence_status(last, counter, _COUNTER_COUNT, self._max_delta)

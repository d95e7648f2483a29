"""Why a line, a frame or a value did not become a sample."""

from collections import Counter
from enum import StrEnum


class RejectReason(StrEnum):
    """Named reasons; every counter of this room is keyed by them.

    The last three are counted per sample, all others per line or frame.
    """

    NOT_A_FRAME = "not_a_frame"
    """A blank line, a comment or ``DROPCOUNT:``."""
    MALFORMED = "malformed"
    """Not in the grammar of a candump log."""
    ERROR_FRAME = "error_frame"
    """Bus error report (id & 0x20000000): never data."""
    REMOTE_FRAME = "remote_frame"
    """A request; it carries no data."""
    XL_FRAME = "xl_frame"
    """CAN XL: not described by a DBC."""
    UNKNOWN_INTERFACE = "unknown_interface"
    """From an interface that no configured bus stands for."""
    UNKNOWN_ID = "unknown_id"
    """No role comes from this id."""
    WRONG_LENGTH = "wrong_length"
    """Not the length that the DBC gives."""
    WRONG_CRC = "wrong_crc"
    """The end-to-end protection does not fit the frame."""
    REPEATED_COUNTER = "repeated_counter"
    """The protection's counter stands still: not a new frame."""
    WRONG_SEQUENCE = "wrong_sequence"
    """The protection's counter has jumped; the next frame is taken."""
    NOT_A_NUMBER = "not_a_number"
    """The value is nan, e.g. after a division by zero."""
    OUT_OF_RANGE = "out_of_range"
    """The value is infinite or outside 'min' and 'max'."""
    NOT_AVAILABLE = "not_available"
    """The raw value stands for no value, by the DBC's value table."""


def listed(counts: Counter[RejectReason]) -> str:
    """Return *counts* for a message, the most frequent reason first."""
    return ", ".join(
        f"{count} {reason.value.replace('_', ' ')}"
        for reason, count in counts.most_common()
    )

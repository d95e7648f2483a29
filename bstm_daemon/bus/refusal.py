"""Why a line, a frame or a value did not become a sample."""

from enum import StrEnum


class Refusal(StrEnum):
    """Named reasons; every counter of this room is keyed by them.

    The last two are counted per sample, all others per line or frame.
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
    NOT_A_NUMBER = "not_a_number"
    """The value is nan, e.g. after a division by zero."""
    OUT_OF_RANGE = "out_of_range"
    """The value is infinite or outside 'min' and 'max'."""

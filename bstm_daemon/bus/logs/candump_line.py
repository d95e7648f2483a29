"""The grammar of one line of a candump log, exact and one line at a time.

As ``candump -l`` and ``-L`` write it (can-utils, ``lib.h``)::

    line    = "(" seconds "." fraction ")" blanks interface blanks frame
              [blanks ("R" | "T")]
    frame   = id "#" (data | remote) | id "##" flags data | xl
    id      = 3 hex digits (standard) | 8 hex digits (extended or error)
    data    = up to 8 bytes (64 after "##") of 2 hex digits, each may be
              preceded by "."; after 8 bytes "_" and a raw DLC 9..F may follow
    remote  = ("R" | "r") [0..8 ["_" raw DLC]]
    xl      = 5 hex digits "#" flags ":" sdt ":" acceptance field "#" data

``fraction`` has 1 to 9 digits; times are whole microseconds, rounded down.
"""

import re
from collections.abc import Callable
from typing import Final, NamedTuple

from bstm_daemon.bus.signals.extraction import (
    EXTENDED_MAX,
    FD_LENGTHS,
    STANDARD_MAX,
)
from bstm_daemon.bus.signals.reject_reason import RejectReason

ERROR_FLAG: Final = 0x20000000
"""Set in the 8-digit id of an error frame (``linux/can.h``)."""
LINE_LIMIT: Final = 16384
"""Bytes of a line that are read; a CAN XL frame has up to 6.2 kB."""

_STANDARD_DIGITS: Final = 3
_XL_DIGITS: Final = 5
_HEADER: Final = re.compile(
    rb"\((?P<seconds>[0-9]{1,12})\.(?P<fraction>[0-9]{1,9})\)"
    rb"[ \t]+(?P<interface>[^\s#]+)[ \t]+"
    rb"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}|[0-9A-Fa-f]{5})#"
)
_BYTES: Final = rb"(?:\.?[0-9A-Fa-f]{2})"
_END: Final = rb"(?:[ \t]+[RrTt])?[ \t\r]*"
_CLASSIC: Final = re.compile(
    rb"(?:(?P<data>" + _BYTES + rb"{8})(?:_[9A-Fa-f])?"
    rb"|(?P<short>" + _BYTES + rb"{0,7}))" + _END
)
_FD: Final = re.compile(
    rb"#[0-9A-Fa-f](?P<data>" + _BYTES + rb"{0,64})" + _END
)
_REMOTE: Final = re.compile(rb"[Rr](?:[0-8]|8_[9A-Fa-f])?" + _END)
_XL: Final = re.compile(
    rb"[0-9A-Fa-f]{2}:[0-9A-Fa-f]{2}:[0-9A-Fa-f]{8}#"
    + _BYTES
    + rb"{1,2048}"
    + _END
)
_NOT_A_FRAME: Final = re.compile(rb"\s*(?:$|[#;%]|//|DROPCOUNT:)")


class Frame(NamedTuple):
    """A data frame; ``interface`` as it stands in the line."""

    time_us: int
    interface: bytes
    can_id: int
    extended: bool
    data: bytes


WhyUnwanted = Callable[[bytes, int, bool], RejectReason | None]
"""Gives for (interface, id, extended) why its frames are not read, if so."""


def parse_line(line: bytes, why_unwanted: WhyUnwanted) -> Frame | RejectReason:
    """Return the data frame in *line* (without its newline), or why not.

    The payload of an unwanted frame is not read, so a malformed one is not
    noticed there.
    """
    header = _HEADER.match(line)
    if header is None:
        blank = _NOT_A_FRAME.match(line)
        return RejectReason.NOT_A_FRAME if blank else RejectReason.MALFORMED
    seconds, fraction, interface, digits = header.groups()
    if len(digits) == _XL_DIGITS:
        is_xl = _XL.fullmatch(line, header.end())
        return RejectReason.XL_FRAME if is_xl else RejectReason.MALFORMED
    can_id = int(digits, 16)
    extended = len(digits) != _STANDARD_DIGITS
    if extended and can_id & ERROR_FLAG:
        return RejectReason.ERROR_FRAME
    if can_id > (EXTENDED_MAX if extended else STANDARD_MAX):
        return RejectReason.MALFORMED
    reason = why_unwanted(interface, can_id, extended)
    data = reason or _payload(line, header.end())
    if isinstance(data, RejectReason):
        return data
    time_us = int(seconds) * 1_000_000 + int(fraction[:6].ljust(6, b"0"))
    return Frame(time_us, interface, can_id, extended, data)


def _payload(line: bytes, start: int) -> bytes | RejectReason:
    first = line[start : start + 1]
    if first in (b"R", b"r"):
        is_remote = _REMOTE.fullmatch(line, start)
        return (
            RejectReason.REMOTE_FRAME if is_remote else RejectReason.MALFORMED
        )
    match = (_FD if first == b"#" else _CLASSIC).fullmatch(line, start)
    if match is None:
        return RejectReason.MALFORMED
    digits = match["data"]
    if digits is None:
        digits = match["short"]
    data = bytes.fromhex(digits.replace(b".", b"").decode("ascii"))
    return data if len(data) in FD_LENGTHS else RejectReason.MALFORMED

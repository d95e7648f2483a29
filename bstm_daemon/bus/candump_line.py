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

from bstm_daemon.bus.extraction import FD_LENGTHS
from bstm_daemon.bus.refusal import Refusal

ERROR_FLAG: Final = 0x20000000
"""Set in the 8-digit id of an error frame (``linux/can.h``)."""
STANDARD_MAX: Final = 0x7FF
EXTENDED_MAX: Final = 0x1FFFFFFF
LINE_LIMIT: Final = 16384
"""Bytes of a line that are read; a CAN XL frame has up to 6.2 kB."""

_STANDARD_DIGITS: Final = 3
_XL_DIGITS: Final = 5
_HEADER: Final = re.compile(
    rb"\((?P<seconds>[0-9]{1,12})\.(?P<fraction>[0-9]{1,9})\)"
    rb"(?P<gap>[ \t]+(?P<interface>[^\s#]+)[ \t]+)"
    rb"(?P<id>[0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}|[0-9A-Fa-f]{5})#"
)
_BYTES: Final = rb"(?:\.?[0-9A-Fa-f]{2})"
_END: Final = rb"(?:[ \t]+[RrTt])?[ \t\r]*"
_CLASSIC: Final = re.compile(
    rb"(?P<data>" + _BYTES + rb"{8})_[9A-Fa-f]" + _END + rb"|"
    rb"(?P<short>" + _BYTES + rb"{0,8})" + _END
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
_FLAG: Final = re.compile(rb" [RrTt]\r?$")
_NOT_A_FRAME: Final = re.compile(rb"\s*(?:$|[#;%]|//|DROPCOUNT:)")


class Header(NamedTuple):
    """What stands before the payload, as text; ``end`` is its length."""

    seconds: bytes
    fraction: bytes
    gap: bytes
    interface: bytes
    id_digits: bytes
    end: int


class Frame(NamedTuple):
    """A data frame; ``interface`` as it stands in the line."""

    time_us: int
    interface: bytes
    can_id: int
    extended: bool
    data: bytes


Judge = Callable[[bytes, int, bool], Refusal | None]
"""Says of (interface, id, extended) why its frames are not wanted, if so."""


def read_header(line: bytes) -> Header | None:
    """Return the header of *line* (without its newline), if it has one."""
    match = _HEADER.match(line)
    if match is None:
        return None
    return Header(
        match["seconds"],
        match["fraction"],
        match["gap"],
        match["interface"],
        match["id"],
        match.end(),
    )


def ends_with_flag(line: bytes) -> bool:
    """Whether a direction flag, `` R`` or `` T``, ends *line*."""
    return _FLAG.search(line) is not None


def parse_line(line: bytes, judge: Judge) -> Frame | Refusal:
    """Return the data frame in *line* (without its newline), or why not.

    The id decides first: where *judge* refuses the frame, its payload is not
    read, so a payload that is out of the grammar is not noticed there.
    """
    header = read_header(line)
    if header is None:
        blank = _NOT_A_FRAME.match(line)
        return Refusal.NOT_A_FRAME if blank else Refusal.MALFORMED
    key = _identify(line, header)
    if isinstance(key, Refusal):
        return key
    refusal = judge(header.interface, *key)
    data = refusal or _payload(line, header.end)
    if isinstance(data, Refusal):
        return data
    time_us = int(header.seconds) * 1_000_000 + int(
        header.fraction[:6].ljust(6, b"0")
    )
    return Frame(time_us, header.interface, *key, data)


def _identify(line: bytes, header: Header) -> tuple[int, bool] | Refusal:
    """Return (id, extended) of what may be a data frame."""
    digits = len(header.id_digits)
    if digits == _XL_DIGITS:
        is_xl = _XL.fullmatch(line, header.end)
        return Refusal.XL_FRAME if is_xl else Refusal.MALFORMED
    can_id = int(header.id_digits, 16)
    extended = digits != _STANDARD_DIGITS
    if extended and can_id & ERROR_FLAG:
        return Refusal.ERROR_FRAME
    if can_id > (EXTENDED_MAX if extended else STANDARD_MAX):
        return Refusal.MALFORMED
    return can_id, extended


def _payload(line: bytes, start: int) -> bytes | Refusal:
    first = line[start : start + 1]
    if first in (b"R", b"r"):
        is_remote = _REMOTE.fullmatch(line, start)
        return Refusal.REMOTE_FRAME if is_remote else Refusal.MALFORMED
    match = (_FD if first == b"#" else _CLASSIC).fullmatch(line, start)
    if match is None:
        return Refusal.MALFORMED
    digits = match["data"]
    if digits is None:
        digits = match["short"]
    data = bytes.fromhex(digits.replace(b".", b"").decode("ascii"))
    return data if len(data) in FD_LENGTHS else Refusal.MALFORMED

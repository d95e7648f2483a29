"""Candump lines of one layout, parsed as columns.

Nearly all lines of a log look alike: stamps of the same width, a handful of
interfaces, ids of 3 or 8 digits. Such a *layout* has every character of the
line's header at a fixed place, so that NumPy reads all its lines at once,
8 characters in a 64-bit word. What a layout does not settle is left for
:mod:`~bstm_daemon.bus.candump_line`, whose verdict is the same for every
line that is settled here.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from bstm_daemon.bus.candump_line import (
    EXTENDED_MAX,
    STANDARD_MAX,
    Header,
    ends_with_flag,
)
from bstm_daemon.bus.extraction import FD_LENGTHS
from bstm_daemon.bus.frame_chunk import PREFIX_MASKS, FrameChunk

Integers = npt.NDArray[np.int64]
Words = npt.NDArray[np.uint64]
Flags = npt.NDArray[np.bool_]

PADDING: Final = 512
"""Bytes that must follow the text, so that records may reach beyond it."""

_INVALID: Final = 0x80
_HEX: Final = bytes(
    int(chr(c), 16) if chr(c) in "0123456789abcdefABCDEF" else _INVALID
    for c in range(256)
)
_INVALID_WORD: Final = np.uint64(0x8080808080808080)
_EVERY_BIT: Final = np.uint64(0xFFFFFFFFFFFFFFFF)
_LONGEST_HEADER: Final = 128
_IS_FD_LENGTH: Final = np.isin(np.arange(65), FD_LENGTHS)


def _words(values: npt.NDArray[Any]) -> Words:
    """Return byte values as words of 8, the first byte lowest."""
    return values.astype(np.uint8).view("<u8")


@dataclass(frozen=True, slots=True)
class Text:
    """Whole lines: ``starts`` and ``ends`` (at the newline) in ``buffer``.

    ``numbers`` are those of the lines in the log, rising.
    """

    buffer: npt.NDArray[np.uint8]
    starts: Integers
    ends: Integers
    numbers: Integers

    def line(self, index: int) -> bytes:
        """Return line *index* without its newline."""
        return self.buffer[self.starts[index] : self.ends[index]].tobytes()

    def records(self, at: Integers, size: int) -> Words:
        """Return *size* (a multiple of 8) bytes from each *at* on, as words.

        Shape (n, size / 8). One copy of a record is as fast as one of a word.
        """
        windows: npt.NDArray[np.void] = np.ndarray(
            (len(self.buffer) - size + 1,),
            np.dtype((np.void, size)),
            self.buffer.data,
            0,
            (1,),
        )
        return windows[at].view("<u8").reshape(len(at), size // 8)


class Channel:
    """An interface of a log and the ids wanted from it.

    ``wanted`` is a collection of (id, extended), or ``None`` where the
    interface stands for no bus; ``everything`` overrides it.
    """

    def __init__(
        self,
        number: int,
        wanted: Collection[tuple[int, bool]] | None,
        *,
        everything: bool = False,
    ) -> None:
        """Prepare the look-up of *wanted* for interface *number*."""
        self.number = number
        self.known = everything or wanted is not None
        self._everything = everything
        self._wanted = frozenset(wanted or ())
        standard = [key[0] for key in self._wanted if not key[1]]
        self._standard = np.zeros(STANDARD_MAX + 1, np.bool_)
        self._standard[standard] = True
        self._extended = np.array(
            sorted(key[0] for key in self._wanted if key[1]), np.int64
        )

    def wants(self, can_id: int, extended: bool) -> bool:  # noqa: FBT001
        """Whether frames of (*can_id*, *extended*) are wanted."""
        return self._everything or (can_id, extended) in self._wanted

    def wants_each(self, ids: Integers, *, extended: bool) -> Flags:
        """Return for each of *ids* whether it is wanted."""
        if self._everything:
            return np.ones(len(ids), np.bool_)
        if not extended:
            named: Flags = self._standard[ids & STANDARD_MAX]
            return named
        if not self._extended.size:
            return np.zeros(len(ids), np.bool_)
        place = np.searchsorted(self._extended, ids)
        place[place == len(self._extended)] = 0
        found: Flags = self._extended[place] == ids
        return found


@dataclass(frozen=True, slots=True)
class Scan:
    """What a layout made of some lines.

    ``pending`` are the lines it does not settle. ``ids`` and ``counts`` tell
    of all settled lines, ``refused`` of them were not wanted; ``parts`` are
    the frames of the others.
    """

    pending: Integers
    ids: Integers
    counts: Integers
    refused: int
    parts: list[FrameChunk]


class LayoutKey(NamedTuple):
    """What the lines of a layout have in common."""

    seconds: int
    fraction: int
    gap: bytes
    id_digits: int
    is_fd: bool
    has_flag: bool


def layout_key(line: bytes, header: Header) -> LayoutKey | None:
    """Return the key of *line*, if its layout can be read as columns."""
    if len(header.id_digits) == 5 or header.end > _LONGEST_HEADER:
        return None
    return LayoutKey(
        len(header.seconds),
        len(header.fraction),
        header.gap,
        len(header.id_digits),
        line.startswith(b"#", header.end),
        ends_with_flag(line),
    )


class _Check(NamedTuple):
    """How a word of 8 characters of a header has to be.

    Only the bits of ``fixed`` count. Adding ``carry`` to what differs from
    ``expected`` brings bit 7 of a byte that is no digit; it is ``None``
    where the word has no digits.
    """

    word: int
    expected: np.uint64
    fixed: np.uint64
    carry: np.uint64 | None

    def add(self, words: Words, wrong: Words, unlike: Words) -> None:
        """Set what is wrong with each of *words*.

        That is bit 7 of a byte in *wrong*, or any bit in *unlike*.
        """
        differs = words ^ self.expected
        if self.fixed != _EVERY_BIT:
            differs &= self.fixed
        if self.carry is None:
            unlike |= differs
        else:
            # a carry out of a byte comes only from one that is wrong already
            wrong |= differs
            differs += self.carry
            wrong |= differs


def _check(
    word: int,
    expected: npt.NDArray[np.uint8],
    digit: npt.NDArray[np.bool_],
    fixed: npt.NDArray[np.bool_],
) -> _Check:
    """Return the check of the 8 characters *expected*, 0 for any digit."""
    carry = np.where(digit, 0x80 - 10, np.where(fixed, 0x80 - 1, 0))
    return _Check(
        word,
        _words(expected)[0],
        _words(np.where(fixed, 0xFF, 0))[0],
        _words(carry)[0] if digit.any() else None,
    )


class Layout:
    """All lines with one header but for its digits.

    A frame is read from a line that is CAN FD, and that ends in a direction
    flag, as its key says; of other ids a line is settled by its header.
    """

    def __init__(self, key: LayoutKey, channel: Channel) -> None:
        """Take the places of the digits from *key*."""
        self.channel = channel
        self.extended = key.id_digits == 8
        self._key = key
        stamp = b"(" + b"0" * key.seconds + b"." + b"0" * key.fraction + b")"
        self._id_at = len(stamp) + len(key.gap)
        self._end = self._id_at + key.id_digits + 1
        text = stamp + key.gap + b"\0" * key.id_digits + b"#"
        # the id's digits and 8 characters from any of the stamp's are in it
        needed = max(len(text), len(stamp) + 6)
        self._size = -(-needed // 8) * 8
        expected = np.frombuffer(text.ljust(self._size, b"\0"), np.uint8)
        place = np.arange(self._size)
        digit = (expected == ord("0")) & (place < len(stamp))
        fixed = (place < self._id_at) | (place == self._end - 1)
        self._checks = [
            _check(word, expected[at], digit[at], fixed[at])
            for word, at in enumerate(
                slice(start, start + 8) for start in range(0, self._size, 8)
            )
            if fixed[at].any()
        ]

    def scan(self, text: Text, lines: Integers) -> Scan:
        """Settle those of *lines* that have this layout."""
        is_all = len(lines) == len(text.starts)
        starts = text.starts if is_all else text.starts[lines]
        heads = text.records(starts, self._size)
        ids, settled = self._ids(heads)
        settled &= self._matches(heads)
        parts = []
        refused = int(np.count_nonzero(settled))
        if self.channel.known:
            wanted = self.channel.wants_each(ids, extended=self.extended)
            rows = np.flatnonzero(settled & wanted)
            refused -= len(rows)
            if rows.size:
                part, bad = self._frames(
                    text, lines[rows], _rows(heads, rows), ids[rows]
                )
                parts.append(part)
                if len(part) < len(rows):
                    settled[rows[bad]] = False
        if settled.all():
            pending = lines[:0]
        else:
            pending, ids = lines[~settled], ids[settled]
        return Scan(pending, *self._tally(ids), refused, parts)

    def _matches(self, heads: Words) -> Flags:
        """Whether every character of the header but the id is right.

        Eight characters at once.
        """
        wrong, unlike = np.zeros((2, len(heads)), np.uint64)
        for check in self._checks:
            word = heads[:, check.word]
            # as the first digits of the stamps: one tells of all
            if _all_alike(word):
                one = np.zeros((2, 1), np.uint64)
                check.add(word[:1], *one)
                if one[1, 0] or one[0, 0] & _INVALID_WORD:
                    return np.zeros(len(heads), np.bool_)
            else:
                check.add(word, wrong, unlike)
        wrong &= _INVALID_WORD
        wrong |= unlike
        return np.equal(wrong, 0)

    def _ids(self, heads: Words) -> tuple[Integers, Flags]:
        """Return the ids and whether each is one."""
        if self.extended:
            nibbles = _from_hex(_field(heads, self._id_at, "<u8"))
            valid = np.equal(nibbles & _INVALID_WORD, 0)
            ids = (nibbles << 4 | nibbles >> 8) & 0x00FF00FF00FF00FF
            ids = (ids << 8 | ids >> 16) & 0x0000FFFF0000FFFF
            ids = (ids << 16 | ids >> 32) & 0xFFFFFFFF
            return ids.astype(np.int64), valid & (ids <= EXTENDED_MAX)
        nibbles = _from_hex(_field(heads, self._id_at, "<u4"))
        valid = np.equal(nibbles & 0x808080, 0)
        # the third digit, the second 4 bits above it, the first 8
        number = nibbles * np.uint32(1 + (1 << 12) + (1 << 24))
        number >>= 16
        number &= 0xFFF
        valid &= number <= STANDARD_MAX
        return number.astype(np.int64), valid

    def _frames(
        self, text: Text, lines: Integers, heads: Words, ids: Integers
    ) -> tuple[FrameChunk, Flags]:
        """Return the frames in *lines* and which lines are not one."""
        is_fd = self._key.is_fd
        words = 16 if is_fd else 2
        at = text.starts[lines] + (self._end + 2 if is_fd else self._end)
        ends = text.ends[lines]
        bad = np.zeros(len(lines), np.bool_)
        # a payload has an even number of digits
        if self._key.has_flag or ((ends - at) & 1).any():
            ends -= text.buffer[ends - 1] == ord("\r")
        if self._key.has_flag:
            letter = text.buffer[ends - 1] & ~np.uint8(0x20)
            bad |= (letter != ord("R")) & (letter != ord("T"))
            bad |= text.buffer[ends - 2] != ord(" ")
            ends -= 2
        size = ends - at
        bad |= (size < 0) | (size > 8 * words) | (size & 1).astype(np.bool_)
        size[bad] = 0
        length = size >> 1
        if is_fd:
            marks = text.buffer[at - 2] == ord("#")
            digit = text.buffer[at - 1].tobytes().translate(_HEX)
            bad |= ~marks | (np.frombuffer(digit, np.uint8) == _INVALID)
            bad |= ~_IS_FD_LENGTH[length]
        data, invalid = _payloads(text.records(at, 8 * words), length)
        bad |= invalid
        if bad.any():
            good = ~bad
            lines, heads, ids = lines[good], heads[good], ids[good]
            length, data = length[good], data[good]
        width = 8 if length.max(initial=0) <= 8 else 64
        part = FrameChunk(
            time_us=self._time_us(heads),
            line=text.numbers[lines],
            channel=np.full(len(lines), self.channel.number, np.int16),
            can_id=ids.astype(np.uint32),
            extended=np.full(len(lines), self.extended),
            length=length.astype(np.uint8),
            data=data[:, :width],
        )
        return part, bad

    def _time_us(self, heads: Words) -> Integers:
        low = min(self._key.seconds, 8)
        high = self._key.seconds - low
        seconds = _decimal(heads, 1 + high, low)
        if high:
            # in the first word; alike for years
            some = heads[:1] if _all_alike(heads[:, 0]) else heads
            seconds += _decimal(some, 1, high) * 10**8
        digits = min(self._key.fraction, 6)
        fraction = _decimal(heads, self._key.seconds + 2, digits)
        time_us: Integers = seconds * 10**6 + fraction * 10 ** (6 - digits)
        return time_us

    def _tally(self, ids: Integers) -> tuple[Integers, Integers]:
        if self.extended:
            found, counts = np.unique(ids, return_counts=True)
            return found, counts.astype(np.int64)
        counts = np.bincount(ids).astype(np.int64)
        found = np.flatnonzero(counts).astype(np.int64)
        return found, counts[found]


def _all_alike(words: Words) -> bool:
    """Whether all *words* are the same; few have to be looked at if not."""
    if not len(words) or words[0] != words[-1]:
        return False
    return bool(np.equal(words, words[0]).all())


def _field(records: Words, at: int, kind: str) -> npt.NDArray[Any]:
    """Return the number of *kind* that starts at byte *at* of each record."""
    if not len(records):
        return np.empty(0, kind)
    stride = records.shape[1] * 8
    return np.ndarray((len(records),), kind, records.data, at, (stride,))


def _rows(records: Words, rows: Integers) -> Words:
    """Return *rows* of *records*, each copied as one item."""
    if records.shape[1] == 1:
        return records.take(rows, axis=0)
    items = records.view(np.dtype((np.void, records.shape[1] * 8)))[:, 0]
    return items[rows].view("<u8").reshape(len(rows), records.shape[1])


def _from_hex(words: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Replace each hex digit by its value, any other byte by 0x80."""
    text = words.tobytes().translate(_HEX)
    return np.frombuffer(text, words.dtype).reshape(words.shape)


def _payloads(
    digits: Words, length: Integers
) -> tuple[npt.NDArray[np.uint8], Flags]:
    """Return the bytes (n, 4 * words) of pairs of hex *digits* (n, words).

    Bytes beyond *length* (n,) are zero. Also returns in which rows a byte
    within it is none.
    """
    pairs = _from_hex(digits).view("<u2")
    size = pairs.shape[1]
    invalid = np.not_equal(pairs & 0x8080, 0).view("<u8")
    pairs = pairs * np.uint16(1 + (1 << 12))
    pairs >>= 8
    data = pairs.astype(np.uint8)
    if length.min() < size:
        kept = _rows(PREFIX_MASKS[size], length)
        data.view("<u8")[:] &= kept
        invalid &= kept
    if invalid.shape[1] == 1:
        return data, np.not_equal(invalid[:, 0], 0)
    return data, np.bitwise_or.reduce(invalid, axis=1) != 0


def _decimal(records: Words, at: int, digits: int) -> Integers:
    """Return the number in the *digits* (1 to 8) digits from byte *at* on.

    All digits of a word at once: pairs, then fours, then eight.
    """
    word = _field(records, at, "<u8") << (8 * (8 - digits))
    word &= 0x0F0F0F0F0F0F0F0F
    word = ((word * (10 * 2**8 + 1)) >> 8) & 0x00FF00FF00FF00FF
    word = ((word * (100 * 2**16 + 1)) >> 16) & 0x0000FFFF0000FFFF
    word = (word * (10000 * 2**32 + 1)) >> 32
    return word.astype(np.int64)

"""Lines of logs and rows of tables, and what may happen to them on a disk."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from random import Random

LINE_LENGTH: Final = 16384
"""What a reader keeps of a line; longer ones are made now and then."""

_NUMBER: Final = re.compile(rb"[0-9]+")
_EDGES: Final = (
    b"0/:@G`gAaFf9#.)( RT\r\t\0\x0b\x0c\x1a\x1c\x85\xa0\xb2\xff\x80_,;|\"'+-eE"
)
_ENDS: Final = (b"\r\n", b"\n\r", b"\r", b"\n\n", b"\0\n", b"\x0b", b"")
_HUGE: Final = (
    *(b"9" * digits for digits in (12, 13, 19, 20, 40, 400)),
    *(b"0" * 30, b"-1", b"1e308", b"1e309", b"-1e400", b"1e-400"),
    *(b"nan", b"-nan", b"+inf", b"1_000", b"0x1F", b"1,5", b"4e18"),
    *(str(1 << 63).encode(), str(-(1 << 63)).encode()),
    *("\u0665\u0666".encode(), "\uff11".encode(), "\u00bd".encode()),
)
_FD_BYTES: Final = (0, 1, 7, 8, 12, 16, 20, 24, 32, 48, 64, 9)
_INTERFACES: Final = (b"can0", b"can0", b"can0", b"can1", b"vcan-x.7")
_IDS: Final = (
    b"100",
    b"1A0",
    b"7ff",
    b"00000100",
    b"18FF0102",
    b"110",
    b"1B0",
)


def candump_line(rng: Random) -> bytes:
    """Return a line as candump writes it, with its newline."""
    if rng.random() < 0.02:
        return rng.choice(
            (b"\n", b"# comment\n", b"DROPCOUNT: dropped 3 CAN frames\n")
        )
    fraction = b"%06d" % rng.randrange(1_000_000)
    if rng.random() < 0.1:
        fraction += b"%03d" % rng.randrange(1000)
    can_id, payload = rng.choice(_IDS), _payload(rng)
    if payload == b"xl":
        can_id = b"45123"
        payload = b"81:00:12345678#" + rng.randbytes(12).hex().encode()
    elif payload == b"error":
        can_id, payload = b"20000004", b"0004000000000000"
    end = rng.choice((b"", b"", b"", b"", b" R", b" T", b"\r"))
    return b"(%d.%s) %s %s#%s%s\n" % (
        1_600_000_000 + rng.randrange(10_000),
        fraction,
        rng.choice(_INTERFACES),
        can_id,
        payload,
        end,
    )


def _payload(rng: Random) -> bytes:
    kind = rng.random()
    if kind < 0.7:
        return rng.randbytes(8).hex().upper().encode()
    if kind < 0.8:
        return rng.randbytes(rng.randrange(9)).hex().encode()
    if kind < 0.9:
        return b"#5" + rng.randbytes(rng.choice(_FD_BYTES)).hex().encode()
    return rng.choice(
        (
            b"R",
            b"R8",
            b"r8_9",
            b"11.22",
            b"1122334455667788_A",
            b"xl",
            b"error",
        )
    )


def table_row(rng: Random, number: int, delimiter: bytes) -> bytes:
    """Return row *number* of a table of five columns, with its newline."""
    cells = [
        b"%.3f" % (number * 0.02),
        b"%.2f" % rng.uniform(0, 200),
        b"%.1f" % rng.uniform(-1, 120),
        rng.choice((b"0", b"1", b"true", b"")),
        rng.choice((b"x", b'"a, b"', b"", b"12")),
    ]
    return delimiter.join(cells) + rng.choice((b"\n", b"\n", b"\r\n"))


def mutated(line: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """Return *line* with one to four changes, never as it was."""
    changed = line
    while changed == line:
        for _ in range(rng.choice((1, 1, 1, 2, 4))):
            change = rng.choice(_CHANGES)
            changed = change(changed, rng.choice(others), rng)
    return changed


def _flip_bit(line: bytes, _: bytes, rng: Random) -> bytes:
    if not line:
        return line
    at = rng.randrange(len(line))
    flipped = line[at] ^ (1 << rng.randrange(8))
    return line[:at] + bytes([flipped]) + line[at + 1 :]


def _set_edge(line: bytes, _: bytes, rng: Random) -> bytes:
    at = rng.randrange(len(line) + 1)
    return line[:at] + bytes([rng.choice(_EDGES)]) + line[at + 1 :]


def _delete(line: bytes, _: bytes, rng: Random) -> bytes:
    at = rng.randrange(len(line) + 1)
    return line[:at] + line[at + rng.choice((1, 1, 2, 3, 10, 100)) :]


def _insert(line: bytes, _: bytes, rng: Random) -> bytes:
    at = rng.randrange(len(line) + 1)
    if rng.random() < 0.5:
        new = bytes(rng.choices(_EDGES, k=rng.randrange(1, 4)))
    else:
        new = rng.randbytes(rng.choice((1, 2, 5, 40)))
    return line[:at] + new + line[at:]


def _double(line: bytes, _: bytes, rng: Random) -> bytes:
    at = rng.randrange(len(line) + 1)
    part = line[at : at + rng.randrange(1, 20)]
    times = LINE_LENGTH // 8 if rng.random() < 0.002 else rng.randrange(1, 4)
    return line[:at] + part * times + line[at:]


def _splice(line: bytes, other: bytes, rng: Random) -> bytes:
    at, from_ = rng.randrange(len(line) + 1), rng.randrange(len(other) + 1)
    return line[:at] + other[from_:]


def _huge_number(line: bytes, _: bytes, rng: Random) -> bytes:
    numbers = list(_NUMBER.finditer(line))
    if not numbers:
        return line + rng.choice(_HUGE)
    start, end = rng.choice(numbers).span()
    return line[:start] + rng.choice(_HUGE) + line[end:]


def _other_end(line: bytes, _: bytes, rng: Random) -> bytes:
    return line.rstrip(b"\r\n") + rng.choice(_ENDS)


def _binary(line: bytes, _: bytes, rng: Random) -> bytes:
    noise = rng.randbytes(rng.randrange(1, 60))
    return noise + b"\n" if line else noise


def _other_case(line: bytes, _: bytes, __: Random) -> bytes:
    return line.swapcase()


_CHANGES: Final[tuple[Callable[[bytes, bytes, Random], bytes], ...]] = (
    *(_flip_bit, _flip_bit, _set_edge, _set_edge, _delete, _insert),
    *(_double, _splice, _huge_number, _other_end, _binary, _other_case),
)

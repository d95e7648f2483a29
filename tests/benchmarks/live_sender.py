"""Pace recorded frames into sockets: a program of its own.

``live_sender.py FRAMES SECONDS FD[w] ...``: the frames of FRAMES (see
:func:`pack_frames`), again and again for SECONDS, each at its time, into all
sockets; those marked ``w`` get the wanted frames only. Begins at the line
``go`` on standard input and writes the number sent and the latest it was.
"""

from __future__ import annotations

import re
import socket
import struct
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection

_RECORD = struct.Struct("=Q?16s")
"""Offset from the start [us], whether wanted, ``can_frame``."""
_FRAME = struct.Struct("=IB3x8s")
_LINE = re.compile(rb"\((\d+)\.(\d{6})\) \S+ ([0-9A-F]+)#([0-9A-F]*)\n")


def pack_frames(log: bytes, wanted: Collection[int]) -> bytes:
    """Return the frames of candump text *log* as the sender reads them."""
    records = []
    start_us = None
    for seconds, micros, word, text in _LINE.findall(log):
        stamp_us = int(seconds) * 1_000_000 + int(micros)
        start_us = stamp_us if start_us is None else start_us
        can_id, data = int(word, 16), bytes.fromhex(text.decode())
        frame = _FRAME.pack(can_id, len(data), data)
        records.append(
            _RECORD.pack(stamp_us - start_us, can_id in wanted, frame)
        )
    return b"".join(records)


def send(path: Path, seconds: float, ends: dict[socket.socket, bool]) -> None:
    """Pace the frames of *path* into *ends*, True for the wanted only."""
    records = [
        (offset_us * 1e-6, is_wanted, frame)
        for offset_us, is_wanted, frame in _RECORD.iter_unpack(
            path.read_bytes()
        )
    ]
    everything = [end for end, only in ends.items() if not only]
    both = list(ends)
    sys.stdin.readline()
    start_s = time.monotonic()
    sent, latest_s, index = 0, 0.0, 0
    while True:
        if index == len(records):
            start_s, index = start_s + records[-1][0], 0
            seconds -= records[-1][0]
        offset_s, is_wanted, frame = records[index]
        if offset_s > seconds:
            break
        wait_s = start_s + offset_s - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)
        elif wait_s < -latest_s:
            latest_s = -wait_s
        for end in tuple(both if is_wanted else everything):
            try:
                end.send(frame)
            except (BrokenPipeError, ConnectionResetError):
                # that reader has had enough
                both.remove(end)
                if end in everything:
                    everything.remove(end)
        sent += 1
        index += 1
    sys.stdout.write(f"{sent} {latest_s:.6f}\n")


def main() -> None:
    """Send as the command line says."""
    path, seconds, *places = sys.argv[1:]
    send(
        Path(path),
        float(seconds),
        {
            socket.socket(fileno=int(place.rstrip("w"))): place.endswith("w")
            for place in places
        },
    )


if __name__ == "__main__":
    main()

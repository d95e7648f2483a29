"""The board as lines of text."""

import time
from contextlib import AbstractContextManager
from math import isfinite, isnan
from typing import Final, TextIO

from bstm_daemon.watch.board import NODES, SECOND_US, STATUS, Board
from bstm_daemon.watch.terminal_text import visible

LABELS: Final = dict(
    zip(NODES, ("disc", "pad front", "pad back", "fluid"), strict=True)
)


class LineView(AbstractContextManager["LineView"]):
    """One line of ``key=value`` per second of the board's time."""

    def __init__(self, stream: TextIO) -> None:
        """Write to *stream*."""
        self._stream = stream
        self._second: int | None = None

    @property
    def has_left(self) -> bool:
        """Whether the user wants to leave: never, in a view of lines."""
        return False

    def show(
        self, board: Board, now_us: int, source: str, *, at_once: bool = False
    ) -> None:
        """Show *board* at its time *now_us*, unless it was just shown.

        *source* says where the frames come from; *at_once* shows it anyway.
        """
        second = now_us // SECOND_US
        if second == self._second and not at_once:
            return
        self._second = second
        self._stream.write(f"{text_line(board, now_us, source)}\n")
        self._stream.flush()

    def pause(self, seconds: float) -> None:
        """Wait, but not longer than the user wants to stay."""
        time.sleep(seconds)

    def linger(self) -> None:
        """Stay until the user leaves, where there is one."""

    def __exit__(self, *error: object) -> None:
        """Leave the stream open: it is the caller's."""


def number(value: float, form: str = ".1f") -> str:
    """Return *value* as shown: ``-`` is unknown, ``error`` not a number."""
    if isnan(value):
        return "-"
    return format(value, form) if isfinite(value) else "error"


def text_line(board: Board, now_us: int, source: str) -> str:
    """Return the board as ``key=value`` pairs, ``-`` for what is unknown.

    Times are in seconds, temperatures in degC, the margin in K.
    """
    pairs = [("t_s", f"{now_us / SECOND_US:.1f}"), ("source", visible(source))]
    is_silent = board.silence_s(STATUS, now_us) is not None
    if not board.has_frames or board.wrong_layout is not None:
        pairs.append(("state", "none"))
    else:
        state = "silent" if is_silent else board.state.name.lower()
        substituted = board.is_set("HeatSubstituted")
        pairs += [
            ("state", state),
            ("heat", board.heat_mode.name.lower()),
            ("stale", ",".join(board.stale_inputs) or "-"),
            ("inputs", "suspect" if board.is_set("InputSuspect") else "sound"),
            ("heat_from", "substitute" if substituted else "own"),
            ("unverified", ",".join(board.unverified.words) or "-"),
        ]
        for name in board.corners:
            pairs += _of_corner(board, now_us, name)
    return " ".join(f"{key}={value}".replace(" ", "_") for key, value in pairs)


def _of_corner(board: Board, now_us: int, name: str) -> list[tuple[str, str]]:
    frame = f"BSTM_{name}_Temperatures"
    silent = board.silence_s(frame, now_us) is not None
    margin_k = board.value(f"BSTM_{name}_Risk", "Margin")
    validity = board.validity(frame).name.lower()
    return [
        *(
            (f"{name}.{label}_c", number(board.value(frame, node)))
            for node, label in LABELS.items()
        ),
        (f"{name}.margin_k", number(margin_k)),
        (f"{name}.risk", board.risk(name).name.lower()),
        (f"{name}.validity", "silent" if silent else validity),
        (f"{name}.reasons", ",".join(board.reasons(name).words) or "-"),
    ]

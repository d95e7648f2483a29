"""The board as lines of a screen of given size."""

from __future__ import annotations

from math import isfinite, isnan
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.output_layout import (
    LAYOUT_VERSION,
    RiskLevel,
    State,
    Validity,
)
from bstm_daemon.watch.board import NODES
from bstm_daemon.watch.history import BARS, HISTORY_S, sparkline
from bstm_daemon.watch.styled import (
    Line,
    Span,
    beside,
    fitted,
    flowed,
    length,
)

if TYPE_CHECKING:
    from bstm_daemon.watch.board import Board

STATUS: Final = "BSTM_Status"

TWO_COLUMNS: Final = 72
"""Cells from which on the axles have left and right side by side."""

LABELS: Final = dict(
    zip(NODES, ("disc", "pad front", "pad back", "fluid"), strict=True)
)

_RISK_STYLES: Final = {
    RiskLevel.NORMAL: "good",
    RiskLevel.ELEVATED: "warning",
    RiskLevel.HIGH: "bad",
    RiskLevel.CRITICAL: "alarm",
    RiskLevel.UNKNOWN: "faint",
}
_VALIDITY_STYLES: Final = {
    Validity.VALID: "good",
    Validity.DEGRADED: "warning",
    Validity.INVALID: "bad",
    Validity.NOT_AVAILABLE: "faint",
}
_STATE_STYLES: Final = {
    State.RUNNING: "good",
    State.STARTING: "warning",
    State.DEGRADED: "warning",
    State.NO_INPUT: "bad",
    State.STOPPING: "bad",
    State.NOT_AVAILABLE: "faint",
}
_AXLES: Final = (("FL", "FR"), ("RL", "RR"))


def picture(
    board: Board,
    now_us: int,
    source: str,
    width: int,
    height: int,
    bars: str = BARS,
) -> list[Line]:
    """Return at most *height* lines of exactly *width* cells.

    *source* says where the frames come from; times are those of the board
    [us]. What there is no room for gives way in this order: blank lines,
    the forecast, histories, what is below the screen.
    """
    head, foot = _head(board, now_us, source, width), _foot(width)
    if board.wrong_layout is not None:
        middle = _wrong_layout(board.wrong_layout, width)
    elif not board.has_frames:
        middle = _nothing(board, width)
    else:
        room = height - len(head) - len(foot)
        middle = _corners(board, now_us, width, room, bars)
    # on a screen of a few lines the corners are what is looked for
    head = head[: max(height - len(middle) - len(foot), 1)]
    if len(head) + len(middle) + len(foot) < height:
        head = [*head, ()]
    lines = [*head, *middle][: height - len(foot)]
    lines += [()] * (height - len(lines) - len(foot))
    return [fitted(line, width) for line in [*lines, *foot][:height]]


def number(value: float, form: str = ".1f") -> str:
    """Return *value* as it is shown: ``-`` unknown, ``error`` no number."""
    if isnan(value):
        return "-"
    return format(value, form) if isfinite(value) else "error"


def words(name: str) -> str:
    """Return the *name* of an enumeration's value as it is shown."""
    return name.lower().replace("_", " ")


def _head(board: Board, now_us: int, source: str, width: int) -> list[Line]:
    doing, inputs = [Span("bstm", "strong")], []
    if board.has_frames and board.wrong_layout is None:
        doing += _doing(board, now_us)
        inputs = _inputs(board)
    lines = flowed(doing, width)
    # a file name may hold anything, also what a terminal obeys
    shown = "".join(c if c.isprintable() else "?" for c in source)
    free = width - length(lines[0])
    if free >= len(shown) + 2:
        blank = Span(" " * (free - len(shown)))
        lines[0] = (*lines[0], blank, Span(shown, "faint"))
    else:
        words_of_it = [Span(word, "faint") for word in shown.split(" ")]
        lines = [*flowed(words_of_it, width, " "), *lines]
    return [*lines, *flowed(inputs, width)]


def _doing(board: Board, now_us: int) -> list[Span]:
    silence_s = board.silence_s(STATUS, now_us)
    state = board.state
    if silence_s is not None:
        last = "silent for" if state is not State.STOPPING else "stopped since"
        spans = [Span(f"{last} {silence_s:.0f} s", "bad")]
    else:
        spans = [Span(words(state.name), _STATE_STYLES[state])]
    spans.append(Span(f"heat {words(board.heat_mode.name)}"))
    if board.has_substituted_heat:
        spans.append(Span("heat substituted or unknown", "warning"))
    if board.value(STATUS, "HistoryKnown") == 1:
        spans.append(Span("history known"))
    else:
        spans.append(Span("history unknown", "warning"))
    if board.value(STATUS, "CompiledKernel") == 0:
        spans.append(Span("Python kernel"))
    if board.value(STATUS, "ClockJump") == 1:
        spans.append(Span("clock jumped", "warning"))
    return spans


def _inputs(board: Board) -> list[Span]:
    stale = board.stale_inputs
    spans = [
        Span(f"stale: {', '.join(stale)}", "bad")
        if stale
        else Span("inputs fresh"),
        Span(f"oldest {number(board.value(STATUS, 'OldestInputAge'))} s"),
    ]
    if board.has_suspect_input:
        spans.insert(1, Span("an input is suspect", "warning"))
    for label in ("Rejected", "Dropped"):
        count = board.value(STATUS, f"{label}Frames")
        style = "warning" if count > 0 else "plain"
        spans.append(Span(f"{label.lower()} {number(count, '.0f')}", style))
    if board.refused:
        spans.append(Span(f"bad frames here {board.refused}", "warning"))
    return spans


def _foot(width: int) -> list[Line]:
    minutes = HISTORY_S // 60
    long = f"degC; {minutes} min of each, the highest at the right end"
    text = long if width >= len(long) + 11 else f"degC, {minutes} min"
    blank = " " * max(width - len(text) - 8, 1)
    return [(Span(f"{text}{blank}q leaves", "faint"),)]


def _wrong_layout(version: int, width: int) -> list[Line]:
    text = (
        f"frames of layout {version}, this program reads layout "
        f"{LAYOUT_VERSION}: no values shown"
    )
    return flowed([Span(word, "bad") for word in text.split()], width, " ")


def _nothing(board: Board, width: int) -> list[Line]:
    text = (
        f"no frame yet with an id from 0x{board.ids[0]:X} to "
        f"0x{board.ids[-1]:X}: does a daemon with [publish] enabled = true "
        f"send on this bus?"
    )
    if board.refused:
        text = f"{board.refused} frames with our ids, none of them ours"
    return flowed([Span(word) for word in text.split()], width, " ")


def _corners(
    board: Board, now_us: int, width: int, room: int, bars: str
) -> list[Line]:
    has_two = width >= TWO_COLUMNS and {name[1] for name in board.corners} == {
        "L",
        "R",
    }
    cell = (width - 2) // 2 if has_two else width
    blocks = {
        name: _block(board, now_us, name, cell, bars) for name in board.corners
    }
    deep = len(_AXLES) if has_two else len(blocks)
    if deep * (2 + len(NODES)) > room:
        blocks = {name: block[:-1] for name, block in blocks.items()}
    rows = []
    if has_two:
        blank = [fitted((), cell)] * max(map(len, blocks.values()))
        for left, right in _AXLES:
            if left in blocks or right in blocks:
                rows.append(
                    beside(blocks.get(left, blank), blocks.get(right, blank))
                )
    else:
        rows = list(blocks.values())
    tall = sum(len(row) for row in rows)
    if tall > room:
        return [_short(board, now_us, name) for name in board.corners]
    # one more below the head
    between: list[Line] = [()] if tall + len(rows) <= room else []
    lines: list[Line] = []
    for row in rows:
        lines += [*(between if lines else []), *row]
    return lines


def _block(
    board: Board, now_us: int, corner: str, width: int, bars: str
) -> list[Line]:
    frame = f"BSTM_{corner}_Temperatures"
    estimate, usable = _validity(board, now_us, corner)
    title: Line = (Span(f"{corner} ", "strong"), estimate)
    if board.silence_s(frame, now_us) is None:
        risk = board.risk(corner)
        margin_k = board.value(f"BSTM_{corner}_Risk", "Margin")
        title = (
            *title,
            Span("  risk "),
            Span(words(risk.name), _RISK_STYLES[risk]),
            Span(f"  margin {number(margin_k, '.0f')} K"),
        )
    lines = [fitted(title, width)]
    for node in NODES:
        value = board.value(frame, node)
        columns = board.history(corner, node).columns(
            now_us, max(width - 24, 1)
        )
        highest = max((c for c in columns if isfinite(c)), default=None)
        peak = "" if highest is None else f"{highest:.0f}"
        lines.append(
            fitted(
                (
                    Span(f"{LABELS[node]:9} "),
                    Span(
                        f"{number(value):>6} ",
                        "strong" if usable else "faint",
                    ),
                    Span(sparkline(columns, bars)),
                    Span(f" {peak:>5}", "faint"),
                ),
                width,
            )
        )
    return [*lines, fitted(_parked(board, corner, now_us), width)]


def _parked(board: Board, corner: str, now_us: int) -> Line:
    """Word what the fluid will do if the car parks now."""
    frame = f"BSTM_{corner}_Forecast"
    peak_c = board.value(frame, "Peak")
    if board.silence_s(frame, now_us) is not None or not isfinite(peak_c):
        return (Span(f"{'parked':9} {'-':>6} ", "faint"),)
    age_s = board.value(frame, "Age")
    left_s = max(board.value(frame, "PeakIn") - age_s, 0.0)
    percent = board.value(f"BSTM_{corner}_Risk", "Probability")
    return (
        Span(f"{'parked':9} "),
        Span(f"{number(peak_c):>6} ", "strong"),
        Span(f"in {number(left_s / 60.0, '.0f')} min, vapour "),
        Span(f"{number(percent)} %", _RISK_STYLES[board.risk(corner)]),
    )


def _validity(board: Board, now_us: int, corner: str) -> tuple[Span, bool]:
    """Word whether the temperatures may be used, and say it."""
    frame = f"BSTM_{corner}_Temperatures"
    silence_s = board.silence_s(frame, now_us)
    if silence_s is not None:
        return Span(f"silent for {silence_s:.0f} s", "bad"), False
    validity = board.validity(frame)
    usable = validity in (Validity.VALID, Validity.DEGRADED)
    is_there = validity is not Validity.NOT_AVAILABLE
    text = words(validity.name) if is_there else "no value"
    return Span(text, _VALIDITY_STYLES[validity]), usable


def _short(board: Board, now_us: int, corner: str) -> Line:
    disc, front, back, fluid = (
        number(board.value(f"BSTM_{corner}_Temperatures", node), ".0f")
        for node in NODES
    )
    risk = board.risk(corner)
    margin = number(board.value(f"BSTM_{corner}_Risk", "Margin"), ".0f")
    estimate, _ = _validity(board, now_us, corner)
    return (
        Span(f"{corner} ", "strong"),
        Span(f"{words(risk.name)} {margin} K", _RISK_STYLES[risk]),
        Span(f" disc {disc} pad {front}/{back} fluid {fluid} "),
        estimate,
    )

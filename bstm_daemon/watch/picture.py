"""The board as a picture that rich draws."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isfinite
from typing import Final

from rich.console import (
    Console,
    ConsoleOptions,
    Group,
    RenderableType,
    RenderResult,
)
from rich.layout import Layout
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from bstm_daemon.bus.output.layout import LAYOUT_VERSION
from bstm_daemon.estimate import RiskLevel, State, Validity
from bstm_daemon.watch.board import (
    BARS,
    HISTORY_S,
    NODES,
    STATUS,
    Board,
    History,
    sparkline,
)
from bstm_daemon.watch.lines import LABELS, number
from bstm_daemon.watch.terminal_text import visible

_RISK_STYLES: Final = {
    RiskLevel.NORMAL: "green",
    RiskLevel.ELEVATED: "yellow",
    RiskLevel.HIGH: "red",
    RiskLevel.CRITICAL: "bold white on red",
    RiskLevel.UNKNOWN: "dim",
}
_VALIDITY_STYLES: Final = {
    Validity.VALID: "green",
    Validity.DEGRADED: "yellow",
    Validity.INVALID: "red",
    Validity.NOT_AVAILABLE: "dim",
}
_STATE_STYLES: Final = {
    State.RUNNING: "green",
    State.STARTING: "yellow",
    State.DEGRADED: "yellow",
    State.NO_INPUT: "red",
    State.STOPPING: "red",
    State.NOT_AVAILABLE: "dim",
}


def picture(
    board: Board, now_us: int, source: str, console: Console, bars: str = BARS
) -> Layout:
    """Return what fills the screen of *console*.

    Args:
        board: what the car published.
        now_us: its time [us].
        source: where the frames come from.
        console: gives width and height.
        bars: characters of the histories, the lowest first.
    """
    parts = _head(board, now_us, source)
    head = Text("  ").join(Text(text, style) for text, style in parts)
    head_lines = len(head.wrap(console, console.width))
    body: RenderableType
    if board.wrong_layout is not None:
        wrong = (
            f"frames of layout {board.wrong_layout}, this program reads "
            f"layout {LAYOUT_VERSION}: no values shown"
        )
        body = Text(wrong, "red")
    elif not board.has_frames:
        body = Text(_no_frames(board))
    else:
        # heading, estimate, risk, two a node, forecast in up to three, foot
        rows = 3 + 2 * len(NODES) + 3 + 1
        rows += max(
            (len(board.reasons(c).words) for c in board.corners), default=0
        )
        has_room = head_lines + rows <= console.height
        body = _corners(board, now_us, bars if has_room else "")
    screen = Layout()
    screen.split_column(
        Layout(head, size=head_lines), Layout(body), Layout(_foot(), size=1)
    )
    return screen


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


def _head(board: Board, now_us: int, source: str) -> list[tuple[str, str]]:
    parts = [("bstm", "bold"), (visible(source), "dim")]
    if not board.has_frames or board.wrong_layout is not None:
        return parts
    silence_s = board.silence_s(STATUS, now_us)
    state = board.state
    if silence_s is not None:
        last = "stopped" if state is State.STOPPING else "silent"
        parts.append((f"{last} for {silence_s:.0f} s", "red"))
    else:
        parts.append((_words(state.name), _STATE_STYLES[state]))
    parts.append((f"heat {_words(board.heat_mode.name)}", ""))
    if board.is_set("HeatSubstituted"):
        parts.append(("heat substituted or unknown", "yellow"))
    known = board.is_set("HistoryKnown")
    parts.append(
        ("history known", "")
        if known
        else ("history unknown: risk at most as shown", "yellow")
    )
    if board.value(STATUS, "CompiledKernel") == 0:
        parts.append(("Python kernel", ""))
    if board.is_set("ClockJump"):
        parts.append(("clock jumped", "yellow"))
    stale = ", ".join(board.stale_inputs)
    parts.append((f"stale: {stale}", "red") if stale else ("inputs fresh", ""))
    if board.is_set("InputSuspect"):
        parts.append(("an input is suspect", "yellow"))
    if board.unverified:
        inputs = ", ".join(board.unverified.words)
        parts.append((f"unverified: {inputs}", "yellow"))
    oldest_s = board.value(STATUS, "OldestInputAge")
    parts.append((f"oldest {number(oldest_s)} s", ""))
    for label in ("Rejected", "Dropped"):
        count = board.value(STATUS, f"{label}Frames")
        style = "yellow" if count > 0 else ""
        parts.append((f"{label.lower()} {number(count, '.0f')}", style))
    if board.rejected:
        parts.append((f"bad frames here {board.rejected}", "yellow"))
    return parts


def _no_frames(board: Board) -> str:
    if board.rejected:
        return f"{board.rejected} frames with these ids from another sender"
    return (
        f"no frame yet with an id from 0x{board.ids[0]:X} to "
        f"0x{board.ids[-1]:X}: does a daemon with [publish] enabled = true "
        "send on this bus?"
    )


def _foot() -> Table:
    foot = Table.grid(expand=True)
    foot.add_column(ratio=1, no_wrap=True, overflow="crop", style="dim")
    foot.add_column(no_wrap=True, overflow="crop", style="dim")
    minutes = HISTORY_S // 60
    foot.add_row(f"degC; {minutes} min of each and the highest", "q leaves")
    return foot


def _corners(board: Board, now_us: int, bars: str) -> Table:
    """Return a column for each corner, with histories if there are *bars*."""
    table = Table(box=None, expand=True, pad_edge=False, header_style="bold")
    table.add_column(no_wrap=True, overflow="crop")
    for corner in board.corners:
        table.add_column(corner, ratio=1, min_width=6, overflow="fold")
    cells: dict[str, Callable[[Board, int, str], RenderableType]] = {
        "estimate": _estimate,
        "risk": _risk,
        **{
            label: partial(_temperature, node=node, bars=bars)
            for node, label in LABELS.items()
        },
        "parked": _forecast,
    }
    for label, cell in cells.items():
        table.add_row(label, *(cell(board, now_us, c) for c in board.corners))
    return table


def _estimate(board: Board, now_us: int, corner: str) -> Text:
    """Word how far the temperatures can be used."""
    frame = f"BSTM_{corner}_Temperatures"
    silence_s = board.silence_s(frame, now_us)
    if silence_s is not None:
        return Text(f"silent for {silence_s:.0f} s", "red")
    validity = board.validity(frame)
    absent = validity is Validity.NOT_AVAILABLE
    text = "no value" if absent else _words(validity.name)
    style = _VALIDITY_STYLES[validity]
    return Text("\n", style).join(
        Text(line, style) for line in (text, *board.reasons(corner).words)
    )


def _risk(board: Board, now_us: int, corner: str) -> Text:
    """Word risk and margin, nothing while the temperatures are silent."""
    if board.silence_s(f"BSTM_{corner}_Temperatures", now_us) is not None:
        return Text("-", "dim")
    risk = board.risk(corner)
    margin = number(board.value(f"BSTM_{corner}_Risk", "Margin"), ".0f")
    return Text.assemble(
        (_words(risk.name), _RISK_STYLES[risk]), f" {margin} K"
    )


def _temperature(
    board: Board, now_us: int, corner: str, *, node: str, bars: str
) -> Group:
    frame = f"BSTM_{corner}_Temperatures"
    good = board.validity(frame) in (Validity.VALID, Validity.DEGRADED)
    is_usable = good and board.silence_s(frame, now_us) is None
    style = "bold" if is_usable else "dim"
    value = Text(number(board.value(frame, node)), style)
    if not bars:
        return Group(value)
    return Group(value, _Sparkline(board.history(corner, node), now_us, bars))


def _forecast(board: Board, now_us: int, corner: str) -> Text:
    """Word what the fluid will do if the car parks now."""
    frame = f"BSTM_{corner}_Forecast"
    peak_c = board.value(frame, "Peak")
    if board.silence_s(frame, now_us) is not None or not isfinite(peak_c):
        return Text("-", "dim")
    left_s = max(board.value(frame, "PeakIn") - board.value(frame, "Age"), 0.0)
    percent = board.value(f"BSTM_{corner}_Risk", "Probability")
    return Text.assemble(
        (number(peak_c), "bold"),
        f" in {number(left_s / 60.0, '.0f')} min, vapour ",
        (f"{number(percent)} %", _RISK_STYLES[board.risk(corner)]),
    )


@dataclass(frozen=True, slots=True)
class _Sparkline:
    """A history and its highest value, as wide as the cell."""

    history: History
    now_us: int
    bars: str

    def __rich_console__(
        self, console: Console, options: ConsoleOptions
    ) -> RenderResult:
        (peak,) = self.history.columns(self.now_us, 1)
        highest = f" {peak:.0f}" if isfinite(peak) else ""
        width = options.max_width - len(highest)
        columns = self.history.columns(self.now_us, max(width, 1))
        yield Text.assemble(sparkline(columns, self.bars), (highest, "dim"))

    def __rich_measure__(
        self, console: Console, options: ConsoleOptions
    ) -> Measurement:
        return Measurement(1, options.max_width)

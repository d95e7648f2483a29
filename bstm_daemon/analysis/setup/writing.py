"""A proposal as the text of a complete configuration file."""

import json
import os
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from string import Template
from typing import Final

from bstm_daemon.analysis.setup.proposal import (
    TYPICAL_RADIUS_M,
    Candidate,
    Proposal,
)
from bstm_daemon.analysis.setup.recording import Recording
from bstm_daemon.errors import ConfigError
from bstm_daemon.roles import ROLE_INDEX, ROLES
from bstm_daemon.units import UNITS

_TEMPLATE: Final = Path(__file__).parent / "_data" / "typical.toml"
_WIDTH: Final = 79
_MISSED_FRAMES: Final = 5
_IDS_SHOWN: Final = 24
_FEED_FORWARD: Final = """\
[heat]
mode = "auto"                 # pressure, and motion where all is mapped
brake_on_pressure_pa = 1.0e5  # Pa; typical, replace"""
_FEED_BACK: Final = """\
[heat]
mode = $mode # motion of the car: no sure pressure
brake_on_force_n = 300.0      # N; typical, replace"""
_ASSUMPTION: Final = """\
# No sure torque at the wheels, so an assumption: 0.0 = the car coasts while it
# brakes. Engine braking then counts as brake heat.
assume_powertrain_torque_nm = 0.0  # Nm; typical, replace"""
_BUS: Final = """\
[[bus]]
name = "car"
interface = "socketcan"
channel = $channel
# bitrate = 500000          # bit/s; a SocketCAN link is set up outside
dbc = $dbc
strict = $strict
encoding = $encoding
$ignored"""
_SPEEDS: Final = ("vehicle_speed", "wheel_speed_")


def configuration_text(
    proposal: Proposal,
    recording: Recording | None,
    *,
    origin: Path,
    source: str,
    notes: Iterable[str] = (),
    columns: Mapping[str, str] | None = None,
) -> str:
    """Return the configuration for *proposal*.

    Args:
        proposal: the roles.
        recording: what they were looked at in, None without a log.
        origin: the DBC or the table that they are of.
        source: the section of the bus or of the table.
        notes: what is not used or not explained, a sentence each.
        columns: of a table, the column of each signal.

    Raises:
        ConfigError: no signal can be the car's speed, no configuration would
            be complete.
    """
    sure, unsure = list(proposal.sure), list(proposal.unsure)
    if not any(one.role.startswith(_SPEEDS) for one in sure):
        speed = next(
            (
                one
                for one in unsure
                if one.role.startswith(_SPEEDS) and one.unit in UNITS
            ),
            None,
        )
        if speed is None:
            msg = (
                f"{origin}: no signal has name and unit of a speed, without "
                "one there is no estimate: write the configuration by hand"
            )
            raise ConfigError([msg])
        unsure.remove(speed)
        sure.insert(0, speed)
    blocks = [_active(one, _keys(one, columns)) for one in sure]
    if unsure:
        title = "Unsure. Remove the '#' where the role is right."
        blocks.append(_comment(title))
        blocks += [_inactive(one, _keys(one, columns)) for one in unsure]
    return Template(_TEMPLATE.read_text("utf-8")).substitute(
        head=_head(recording, origin, notes),
        vehicle=_text(origin.stem),
        radius=_radius(proposal),
        source=source,
        signals="\n\n".join(blocks),
        heat=_heat(proposal),
    )


def bus_section(
    recording: Recording | None,
    *,
    dbc: Path,
    folder: Path,
    strict: bool,
    encoding: str,
) -> str:
    """Return the section of the bus of *dbc*, as a file of *folder* has it."""
    return Template(_BUS).substitute(
        channel=_text(recording.interface if recording else "can0"),
        ignored=_ignored(recording),
        dbc=_text(Path(os.path.relpath(dbc, folder)).as_posix()),
        strict="true" if strict else "false             # it has defects",
        encoding=_text(encoding),
    )


def table_section(time: str) -> str:
    """Return the section of a table whose column *time* has the time."""
    return f"[table]\ntime = {_text(time)}"


def _head(
    recording: Recording | None, origin: Path, notes: Iterable[str]
) -> str:
    title = (
        f"Proposed by 'bstm init' from {origin.name}. What is marked "
        "'typical, replace' is no value of this car: estimates are an order "
        "of magnitude until it is. docs/reference.md explains every key."
    )
    lines = [title]
    if recording is None:
        lines.append(
            "No log was given: the signals are chosen by name and unit only, "
            "nothing is checked."
        )
        return "\n#\n".join(map(_comment, lines))
    where = f", interface {recording.interface}" if recording.interface else ""
    lines.append(
        f"The signals were looked at in {recording.duration_s:.0f} s of "
        f"log{where}."
    )
    lines += notes
    return "\n#\n".join(map(_comment, lines))


def notes_of(recording: Recording) -> list[str]:
    """Return what of the log the DBC does not explain, a sentence each."""
    notes = []
    if recording.unknown:
        shown = ", ".join(recording.unknown[:_IDS_SHOWN])
        more = len(recording.unknown) - _IDS_SHOWN
        tail = f" and {more} more" if more > 0 else ""
        notes.append(
            f"{len(recording.unknown)} ids in the log are not in the DBC: "
            f"{shown}{tail}."
        )
    notes += [
        f"Interface {name} was left out: {known} of its {ids} ids are in the "
        "DBC. It is a [[bus]] with ignore = true: no command needs --map."
        for name, (ids, known) in recording.others.items()
    ]
    return notes


def _radius(proposal: Proposal) -> str:
    if proposal.radius_m is None:
        return f"{TYPICAL_RADIUS_M:<10}  # m, rolling; typical, replace"
    return f"{proposal.radius_m:<10}  # m, rolling; from the speeds of the log"


def _ignored(recording: Recording | None) -> str:
    if recording is None or not recording.others:
        return ""
    return "".join(
        f"\n[[bus]]\nname = {_text(name)}\n"
        "ignore = true            # of the log, without a DBC\n"
        for name in recording.others
    )


def _active(one: Candidate, keys: list[str]) -> str:
    reason = one.reason if one.sure else f"UNSURE, check: {one.reason}"
    lines = [_comment(_sentence(reason))]
    if one.unread:
        lines.append(_comment(f"NOT READ: {one.unread}."))
    return "\n".join([*lines, *keys])


def _inactive(one: Candidate, keys: list[str]) -> str:
    marked = [f"# {line}" for line in keys]
    return "\n".join([_comment(f"? {_sentence(one.reason)}"), *marked])


def _keys(one: Candidate, columns: Mapping[str, str] | None) -> list[str]:
    message, signal = one.match.message.name, one.match.signal.name
    lines = [
        f"[signals.{one.role}]",
        *(
            [f"message = {_text(message)}", f"signal = {_text(signal)}"]
            if columns is None
            else [f"column = {_text(columns[signal])}"]
        ),
        f"unit = {_text(one.unit or '?')}",
    ]
    if one.scale != 1.0:
        lines.append(f"scale = {one.scale:g}")
    if one.sign != 1:
        lines.append(f"sign = {one.sign}")
    usual_s = ROLES[ROLE_INDEX[one.role]].timeout_s
    if one.rate_hz and _MISSED_FRAMES / one.rate_hz > usual_s:
        timeout_s = _MISSED_FRAMES / one.rate_hz
        lines.append(f"timeout_s = {timeout_s:.1f}")
    return lines


def _heat(proposal: Proposal) -> str:
    if proposal.ready("primary_pressure"):
        return _FEED_FORWARD
    # a pressure that is mapped but not read would be waited for
    waits = any(one.role == "primary_pressure" for one in proposal.sure)
    mode = '"fb"  ' if waits else '"auto"'
    text = Template(_FEED_BACK).substitute(mode=f"{mode:22}")
    if proposal.ready("powertrain_torque"):
        return text
    return f"{text}\n{_ASSUMPTION}"


def _comment(text: str) -> str:
    return textwrap.fill(
        text,
        _WIDTH,
        initial_indent="# ",
        subsequent_indent="# ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
